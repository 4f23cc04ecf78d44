"""Samples lost without notice: everything recorded after a loss is early."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from tissueid.twin import _lost_samples
from tissueid.twin.effect import Effect, FloatArray, Parameter, Readings

PLACES = 24
"""Most losses in a test."""


def recording(readings: Readings, values: FloatArray) -> Readings:
    """Shift all channels or only the position ahead after each loss; hold the end.

    Losses are rounded to whole samples; they are not fitted by derivatives.
    """
    size = readings.position.size
    at, lost = values[1::2], np.round(values[2::2])
    number = np.arange(size)
    ahead = ((number[:, None] >= at) * lost).sum(axis=1).astype(np.int64)
    index = np.clip(number + ahead, 0, size - 1)
    position = readings.position[index]
    if values[0] >= 0.5:
        return replace(readings, position=position)
    return replace(readings, position=position, voltage=readings.voltage[index], current=readings.current[index])


def estimate_from_record(signals: Mapping[str, FloatArray], sample_rate_hz: float) -> Mapping[str, float]:
    """Return losses of the whole record from the voltage, or else of the position from back-EMF and prediction."""
    slips = _lost_samples.of_record(signals["command"], signals["voltage"])
    alone = not slips
    if alone:
        motion = signals.get("predicted_position")
        slips = _lost_samples.of_position(signals["voltage"], signals["current"], signals["position"], motion)
    return {"position_alone": float(alone and bool(slips)), **_lost_samples.as_parameters(slips, PLACES)}


EFFECT = Effect(
    name="dropped_samples",
    stage="sensing",
    title="Samples lost without notice",
    equation="y(n) = x(n + sum of lost(k) over slips k with sample(k) <= n); vanishes with every lost(k) = 0",
    signature="after certain samples, voltage, current and position are all early against the command by whole samples,"
    " at other places in every test; or only the position is early against the current's back-EMF",
    source="Viterbi, IEEE Trans. Information Theory 13 (1967) 260-269 (the path of lags)",
    parameters=(
        Parameter(
            "position_alone",
            "1",
            None,
            0.0,
            1.0,
            per_test=True,
            fixed=True,
            meaning="1: only the position loses samples",
        ),
        *(
            parameter
            for k in range(1, PLACES + 1)
            for parameter in (
                Parameter(
                    f"slip_{k}_sample", "1", None, 0.0, 1e7, per_test=True, fixed=True, meaning="first sample after it"
                ),
                Parameter(f"slip_{k}_lost", "1", 0.0, -200.0, 200.0, per_test=True, fixed=True, meaning="lost samples"),
            )
        ),
    ),
    starts=((0.0,) * (1 + 2 * PLACES),),
    mistaken_for=("clock_skew", "latency", "sensor_lag"),
    recording=recording,
    needs=frozenset({"command", "voltage", "current", "position"}),
    estimate_from_record=estimate_from_record,
    re_estimate=True,
    jointly=True,
    remedy="Check the link's counters and cable; record with sample numbers.",
)
