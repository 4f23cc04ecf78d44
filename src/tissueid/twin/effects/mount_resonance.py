"""A frame on a spring and a damper, against which the position is measured."""

from __future__ import annotations

import math

from tissueid.twin import bus
from tissueid.twin.effect import ActsOn, Effect, FloatArray, Parameter

MODES = 2
_ACCELERATION = 2 * MODES
_FREQUENCIES_HZ = tuple(5.0 * 1.18**k for k in range(20))
"""Frequencies of the scan, 5 to 116 Hz, close enough to find a narrow resonance."""
ELSEWHERE, ON_FRAME = 0.0, 1.0
"""Where the tissue rests: elsewhere, or on the frame."""


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Move the frame by the reaction; ``s`` holds position (m) and velocity (m/s) of each mode, then acceleration."""
    on_frame = p[5] == ON_FRAME
    if where == bus.SURFACE:
        for k in range(MODES):
            s[2 * k] += 0.5 * dt * s[2 * k + 1]
            if not on_frame:
                b[bus.SURFACE_POSITION] -= s[2 * k]
                b[bus.SURFACE_VELOCITY] -= s[2 * k + 1]
        if not on_frame:
            b[bus.SURFACE_VELOCITY] -= 0.5 * dt * s[_ACCELERATION]
        return
    if on_frame != (where == bus.TISSUE):
        return
    relative = b[bus.VELOCITY] + 0.5 * dt * b[bus.ACCELERATION]
    if on_frame:
        # The force of the tissue is an internal one: what is left is the inertia of the absolute motion.
        reaction = (b[bus.DAMPING] + b[bus.TISSUE_DAMPING]) * relative + b[bus.TISSUE_FORCE] - b[bus.FORCE]
    else:
        # The frame is driven by the coil and the drag of the bearing. The mass of the tissue is that of the previous
        # step.
        reaction = b[bus.DAMPING] * relative - b[bus.FORCE_CONSTANT] * b[bus.CURRENT]
    acceleration = 0.0
    for k in range(MODES):
        angular = 2.0 * math.pi * p[0] * (p[3] if k > 0 else 1.0)
        share = p[4] if k > 0 else 1.0
        drag = dt * p[1] * angular
        before = s[2 * k + 1]
        driven = dt * (share * reaction / p[2] - angular * angular * s[2 * k])
        then = (before * (1.0 - drag) + driven) / (1.0 + drag)
        acceleration += (then - before) / dt
        s[2 * k + 1] = then
        s[2 * k] += 0.5 * dt * then
    s[_ACCELERATION] = b[bus.FRAME_ACCELERATION] = acceleration
    b[bus.FORCE] -= (b[bus.MASS] + b[bus.TISSUE_MASS]) * acceleration


EFFECT = Effect(
    name="mount_resonance",
    stage="mechanics",
    acts_on=ActsOn.FRAME,
    title="The frame moves",
    equation="M (y_k'' + 2 z w_k y_k' + w_k^2 y_k) = s_k R, k = 1, 2, s_1 = 1; x is read against the frame. Tissue "
    "elsewhere: R = -(coil force - bearing drag), the moving part feels -m y'', the tissue x + y. Tissue on the frame: "
    "R = -m (x'' + y''), the moving part feels -m y''. Vanishes with M = infinity",
    signature="one or two narrow resonances and antiresonances in the response of position to force, the same in "
    "every test; linear: no distortion; current only near these frequencies",
    source="Inman, Engineering Vibration (2014) (two masses); Ewins, Modal Testing (2000) (several modes)",
    parameters=(
        Parameter(
            "frequency_hz", "Hz", None, 2.0, 200.0, True, meaning="resonance frequency of the frame on its mount"
        ),
        Parameter("damping_ratio", "1", None, 0.003, 1.0, True, meaning="damping ratio of the mount"),
        Parameter("frame_kg", "kg", math.inf, 0.05, 3000.0, True, meaning="mass of the frame"),
        Parameter(
            "second_ratio",
            "1",
            None,
            1.3,
            8.0,
            True,
            prior=2.5,
            prior_std=0.5,
            default=2.5,
            meaning="frequency of the second mode relative to the first",
        ),
        Parameter(
            "second_share",
            "1",
            None,
            0.0,
            1.0,
            prior=0.0,
            prior_std=0.3,
            default=0.0,
            meaning="motion of the second mode relative to the first, at equal force",
        ),
        Parameter(
            "tissue_on_frame",
            "1",
            None,
            0.0,
            1.0,
            fixed=True,
            default=0.0,
            meaning="1 where the tissue rests on the frame, 0 where it rests elsewhere",
        ),
    ),
    starts=(
        (20.0, 0.05, 1.0, 2.5, 0.05, ELSEWHERE),
        (45.0, 0.05, 1.0, 2.5, 0.05, ELSEWHERE),
        (100.0, 0.05, 0.5, 2.5, 0.05, ELSEWHERE),
        (45.0, 0.05, 1.0, 2.5, 0.05, ON_FRAME),
    ),
    scan=tuple(
        (frequency, 0.05, 20.0, 2.5, 0.05, mount) for mount in (ELSEWHERE, ON_FRAME) for frequency in _FREQUENCIES_HZ
    ),
    other_minima=tuple({"second_ratio": ratio, "second_share": 0.1} for ratio in (1.5, 1.9, 2.4, 3.2)),
    mistaken_for=("viscoelasticity", "sensor_lag", "physiological_motion", "reflex"),
    places=(bus.SURFACE, bus.MECHANICS, bus.TISSUE),
    hook=hook,
    remedy="Clamp the frame or make its stand heavier; rest the device on the bench.",
)
