"""Figures of a calibration in the units of the window; their names and words are the calibration's own."""

from __future__ import annotations

from tissueid.app.units import shown
from tissueid.calibration.file import Quantity
from tissueid.calibration.words import readable
from tissueid.records import Estimate
from tissueid.wording import plus_minus


def figure_of(name: str, found: Quantity) -> tuple[str, str, str]:
    """Label, value with its deviation, and unit."""
    label, value, unit = readable(name, found)
    said, factor = shown(unit)
    if factor == 1.0:
        return label, value, said
    # What is converted is shown without a prefix, and that is how a calibration keeps it.
    return label, plus_minus(Estimate(found.value, found.std)), said
