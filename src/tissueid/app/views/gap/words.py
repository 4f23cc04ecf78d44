"""What stages and verdicts are called where there is little room."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tissueid.twin.effect import Stage

STAGE_TITLES: dict[Stage, str] = {
    "drive": "Amplifier",
    "coil": "Coil",
    "mechanics": "Moving part",
    "tissue": "Tissue",
    "sensing": "Sensors",
    "environment": "Surroundings",
}
VERDICT_WORDS = {"effect": "Effect named", "no_gap": "No gap", "unexplained": "Unexplained"}
