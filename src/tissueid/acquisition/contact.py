"""Contact of the probe with the skin, from the samples of a released coil."""

from __future__ import annotations

from enum import Enum

import numpy as np
from numpy.typing import NDArray

from tissueid.device import GRAVITY_M_S2, DeviceDescription
from tissueid.language import marked

MARGIN_M = 1.0e-3
"""Distance from an end of the stroke that counts as the end, m; as in the placement of a test."""
MOVING_M = 0.5e-3
"""Motion within a quarter of a second above which the probe is moving, m."""
RECENT_S = 0.25
_LAID = 0.5 * GRAVITY_M_S2
"""Smallest component of gravity along the stroke that rests a released probe on the skin, m/s²."""


class Contact(Enum):
    """State of contact; the value is its English text."""

    UNWATCHED = marked("Contact is not watched")
    FINDING = marked("Finding the skin")
    OFF = marked("Off the skin: bring the probe down onto it")
    ON = marked("On the skin")
    TOO_FAR = marked("Pressed too far: lift the instrument a little")
    TOO_DEEP = marked("Pressed too far: the probe is near the end of its stroke")
    MOVING = marked("Moving: hold still")
    UNTOLD = marked("Held so that gravity does not lay the probe down: the test finds the skin")

    @property
    def level(self) -> str:
        """Level of its colour: "good", "check" or ""."""
        if self is Contact.ON:
            return "good"
        return "" if self in (Contact.UNWATCHED, Contact.FINDING, Contact.UNTOLD) else "check"


def contact_of_free(samples: NDArray[np.void], device: DeviceDescription) -> Contact:
    """Return the contact with a released coil from the newest samples, shape (k,) of SAMPLE."""
    position = finite(samples["position"])
    along = finite(samples["acceleration_x"])
    if not position.size:
        return Contact.FINDING
    where = contact_at(position, device.stroke_m)
    if along.size and float(along.mean()) < _LAID and where is not Contact.ON:
        return Contact.UNTOLD
    return where


def contact_at(position: NDArray[np.float64], stroke_m: float) -> Contact:
    """Return the contact by positions, shape (k,), m, which grow into the tissue: a free probe is at the far end."""
    middle = float(np.median(position))
    if middle > stroke_m - MARGIN_M:
        return Contact.OFF
    if middle < MARGIN_M:
        return Contact.TOO_FAR
    return Contact.MOVING if float(np.ptp(position)) > MOVING_M else Contact.ON


def finite(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the finite values."""
    return np.asarray(values[np.isfinite(values)], np.float64)
