"""A position channel that is timed by another clock."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tissueid.twin._between import between
from tissueid.twin.effect import Effect, FloatArray, Parameter, Readings

EARLIEST_S = 1e-4
"""A position cannot be told much before it is met, but for the order in which the channels are sampled."""


def recording(readings: Readings, values: FloatArray) -> Readings:
    """Position as of the other clock's time."""
    offset, rate, drift = values
    time = readings.time
    ahead = (offset + rate * time + 0.5 * drift * time * time) * readings.sample_rate_hz
    return replace(readings, position=between(readings.position, np.arange(time.size) + ahead))


EFFECT = Effect(
    name="clock_skew",
    stage="sensing",
    title="Position timed by another clock",
    equation="y(t) = x(t + t0 + r t + d t^2 / 2); vanishes with t0 = r = d = 0",
    signature="position runs ahead of voltage and current, or falls behind, by an interval that grows from the start "
    "of every test; a pure delay, so its phase grows with frequency and its gain stays",
    source="Moon, Skelly & Towsley, IEEE INFOCOM (1999) 227-234 (offset and rate); Laakso et al., IEEE Signal "
    "Processing Magazine 13 (1996) 30-60 (Lagrange interpolation)",
    parameters=(
        Parameter("offset_s", "s", 0.0, -1e-2, EARLIEST_S, prior=0.0, prior_std=2e-3, meaning="ahead at the start"),
        Parameter("rate", "1", 0.0, -2e-2, 2e-2, prior=0.0, prior_std=5e-3, meaning="gained in each second"),
        Parameter("drift_per_s", "1/s", 0.0, -5e-3, 5e-3, prior=0.0, prior_std=1e-3, meaning="change of the rate"),
    ),
    starts=((0.0, 3e-4, 0.0), (0.0, -3e-4, 0.0), (0.0, 4e-3, 0.0), (0.0, -4e-3, 0.0)),
    mistaken_for=("sensor_lag", "dropped_samples", "latency"),
    recording=recording,
    needs=frozenset({"voltage", "position"}),
    jointly=True,
    exact=True,
    remedy="Let one clock time all channels; else record its count beside the position.",
)
