"""Diagnosis of the gap of a session."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from tissueid.gap import Diagnosis, diagnose, executor, prepare
from tissueid.gap.accepting import NamedEffects, named_effects
from tissueid.gap.twin_export import against_twin
from tissueid.instrument.twin_file import TwinFile, check_twin_writable, read_twin
from tissueid.language import marked
from tissueid.procedures.control import Control, counted
from tissueid.procedures.gap_plans import DiagnosisPlan
from tissueid.procedures.output_files import HTML, check_different, check_output, check_report, unwritable
from tissueid.sessions import Session, read_session

if TYPE_CHECKING:
    from tissueid.gap.search import SearchProgress, Work

STEPS: Mapping[Work, str] = {
    "baseline": marked("Fitting the baseline twin"),
    "screening": marked("Looking at every known effect"),
    "likeliest candidates": marked("Fitting the likeliest effects"),
    "candidates": marked("Fitting the other effects"),
    "leading candidates": marked("Fitting the leading effects to the end"),
    "further starting points": marked("Fitting from further starting points"),
    "further candidates": marked("Fitting further effects to the end"),
    "near relations": marked("Fitting near relations of what leads"),
    "tissue": marked("Fitting the effects of living tissue together"),
    "additions": marked("Fitting sets with one more effect"),
    "leading additions": marked("Fitting the leading sets to the end"),
    "removals": marked("Fitting the set without each effect"),
    "replacements": marked("Fitting other effects in place of each"),
    "leading replacements": marked("Fitting the leading replacements to the end"),
}
"""Text of each step of the search."""
_ENDS: frozenset[Work] = frozenset(
    {"leading candidates", "near relations", "leading additions", "leading replacements"}
)
_LAST = marked("Working out where, which and how far")
_READING = marked("Reading the session")


@dataclass(frozen=True)
class DiagnosedSession:
    """A diagnosis with the session and the baseline twin (None for the nominal one) from which it was made."""

    plan: DiagnosisPlan
    session: Session
    twin: TwinFile | None
    found: Diagnosis

    @property
    def named(self) -> NamedEffects:
        """What the diagnosis names for a twin."""
        return named_effects(self.found, self.session.session_id, self.twin)

    @property
    def report_html(self) -> str:
        """The report as HTML, in the language in force."""
        from tissueid.reports.gap import Origin, gap_html

        return gap_html(self.found, origin=Origin(self.session, self.plan.session))


def diagnose_session(plan: DiagnosisPlan, control: Control) -> DiagnosedSession:
    """Diagnose a session and write the report if one is named. Whether a twin can be saved is checked before.

    Raises:
        UnusableInputError: the session, the twin, a test number or a file cannot be used.
        CancelledError: the diagnosis was cancelled; nothing was written.
    """
    check_output(plan.report, HTML)
    check_different(plan.report, plan.twin_out)
    if plan.twin_out is not None:
        check_twin_writable(plan.twin_out)
    control.progress(None, _READING)
    twin = None if plan.twin is None else read_twin(plan.twin)
    session = read_session(plan.session)
    check_report(plan.report, session)
    dataset, known = against_twin(prepare(session, plan.fit, plan.check), twin)
    with executor(plan.workers) as pool:
        progress = functools.partial(show_search, control)
        found = diagnose(dataset, pool, known=known, progress=progress, cancelled=control.check)
    diagnosed = DiagnosedSession(plan, session, twin, found)
    if plan.report is not None:
        from tissueid.reports.html import write_text_atomically

        try:
            write_text_atomically(plan.report, diagnosed.report_html)
        except OSError as error:
            raise unwritable(plan.report, error) from error
    return diagnosed


def show_search(control: Control, progress: SearchProgress) -> None:
    """Show the progress of a search."""
    done, total = progress.done, progress.total
    if progress.what in _ENDS and done == total:
        control.progress(None, _LAST)
    elif total > 1:
        control.progress(done / total, counted(STEPS[progress.what], done, total))
    else:
        control.progress(None, STEPS[progress.what])
