"""The numerical bricks, against dense linear algebra and direct sums."""

from __future__ import annotations

import numpy as np
import pytest
from coded import codes
from hypothesis import given
from hypothesis import strategies as st
from identification import simulated
from scipy import linalg, signal

from tissueid.identification import impulse_response
from tissueid.identification.impulse_response import (
    Correlator,
    condition_number,
    convolve_at_rest,
    factor_input,
    lagged_products,
    long_run_covariance,
    toeplitz_inverse,
    toeplitz_solve,
)
from tissueid.identification.preparation import prepare
from tissueid.records import Record


def coloured(seed: int, n: int = 600, pole: float = 0.8) -> np.ndarray:
    x = signal.lfilter([1.0], [1.0, -pole], simulated.generator(seed).standard_normal(n))
    return x - x.mean()


@given(st.integers(2, 80), st.integers(1, 30))
def test_correlations_are_the_sums_of_eqs_3_3_and_3_4(n: int, lags: int):
    rng = simulated.generator(n, lags)
    x, y = rng.standard_normal(n), rng.standard_normal(n)
    auto = [sum(x[i] * x[i + k] for i in range(n - k)) / n for k in range(lags)]
    cross = [sum(x[i] * y[i + k] for i in range(n - k)) / n for k in range(lags)]
    np.testing.assert_allclose(Correlator(x, lags).auto(), auto, atol=1e-12)
    np.testing.assert_allclose(Correlator(x, lags).cross(y), cross, atol=1e-12)


@pytest.mark.parametrize("lags", [1, 2, 3, 10, 75])
@pytest.mark.parametrize("pole", [0.0, 0.8, -0.9, 0.99])
def test_toeplitz_algebra_against_dense(lags: int, pole: float):
    column = Correlator(coloured(lags, pole=pole), lags).auto()
    matrix = linalg.toeplitz(column)
    inverse = toeplitz_inverse(column)
    np.testing.assert_allclose(inverse @ matrix, np.eye(lags), atol=1e-10)
    right = simulated.generator(lags, 1).standard_normal(lags)
    np.testing.assert_allclose(toeplitz_solve(column, right), np.linalg.solve(matrix, right), rtol=1e-8)
    exact = np.linalg.cond(matrix, 1)
    assert 0.7 * exact <= condition_number(column) <= exact * (1.0 + 1e-9)


def test_condition_is_refused_for_what_is_not_positive_definite():
    with pytest.raises(np.linalg.LinAlgError):
        condition_number(np.array([1.0, 1.5, 2.0, -3.0]))


@given(st.integers(1, 12), st.lists(st.integers(0, 79), max_size=6))
def test_convolution_and_products_leave_out_exactly_what_gaps_touch(lags: int, holes: list[int]):
    rng = simulated.generator(lags, len(holes))
    x, kernel = rng.standard_normal(80), rng.standard_normal(lags)
    x[holes] = np.nan
    expected = np.array([
        sum(kernel[k] * x[n - k] for k in range(min(lags, n + 1))) if n >= 0 else 0.0 for n in range(80)
    ])  # fmt: skip
    np.testing.assert_allclose(convolve_at_rest(kernel, x), expected, atol=1e-12)

    used = np.isfinite(expected) & (np.arange(80) >= lags - 1)
    if used.any():
        rows = np.array([x[n - lags + 1 : n + 1][::-1] for n in np.flatnonzero(used)])
        np.testing.assert_allclose(lagged_products(x, used, lags), rows.T @ rows / used.sum(), atol=1e-12)


def test_kernel_with_gaps_is_the_least_squares_answer_on_the_complete_windows():
    rng = simulated.generator(11)
    u = coloured(11, 1500)
    y = signal.lfilter([0.5, 0.3, 0.2], [1.0, -0.5], u) + 0.1 * rng.standard_normal(1500)
    u[[200, 201, 700]] = np.nan
    y[900:910] = np.nan
    lags = 40
    prepared = prepare(Record(u, y, 1000.0), None, 0.040)
    solved = factor_input(prepared)

    rows = [n for n in range(lags - 1, 1500) if np.isfinite(y[n]) and np.all(np.isfinite(u[n - lags + 1 : n + 1]))]
    np.testing.assert_array_equal(np.flatnonzero(prepared.used), rows)
    regressors = np.array([u[n - lags + 1 : n + 1][::-1] - prepared.input_mean for n in rows])
    target = y[rows] - np.mean(y[rows])
    plain, *_ = np.linalg.lstsq(regressors, target, rcond=None)
    dense = factor_input(prepared, pseudo_inverse=True)
    np.testing.assert_allclose(dense.kernel(y), plain, atol=1e-10)
    assert dense.condition == pytest.approx(np.linalg.cond(regressors.T @ regressors), rel=1e-6)

    ridge = np.sqrt(impulse_response.RIDGE * np.mean(np.sum(regressors**2, axis=0))) * np.eye(lags)
    held, *_ = np.linalg.lstsq(np.vstack([regressors, ridge]), np.concatenate([target, np.zeros(lags)]), rcond=None)
    np.testing.assert_allclose(solved.kernel(y), held, atol=1e-10)
    np.testing.assert_allclose(held, plain, atol=2.0 * impulse_response.RIDGE * np.max(np.abs(plain)))


def test_an_input_that_leaves_lags_unexcited_falls_back_on_the_pseudo_inverse(monkeypatch: pytest.MonkeyPatch):
    u = coloured(13, 4000)
    prepared = prepare(Record(u, u, 2000.0), None, 0.02)

    def singular(column: np.ndarray) -> float:
        raise np.linalg.LinAlgError

    monkeypatch.setattr(impulse_response, "condition_number", singular)
    solved = factor_input(prepared)
    assert "impulse_response.pseudo_inverse" in codes(solved.warnings)
    np.testing.assert_allclose(solved.kernel(u), np.eye(40)[0], atol=1e-9)


@pytest.mark.parametrize("pole", [0.0, 0.5, 0.9])
def test_long_run_covariance_of_sums_of_dependent_terms(pole: float):
    n, runs = 2000, 300
    rng = simulated.generator(12, int(100 * pole))
    terms = signal.lfilter([1.0], [1.0, -pole], rng.standard_normal((runs, n + 200)), axis=1)[:, 200:]
    truth = n / (1.0 - pole) ** 2  # variance of the sum of an autoregression of unit innovations
    found = np.mean([float(long_run_covariance(row[:, None], 40)[0, 0]) for row in terms])
    assert found == pytest.approx(truth, rel=0.12)
