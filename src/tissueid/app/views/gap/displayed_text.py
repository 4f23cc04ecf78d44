"""Short titles of stages, signals and verdicts, and texts of a diagnosis in the language of the window."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tissueid.app.words import sentence
from tissueid.formatting import clean
from tissueid.language import marked
from tissueid.messages import translated

if TYPE_CHECKING:
    from tissueid.twin.effect import Stage

STAGE_TITLES: dict[Stage, str] = {
    "drive": marked("Amplifier"),
    "coil": marked("Coil"),
    "mechanics": marked("Moving part"),
    "tissue": marked("Tissue"),
    "sensing": marked("Sensors"),
    "environment": marked("Environment"),
}
SIGNALS = (marked("Voltage"), marked("Current"), marked("Position"), marked("current"), marked("position"))
"""Names of the compared signals; ``voltage`` is marked in the chain."""
VERDICT_TITLES = {"effect": marked("Effect named"), "no_gap": marked("No gap"), "unexplained": marked("Unexplained")}
STATE_TITLES = {"changed": marked("Session changed since"), "missing": marked("Session file missing")}
"""State of the session file of a diagnosis."""


def as_sentence(text: str) -> str:
    """Return a text of a diagnosis, translated, with a capital and a full stop; "" stays ""."""
    return sentence(clean(translated(text)))


def as_title(text: str) -> str:
    """Return a text of a diagnosis, translated, with a capital and without a full stop, unbroken before %."""
    return as_sentence(text).rstrip(".").replace(" %", "\u00a0%")
