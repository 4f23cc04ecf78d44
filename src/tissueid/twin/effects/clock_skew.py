"""Position channel sampled by a different clock."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tissueid.twin._interpolation import interpolate
from tissueid.twin.effect import ActsOn, Effect, FloatArray, Parameter, Readings

EARLIEST_S = 1e-4
"""Largest lead, s: a position can precede its measurement only by the order in which channels are sampled."""


def recording(readings: Readings, values: FloatArray) -> Readings:
    """Return the position at the time of the other clock."""
    offset, rate, drift = values
    time = readings.time
    ahead = (offset + rate * time + 0.5 * drift * time * time) * readings.sample_rate_hz
    return replace(readings, position=interpolate(readings.position, np.arange(time.size) + ahead))


EFFECT = Effect(
    name="clock_skew",
    stage="sensing",
    acts_on=ActsOn.CLOCK,
    title="Position sampled by another clock",
    equation="y(t) = x(t + t0 + r t + d t^2 / 2); vanishes with t0 = r = d = 0",
    signature="position runs ahead of voltage and current, or falls behind, by an interval that grows from the start "
    "of every test; a pure delay, so its phase grows with frequency and its gain stays",
    source="Moon, Skelly & Towsley, IEEE INFOCOM (1999) 227-234 (offset and rate); Laakso et al., IEEE Signal "
    "Processing Magazine 13 (1996) 30-60 (Lagrange interpolation)",
    parameters=(
        Parameter("offset_s", "s", 0.0, -1e-2, EARLIEST_S, prior=0.0, prior_std=2e-3, meaning="lead at the start"),
        Parameter("rate", "1", 0.0, -2e-2, 2e-2, prior=0.0, prior_std=5e-3, meaning="relative error of the rate"),
        Parameter("drift_per_s", "1/s", 0.0, -5e-3, 5e-3, prior=0.0, prior_std=1e-3, meaning="its change per second"),
    ),
    starts=((0.0, 3e-4, 0.0), (0.0, -3e-4, 0.0), (0.0, 4e-3, 0.0), (0.0, -4e-3, 0.0)),
    mistaken_for=("sensor_lag", "dropped_samples", "latency"),
    recording=recording,
    needs=frozenset({"voltage", "position"}),
    jointly=True,
    exact=True,
    remedy="Sample all channels by one clock; otherwise record the other clock's count with the position.",
)
