"""A frame on a spring and a damper, against which the position is measured."""

from __future__ import annotations

import math

from tissueid.twin import bus
from tissueid.twin.effect import Effect, FloatArray, Parameter

_FREQUENCIES_HZ = tuple(5.0 * 1.18**k for k in range(20))
"""Frequencies of the scan, 5 to 116 Hz, close enough to find a narrow resonance."""


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Move the frame by the reaction; ``s[0]`` and ``s[1]`` are its position (m) and velocity (m/s)."""
    if where == bus.SURFACE:
        s[0] += 0.5 * dt * s[1]
        b[bus.SURFACE_POSITION] -= s[0]
        return
    frame, angular = p[2], 2.0 * math.pi * p[0]
    relative = b[bus.VELOCITY] + 0.5 * dt * b[bus.ACCELERATION]
    # The frame is driven by the coil and the drag of the bearing.
    reaction = b[bus.DAMPING] * relative - b[bus.FORCE_CONSTANT] * b[bus.CURRENT]
    drag = 0.5 * dt * 2.0 * p[1] * angular
    then = (s[1] * (1.0 - drag) + dt * (reaction / frame - angular * angular * s[0])) / (1.0 + drag)
    acceleration = (then - s[1]) / dt
    mean = 0.5 * (then + s[1])
    s[1] = then
    s[0] += 0.5 * dt * then
    # Tissue is not on the frame: it feels the absolute motion, with the mass and damping of the previous step.
    b[bus.FORCE] -= (b[bus.MASS] + b[bus.TISSUE_MASS]) * acceleration + b[bus.TISSUE_DAMPING] * mean


EFFECT = Effect(
    name="mount_resonance",
    stage="mechanics",
    title="The frame moves",
    equation="M y'' + 2 z w M y' + w^2 M y = -(coil force - bearing drag), x is read against the frame: the moving "
    "part feels -m y'', the tissue x + y; vanishes with M = infinity",
    signature="a narrow resonance and antiresonance in the response of position to force at one frequency, the same in "
    "every test; linear: no distortion; current only near that frequency",
    source="Inman, Engineering Vibration (2014) (two masses); Ewins, Modal Testing (2000)",
    parameters=(
        Parameter(
            "frequency_hz", "Hz", None, 2.0, 200.0, True, meaning="resonance frequency of the frame on its mount"
        ),
        Parameter("damping_ratio", "1", None, 0.003, 1.0, True, meaning="damping ratio of the mount"),
        Parameter("frame_kg", "kg", math.inf, 0.05, 3000.0, True, meaning="mass of the frame"),
    ),
    starts=((8.0, 0.05, 2.0), (20.0, 0.05, 1.0), (45.0, 0.05, 1.0), (100.0, 0.05, 0.5)),
    scan=tuple((frequency, 0.05, 20.0) for frequency in _FREQUENCIES_HZ),
    mistaken_for=("viscoelasticity", "sensor_lag", "physiological_motion", "reflex"),
    places=(bus.SURFACE, bus.MECHANICS),
    hook=hook,
    remedy="Clamp the frame or make its stand heavier; rest the device on the bench.",
)
