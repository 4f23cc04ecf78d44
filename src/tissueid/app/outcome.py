"""The message about the end of a test."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tissueid.messages import Message, Verbatim, translated

if TYPE_CHECKING:
    from tissueid.app.measurement_job import Outcome

_STOPPED = Message("outcome.stopped", "Stopped, and the coil is released.")
_STOPPED_BY_BUTTON = Message(
    "outcome.stopped_by_button", "Stopped by the button on the instrument, and the coil is released."
)
_NOTHING_YET = Message("outcome.nothing_yet", "Nothing was recorded yet.")
_START_AGAIN = Message(
    "outcome.start_again", "Close other programs that keep the computer busy, then press Start again."
)


def outcome_text(outcome: Outcome) -> tuple[str, bool]:
    """Return the message, empty for a completed test, and whether it reports a problem."""
    kept = Message("outcome.saved", "The recorded part is saved in {path}.", path=Verbatim(outcome.path))
    saved = translated(kept) if outcome.session else ""
    if outcome.stopped:
        how = translated(_STOPPED_BY_BUTTON if outcome.by_button else _STOPPED)
        words = [how, saved or outcome.trouble or translated(_NOTHING_YET)]
    elif outcome.unanswered:
        nothing = "" if outcome.trouble else translated(_NOTHING_YET)
        words = [outcome.problem, saved or nothing, translated(_START_AGAIN)]
    else:
        words = [outcome.problem, saved if outcome.problem else ""]
    failed = bool(outcome.trouble or outcome.unlogged or (outcome.problem and not outcome.stopped))
    return " ".join(filter(None, [*words, outcome.unlogged])), failed
