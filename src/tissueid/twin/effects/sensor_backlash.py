"""Play between the probe and the position sensor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numba import njit

from tissueid.twin.effect import ActsOn, Effect, FloatArray, Parameter, Readings

SHARES = (-0.8, -0.4, 0.0, 0.4, 0.8)
"""Relative widths of the plays whose mean has rounded corners, in units of ``rounding``."""


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _follow(position, play, engaged, out):  # type: ignore[no-untyped-def]
    """Add the output of a play of half width ``play`` to ``out``."""
    follower = position[0] - engaged * play
    out[0] += follower
    for n in range(1, position.size):
        follower = min(max(follower, position[n] - play), position[n] + play)
        out[n] += follower


def recording(readings: Readings, values: FloatArray) -> Readings:
    """Return the mean of several plays (Prandtl and Ishlinskii), exact for any motion between samples."""
    play, rounding, engaged = values
    position = np.ascontiguousarray(readings.position, np.float64)
    followers = np.zeros(position.size)
    for share in SHARES:
        _follow(position, play * (1.0 + rounding * share), engaged, followers)
    return replace(readings, position=followers / len(SHARES))


EFFECT = Effect(
    name="sensor_backlash",
    stage="sensing",
    acts_on=ActsOn.SENSOR_PLAY,
    title="Play between probe and position sensor",
    equation="y follows x as far as |x - y| <= w allows; corners rounded by a spread of w; vanishes with w = 0",
    signature="position stays constant after each reversal until the play is taken up, at any speed: loops of constant "
    "width in the slow ramp, small motions not recorded; the back-EMF in the current shows that the probe did"
    " move",
    source="Visintin, Differential Models of Hysteresis (1994), ch. III (play operator); Kuhnen, European J. Control 9 "
    "(2003) 407-418 (Prandtl-Ishlinskii)",
    parameters=(
        Parameter("half_width_m", "m", 0.0, 1e-7, 1e-3, True, meaning="half width of the play"),
        Parameter("rounding", "1", None, 0.0, 1.2, prior=0.2, prior_std=0.5, meaning="spread of the play"),
        Parameter(
            "engaged", "1", None, -1.0, 1.0, prior=0.0, prior_std=0.6, meaning="place in the play where a test starts"
        ),
    ),
    starts=((1e-5, 0.2, 0.0), (8e-5, 0.2, 0.5), (8e-5, 0.2, -0.5)),
    mistaken_for=("dry_friction", "tissue_hysteresis", "sensor_lag"),
    recording=recording,
    needs=frozenset({"voltage", "position"}),
    remedy="Tighten or preload the coupling between probe and sensor.",
)
