"""Figures of a calibration in the active units of the window."""

from __future__ import annotations

from tissueid.calibration.file import Quantity
from tissueid.calibration.labels import readable
from tissueid.formatting import plus_minus
from tissueid.messages import translated
from tissueid.records import Estimate
from tissueid.units import shown


def figure_of(name: str, found: Quantity) -> tuple[str, str, str]:
    """Return label, value with its deviation, and unit."""
    label, value, unit = readable(name, found)
    label = translated(label)
    said, factor = shown(unit)
    if factor == 1.0:
        return label, value, said
    # What is converted is shown without a prefix, and that is how a calibration keeps it.
    return label, plus_minus(Estimate(found.value, found.std)), said
