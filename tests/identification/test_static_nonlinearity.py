"""Static nonlinearities: fits against scipy, derivatives against differences, inverses against themselves."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from identification import simulated
from scipy import optimize

from tissueid.identification.static_nonlinearity import (
    Form,
    StaticNonlinearity,
    fit_exponential,
    fit_nonlinearity,
    fit_polynomial,
    fit_spline,
)

FORMS: tuple[Form, ...] = ("exponential", "polynomial", "spline")


def data(noise: float = 0.02, n: int = 3000) -> tuple[np.ndarray, np.ndarray]:
    rng = simulated.generator(40)
    z = 4.0 + 1.5 * rng.standard_normal(n)
    return z, 0.5 + 7.0 * (1.0 - np.exp(-0.2 * z)) + noise * rng.standard_normal(n)


@pytest.fixture(params=FORMS)
def fitted(request: pytest.FixtureRequest) -> StaticNonlinearity:
    return fit_nonlinearity(request.param, *data(), 5)


def test_slopes_and_jacobians_are_the_differences(fitted: StaticNonlinearity):
    z = np.linspace(fitted.low + 0.01, fitted.high - 0.01, 40)
    step = 1e-5
    slope = (fitted(z + step) - fitted(z - step)) / (2.0 * step)
    np.testing.assert_allclose(fitted.slope(z), slope, rtol=1e-5)
    for k in range(fitted.coefficients.size):
        nudge = np.zeros(fitted.coefficients.size)
        nudge[k] = 1e-5
        above = fitted.with_coefficients(fitted.coefficients + nudge)(z)
        below = fitted.with_coefficients(fitted.coefficients - nudge)(z)
        np.testing.assert_allclose(fitted.jacobian(z)[:, k], (above - below) / 2e-5, atol=1e-6)


def test_inverse_undoes(fitted: StaticNonlinearity):
    z = np.linspace(fitted.low, fitted.high, 101)[5:-5]
    assert fitted.invertible
    np.testing.assert_allclose(fitted.inverse(fitted(z)), z, atol=1e-4)
    assert np.isnan(fitted.inverse(np.array([np.nan])))[0]
    low, high = fitted.monotone_range
    np.testing.assert_array_equal(fitted.inverse(np.array([-1e9, 1e9])), [low, high])


def test_all_forms_find_the_curve(fitted: StaticNonlinearity):
    z = np.linspace(1.0, 7.0, 20)
    np.testing.assert_allclose(fitted(z), 0.5 + 7.0 * (1.0 - np.exp(-0.2 * z)), atol=0.02)


def test_exponential_is_the_least_squares_answer():
    z, y = data(noise=0.3)
    ours = fit_exponential(z, y)
    c1, c2, c3, offset = ours.thesis_constants(None, 0.0)
    scipys, _ = optimize.curve_fit(
        lambda z, c1, c2, offset: offset + c1 * (1.0 - np.exp(-c2 * z)), z, y, p0=[5.0, 0.3, 0.0]
    )
    np.testing.assert_allclose([c1, c2, offset], scipys, rtol=1e-4)
    assert c3 == 0.0


@pytest.mark.parametrize("start", [-2.0, 0.0, 0.19, 0.5, 50.0])
def test_where_the_search_begins_does_not_matter(start: float):
    z, y = data(noise=0.3)
    cold, warm = fit_exponential(z, y), fit_exponential(z, y, start=start)
    np.testing.assert_allclose(warm.coefficients, cold.coefficients, rtol=1e-5)


@pytest.mark.parametrize("c2", [1e-9, 1e-6, 2e-5, 4e-5, 1e-3, -1e-6, -1e-3])
def test_a_nearly_straight_curve_is_found_as_well_as_any(c2: float):
    z = simulated.generator(42).uniform(0.0, 4.0, 2000)
    t = z - 2.0
    y = t - c2 * t**2 / 2.0 + c2**2 * t**3 / 6.0 - c2**3 * t**4 / 24.0
    ours = fit_exponential(z, y)
    assert ours.coefficients[2] == pytest.approx(c2, rel=1e-3, abs=1e-8)
    np.testing.assert_allclose(ours(z), y, atol=1e-7)
    np.testing.assert_allclose(ours.inverse(ours(z)), z, atol=1e-9)


def test_an_output_past_the_asymptote_is_inverted_to_the_end():
    z, y = data()
    ours = fit_exponential(z, y)
    low, high = ours.monotone_range
    asymptote = ours.coefficients[0] + ours.coefficients[1] / ours.coefficients[2]
    np.testing.assert_array_equal(ours.inverse(np.array([asymptote, asymptote + 1.0, -1e300])), [high, high, low])


@given(st.floats(-0.8, 0.8), st.floats(-3.0, 3.0))
def test_thesis_constants_write_the_same_curve(c2: float, c3: float):
    z = np.linspace(0.0, 6.0, 200)
    ours = fit_exponential(z, 2.0 * z if abs(c2) < 1e-3 else (1.0 - np.exp(-c2 * z)) / c2)
    for surface, given_c3 in ((None, c3), (-0.5, 0.0)):
        c1, found_c2, found_c3, offset = ours.thesis_constants(surface, given_c3)
        if np.isfinite([c1, found_c3]).all() and abs(found_c2) > 1e-3:
            np.testing.assert_allclose(offset + c1 * (1.0 - np.exp(-found_c2 * (z + found_c3))), ours(z), atol=1e-6)


def test_a_straight_line_is_an_ordinary_case():
    z = np.linspace(-1.0, 5.0, 300)
    ours = fit_exponential(z, 3.0 * z + 1.0)
    np.testing.assert_allclose(ours(z), 3.0 * z + 1.0, atol=1e-9)
    np.testing.assert_allclose(ours.inverse(ours(z)), z, atol=1e-6)


def test_polynomial_is_the_least_squares_answer_and_leaves_along_straight_lines():
    z, y = data(noise=0.3)
    ours = fit_polynomial(z, y, 4)
    np.testing.assert_allclose(ours(z), np.polynomial.Polynomial.fit(z, y, 4)(z), atol=1e-9)
    beyond = ours.high + np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(np.diff(ours(beyond)), ours.slope(np.array([ours.high]))[0], rtol=1e-9)


def test_polynomial_of_high_degree_is_well_conditioned():
    z, y = data()
    assert np.linalg.cond(fit_polynomial(z, y, 12).jacobian(z)) < 1e3


@given(st.integers(0, 10_000), st.integers(1, 9), st.sampled_from([1.0, -1.0]))
def test_spline_never_turns_back(seed: int, pieces: int, direction: float):
    rng = simulated.generator(41, seed)
    z = np.sort(rng.standard_normal(200))
    y = direction * (np.sign(z) * np.abs(z) ** 0.5 + 0.5 * rng.standard_normal(200))
    spline = fit_spline(z, y, pieces)
    grid = np.linspace(z[0] - 1.0, z[-1] + 1.0, 500)
    assert np.all(direction * np.diff(spline(grid)) >= -1e-9)


def test_inverse_keeps_to_the_range_where_the_curve_keeps_its_direction():
    z = np.linspace(-2.0, 3.0, 500)
    ours = fit_polynomial(z, z**2, 2)
    assert not ours.invertible
    low, high = ours.monotone_range
    assert low == pytest.approx(0.0, abs=0.01)
    assert high > 3.0
    assert ours.inverse(np.array([4.0]))[0] == pytest.approx(2.0, abs=0.01)
