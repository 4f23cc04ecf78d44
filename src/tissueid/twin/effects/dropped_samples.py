"""Samples lost without a mark: what is recorded afterwards comes too early."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from tissueid.twin import _slips
from tissueid.twin.effect import Effect, FloatArray, Parameter, Readings

PLACES = 24
"""So many slips a test can have."""


def recording(readings: Readings, values: FloatArray) -> Readings:
    """Every channel, or the position alone, ahead by what was lost before; the end is held.

    Half a sample or more counts as one: losses are whole numbers, and none are searched for by slopes.
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


def from_test(signals: Mapping[str, FloatArray], sample_rate_hz: float) -> Mapping[str, float]:
    """Slips of the whole record by command against voltage; failing those, of the position by the back-EMF.

    And by the motion that was predicted, where there is one.
    """
    slips = _slips.of_record(signals["command"], signals["voltage"])
    alone = not slips
    if alone:
        motion = signals.get("predicted_position")
        slips = _slips.of_position(signals["voltage"], signals["current"], signals["position"], motion)
    return {"position_alone": float(alone and bool(slips)), **_slips.as_parameters(slips, PLACES)}


EFFECT = Effect(
    name="dropped_samples",
    stage="sensing",
    title="Samples lost without a mark",
    equation="y(n) = x(n + sum of lost(k) over slips k with sample(k) <= n); vanishes with every lost(k) = 0",
    signature="from some sample on, voltage, current and position all come early against the command by whole samples, "
    "at other places in every test; or the position alone comes early against the current's back-EMF",
    source="Viterbi, IEEE Trans. Information Theory 13 (1967) 260-269 (the path of lags)",
    parameters=(
        Parameter(
            "position_alone", "1", None, 0.0, 1.0, per_test=True, fixed=True, meaning="1: no other channel slips"
        ),
        *(
            parameter
            for k in range(1, PLACES + 1)
            for parameter in (
                Parameter(f"slip_{k}_sample", "1", None, 0.0, 1e7, per_test=True, fixed=True, meaning="first after it"),
                Parameter(f"slip_{k}_lost", "1", 0.0, -200.0, 200.0, per_test=True, fixed=True, meaning="samples lost"),
            )
        ),
    ),
    starts=((0.0,) * (1 + 2 * PLACES),),
    mistaken_for=("clock_skew", "latency", "sensor_lag"),
    recording=recording,
    needs=frozenset({"command", "voltage", "current", "position"}),
    from_test=from_test,
    read_again=True,
    jointly=True,
    remedy="Look at the link's counters and cable; record with sample numbers.",
)
