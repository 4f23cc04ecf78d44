"""Run a diagnosis outside the GUI thread."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from tissueid.app.file_stamp import Stamp, stamp_of
from tissueid.app.views.gap.diagnosis_result import DiagnosisRequest, DiagnosisResult
from tissueid.app.views.gap.separate_process import Step, run_in_process
from tissueid.errors import UnusableInputError
from tissueid.language import marked, set_language
from tissueid.messages import Message

if TYPE_CHECKING:
    from tissueid.gap.diagnosis import Diagnosis
    from tissueid.gap.search import Work
    from tissueid.gap.workers import Executor
    from tissueid.instrument.twin_file import TwinFile
    from tissueid.sessions import Session

WORDS: Mapping[Work, str] = {
    "baseline": marked("Fitting the baseline twin"),
    "screening": marked("Looking at every known effect"),
    "likeliest candidates": marked("Fitting the likeliest effects"),
    "candidates": marked("Fitting the other effects"),
    "leading candidates": marked("Fitting the leading effects to the end"),
    "further starting points": marked("Fitting from further starting points"),
    "further candidates": marked("Fitting further effects to the end"),
    "near relations": marked("Fitting near relations of what leads"),
    "pairs": marked("Fitting pairs of effects"),
    "leading pairs": marked("Fitting the leading pairs to the end"),
    "members of the pair": marked("Fitting each half of the best pair"),
    "further pairs": marked("Fitting further pairs of effects"),
    "further leading pairs": marked("Fitting further pairs to the end"),
}
"""Step of the search: its text on the page."""
_ENDS: frozenset[Work] = frozenset({"leading candidates", "near relations", "leading pairs", "further leading pairs"})
_LAST = marked("Working out where, which and how far")


def parse_test_numbers(text: str, what: str) -> tuple[int, ...]:
    """Return test numbers from text, separated by commas or blanks.

    Raises:
        UnusableInputError: something else stands there.
    """
    try:
        return tuple(int(part) for part in text.replace(",", " ").split())
    except ValueError:
        raise UnusableInputError(
            Message(
                "gap.test_numbers",
                "{what}: give numbers of tests, separated by commas, not “{text}”",
                what=what,
                text=text[:40],
            )
        ) from None


def run_diagnosis(
    asked: DiagnosisRequest, step: Step, cancelled: Callable[[], bool], *, separate_process: bool
) -> DiagnosisResult | None:
    """Diagnose a session, in other processes if ``separate_process`` is true; return None if it was cancelled.

    Raises:
        UnusableInputError: the session, the twin or the numbers of tests cannot be used.
    """
    step(marked("Starting"), 0, 0)
    if separate_process:
        return run_in_process(functools.partial(_diagnosed, asked), step, cancelled)
    from tissueid.gap.fitting import Cancelled
    from tissueid.gap.workers import SerialExecutor

    try:
        return _diagnosed(asked, step, SerialExecutor(), cancelled)
    except Cancelled:
        return None


def _diagnosed(
    asked: DiagnosisRequest, step: Step, executor: Executor, cancelled: Callable[[], bool]
) -> DiagnosisResult:
    # Imported here and not above: the window should not wait for what only this needs.
    from tissueid.gap import diagnose, prepare
    from tissueid.gap.search import SearchProgress
    from tissueid.gap.twin_export import with_prior_twin
    from tissueid.instrument.twin_file import read_twin
    from tissueid.sessions import read_session

    set_language(asked.language)  # a new process starts in English

    def report_progress(progress: SearchProgress) -> None:
        over = progress.what in _ENDS and progress.done == progress.total
        step(_LAST if over else WORDS[progress.what], progress.done, progress.total)

    step(marked("Reading the session"), 0, 0)
    twin = None if asked.twin is None else read_twin(asked.twin)
    stamp = stamp_of(asked.session)
    session = read_session(asked.session)
    observed = prepare(session, asked.fit, asked.check)
    known: tuple[str, ...] = ()
    if twin is not None:
        observed, known = with_prior_twin(observed, twin.twin), twin.twin.effects
    found = diagnose(observed, executor, known=known, progress=report_progress, cancelled=cancelled)
    return result_of(found, session, asked, twin, stamp)


def result_of(
    found: Diagnosis,
    session: Session,
    asked: DiagnosisRequest,
    twin: TwinFile | None = None,
    stamp: Stamp | None = None,
) -> DiagnosisResult:
    """Return the values of a diagnosis that the page shows and stores, without its records.

    Args:
        found: the diagnosis.
        session: what was diagnosed.
        asked: what was asked.
        twin: content of the baseline twin; None for the nominal one.
        stamp: of the session file, from before it was read.
    """
    from tissueid.app.views.gap.page_content_builder import page_content_of
    from tissueid.gap import as_answer
    from tissueid.reports.gap import Origin, gap_html

    made, refused = _twin_of(found, session.session_id, twin)
    return DiagnosisResult(
        asked,
        session.session_id,
        found.dataset.instrument,
        twin,
        page_content_of(found, session),
        _finite(as_answer(found)),
        gap_html(found, origin=Origin(session, asked.session)),
        made,
        refused,
        stamp,
    )


def _twin_of(found: Diagnosis, session_id: str, before: TwinFile | None) -> tuple[TwinFile | None, str]:
    """Return the twin with the named effects, or None and the reason."""
    from pydantic import ValidationError

    from tissueid.gap.accepting import accepted
    from tissueid.option_errors import validation_reason

    if found.verdict != "effect" or found.best is None:
        return None, ""
    try:
        return accepted(found, "twin" if before is None else before.name, session_id, before), ""
    except UnusableInputError as error:
        return None, error.message
    except ValidationError as error:
        return None, validation_reason(error)


def _finite(value: Any) -> Any:
    # What is no number is null, as the command has it.
    if isinstance(value, dict):
        return {str(name): _finite(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value.item() if hasattr(value, "item") else value
