"""Low-pass lag of the position channel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import linalg, signal

from tissueid.twin._interpolation import interpolate
from tissueid.twin.effect import ActsOn, Effect, FloatArray, Parameter, Readings


def recording(readings: Readings, values: FloatArray) -> Readings:
    """Filter the position: exact for linear motion between samples, from rest at its first value.

    Filters of higher order are similar to second order with a dead time. Time is scaled by the filter's delay, so that
    the matrix exponential is well conditioned.
    """
    delay, second, dead = values
    if delay <= 0.0:
        return readings
    step = 1.0 / (readings.sample_rate_hz * delay * (1.0 - dead))
    # States: output and its slope, input and its slope, for a linear input over the step (Van Loan).
    system = np.zeros((4, 4))
    system[0, 1] = 1.0
    system[1, :3] = -1.0 / second, -1.0 / second, 1.0 / second
    system[2, 3] = 1.0
    moved = linalg.expm(system * step)
    kept, held = moved[:2, :2], moved[:2, 2]
    rising = moved[:2, 3] / step
    # Output over input, as polynomials in z: (z - kept)^-1 (held - rising + rising z), first state.
    constant = held - rising
    taps = (
        rising[0],
        constant[0] - kept[1, 1] * rising[0] + kept[0, 1] * rising[1],
        -kept[1, 1] * constant[0] + kept[0, 1] * constant[1],
    )
    poles = (1.0, -kept[0, 0] - kept[1, 1], kept[0, 0] * kept[1, 1] - kept[0, 1] * kept[1, 0])
    late = dead * delay * readings.sample_rate_hz
    position = interpolate(readings.position, np.arange(readings.position.size) - late)
    return replace(readings, position=position[0] + signal.lfilter(taps, poles, position - position[0]))


EFFECT = Effect(
    name="sensor_lag",
    stage="sensing",
    acts_on=ActsOn.SENSOR_RESPONSE,
    title="Slow position channel",
    equation="q T^2 y'' + T y' + y = x(t - D): q = 0 first order, 1/4 two equal poles, 1/2 Butterworth; D the dead "
    "share of T + D; vanishes with T + D = 0",
    signature="position lags the motion that back-EMF shows in current and voltage: gain falls and phase grows with "
    "frequency, equally in every test and at every depth; voltage and current unchanged",
    source="Pintelon & Schoukens, System Identification: A Frequency Domain Approach (2012), ch. 1 and 6; Van Loan, "
    "IEEE Trans. Automatic Control 23 (1978) 395-404",
    parameters=(
        Parameter("delay_s", "s", 0.0, 1e-6, 3e-2, True, meaning="delay at low frequency"),
        Parameter("second_order", "1", None, 1e-3, 1.5, meaning="share of the second pole"),
        Parameter(
            "dead_share", "1", None, 0.0, 0.8, prior=0.0, prior_std=0.4, meaning="share of dead time in the delay"
        ),
    ),
    starts=((3e-4, 0.05, 0.05), (3e-3, 0.3, 0.05)),
    mistaken_for=("clock_skew", "latency", "sensor_backlash", "dropped_samples"),
    recording=recording,
    needs=frozenset({"voltage", "position"}),
    exact=True,
    remedy="Set the position sensor's filter to its widest bandwidth, or measure its step response and set the twin "
    "accordingly.",
)
