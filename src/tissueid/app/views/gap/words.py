"""What stages and verdicts are called where there is little room."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tissueid.language import marked

if TYPE_CHECKING:
    from tissueid.twin.effect import Stage

STAGE_TITLES: dict[Stage, str] = {
    "drive": marked("Amplifier"),
    "coil": marked("Coil"),
    "mechanics": marked("Moving part"),
    "tissue": marked("Tissue"),
    "sensing": marked("Sensors"),
    "environment": marked("Surroundings"),
}
SIGNALS = (marked("Voltage"), marked("Current"), marked("Position"), marked("current"), marked("position"))
"""What the core calls the signals that are compared; ``voltage`` is marked in the chain."""
VERDICT_WORDS = {"effect": marked("Effect named"), "no_gap": marked("No gap"), "unexplained": marked("Unexplained")}
