"""Diagnosis of the gap of a session."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from tissueid.gap import Diagnosis, diagnose, executor, prepare
from tissueid.gap.search import STEPS
from tissueid.gap.twin_export import NamedEffects, against_twin, named_effects
from tissueid.instrument.twin_file import TwinFile, check_twin_writable, read_twin
from tissueid.language import marked
from tissueid.procedures.control import Control, RemainingTime, counted
from tissueid.procedures.gap_plans import DiagnosisPlan
from tissueid.procedures.output_files import HTML, check_different, check_output, check_report, write_text
from tissueid.sessions import Session, read_session
from tissueid.twin.catalogue import effect

if TYPE_CHECKING:
    from tissueid.gap.search import SearchProgress, Work

SHARES: Mapping[Work, tuple[float, float]] = {
    "baseline": (0.0, 0.05),
    "screening": (0.05, 0.4),
    "likeliest candidates": (0.4, 0.5),
    "candidates": (0.5, 0.65),
    "leading candidates": (0.65, 0.9),
    "near relations": (0.9, 1.0),
}
"""Share of a search for one effect at the begin and the end of each step, from timings of sessions of one test."""
_SINGLES = 0.2
"""Share of the search for single effects in a search that continues with sets."""
_TYPICAL_STEPS = 5.0
"""Steps of the search for sets after which about two thirds are done."""
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
        from tissueid.reports.gap_page import DiagnosisOrigin, gap_html

        return gap_html(self.found, origin=DiagnosisOrigin(self.session, self.plan.session))


def diagnose_session(plan: DiagnosisPlan, control: Control) -> DiagnosedSession:
    """Diagnose a session and write the report if one is named. Whether a twin can be saved is checked before.

    Raises:
        UnusableInputError: the session, the twin, a test number, an effect or a file cannot be used.
        CancelledError: the diagnosis was cancelled; nothing was written.
    """
    check_output(plan.report, HTML)
    check_different(plan.report, plan.twin_out)
    if plan.twin_out is not None:
        check_twin_writable(plan.twin_out)
    for name in plan.without:
        effect(name)
    control.progress(None, _READING)
    twin = None if plan.twin is None else read_twin(plan.twin)
    session = read_session(plan.session)
    check_report(plan.report, session)
    dataset, known = against_twin(prepare(session, plan.fit, plan.check), twin)
    with executor(plan.workers) as pool:
        found = diagnose(
            dataset,
            pool,
            known=known,
            without=plan.without,
            seconds=plan.seconds,
            progress=SearchDisplay(control),
            cancelled=control.check,
        )
    diagnosed = DiagnosedSession(plan, session, twin, found)
    if plan.report is not None:
        write_text(plan.report, diagnosed.report_html)
    return diagnosed


class SearchDisplay:
    """Shows the progress of a search with the share of the whole search that is done and the remaining time.

    A search for one effect has known steps. If it continues with sets of effects, the number of its steps is not known:
    every further step completes a part of what is left.
    """

    def __init__(self, control: Control, remaining: RemainingTime | None = None) -> None:
        self._control = control
        self._remaining = remaining or RemainingTime()
        self._what: Work = "baseline"
        self._steps_of_sets = 0
        self._share = 0.0

    def __call__(self, progress: SearchProgress) -> None:
        """Show the progress of a step."""
        done, total = progress.done, progress.total
        if progress.what != self._what:
            self._what = progress.what
            if self._steps_of_sets or progress.what not in SHARES:
                self._share = self._share if self._steps_of_sets else 0.0
                self._steps_of_sets += 1
        self._share = max(self._share, self._share_at(done / max(total, 1)))
        if progress.what in _ENDS and done == total:
            self._control.progress(None, _LAST)
        elif total > 1:
            step = self._remaining.added_to(counted(STEPS[progress.what], done, total), self._share)
            self._control.progress(self._share, step)
        else:
            self._control.progress(None, STEPS[progress.what])

    def _share_at(self, part: float) -> float:
        if self._steps_of_sets:
            return _SINGLES + (1.0 - _SINGLES) * (1.0 - math.exp(-(self._steps_of_sets - 1 + part) / _TYPICAL_STEPS))
        begin, end = SHARES[self._what]
        return begin + part * (end - begin)
