"""Correlations of the signals of tests."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from tissueid.analysis.curves.overlay import COLOURS, KINDS
from tissueid.analysis.curves.plot import Array, Axis, Curve, Plot
from tissueid.analysis.curves.units import LAG
from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Record

_CORRELATION_S = 0.1
"""Largest lag of the correlations of a test, s."""


def signal_correlations(records: Mapping[str, Record], seconds: float = _CORRELATION_S) -> tuple[Plot, Plot, Plot]:
    """Return normalised correlations of tests over both signs of the lag (Chen 2010, Fig. 3.4).

    Autocorrelations of input and output, and cross-correlation of the output with the input: for a white input the
    last one is the impulse response. Lost samples are left out of the sums.

    Args:
        records: tests by their names in the key.
        seconds: largest lag, s.

    Raises:
        UnusableInputError: a test is constant or shorter than the lags.
    """
    made: tuple[list[Curve], ...] = ([], [], [])
    for place, (name, record) in enumerate(records.items()):
        lags = round(seconds * record.sample_rate_hz)
        colour, kind = COLOURS[place % len(COLOURS)], KINDS[place // len(COLOURS) % len(KINDS)]
        u, y = (_centred(values, lags) for values in (record.input, record.output))
        lag_ms = 1e3 * np.arange(-lags, lags + 1, dtype=np.float64) / record.sample_rate_hz
        for into, (one, other) in zip(made, ((u, u), (y, y), (u, y)), strict=True):
            values = _correlation(one, other, lags)
            into.append(Curve(lag_ms, values, name if len(records) > 1 else "", colour, kind))
    first = next(iter(records.values()))
    lag = replace(LAG, limits=(-1e3 * seconds, 1e3 * seconds))
    correlation = Axis(marked("Correlation"), limits=(-1.05, 1.05), zero=True)
    titles = [
        *(
            Message("plot.autocorrelation", "autocorrelation of the {signal}", signal=name)
            for name in (first.input_name, first.output_name)
        ),
        Message("plot.cross_correlation", "{input} to {output}", input=first.input_name, output=first.output_name),
    ]
    left, middle, right = (
        Plot(title, lag, correlation, tuple(curves)) for title, curves in zip(titles, made, strict=True)
    )
    return left, middle, right


def _centred(values: Array, lags: int) -> Array:
    """Return values without their mean, zero where nothing was received.

    Raises:
        UnusableInputError: they are constant or too few.
    """
    known = np.isfinite(values)
    if values.size < 2 * lags or not known.any() or not float(np.ptp(values[known])) > 0.0:
        raise UnusableInputError("plot.no_correlation", "the test is too short or constant for correlations")
    return np.where(known, values - values[known].mean(), 0.0)


def _correlation(one: Array, other: Array, lags: int) -> Array:
    """Return the normalised correlation (2 lags + 1,) of the later ``other`` with ``one``, biased as Eqs. 3.3, 3.4."""
    from scipy.signal import correlate  # whose import takes half a second

    whole = correlate(other, one, method="fft")
    middle = one.size - 1
    scale = float(np.sqrt(np.sum(one**2) * np.sum(other**2)))
    return np.asarray(whole[middle - lags : middle + lags + 1] / scale, dtype=np.float64)
