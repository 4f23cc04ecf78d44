"""Amplifier gain or offset that drifts during a test."""

from __future__ import annotations

import math

from tissueid.twin import bus
from tissueid.twin.effect import Effect, FloatArray, Parameter


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Apply an exponential drift of gain and offset and a linear drift of gain."""
    settling, gain, rate, offset = p[0], p[1], p[2], p[3]
    time = b[bus.TIME] + 0.5 * dt
    gone = -math.expm1(-time / settling)
    scale = 1.0 + gain * gone + rate * time
    b[bus.VOLTAGE] = scale * b[bus.VOLTAGE] + offset * gone
    b[bus.VOLTAGE_RISE] *= scale
    b[bus.VOLTAGE_TILT] *= scale


EFFECT = Effect(
    name="amplifier_drift",
    stage="drive",
    title="Amplifier drifts",
    equation="v = u (1 + a (1 - e^(-t/T)) + b t) + c (1 - e^(-t/T)); vanishes with a = b = c = 0",
    signature="voltage proportional to the command at each instant, with a gain or an offset that changes over seconds;"
    " the offset shows in quiet records; current against voltage unchanged",
    source="Horowitz and Hill, The Art of Electronics, 3rd ed. (2015) ch. 5 (drift of gain and offset)",
    parameters=(
        Parameter(
            "settling_s",
            "s",
            None,
            0.05,
            50.0,
            True,
            prior=2.0,
            prior_std=1.5,
            meaning="time constant of the slow curve",
        ),
        Parameter("gain_change", "1", 0.0, -0.6, 0.6, meaning="final relative change of gain"),
        Parameter("gain_rate_per_s", "1/s", 0.0, -0.2, 0.2, prior=0.0, prior_std=0.1, meaning="steady drift of gain"),
        Parameter("offset_change_v", "V", 0.0, -10.0, 10.0, meaning="final change of offset"),
    ),
    starts=((2.0, 0.02, 0.0, 0.0), (2.0, 0.0, 0.0, 0.2), (0.3, 0.02, 0.0, 0.0)),
    mistaken_for=("coil_heating", "amplifier_deadband", "preconditioning"),
    places=(bus.AMPLIFIER,),
    hook=hook,
    jointly=True,
    needs=frozenset({"command"}),
    remedy="Let the amplifier warm up; calibrate voltage gain and offset both before and after a test.",
)
