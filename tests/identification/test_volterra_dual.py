"""The dual route: the posterior over every coefficient written out, cubic systems, and simulation of a third order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from coded import Refusal, says
from identification import simulated, simulated_kernels
from identification.simulated_kernels import LAGS, covered, matern, polynomial, with_gap
from scipy import linalg, stats

from tissueid.errors import UnusableInputError
from tissueid.identification.volterra.methods import RegressionKernels, regression_kernels, simulate_third


def _prior(hyper: dict[str, float], lags: int, order: int) -> list[np.ndarray]:
    """Covariance of all L^k entries of the kernel of each order, symmetric in their lags."""
    found = [matern(np.arange(lags), hyper["first_std"], hyper["first_decay"], hyper["first_rate"])]
    for k, name in ((2, "second"), (3, "third"))[: order - 1]:
        lag = matern(np.arange(lags), 1.0, hyper["smooth_decay"], hyper["smooth_rate"])
        smooth = lag
        for _ in range(k - 1):
            smooth = np.kron(smooth, lag)
        covariance = hyper[f"{name}_std"] ** 2 * smooth
        each = np.arange(lags) * sum(lags**power for power in range(k))  # places of the diagonal
        on = matern(np.arange(lags), hyper[f"{name}_diagonal_std"], hyper["first_decay"], hyper["first_rate"])
        covariance[np.ix_(each, each)] += on
        found.append(covariance)
    return found


def _written_out(x: np.ndarray, rows: np.ndarray, lags: int, spacing: int, order: int) -> list[np.ndarray]:
    """Products of lagged inputs of each order, every order of factors by itself: (rows, L^k)."""
    windows = np.column_stack([x[rows - lag * spacing] for lag in range(lags)])
    found = [windows]
    for _ in range(order - 1):
        found.append(np.einsum("ni,nj->nij", found[-1], windows).reshape(rows.size, -1))
    return found


@pytest.mark.parametrize(("order", "spacing"), [(1, 1), (2, 1), (3, 1), (3, 2)])
def test_it_is_the_posterior_of_that_prior(order: int, spacing: int):
    lags = 5
    known = polynomial(20, n=330, lags=lags, spacing=spacing, cube=0.5, slowness=0.4, snr_db=15.0)
    found = regression_kernels(known.x, known.y, known.used, lags, spacing, order)
    rows = np.flatnonzero(known.used)
    products = _written_out(known.x, rows, lags, spacing, order)
    prior = _prior(found.hyperparameters, lags, order)
    density = found.noise_variance * found.dependence
    p, covariance = np.concatenate(products, axis=1), linalg.block_diag(*prior)
    noisy = p @ covariance @ p.T + density * np.eye(rows.size)
    ones, y = np.ones(rows.size), known.y[rows]
    solve = linalg.cho_factor(noisy)
    certainty = ones @ linalg.cho_solve(solve, ones)
    constant = ones @ linalg.cho_solve(solve, y) / certainty
    gain = linalg.cho_solve(solve, p @ covariance).T
    mean = gain @ (y - constant)
    spread = covariance - gain @ p @ covariance + np.outer(gain @ ones, gain @ ones) / certainty
    assert found.kernel0 == pytest.approx(constant, rel=1e-8)
    assert found.kernel0_std == pytest.approx(certainty**-0.5, rel=1e-6)
    edges = np.cumsum([0, *(lags**k for k in range(1, order + 1))])
    for k, kernel in enumerate((found.kernel1, found.kernel2, found.kernel3)[:order], start=1):
        expected = mean[edges[k - 1] : edges[k]].reshape((lags,) * k)
        expected = sum(np.transpose(expected, turned) for turned in _orders(k)) / len(_orders(k))
        assert np.linalg.norm(kernel - expected) < 1e-8 * np.linalg.norm(expected)
    np.testing.assert_allclose(found.kernel1_std, np.sqrt(np.diag(spread)[:lags]), rtol=1e-6)
    if order >= 2:
        turn = np.zeros((lags, lags, lags, lags))  # the symmetric part of h2
        i, j = np.indices((lags, lags))
        turn[i, j, i, j] += 0.5
        turn[i, j, j, i] += 0.5
        turn = turn.reshape(lags**2, lags**2)
        second = turn @ spread[edges[1] : edges[2], edges[1] : edges[2]] @ turn.T
        np.testing.assert_allclose(found.kernel2_std, np.sqrt(np.diag(second)).reshape(lags, lags), rtol=1e-6)
    left = linalg.inv(noisy)
    left -= np.outer(left @ ones, left @ ones) / certainty
    assert found.effective_parameters == pytest.approx(rows.size - density * np.trace(left), rel=1e-6)


def _orders(k: int) -> list[tuple[int, ...]]:
    return {1: [(0,)], 2: [(0, 1), (1, 0)]}.get(k, [(0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)])


def test_the_likelihood_is_what_it_says_and_is_at_its_greatest():
    lags, order = 5, 3
    known = polynomial(21, n=300, lags=lags, cube=0.5, slowness=0.4, snr_db=10.0)
    found = regression_kernels(known.x, known.y, known.used, lags, 1, order)
    rows = np.flatnonzero(known.used)
    p = np.concatenate(_written_out(known.x, rows, lags, 1, order), axis=1)
    contrasts = linalg.helmert(rows.size)  # what the constant leaves

    def likelihood(hyper: dict[str, float]) -> float:
        seen = contrasts @ p
        covariance = seen @ linalg.block_diag(*_prior(hyper, lags, order)) @ seen.T
        covariance += found.noise_variance * np.eye(rows.size - 1)
        return float(stats.multivariate_normal.logpdf(contrasts @ known.y[rows], cov=covariance))

    here = likelihood(found.hyperparameters)
    assert found.dependence < 1.4
    assert found.log_evidence + 0.5 * np.log(rows.size) == pytest.approx(here, abs=1e-5)
    for name, value in found.hyperparameters.items():
        for factor in (0.8, 1.25):
            assert likelihood(found.hyperparameters | {name: factor * value}) < here + 0.05, name


@pytest.fixture(scope="module")
def cubic() -> tuple[simulated_kernels.Known, RegressionKernels]:
    known = polynomial(22, n=2000, cube=2.0, cutoff_hz=500.0, snr_db=30.0)
    return known, regression_kernels(known.x, known.y, known.used, LAGS, 1, 3, search_rows=700)


@pytest.mark.soak
def test_a_cubic_system_shows_its_kernels(cubic: tuple[simulated_kernels.Known, RegressionKernels]):
    known, found = cubic
    for kernel, truth, error in (
        (found.kernel1, known.kernel1, 0.05),
        (found.kernel2, known.kernel2, 0.05),
        (found.kernel3, known.kernel3, 0.2),
    ):
        assert np.linalg.norm(kernel - truth) < error * np.linalg.norm(truth)
    assert found.kernel0 == pytest.approx(5.0, abs=0.03)
    assert found.warnings == ()
    for turned in _orders(3):
        np.testing.assert_allclose(found.kernel3, found.kernel3.transpose(turned), atol=1e-12)


def test_fresh_samples_are_met(cubic: tuple[simulated_kernels.Known, RegressionKernels]):
    _, found = cubic
    fresh = polynomial(22, 1, n=1500, cube=2.0, cutoff_hz=500.0, snr_db=None)
    windows = np.column_stack([np.roll(fresh.x, lag) for lag in range(LAGS)])
    output = found.kernel0 + windows @ found.kernel1 + np.einsum("ni,ij,nj->n", windows, found.kernel2, windows)
    output += simulate_third(found.kernel3, fresh.x, 1)
    left = (fresh.y - output)[fresh.used]
    assert np.var(left) < 0.005 * np.var(fresh.y)


@pytest.mark.parametrize("order", [2, 3])
def test_a_curve_before_the_dynamics_is_found_on_the_diagonal(order: int):
    known = polynomial(23, n=1200, before=True, square=0.5, cube=0.1 if order == 3 else 0.0)
    found = regression_kernels(known.x, known.y, known.used, LAGS, 1, order, search_rows=400)
    assert np.linalg.norm(found.kernel2 - known.kernel2) < 0.12 * np.linalg.norm(known.kernel2)
    off = found.kernel2 - np.diag(np.diag(found.kernel2))
    assert np.linalg.norm(off) < 0.1 * np.linalg.norm(found.kernel2)


def _estimate(known: simulated_kernels.Known) -> tuple[np.ndarray, ...]:
    found = regression_kernels(known.x, known.y, known.used, LAGS, 1, 2, search_rows=600)
    return found.kernel1, found.kernel2, found.kernel1_std, found.kernel2_std


def test_standard_deviations_hold():
    assert np.all(covered(_estimate, 2, 24, n=2000, cutoff_hz=600.0, colour=0.9) > 0.85)


@pytest.mark.soak
@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    "options",
    [{}, {"cutoff_hz": 600.0}, {"cutoff_hz": 600.0, "colour": 0.95}, {"colour": 0.8, "before": True}],
    ids=str,
)
def test_coverage_over_20_runs(options: dict[str, object]):
    share = covered(_estimate, 20, 24, **options)
    print("\n", options, share)
    assert np.all(share > 0.92)


def test_more_rows_than_allowed_are_thinned_with_a_warning():
    known = polynomial(25, n=2000)
    found = regression_kernels(known.x, known.y, known.used, LAGS, 1, 2, max_rows=500, search_rows=300)
    assert found.rows == 495
    assert any(says(text, "volterra.thinned", every=4) for text in found.warnings)
    whole = regression_kernels(known.x, known.y, known.used, LAGS, 1, 2, search_rows=300)
    assert whole.rows == known.used.sum()
    assert np.mean(found.kernel2_std) > np.mean(whole.kernel2_std)
    error = [np.linalg.norm(k.kernel2 - known.kernel2) for k in (whole, found)]
    assert error[0] < error[1] < 0.2 * np.linalg.norm(known.kernel2)


def test_rows_may_have_gaps():
    known = with_gap(polynomial(26, n=1500), 700)
    found = regression_kernels(known.x, known.y, known.used, LAGS, 1, 2, search_rows=400)
    assert np.linalg.norm(found.kernel2 - known.kernel2) < 0.1 * np.linalg.norm(known.kernel2)


@pytest.mark.parametrize("spacing", [1, 3])
def test_a_third_order_kernel_is_simulated_as_loops_do_it(spacing: int):
    rng = simulated.generator(27)
    kernel = rng.standard_normal((6, 6, 6))
    kernel = sum(np.transpose(kernel, turned) for turned in _orders(3)) / 6.0
    x = rng.standard_normal(150)
    expected = simulated_kernels.third_order_output(kernel, x, spacing)
    np.testing.assert_allclose(simulate_third(kernel, x, spacing), expected, rtol=1e-10)
    x[60] = np.nan
    holds = np.isnan(simulate_third(kernel, x, spacing))
    np.testing.assert_array_equal(np.flatnonzero(holds), 60 + spacing * np.arange(6))


@pytest.mark.parametrize(
    ("order", "n", "refusal"),
    [
        (0, 500, Refusal("volterra.dual_order", order=0)),
        (4, 500, Refusal("volterra.dual_order", order=4)),
        (2, LAGS + 4, Refusal("volterra.too_few_rows_for_kernels", rows=5)),
    ],
)
def test_refusals(order: int, n: int, refusal: Refusal):
    known = polynomial(28, n=n)
    with pytest.raises(UnusableInputError, check=refusal.check):
        regression_kernels(known.x, known.y, known.used, LAGS, 1, order)


def test_units_do_not_matter():
    known = polynomial(30, n=400, lags=12)
    found = regression_kernels(known.x, known.y, known.used, 12, 1, 2)
    other = replace(known, x=1e3 * known.x, y=1e-6 * known.y)
    scaled = regression_kernels(other.x, other.y, other.used, 12, 1, 2)
    np.testing.assert_allclose(1e9 * scaled.kernel1, found.kernel1, atol=1e-3 * np.max(np.abs(found.kernel1)))
    assert scaled.effective_parameters == pytest.approx(found.effective_parameters, rel=0.02)
