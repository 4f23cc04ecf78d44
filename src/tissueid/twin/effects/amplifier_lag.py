"""Amplifier bandwidth lower than assumed."""

from __future__ import annotations

import math

from tissueid.twin import bus
from tissueid.twin.effect import ActsOn, Effect, FloatArray, Parameter

# State: output, its rate, the output held over this sample, its number, and the coefficients of a step and of a sample.
OUTPUT, RATE, HELD, SAMPLE, STEP, WHOLE = 0, 1, 2, 3, 4, 8
STAYS, CARRIES, FADES, RETURNS = range(4)


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Apply a second-order low-pass, exact for a voltage that is constant over the step."""
    lag, shape, held = p[0], p[1], p[2]
    target = b[bus.VOLTAGE]
    n = b[bus.SAMPLE]
    if n == 0.0:
        # Before the test the command is taken to be its first value.
        s[OUTPUT] = target
        return
    if s[SAMPLE] == 0.0:
        middle = 0.5 / (shape * lag)
        stiffness = 1.0 / (shape * lag * lag)
        square = middle * middle - stiffness
        root = math.sqrt(abs(square))
        for at in (STEP, WHOLE):
            time = dt if at == STEP else b[bus.TIME] / n
            if root * time < 1e-4:
                even = math.exp(-middle * time)
                odd = even * time * (1.0 + square * time * time / 6.0)
            elif square > 0.0:
                slow = math.exp(-stiffness / (middle + root) * time)
                fast = math.exp(-(middle + root) * time)
                even = 0.5 * (slow + fast)
                odd = 0.5 * (slow - fast) / root
            else:
                even = math.exp(-middle * time) * math.cos(root * time)
                odd = math.exp(-middle * time) * math.sin(root * time) / root
            s[at + STAYS] = even + middle * odd
            s[at + CARRIES] = odd
            s[at + FADES] = even - middle * odd
            s[at + RETURNS] = stiffness * odd
    away, rate = s[OUTPUT] - target, s[RATE]
    if s[SAMPLE] != n:
        s[SAMPLE] = n
        s[HELD] = target + away * s[WHOLE + STAYS] + rate * s[WHOLE + CARRIES]
    then = away * s[STEP + STAYS] + rate * s[STEP + CARRIES]
    s[RATE] = rate * s[STEP + FADES] - away * s[STEP + RETURNS]
    s[OUTPUT] = target + then
    # The filter's own equation, integrated over the step, gives the mean.
    mean = target - lag * (then - away + shape * lag * (s[RATE] - rate)) / dt
    b[bus.VOLTAGE] = (1.0 - held) * mean + held * s[HELD]
    b[bus.VOLTAGE_RISE] = (1.0 - held) * (s[OUTPUT] - mean)
    b[bus.VOLTAGE_TILT] = (1.0 - held) * 0.5 * (then - away)


EFFECT = Effect(
    name="amplifier_lag",
    stage="drive",
    acts_on=ActsOn.AMPLIFIER_RESPONSE,
    title="Slow amplifier",
    equation="u = v + T v' + q T^2 v'', from one pole (q = 0) over Butterworth (q = 1/2), its output held sample by "
    "sample (h = 1) or not (h = 0); vanishes with T = 0",
    signature="voltage late and smaller against the command at high frequencies, its steps rounded; nothing at "
    "constant or slow command; current against voltage unchanged",
    source="Franklin, Powell and Workman, Digital Control of Dynamic Systems, 3rd ed. (1998), ch. 4 (hold, actuator)",
    parameters=(
        Parameter("lag_s", "s", 0.0, 2e-6, 0.01, True, meaning="delay of slow signals; 1/(2 pi T) is the bandwidth"),
        Parameter(
            "shape", "1", None, 0.01, 1.0, True, meaning="shape: 0 one pole, 1/4 two equal poles, above 1/4 overshoot"
        ),
        Parameter("held_share", "1", None, 0.0, 1.0, meaning="share of the delay that lies before the sample-and-hold"),
    ),
    starts=((6e-5, 0.05, 0.2), (2.5e-4, 0.15, 0.2), (1.2e-3, 0.25, 0.2)),
    mistaken_for=("latency", "eddy_currents", "sensor_lag"),
    places=(bus.AMPLIFIER,),
    hook=hook,
    needs=frozenset({"command"}),
    remedy="Measure the amplifier's step response into the coil; check its compensation and any filter before it.",
)
