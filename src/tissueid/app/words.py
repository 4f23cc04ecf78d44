"""Errors, the end of a test, the state of a calibration and other texts of the window."""

from __future__ import annotations

import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING

from platformdirs import user_log_path

from tissueid.acquisition.journal import JournalError, journal_path
from tissueid.atomic_write import private_folder, write_private
from tissueid.calibration.active import calibration_summary
from tissueid.calibration.file import CalibratedQuantity
from tissueid.calibration.status import readable
from tissueid.device import DeviceDescription
from tissueid.errors import TissueIDError
from tissueid.formatting import plus_minus
from tissueid.language import marked
from tissueid.messages import Message, Verbatim, translated
from tissueid.records import Estimate
from tissueid.units import shown

if TYPE_CHECKING:
    from tissueid.procedures.test_run import TestOutcome


RESEARCH_USE = marked("Research use only. Not a medical device.")


def sentence(text: str) -> str:
    """Return a text in one line with a capital letter and a full stop."""
    text = " ".join(text.split())
    if not text:
        return ""
    return text[0].upper() + text[1:] + ("" if text[-1] in ".!?" else ".")


def in_words(error: BaseException) -> str:
    """Return an error as a translated sentence. The traceback of a defect goes to a file, and the sentence names it."""
    if isinstance(error, TissueIDError):
        return sentence(translated(error.message))
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        return sentence(f"{where}{error.strerror or error}")
    path = private_folder(user_log_path("tissueid", appauthor=False)) / "last-defect.txt"
    write_private(path, "".join(traceback.format_exception(error)))
    return translated(
        Message("window.defect", "This is a defect of the software; please report {path}", path=Verbatim(path))
    )


_STOPPED = Message("outcome.stopped", "Stopped, and the coil is released.")
_STOPPED_BY_BUTTON = Message(
    "outcome.stopped_by_button", "Stopped by the button on the instrument, and the coil is released."
)
_NOTHING_YET = Message("outcome.nothing_yet", "Nothing was recorded yet.")
_NOTHING = Message("outcome.nothing", "Nothing was recorded.")
_START_AGAIN = Message(
    "outcome.start_again", "Close other programs that keep the computer busy, then press “Start test” again."
)


def outcome_text(outcome: TestOutcome, *, unanswered: bool = False, unlogged: Sequence[str] = ()) -> tuple[str, bool]:
    """Return the message, empty for a completed test, and whether it reports a problem.

    ``unanswered`` is whether the window stood still for too long, ``unlogged`` why the audit log lacks something.
    """
    trouble = _trouble(outcome)
    problem = " ".join(filter(None, [_problem(outcome, trouble), trouble]))
    kept = Message("outcome.saved", "The recorded part is saved in {path}.", path=Verbatim(outcome.path))
    saved = translated(kept) if outcome.session else ""
    stopped = outcome.by_button or (outcome.cancelled and not unanswered)
    if stopped:
        how = translated(_STOPPED_BY_BUTTON if outcome.by_button else _STOPPED)
        parts = [how, saved or trouble or translated(_NOTHING_YET)]
    elif outcome.cancelled:
        nothing = "" if trouble else translated(_NOTHING_YET)
        parts = [problem, saved or nothing, translated(_START_AGAIN)]
    else:
        parts = [problem, saved if problem else ""]
    failed = bool(trouble or unlogged or (problem and not stopped))
    return " ".join(filter(None, [*parts, *(sentence(translated(notice)) for notice in unlogged)])), failed


def _problem(outcome: TestOutcome, trouble: str) -> str:
    """Return the error of a test as a sentence; empty where ``trouble`` already reports the failed disk."""
    error = outcome.error
    if error is None:
        return ""
    if not isinstance(error, JournalError) or outcome.session is not None:
        return in_words(error)
    return "" if trouble else f"{_cause(error)} {translated(_NOTHING)}"


def _trouble(outcome: TestOutcome) -> str:
    """Return why the recording could not be saved, and where it is; "" if it was."""
    if outcome.not_saved is None:
        return ""
    kept = Message(
        "outcome.recording_stays",
        "The recording stays in {path}; it is offered for recovery at the next start.",
        path=Verbatim(journal_path(outcome.path)),
    )
    return f"{_cause(outcome.not_saved)} {translated(kept)}"


def _cause(error: Exception) -> str:
    """Return the cause of a failure; the recovery advice of a journal is meant for the command line."""
    cause = error.__cause__ if isinstance(error, JournalError) else None
    return in_words(cause if isinstance(cause, Exception) else error)


UNKNOWN = marked("Calibration: not known yet")


@dataclass(frozen=True)
class CalibrationState:
    """State in one line, ``level`` of its colour ("good", "check", or "" if not known), and ``warnings``.

    ``until`` is the date of the next calibration, "" if it is not known.
    """

    summary: str = UNKNOWN
    level: str = ""
    warnings: tuple[str, ...] = ()
    until: str = ""


def calibration_state(device: DeviceDescription, now: datetime | None = None) -> CalibrationState:
    """Return the state of a device's calibration; ``now`` is timezone-aware."""
    good = device.calibration.get("state") == "valid"
    warnings = tuple(sentence(translated(line)) for line in device.calibration_warnings)
    summary = sentence(translated(calibration_summary(device, now))).removesuffix(".")
    until = str(device.calibration.get("valid_until", ""))
    return CalibrationState(summary, "good" if good else "check", warnings, until)


def figure_of(name: str, quantity: CalibratedQuantity) -> tuple[str, str, str]:
    """Return label, value with its deviation, and unit."""
    label, value, unit = readable(name, quantity)
    label = translated(label)
    said, factor = shown(unit)
    if factor == 1.0:
        return label, value, said
    # What is converted is shown without a prefix, and that is how a calibration keeps it.
    return label, plus_minus(Estimate(quantity.value, quantity.std)), said
