"""Least squares on either route, and the Gram matrix of lagged channels, against LAPACK on the explicit matrix."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from coded import says
from identification.simulated import Array, generator
from scipy import linalg

from tissueid.identification.least_squares import LaggedRegressors, factor


class Explicit:
    """Regressors that exist as a matrix, and count how often that is asked for."""

    def __init__(self, matrix: Array) -> None:
        self.values, self.asked = matrix, 0

    def apply(self, theta: Array) -> Array:
        return self.values @ theta

    def adjoint(self, r: Array) -> Array:
        return self.values.T @ r

    def matrix(self) -> Array:
        self.asked += 1
        return self.values.copy()


def conditioned(condition: float, rows: int = 500, columns: int = 60) -> Array:
    rng = generator(1)
    left = np.linalg.qr(rng.standard_normal((rows, columns)))[0]
    right = np.linalg.qr(rng.standard_normal((columns, columns)))[0]
    return left * np.geomspace(1.0, 1.0 / condition, columns) @ right.T


def reference(matrix: Array, y: Array) -> Array:
    scale = 1.0 / np.linalg.norm(matrix, axis=0)
    return scale * linalg.lstsq(matrix * scale, y, lapack_driver="gelsy")[0]


@pytest.mark.parametrize(
    ("condition", "route"),
    [(1e1, "semi-normal"), (1e4, "semi-normal"), (1e6, "semi-normal"), (1e8, "householder"), (1e11, "householder")],
)
def test_either_route_is_as_near_as_a_backward_stable_one(condition: float, route: str):
    matrix = conditioned(condition)
    rng = generator(2)
    truth = rng.standard_normal(60)
    for residual in (0.0, 1e-6, 1.0):
        noise = rng.standard_normal(500)
        noise -= matrix @ np.linalg.lstsq(matrix, noise, rcond=None)[0]
        y = matrix @ truth + residual * noise
        regressors = Explicit(matrix)
        solved = factor(matrix.T @ matrix, regressors)
        assert solved.route == route
        assert regressors.asked == (route == "householder")
        assert condition / 20.0 < solved.condition < condition * 20.0
        error = np.linalg.norm(solved.solve(y) - truth)
        # What perturbations of P and y by one unit in the last place alone do (Wedin 1973).
        unavoidable = condition * np.linalg.norm(truth) + condition**2 * residual * np.linalg.norm(noise)
        assert error < 50.0 * np.finfo(float).eps * unavoidable


def test_a_gram_matrix_with_rounding_errors_is_corrected():
    matrix = conditioned(1e4)
    rng = generator(3)
    y = rng.standard_normal(500)
    gram = matrix.T @ matrix
    off = 1e-13 * rng.standard_normal(gram.shape) * np.sqrt(np.outer(np.diag(gram), np.diag(gram)))
    solved = factor(gram + off + off.T, Explicit(matrix))
    assert solved.route == "semi-normal"
    assert solved.contraction > 1e-8
    expected = reference(matrix, y)
    assert np.linalg.norm(solved.solve(y) - expected) < 1e-10 * np.linalg.norm(expected)


@pytest.mark.parametrize("condition", [1e2, 1e9])
def test_a_factor_answers_any_output_and_gives_the_inverse(condition: float):
    matrix = conditioned(condition)
    solved = factor(matrix.T @ matrix, Explicit(matrix))
    rng = generator(4)
    for _ in range(3):
        y = matrix @ rng.standard_normal(60) + 1e-9 * rng.standard_normal(500)
        expected = reference(matrix, y)
        assert np.linalg.norm(solved.solve(y) - expected) < 1e-15 * condition * np.linalg.norm(expected) + 1e-12
    half = linalg.pinv(matrix, rtol=1e-16)
    inverse = half @ half.T
    np.testing.assert_allclose(solved.inverse(), inverse, rtol=0.0, atol=1e-5 * np.max(inverse))
    right = rng.standard_normal((60, 2))
    np.testing.assert_allclose(solved.gram_solve(right), inverse @ right, atol=1e-5 * np.max(np.abs(inverse @ right)))
    np.testing.assert_allclose(solved.gram_solve(right[:, 0]), solved.gram_solve(right)[:, 0], rtol=1e-9)


def test_columns_of_any_size_are_alike():
    matrix = conditioned(1e3)
    sizes = np.geomspace(1e-12, 1e12, 60)
    solved = factor((matrix * sizes).T @ (matrix * sizes), Explicit(matrix * sizes))
    assert solved.route == "semi-normal"
    y = generator(5).standard_normal(500)
    expected = reference(matrix, y)
    assert np.linalg.norm(sizes * solved.solve(y) - expected) < 1e-10 * np.linalg.norm(expected)


@pytest.mark.parametrize("empty", [False, True], ids=["repeated column", "column of zeros"])
def test_a_rank_deficiency_gives_a_warning_and_the_shortest_solution(empty: bool):
    matrix = conditioned(1e1)
    matrix[:, 7] = 0.0 if empty else matrix[:, 3]
    solved = factor(matrix.T @ matrix, Explicit(matrix))
    assert solved.route == "householder"
    assert solved.rank == 59
    assert solved.condition == np.inf
    assert says(solved.warnings[0], "least_squares.rank", rank=59, coefficients=60)
    y = generator(6).standard_normal(500)
    found = solved.solve(y)
    assert found[7] == pytest.approx(0.0 if empty else found[3], abs=1e-9)
    expected = matrix @ np.linalg.lstsq(matrix, y, rcond=None)[0]
    np.testing.assert_allclose(matrix @ found, expected, atol=1e-12)


def _channels(n: int) -> Array:
    return generator(7).standard_normal((5, n))


@pytest.mark.parametrize("constant", [True, False])
@pytest.mark.parametrize("spacing", [1, 3])
@pytest.mark.parametrize(
    ("edges", "hole"),
    [
        pytest.param((30, 600), 0, id="one run"),
        pytest.param((30, 300, 600), 40, id="two runs"),
        pytest.param((30, 34, 35, 600), 1, id="a run shorter than the spacing"),
        pytest.param(tuple(range(30, 600, 7)), 2, id="many short runs"),
    ],
)
def test_gram_of_lagged_channels(edges: tuple[int, ...], hole: int, spacing: int, constant: bool):
    channels, lags = _channels(600), (7, 7, 3, 1, 6)
    used = np.zeros(600, dtype=np.bool_)
    for first, end in itertools.pairwise(edges):
        used[first : end - hole] = True
    read = np.zeros(600, dtype=np.bool_)
    for lag in range(7):
        read[np.flatnonzero(used) - lag * spacing] = True
    channels[:, ~read] = np.nan  # what no row needs is never read
    regressors = LaggedRegressors(channels, lags, spacing, used, constant)
    rows = np.flatnonzero(used)
    columns = [np.ones(rows.size)] if constant else []
    columns += [channels[k, rows - lag * spacing] for k, count in enumerate(lags) for lag in range(count)]
    explicit = np.column_stack(columns)
    np.testing.assert_array_equal(regressors.matrix(), explicit)
    np.testing.assert_allclose(regressors.gram(), explicit.T @ explicit, atol=1e-11)
    order = generator(8).permutation(explicit.shape[1])
    np.testing.assert_allclose(regressors.gram(order), (explicit.T @ explicit)[np.ix_(order, order)], atol=1e-11)
    theta, r = generator(9).standard_normal(explicit.shape[1]), generator(10).standard_normal(rows.size)
    np.testing.assert_allclose(regressors.apply(theta), explicit @ theta, atol=1e-12)
    np.testing.assert_allclose(regressors.adjoint(r), explicit.T @ r, atol=1e-11)
    level, kernels = regressors.split(theta)
    assert [kernel.size for kernel in kernels] == list(lags)
    assert level == (theta[0] if constant else 0.0)


def test_missing_samples_between_rows_of_another_channel():
    channels = _channels(400)[:2]
    channels[0, 200] = np.nan
    used = np.zeros(400, dtype=np.bool_)
    used[10:200] = used[206:] = True
    regressors = LaggedRegressors(channels, (6, 6), 1, used)
    explicit = regressors.matrix()
    assert np.isfinite(explicit).all()
    np.testing.assert_allclose(regressors.gram(), explicit.T @ explicit, atol=1e-11)
