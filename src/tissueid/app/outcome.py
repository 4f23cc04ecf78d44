"""The message about the end of a test."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tissueid.language import _

if TYPE_CHECKING:
    from tissueid.app.measurement_job import Outcome


def outcome_text(outcome: Outcome) -> tuple[str, bool]:
    """Return the message, empty for a completed test, and whether it reports a problem."""
    saved = _("The recorded part is saved in {path}.").format(path=outcome.path) if outcome.session else ""
    if outcome.stopped:
        by_button = _("Stopped by the button on the instrument, and the coil is released.")
        how = by_button if outcome.by_button else _("Stopped, and the coil is released.")
        words = [how, saved or outcome.trouble or _("Nothing was recorded yet.")]
    elif outcome.unanswered:
        nothing = "" if outcome.trouble else _("Nothing was recorded yet.")
        again = _("Close other programs that keep the computer busy, then press Start again.")
        words = [outcome.problem, saved or nothing, again]
    else:
        words = [outcome.problem, saved if outcome.problem else ""]
    failed = bool(outcome.trouble or outcome.unlogged or (outcome.problem and not outcome.stopped))
    return " ".join(filter(None, [*words, outcome.unlogged])), failed
