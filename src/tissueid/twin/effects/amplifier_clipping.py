"""Amplifier output limited below the rated voltage, softly or hard."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from tissueid.twin import bus
from tissueid.twin.effect import ActsOn, Effect, FloatArray, Parameter

PEAK = 0.998
"""Share of the readings that lie below the peak of a signal; the others can be noise."""


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Limit the voltage, with a remaining slope beyond the limit.

    The state holds the last inputs, their outputs, and whether there were any.
    """
    limit, knee, beyond, ratio, middle = p[0], p[1], p[2], p[3], p[4]
    mean = b[bus.VOLTAGE]
    end = mean + b[bus.VOLTAGE_RISE]
    for k in range(2):
        asked = mean if k == 0 else end
        # A held command is the same at every step of a sample, and at the end of a step as in its mean.
        if k == 1 and asked == s[0]:
            s[1] = s[0]
            s[3] = s[2]
        elif asked != s[k] or s[4 + k] == 0.0:
            swing = asked - middle
            level = limit if swing > 0.0 else limit * ratio
            logarithm = knee * math.log(abs(swing) / level) if swing != 0.0 else -700.0
            kept = 1.0
            if logarithm > 3.0:
                kept = level / abs(swing)
            elif logarithm > -18.0:
                power = math.exp(logarithm)
                kept = math.exp(math.log(math.tanh(power) / power) / knee)
            s[k], s[4 + k] = asked, 1.0
            s[2 + k] = middle + swing * (beyond + (1.0 - beyond) * kept)
    b[bus.VOLTAGE] = s[2]
    b[bus.VOLTAGE_RISE] = s[3] - s[2]
    if b[bus.VOLTAGE_TILT] != 0.0:
        b[bus.VOLTAGE_TILT] = s[3] - s[2]


def starts_from(tests: Sequence[Mapping[str, FloatArray]], sample_rate_hz: float) -> tuple[tuple[float, ...], ...]:
    """Return limits near the ends of the recorded voltage, from zero and from its mean: a clipped one is there at its
    limit."""
    recorded = [signals["voltage"] for signals in tests if "voltage" in signals]
    received = [values[np.isfinite(values)] for values in recorded]
    moved = [values for values in received if values.size and np.ptp(values) > 0.0]
    if not moved:
        return ()
    largest = max(moved, key=lambda values: float(np.ptp(values)))
    mean, peak = float(np.mean(largest)), float(np.quantile(np.abs(largest), PEAK))
    low, high = np.quantile(largest, [1.0 - PEAK, PEAK])
    from_zero = (1.05 * peak, 8.0, 0.02, 1.0, 0.0)
    if not low < mean < high:
        return (from_zero,)
    return from_zero, (
        1.05 * float(high - mean),
        4.0,
        0.02,
        float(np.clip((mean - low) / (high - mean), 0.4, 2.5)),
        mean,
    )


EFFECT = Effect(
    name="amplifier_clipping",
    stage="drive",
    acts_on=ActsOn.AMPLIFIER_LIMIT,
    title="Amplifier clips below its rating",
    equation="v = m + w (c + (1 - c) (tanh(x^p) / x^p)^(1/p)), w = u - m, x = |w|/L, r L for L where w < 0; vanishes "
    "with L = inf",
    signature="voltage against command bends at large commands, at once and without memory; odd and even distortion in "
    "voltage that is gone at smaller amplitude; current against voltage unchanged",
    source="Pintelon and Schoukens, System Identification, 2nd ed. (2012) ch. 3; Rapp, 2nd European Conf. on Satellite "
    "Communications (1991) 179-184, whose limiter it follows within 0.1 % of what is clipped",
    parameters=(
        Parameter("limit_v", "V", math.inf, 0.05, 1000.0, True, meaning="output limit"),
        Parameter("knee", "1", None, 0.8, 80.0, True, prior=1.5, prior_std=2.0, meaning="sharpness: 1 tanh, 50 hard"),
        Parameter(
            "slope_beyond", "1", 1.0, 0.0, 1.0, prior=0.0, prior_std=0.3, meaning="remaining gain beyond the limit"
        ),
        Parameter(
            "ratio_below",
            "1",
            None,
            0.3,
            3.0,
            True,
            prior=1.0,
            prior_std=0.4,
            meaning="negative limit relative to it",
        ),
        Parameter(
            "middle_v",
            "V",
            None,
            -60.0,
            60.0,
            prior=0.0,
            prior_std=20.0,
            default=0.0,
            meaning="voltage between the limits, from which they are counted",
        ),
    ),
    starts=((30.0, 1.5, 0.02, 1.0, 0.0), (20.0, 8.0, 0.02, 1.0, 0.0)),
    mistaken_for=("amplifier_deadband", "flux_saturation", "amplifier_drift"),
    places=(bus.AMPLIFIER,),
    hook=hook,
    needs=frozenset({"command"}),
    starts_from=starts_from,
    remedy="Check the supply under load and the amplifier's current limit; lower the amplitude until the clipping "
    "ends.",
)
