"""Force of the coil with the force constant of the calibration sweep at each position (Chen 2010, 2.4).

The force constant falls towards the ends of the stroke. The sweep measures it by position, relative to its plateau; the
recorded force uses this profile where an active calibration has one. The safety limits do not: they use the one force
constant of the plateau, with and without a profile.
"""

from __future__ import annotations

import json
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tissueid.device import DeviceDescription
from tissueid.untrusted_input import json_value

Array = NDArray[np.float64]

PROFILE = "relative_force_constant"
"""Name of the profile among the calibrated values of a device: JSON of two lists, positions (m) and relative values."""
USED_NOTE = "force_constant_used"
"""Note of a test whose recorded force uses the profile."""

_MOST_POINTS = 1000
_PLAUSIBLE = (0.2, 1.2)
"""Bounds of the force constant relative to its plateau."""


def profile_text(position_m: Array, relative: Array) -> str | None:
    """Return the stored form of a profile at positions (n,), m; None if it is not plausible."""
    text = json.dumps([[round(float(x), 6) for x in position_m], [round(float(v), 6) for v in relative]])
    return None if _profile(text) is None else text


def relative_force_constant(device: DeviceDescription, position_m: Array) -> Array | None:
    """Return the force constant relative to its plateau at positions (n,); None for a device without a profile.

    Beyond the positions of the sweep the value at its nearest end is used. 1 where the position is unknown.
    """
    text = device.calibration.get(PROFILE)
    profile = _profile(text) if isinstance(text, str) else None
    if profile is None:
        return None
    position = np.asarray(position_m, dtype=np.float64)
    return np.where(np.isfinite(position), np.interp(position, *profile), 1.0)


def recorded_force(samples: NDArray[np.void], device: DeviceDescription) -> Array:
    """Return the coil force of samples (k,) of SAMPLE, N: force constant at the measured position times current."""
    newtons = np.asarray(samples["current"]) * device.force_constant_n_per_a
    relative = relative_force_constant(device, samples["position"])
    return newtons if relative is None else newtons * relative


def force_notes(device: DeviceDescription) -> dict[str, str | float]:
    """Return the note of a test whose force was recorded with the profile; empty for a constant."""
    if relative_force_constant(device, np.zeros(1)) is None:
        return {}
    return {USED_NOTE: f"by position, {device.calibration.get('sweep_file', 'sweep')}"}


@lru_cache(maxsize=8)
def _profile(text: str) -> tuple[Array, Array] | None:
    """Return positions and relative values (n,) of a stored profile; None if it is damaged or not plausible."""
    try:
        rows = np.asarray(json_value(text), dtype=np.float64)
    except (ValueError, TypeError, OverflowError):
        return None
    if rows.ndim != 2 or rows.shape[0] != 2 or not 2 <= rows.shape[1] <= _MOST_POINTS or not np.all(np.isfinite(rows)):
        return None
    position, relative = rows
    low, high = _PLAUSIBLE
    if np.any(np.diff(position) <= 0.0) or np.any(relative < low) or np.any(relative > high):
        return None
    return position, relative
