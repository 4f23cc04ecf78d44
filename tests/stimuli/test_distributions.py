"""Amplitude distributions: the levels are those of the distribution, over the whole range, and rubbish is refused."""

from __future__ import annotations

import numpy as np
import pytest
from coded import coded
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from tissueid.errors import UnusableInputError
from tissueid.stimuli.distributions import (
    Binary,
    Distribution,
    Exponential,
    Gaussian,
    Quantiles,
    Rayleigh,
    Uniform,
    kolmogorov_distance,
)

EVERY = (Uniform(), Gaussian(), Gaussian(2.0), Rayleigh(), Exponential(), Binary(), Quantiles((0.0, 1.0, 1.5, 9.0)))


@pytest.mark.parametrize("distribution", EVERY)
@given(n=st.integers(2, 300))
def test_levels_rise_from_one_end_of_the_range_to_the_other(distribution: Distribution, n: int):
    levels = distribution.levels(n)
    assert levels.shape == (n,)
    assert levels[0] == -1.0
    assert levels[-1] == 1.0
    assert np.all(np.diff(levels) >= 0.0)


def over(low: float, high: float, levels: np.ndarray) -> np.ndarray:
    return low + 0.5 * (levels + 1.0) * (high - low)


@pytest.mark.parametrize(
    ("distribution", "cut_off", "low", "high"),
    [
        (Gaussian(3.0), stats.norm(), -3.0, 3.0),
        (Gaussian(1.5), stats.norm(), -1.5, 1.5),
        (Uniform(), stats.uniform(), 0.0, 1.0),
        (Rayleigh(3.0), stats.rayleigh(), 0.0, stats.rayleigh.mean() + 3.0 * stats.rayleigh.std()),
        (Exponential(2.0), stats.expon(), 0.0, 3.0),
    ],
)
def test_levels_are_those_of_the_distribution_cut_at_its_ends(
    distribution: Distribution, cut_off: stats.rv_continuous, low: float, high: float
):
    values = over(low, high, distribution.levels(2001))
    inside = (cut_off.cdf(values) - cut_off.cdf(low)) / (cut_off.cdf(high) - cut_off.cdf(low))
    np.testing.assert_allclose(inside, np.linspace(0.0, 1.0, 2001), atol=1e-12)


def test_a_leaning_distribution_keeps_its_lean():
    assert Gaussian().levels(1001).mean() == 0.0
    assert Uniform().levels(1001).mean() == pytest.approx(0.0, abs=1e-15)
    assert Exponential().levels(1001).mean() < -0.4
    assert Rayleigh().levels(1001).mean() < -0.1


@pytest.mark.parametrize("n", [2, 3, 16, 17])
def test_binary_is_at_each_end_half_of_the_time(n: int):
    levels = Binary().levels(n)
    assert set(levels) == {-1.0, 1.0}
    assert np.count_nonzero(levels == -1.0) - np.count_nonzero(levels == 1.0) == n % 2


def test_quantiles_are_joined_by_straight_lines():
    table = Quantiles((2.0, 3.0, 3.0, 10.0), (0.0, 0.25, 0.75, 1.0))
    levels = over(2.0, 10.0, table.levels(401))
    np.testing.assert_allclose(levels[100:301], 3.0, atol=1e-12)
    np.testing.assert_allclose(levels[[50, 350]], [2.5, 6.5], atol=1e-12)
    np.testing.assert_allclose(Quantiles((5.0, 6.0)).levels(9), Uniform().levels(9), atol=1e-15)


@pytest.mark.parametrize(
    ("make", "refusal"),
    [
        (lambda: Quantiles((1.0,)), coded("quantiles.few", values=1)),
        (lambda: Quantiles(()), coded("quantiles.few", values=0)),
        (lambda: Quantiles((1.0, 3.0, 2.0)), coded("quantiles.fall")),
        (lambda: Quantiles((1.0, 1.0)), coded("quantiles.equal", values=1.0)),
        (lambda: Quantiles((1.0, 2.0), (0.0, 0.5, 1.0)), coded("quantiles.lengths", values=2, probabilities=3)),
        (lambda: Quantiles((1.0, 2.0), (0.0, 0.9)), coded("quantiles.ends")),
        (lambda: Quantiles((1.0, 2.0, 3.0, 4.0), (0.0, 0.7, 0.3, 1.0)), coded("quantiles.rise")),
        (lambda: Uniform().levels(1), coded("distribution.samples", n=1)),
        (lambda: Gaussian().levels(0), coded("distribution.samples", n=0)),
    ],
)
def test_what_is_no_distribution_is_refused_in_one_line(make, refusal):
    with pytest.raises(UnusableInputError, check=refusal) as refused:
        make()
    assert "\n" not in str(refused.value)


def test_the_kolmogorov_distance_is_that_of_two_samples():
    rng = np.random.default_rng(3)
    one, other = rng.standard_normal(200), rng.uniform(-1.0, 1.0, 300)
    assert kolmogorov_distance(one, other) == pytest.approx(stats.ks_2samp(one, other).statistic)
    assert kolmogorov_distance(rng.permutation(other), other) == 0.0
