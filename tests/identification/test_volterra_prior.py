"""Regularised kernels: the posterior that they claim to be, the likelihood that chooses it, and how they compare."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from coded import Refusal
from identification import simulated, simulated_kernels
from identification.simulated_kernels import LAGS, Known, covered, matern, polynomial, with_gap
from outside_data import RIG
from scipy import linalg, stats

from tissueid.errors import UnusableInputError
from tissueid.identification.validation import vaf_percent
from tissueid.identification.volterra.prior import (
    RegularisedKernels,
    regularised,
    regularised_fit,
    residual_dependence,
    roughness,
)
from tissueid.identification.volterra.regressors import (
    Kernels,
    NormalEquations,
    VolterraRegressors,
    coefficient_count,
    kernels_of,
)
from tissueid.sessions import read_session

SESSIONS = sorted(RIG.glob("rig-*.h5"))


def explicit(known: Known, lags: int, order: int) -> tuple[np.ndarray, np.ndarray, NormalEquations]:
    """Regressors written out (Eq. 4.4), the output at their rows, and the normal equations."""
    rows = np.flatnonzero(known.used)
    windows = np.column_stack([known.x[rows - lag] for lag in range(lags)])
    columns = [np.ones(rows.size), *windows.T]
    if order == 2:
        columns += [windows[:, i] * windows[:, j] for i in range(lags) for j in range(i, lags)]
    p, y = np.column_stack(columns), known.y[rows]
    centred = y - y.mean()
    return p, y, NormalEquations(p.T @ p, p.T @ centred, float(centred @ centred), y.size, lags, order)


def fitted(known: Known, lags: int = LAGS) -> tuple[RegularisedKernels, Kernels, Kernels]:
    """The answer, its kernels and their standard deviations."""
    regressors = VolterraRegressors(known.x, known.used, lags, 1, 2)
    y = known.y[known.used]
    found = regularised_fit(regressors.normal_equations(regressors.gram(), y), regressors, y)
    return found, kernels_of(found.coefficients, lags, 2), kernels_of(found.std, lags, 2)


def prior(hyper: dict[str, float], lags: int, order: int) -> np.ndarray:
    """Covariance of all coefficients but the constant, from the formula."""
    first = matern(np.arange(lags), hyper["first_std"], hyper["first_decay"], hyper["first_rate"])
    if order == 1:
        return first
    i, j = np.triu_indices(lags)
    along = matern((i + j) / 2, hyper["second_std"], hyper["second_decay_along"], hyper["second_rate_along"])
    across = matern(j - i, 1.0, hyper["second_decay_across"], hyper["second_rate_across"])
    twice = 1 + (i != j)
    return linalg.block_diag(first, np.outer(twice, twice) * along * across)


@pytest.mark.parametrize(("lags", "order", "dependence"), [(8, 2, 1.0), (8, 2, 3.5), (12, 1, 1.0), (1, 2, 1.0)])
def test_it_is_the_posterior_of_that_prior(lags: int, order: int, dependence: float):
    known = polynomial(1, n=400, lags=max(lags, 6), cutoff_hz=500.0)
    p, y, equations = explicit(known, lags, order)
    found = regularised(equations, dependence)
    covariance = prior(found.hyperparameters, lags, order)
    density = found.noise_variance * dependence
    # The constant is free: a prior without end, which leaves its row of the stacked problem zero.
    root = np.linalg.inv(linalg.cholesky(covariance, lower=True))
    stacked = np.vstack([p / np.sqrt(density), np.column_stack([np.zeros(root.shape[0]), root])])
    right = np.concatenate([(y - y.mean()) / np.sqrt(density), np.zeros(root.shape[0])])
    expected = linalg.lstsq(stacked, right)[0]
    assert np.linalg.norm(found.coefficients - expected) < 1e-8 * np.linalg.norm(expected)
    posterior = np.linalg.inv(stacked.T @ stacked)
    np.testing.assert_allclose(found.std, np.sqrt(np.diag(posterior)), rtol=1e-6)
    assert found.effective_parameters == pytest.approx(np.trace(p @ posterior @ p.T) / density, rel=1e-6)


def _log_likelihood(p: np.ndarray, y: np.ndarray, hyper: dict[str, float], noise: float, lags: int) -> float:
    contrasts = linalg.helmert(y.size)  # what the constant leaves
    seen = contrasts @ p[:, 1:]
    covariance = seen @ prior(hyper, lags, 2) @ seen.T + noise * np.eye(y.size - 1)
    return float(stats.multivariate_normal.logpdf(contrasts @ y, cov=covariance))


def test_the_likelihood_is_what_it_says_and_is_at_its_greatest():
    lags = 8
    p, y, equations = explicit(polynomial(2, n=300, lags=lags, snr_db=10.0), lags, 2)
    found = regularised(equations)
    here = _log_likelihood(p, y, found.hyperparameters, found.noise_variance, lags)
    assert found.log_evidence == pytest.approx(here, abs=1e-5)
    for name, value in found.hyperparameters.items():
        for factor in (0.8, 1.25):
            there = _log_likelihood(p, y, found.hyperparameters | {name: factor * value}, found.noise_variance, lags)
            assert there < here + 0.02, name


@pytest.mark.parametrize("cutoff_hz", [None, 500.0])
@pytest.mark.parametrize("before", [False, True], ids=["curve after", "curve before"])
def test_kernels_are_nearer_the_truth_than_the_exact_ones(cutoff_hz: float | None, before: bool):
    known = polynomial(3, cutoff_hz=cutoff_hz, before=before)
    _, kernels, _ = fitted(known)
    p, y, _ = explicit(known, LAGS, 2)
    exact = kernels_of(linalg.lstsq(p, y)[0], LAGS, 2)
    for mine, theirs, truth, gain in (
        (kernels.first, exact.first, known.kernel1, 0.9),
        (kernels.second, exact.second, known.kernel2, 0.5),
    ):
        error = np.linalg.norm(mine - truth)
        assert error < 0.08 * np.linalg.norm(truth)
        assert error < gain * np.linalg.norm(theirs - truth)
    if not before:
        assert roughness(kernels.second) < 0.05
        assert cutoff_hz is None or roughness(exact.second) > 0.9


def _estimate(known: Known) -> tuple[np.ndarray, ...]:
    _, kernels, std = fitted(known)
    return kernels.first, kernels.second, std.first, std.second


@pytest.mark.parametrize("colour", [pytest.param(0.0, marks=pytest.mark.soak), 0.95])
def test_standard_deviations_hold(colour: float):
    assert np.all(covered(_estimate, 4, 4, cutoff_hz=600.0, colour=colour) > 0.85)


@pytest.mark.soak
@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"cutoff_hz": 600.0},
        {"cutoff_hz": 600.0, "colour": 0.95},
        {"cutoff_hz": 600.0, "colour": 0.95, "snr_db": 30.0},
        {"colour": 0.8, "before": True},
        {"cutoff_hz": 400.0, "colour": 0.9, "before": True},
    ],
    ids=str,
)
def test_coverage_over_30_runs(options: dict[str, object]):
    share = covered(_estimate, 30, 4, **options)
    print("\n", options, share)
    assert np.all(share > 0.90)
    # With "before", h2 is nothing but its diagonal, and the prior knows it.
    assert "before" in options or np.all(share < 0.999)


def test_dependence_is_one_for_white_noise_and_more_for_coloured():
    rng = simulated.generator(5)
    modelled = simulated_kernels.force(5, 1, n=6000, cutoff_hz=100.0)
    white = rng.standard_normal(6000)
    assert residual_dependence(white, modelled) == pytest.approx(1.0, abs=0.3)
    slow = simulated_kernels.force(5, 2, n=6000, cutoff_hz=100.0)
    assert residual_dependence(slow, modelled) == pytest.approx(10.0, rel=0.2)  # a tenth of the band holds it all
    high = np.diff(white, append=0.0)
    assert residual_dependence(high, modelled) == 1.0
    assert residual_dependence(white, np.zeros(6000)) == 1.0


def test_coloured_noise_is_not_taken_for_kernels():
    known = polynomial(6, cutoff_hz=400.0, snr_db=10.0, colour=0.95)
    found, kernels, _ = fitted(known)
    _, _, equations = explicit(known, LAGS, 2)
    trusting = regularised(equations)
    assert found.dependence > 2.5
    assert found.effective_parameters < 0.7 * trusting.effective_parameters
    error = np.linalg.norm(kernels.second - known.kernel2)
    assert error < np.linalg.norm(kernels_of(trusting.coefficients, LAGS, 2).second - known.kernel2)


def test_a_linear_system_spends_next_to_nothing_on_the_second_order():
    known = polynomial(7, square=0.0)
    found, kernels, std = fitted(known)
    assert found.effective_parameters < 60.0
    assert np.max(np.abs(kernels.second)) < 0.01
    assert np.all(np.abs(kernels.second) < 3.0 * std.second + 1e-12)


def test_units_do_not_matter():
    known = polynomial(8, n=800, lags=12)
    found, kernels, _ = fitted(known, 12)
    scaled, others, _ = fitted(replace(known, x=1e3 * known.x, y=1e-6 * known.y), 12)
    np.testing.assert_allclose(1e9 * others.first, kernels.first, atol=2e-3 * np.max(np.abs(kernels.first)))
    np.testing.assert_allclose(1e12 * others.second, kernels.second, atol=5e-3 * np.max(np.abs(kernels.second)))
    assert scaled.effective_parameters == pytest.approx(found.effective_parameters, rel=0.02)


def test_noise_free_records_and_fewer_rows_than_coefficients():
    silent, kernels, _ = fitted(polynomial(9, n=1500, snr_db=None))
    assert np.isfinite(silent.log_evidence)
    known = polynomial(9, n=330)
    assert known.used.sum() < coefficient_count(LAGS, 2)
    _, few, _ = fitted(known)
    assert np.linalg.norm(few.second - known.kernel2) < 0.3 * np.linalg.norm(known.kernel2)
    assert np.linalg.norm(kernels.second - known.kernel2) < 0.01 * np.linalg.norm(known.kernel2)


def test_rows_may_have_gaps():
    known = with_gap(polynomial(10), 1000)
    _, kernels, _ = fitted(known)
    assert np.linalg.norm(kernels.second - known.kernel2) < 0.05 * np.linalg.norm(known.kernel2)


def test_roughness_is_a_share_of_energy():
    rng = simulated.generator(11)
    assert roughness(rng.standard_normal((200, 200))) == pytest.approx(1.0 - np.pi / 16.0, abs=0.01)
    wave = np.cos(2.0 * np.pi * np.arange(40) / 10.0)
    assert roughness(np.outer(wave, wave)) < 1e-20
    assert roughness(np.outer(wave, (-1.0) ** np.arange(40))) == pytest.approx(1.0)
    assert roughness(np.zeros((5, 5))) == 0.0


@pytest.mark.parametrize(
    ("order", "rows", "refusal"),
    [(3, 500, Refusal("volterra.prior_order", order=3)), (2, 60, Refusal("volterra.dependent_rows", rows=60))],
)
def test_refusals(order: int, rows: int, refusal: Refusal):
    size = coefficient_count(3, 2)
    equations = NormalEquations(np.eye(size), np.ones(size), 10.0, rows, 3, order)
    with pytest.raises(UnusableInputError, check=refusal.check):
        regularised(equations, dependence=10.0)


@pytest.mark.skipif(not SESSIONS, reason="the independent rig's sessions are not here")
@pytest.mark.soak
def test_nothing_is_lost_on_the_rig():
    record = read_session(SESSIONS[0]).test(None).record("force", "position")
    lags, spacing, cut = 41, 3, 6000
    x = record.input - record.input[:cut].mean()
    n = np.arange(len(record))
    fit = VolterraRegressors(x, (n >= (lags - 1) * spacing) & (n < cut), lags, spacing, 2)
    held_out = VolterraRegressors(x, n >= cut, lags, spacing, 2)
    y = record.output[fit.rows]
    equations = fit.normal_equations(fit.gram(), y)
    exact = np.linalg.lstsq(fit.matrix(), y, rcond=None)[0]
    found = regularised_fit(equations, fit, y)
    score = [vaf_percent(record.output[cut:], held_out.apply(theta)) for theta in (exact, found.coefficients)]
    print(score)
    assert score[1] > score[0]
    assert roughness(kernels_of(found.coefficients, lags, 2).second) < 0.01
