"""The stochastic part of real-time input generation: one signal without seams, in range and band."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal, stats

from tissueid.stimuli.kinds.rtig import StochasticStream


def stream(shape: str, seed: int = 1) -> StochasticStream:
    return StochasticStream(shape, 200.0, 8, 2000.0, seed)  # type: ignore[arg-type]


@pytest.mark.parametrize("shape", ["uniform", "gaussian"])
def test_cutting_it_into_blocks_changes_nothing(shape: str):
    whole, cut = stream(shape), stream(shape)
    np.testing.assert_array_equal(whole.take(1000), np.concatenate([cut.take(50) for _ in range(20)]))
    assert abs(np.corrcoef(whole.take(1000), stream(shape, 2).take(1000))[0, 1]) < 0.3


@pytest.mark.parametrize("shape", ["uniform", "gaussian"])
def test_it_keeps_to_its_range_and_band(shape: str):
    values = stream(shape).take(100_000)
    assert np.abs(values).max() <= 1.0
    assert np.var(values) == pytest.approx(StochasticStream.variance(shape), rel=0.05)  # type: ignore[arg-type]
    frequency, power = signal.welch(values, 2000.0, nperseg=1000)
    assert power[frequency > 300.0].sum() < 0.03 * power.sum()
    band = power[(frequency > 10.0) & (frequency < 150.0)]
    assert band.max() < 1.6 * band.min()


def test_its_distributions_are_what_they_are_called():
    assert stats.kstest(stream("uniform").take(200_000)[::20], "uniform", (-1.0, 2.0)).statistic < 0.02
    assert stats.kstest(stream("gaussian").take(200_000)[::20], "norm", (0.0, 1.0 / 3.0)).statistic < 0.02
