"""Block structures read off Volterra kernels: known kernels, with and without errors."""

from __future__ import annotations

import numpy as np
import pytest
from coded import refused
from identification import simulated, simulated_blocks

from tissueid.identification.volterra.structure import StructureVerdict, kernel_structure
from tissueid.messages import code_of

Array = np.ndarray
LAGS = 25
STEP = 4


def _dynamics() -> Array:
    """The forearm's impulse response on lags of 2 ms, with its undershoot."""
    return simulated_blocks.kernel(LAGS * STEP)[::STEP]


def _lnl(first: Array, last: Array) -> tuple[Array, Array]:
    """First and second kernel of a square and a straight part between two filters, by plain sums."""
    kernel1, kernel2 = np.zeros(LAGS), np.zeros((LAGS, LAGS))
    for s in range(LAGS):
        for i in range(s, LAGS):
            kernel1[i] += last[s] * first[i - s]
            for j in range(s, LAGS):
                kernel2[i, j] += last[s] * first[i - s] * first[j - s]
    return kernel1, kernel2


def _known() -> dict[str, tuple[Array, Array]]:
    h = _dynamics()
    return {
        "wiener": (h, -0.4 * np.outer(h, h)),
        "hammerstein": (2.0 * h, -0.3 * np.diag(h)),
        "lnl": _lnl(np.exp(-np.arange(LAGS) / 3.0), h),
        "linear": (h, np.zeros((LAGS, LAGS))),
    }


@pytest.mark.parametrize("name", ["wiener", "hammerstein", "lnl", "linear"])
def test_exact_kernels_are_named(name: str):
    verdict = kernel_structure(*_known()[name])
    assert verdict.name == name
    assert verdict.sentence
    if name != "linear":
        assert verdict.scores[name].cosine == pytest.approx(1.0, abs=1e-3)
        assert verdict.scores["lnl"].cosine == pytest.approx(1.0, abs=1e-3)  # the others are LNL with one block idle


def test_a_narrow_lobe_between_two_of_the_other_sign_is_neither():
    h = _dynamics()
    lag = np.arange(LAGS)
    apart = np.subtract.outer(lag, lag) / 2.0
    verdict = kernel_structure(h, -np.outer(h, h) * (1.0 - apart**2) * np.exp(-0.5 * apart**2))
    assert verdict.name == "neither"
    assert verdict.side_lobes > 0.1
    assert code_of(verdict.sentence) == "structure.side_lobes"


@pytest.mark.parametrize("name", ["wiener", "hammerstein"])
def test_without_a_first_kernel_the_second_speaks_alone(name: str):
    _, kernel2 = _known()[name]
    verdict = kernel_structure(np.zeros(LAGS), kernel2)
    assert verdict.name == name
    assert "lnl" not in verdict.scores


def test_scale_sign_and_slight_asymmetry_do_not_matter():
    kernel1, kernel2 = _known()["wiener"]
    assert kernel_structure(-3e-4 * kernel1, 7e5 * kernel2).name == "wiener"
    assert kernel_structure(kernel1, kernel2 + 1e-6 * np.tri(LAGS)).name == "wiener"


def _noisy(name: str, seed: int, share: float) -> StructureVerdict:
    kernel1, kernel2 = _known()[name]
    rng = simulated.generator(70, seed)
    std1 = share * np.max(np.abs(kernel1)) * np.ones(LAGS)
    std2 = share * np.max(np.abs(kernel2)) * np.ones((LAGS, LAGS)) if kernel2.any() else np.full((LAGS, LAGS), share)
    error = std2 * rng.standard_normal(kernel2.shape)
    error = np.triu(error) + np.triu(error, 1).T
    return kernel_structure(kernel1 + std1 * rng.standard_normal(LAGS), kernel2 + error, std1, std2)


@pytest.mark.parametrize("name", ["wiener", "hammerstein", "lnl"])
def test_names_hold_under_errors_of_three_percent_of_the_peak(name: str):
    named = [_noisy(name, seed, 0.03).name for seed in range(10)]
    assert named.count(name) >= 9, named


def test_a_second_kernel_within_its_errors_is_that_of_a_linear_system():
    assert [_noisy("linear", seed, 0.1).name for seed in range(10)].count("linear") == 10


def test_kernels_drowned_in_errors_are_given_no_name_of_their_own():
    named = {_noisy("wiener", seed, 0.5).name for seed in range(10)}
    assert "hammerstein" not in named
    assert "neither" not in named


def test_bands_are_the_same_every_time_and_widen_with_the_errors():
    narrow, wide = _noisy("wiener", 1, 0.01), _noisy("wiener", 1, 0.1)
    assert _noisy("wiener", 1, 0.01) == narrow
    assert wide.scores["wiener"].band < narrow.scores["wiener"].band


def test_kernels_that_do_not_belong_together_are_refused():
    refused(lambda: kernel_structure(np.ones(5), np.ones((4, 4))), "volterra.kernel_shapes")
    refused(lambda: kernel_structure(np.full(4, np.nan), np.ones((4, 4))), "volterra.kernel_not_finite")
