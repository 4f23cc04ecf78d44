"""Crossover dead zone of the amplifier around zero."""

from __future__ import annotations

import math

from tissueid.twin import bus
from tissueid.twin.effect import ActsOn, Effect, FloatArray, Parameter


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Subtract the loss around zero and its remaining part; the state holds the last input and output."""
    width, kept, corner, missing = p[0], p[1], p[2], 1.0 - p[3]
    mean = b[bus.VOLTAGE]
    end = mean + b[bus.VOLTAGE_RISE]
    for k in range(2):
        asked = mean if k == 0 else end
        if k == 1 and asked == s[0]:
            s[1] = s[0]
            s[3] = s[2]
        elif asked != s[k]:
            logarithm = corner * math.log(abs(asked) / width) if asked != 0.0 else -700.0
            stays = passes = 1.0
            if logarithm > 3.5:
                stays = width / abs(asked)
                passes = 0.0
            elif logarithm > -18.0:
                power = math.exp(logarithm)
                stays = math.exp(math.log(math.tanh(power) / power) / corner)
                passes = math.exp(-power)
            s[k] = asked
            s[2 + k] = asked * (1.0 - missing * (kept * stays + (1.0 - kept) * passes))
    b[bus.VOLTAGE] = s[2]
    b[bus.VOLTAGE_RISE] = s[3] - s[2]
    if b[bus.VOLTAGE_TILT] != 0.0:
        b[bus.VOLTAGE_TILT] = s[3] - s[2]


EFFECT = Effect(
    name="amplifier_deadband",
    stage="drive",
    acts_on=ActsOn.AMPLIFIER_OUTPUT,
    title="Amplifier dead zone around zero",
    equation="v = u (1 - (1 - g) (k (tanh(x^p) / x^p)^(1/p) + (1 - k) e^(-x^p))), x = |u|/w; vanishes with w = 0",
    signature="voltage missing where the command is small, by up to the width; with k = 1 the voltage is closer to zero"
    " by the width at every command; strongest in the spring test, whose command has no mean",
    source="Tao and Kokotovic, Adaptive Control of Systems with Actuator and Sensor Nonlinearities (1996) ch. 2",
    parameters=(
        Parameter("width_v", "V", 0.0, 1e-3, 15.0, True, meaning="width of the zone with little or no output"),
        Parameter("kept_share", "1", None, 0.0, 1.0, meaning="share of the loss that remains at larger commands"),
        Parameter(
            "corner", "1", None, 0.7, 100.0, True, prior=4.0, prior_std=2.0, meaning="sharpness of the zone's edge"
        ),
        Parameter(
            "gain_left", "1", None, 0.0, 0.95, prior=0.1, prior_std=0.3, meaning="share of the gain inside the zone"
        ),
    ),
    starts=((0.4, 0.9, 4.0, 0.1), (2.0, 0.9, 4.0, 0.1), (2.0, 0.1, 2.5, 0.1)),
    mistaken_for=("amplifier_drift", "amplifier_clipping", "dry_friction"),
    places=(bus.AMPLIFIER,),
    hook=hook,
    needs=frozenset({"command"}),
    remedy="Set the amplifier's bias current; measure voltage against a slow ramp through zero.",
)
