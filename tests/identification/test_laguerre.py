"""Laguerre expansions: the functions, least squares on them, and what is chosen."""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np
import pytest
from coded import Refusal, says
from identification.simulated_kernels import LAGS, Known, covered, force, polynomial, with_gap
from scipy import linalg

from tissueid.errors import UnusableInputError
from tissueid.identification.volterra.laguerre import laguerre_functions, laguerre_kernels
from tissueid.identification.volterra.methods import simulate_third


@pytest.mark.parametrize("pole", [0.0, 0.3, 0.9])
def test_functions_are_orthonormal_and_the_first_is_a_decay(pole: float):
    functions = laguerre_functions(600, 8, pole)
    np.testing.assert_allclose(functions.T @ functions, np.eye(8), atol=1e-10)
    np.testing.assert_allclose(functions[:, 0], np.sqrt(1.0 - pole**2) * pole ** np.arange(600.0), atol=1e-12)
    if pole == 0.0:
        np.testing.assert_allclose(functions[:8], np.eye(8), atol=1e-15)


def _written_out(known: Known, functions: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
    rows = np.flatnonzero(known.used)
    windows = np.column_stack([known.x[rows - lag] for lag in range(functions.shape[0])])
    v = windows @ functions
    columns = [np.ones(rows.size)]
    for degree in range(1, order + 1):
        columns += [np.prod(v[:, some], axis=1) for some in combinations_with_replacement(range(v.shape[1]), degree)]
    return np.column_stack(columns), known.y[rows]


@pytest.mark.parametrize("order", [1, 2, 3])
def test_it_is_least_squares_on_the_products(order: int):
    known = polynomial(40, n=1500, cube=0.5)
    found = laguerre_kernels(known.x, known.y, known.used, LAGS, 1, order, functions=4, pole=0.7)
    p, y = _written_out(known, laguerre_functions(LAGS, 4, 0.7), order)
    expected = linalg.lstsq(p, y)[0]
    assert np.linalg.norm(found.coefficients - expected) < 1e-8 * np.linalg.norm(expected)
    assert found.n_parameters == p.shape[1] + 1
    output = p @ expected
    windows = np.column_stack([np.roll(known.x, lag) for lag in range(LAGS)])
    kernels = found.kernel0 + windows @ found.kernel1
    if found.kernel2 is not None:
        kernels = kernels + np.einsum("ni,ij,nj->n", windows, found.kernel2, windows)
    if found.kernel3 is not None:
        kernels = kernels + simulate_third(found.kernel3, known.x, 1)
    np.testing.assert_allclose(kernels[known.used], output, atol=1e-9)
    assert (found.kernel2 is None) == (order < 2)
    assert (found.kernel3 is None) == (order < 3)


def _within_reach(*seed: int, order: int, snr_db: float) -> tuple[Known, float]:
    """A polynomial system whose filter is a sum of three Laguerre functions, and their pole."""
    pole = 0.62
    known = polynomial(*seed, n=3000, snr_db=None)
    h = laguerre_functions(LAGS, 3, pole) @ np.array([0.2, -0.1, 0.15])
    z = np.convolve(known.x, h)[: known.x.size]
    y = z + 2.0 * z**2 * (order >= 2) + 2.0 * z**3 * (order >= 3)
    y = y + 10.0 ** (-snr_db / 20.0) * np.std(y) * force(*seed, 7, n=y.size)
    second, third = 2.0 * np.outer(h, h) * (order >= 2), 2.0 * np.einsum("i,j,k->ijk", h, h, h)
    return Known(known.x, y, known.used, h, second, third), pole


@pytest.mark.parametrize("order", [1, 2, 3])
def test_pole_and_number_are_found_where_the_system_is_such_a_sum(order: int):
    known, pole = _within_reach(41, order=order, snr_db=30.0)
    found = laguerre_kernels(known.x, known.y, known.used, LAGS, 1, order)
    assert found.pole == pytest.approx(pole, abs=0.06)
    assert 3 <= found.functions.shape[1] <= 5
    assert np.linalg.norm(found.kernel1 - known.kernel1) < 0.02 * np.linalg.norm(known.kernel1)
    assert found.held_out_percent == pytest.approx(99.9, abs=0.05)
    if found.kernel2 is not None:
        assert np.linalg.norm(found.kernel2 - known.kernel2) < 0.03 * np.linalg.norm(known.kernel2)
    if found.kernel3 is not None:
        assert np.linalg.norm(found.kernel3 - known.kernel3) < 0.05 * np.linalg.norm(known.kernel3)


def test_few_parameters_do_for_a_system_that_is_no_such_sum():
    known = polynomial(42, cutoff_hz=600.0)
    found = laguerre_kernels(known.x, known.y, known.used, LAGS, 1, 2)
    assert found.n_parameters < 110
    assert np.linalg.norm(found.kernel1 - known.kernel1) < 0.05 * np.linalg.norm(known.kernel1)
    assert np.linalg.norm(found.kernel2 - known.kernel2) < 0.06 * np.linalg.norm(known.kernel2)


def _estimate(known: Known) -> tuple[np.ndarray, ...]:
    found = laguerre_kernels(known.x, known.y, known.used, LAGS, 1, 2)
    return found.kernel1, found.kernel2, found.kernel1_std, found.kernel2_std


@pytest.mark.parametrize("colour", [pytest.param(0.0, marks=pytest.mark.soak), 0.9])
def test_standard_deviations_hold(colour: float):
    assert np.all(covered(_estimate, 3, 43, cutoff_hz=600.0, colour=colour) > 0.8)


@pytest.mark.soak
@pytest.mark.timeout(900)
@pytest.mark.parametrize("options", [{}, {"cutoff_hz": 600.0}, {"cutoff_hz": 600.0, "colour": 0.95}], ids=str)
def test_coverage_over_30_runs(options: dict[str, object]):
    share = covered(_estimate, 30, 43, **options)
    print("\n", options, share)
    assert np.all(share > 0.87)


def test_spaced_lags():
    known = polynomial(44, n=4000, lags=12, spacing=3, slowness=0.4, snr_db=40.0)
    found = laguerre_kernels(known.x, known.y, known.used, 12, 3, 2, functions=12)
    assert np.linalg.norm(found.kernel1 - known.kernel1) < 0.05 * np.linalg.norm(known.kernel1)
    assert np.linalg.norm(found.kernel2 - known.kernel2) < 0.1 * np.linalg.norm(known.kernel2)


def test_rows_may_have_gaps():
    known = with_gap(polynomial(45, n=1500), 700)
    found = laguerre_kernels(known.x, known.y, known.used, LAGS, 1, 2, functions=4, pole=0.7)
    p, output = _written_out(known, laguerre_functions(LAGS, 4, 0.7), 2)
    np.testing.assert_allclose(found.coefficients, linalg.lstsq(p, output)[0], rtol=1e-7)


def test_few_rows_take_fewer_functions_or_warn():
    known = polynomial(46, n=LAGS + 100)
    found = laguerre_kernels(known.x, known.y, known.used, LAGS, 1, 2)
    assert found.n_parameters <= 101 / 3 + 1
    assert found.warnings == ()
    found = laguerre_kernels(known.x, known.y, known.used, LAGS, 1, 2, functions=9)
    assert says(found.warnings[0], "laguerre.few_rows", rows=101, coefficients=55, fewest=3)


@pytest.mark.parametrize(
    ("options", "refusal"),
    [
        ({"order": 4}, Refusal("laguerre.order", order=4)),
        ({"pole": 1.0}, Refusal("laguerre.pole", pole=1.0)),
        ({"functions": LAGS + 1}, Refusal("laguerre.too_many_functions", lags=LAGS, functions=LAGS + 1)),
        ({"functions": 20}, Refusal("laguerre.too_few_rows", rows=101, coefficients=231)),
    ],
)
def test_refusals(options: dict[str, int], refusal: Refusal):
    known = polynomial(47, n=LAGS + 100)
    with pytest.raises(UnusableInputError, check=refusal.check):
        laguerre_kernels(known.x, known.y, known.used, LAGS, 1, **({"order": 2} | options))
