"""Accurate least squares: as stable as Householder QR, and fast if the Gram matrix is cheap.

The Gram matrix P'P of regressors P (rows, p) has the square of their condition number, so that its Cholesky factor
alone loses half of the digits. Iterative refinement with the regressors themselves recovers them (corrected semi-normal
equations, Bjorck 1987), if each correction is much smaller than the one before. That contraction is measured when the
matrix is factored; if it is not sufficient, Householder QR of the explicit matrix is used.

A factor belongs to the regressors and can be used for any number of outputs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from tissueid.identification.base import Array
from tissueid.messages import Message

Route = Literal["semi-normal", "householder"]

_CONDITION = 1e7
"""Condition number of the scaled regressors above which QR is used without trying the Gram matrix."""

_CONTRACTION = 1e-2
"""Largest accepted share of an error that remains after one correction; above it QR is used."""

_PRECISION = float(np.finfo(np.float64).eps)
_TRIALS = 2


class Regressors(Protocol):
    """A matrix P (rows, p) given by its products; it need not be stored explicitly."""

    def apply(self, theta: Array) -> Array:
        """Return P theta, (rows,), for theta (p,)."""

    def adjoint(self, r: Array) -> Array:
        """Return P'r, (p,), for r (rows,)."""

    def matrix(self) -> Array:
        """Return the explicit matrix P, (rows, p); only called if QR is used."""


class _Solver(Protocol):
    """Least squares in scaled coefficients, by either method."""

    def solve(self, y: Array) -> Array: ...

    def half_inverse(self) -> Array:
        """Return W (p, rank) with W W' the (pseudo-)inverse of the scaled Gram matrix."""

    def gram_solve(self, right: Array) -> Array: ...


@dataclass(frozen=True, eq=False)
class Factor:
    """Factored regressors.

    ``condition`` is the estimated condition number of the regressors with all columns scaled to length 1,
    ``contraction`` the share of an error that remains after one correction (zero for QR, which needs none), ``rank``
    the rank of the regressors. If it is less than p, the minimum-norm solution in scaled coefficients is returned, and
    ``warnings`` reports it.
    """

    rank: int
    condition: float
    contraction: float
    route: Route
    warnings: tuple[str, ...]
    scale: Array
    solver: _Solver

    def solve(self, y: Array) -> Array:
        """Return the coefficients (p,) with the least sum of squares of y - P theta, for an output y (rows,)."""
        return self.scale * self.solver.solve(y)

    def gram_solve(self, right: Array) -> Array:
        """Return the inverse of P'P, or its pseudo-inverse, times (p,) or (p, m)."""
        scale = self.scale if right.ndim == 1 else self.scale[:, None]
        return scale * self.solver.gram_solve(scale * right)

    def inverse(self) -> Array:
        """Return the (pseudo-)inverse of P'P, (p, p): the covariance of theta for white noise of unit variance."""
        half = self.scale[:, None] * self.solver.half_inverse()
        return np.asarray(half @ half.T, dtype=np.float64)


def factor(gram: Array, regressors: Regressors) -> Factor:
    """Factor regressors P from their Gram matrix P'P (p, p), or from P itself if that matrix is not accurate enough.

    ``gram`` may have rounding errors of a few units in the last place, relative to the product of the lengths of two
    columns; they are corrected.
    """
    length = np.sqrt(np.maximum(np.diag(gram), 0.0))
    scale = np.divide(1.0, length, out=np.zeros_like(length), where=length > 0.0)
    if np.all(length > 0.0):
        scaled = gram * np.outer(scale, scale)
        found = _semi_normal(scaled, regressors, scale)
        if found is not None:
            return found
    return _householder(regressors, scale)


@dataclass(frozen=True, eq=False)
class _SemiNormal:
    regressors: Regressors
    scale: Array
    upper: Array  # R (p, p) with R'R the scaled Gram matrix
    corrections: int

    def solve(self, y: Array) -> Array:
        theta = self.gram_solve(self.scale * self.regressors.adjoint(y))
        for _ in range(self.corrections):
            left = y - self.regressors.apply(self.scale * theta)
            theta = theta + self.gram_solve(self.scale * self.regressors.adjoint(left))
        return theta

    def gram_solve(self, right: Array) -> Array:
        return np.asarray(linalg.cho_solve((self.upper, False), right, check_finite=False), dtype=np.float64)

    def half_inverse(self) -> Array:
        return _triangular_inverse(self.upper)


def _semi_normal(scaled: Array, regressors: Regressors, scale: Array) -> Factor | None:
    """Return the factor by the scaled Gram matrix (p, p); None if it is not accurate enough."""
    norm = float(np.max(np.abs(scaled).sum(axis=0)))
    try:
        upper = linalg.cholesky(scaled, overwrite_a=True, check_finite=False)
    except np.linalg.LinAlgError:
        return None
    reciprocal, _ = linalg.lapack.dpocon(upper, norm)
    if reciprocal < _CONDITION**-2:
        return None
    once = _SemiNormal(regressors, scale, upper, 1)
    contraction = _contraction(once)
    if contraction > _CONTRACTION:
        return None
    solves = math.ceil(math.log(_PRECISION) / math.log(max(contraction, _PRECISION)))
    corrections = max(1, solves - 1)  # the first solution counts as one
    solver = _SemiNormal(regressors, scale, upper, corrections)
    return Factor(scale.size, float(reciprocal) ** -0.5, contraction, "semi-normal", (), scale, solver)


def _contraction(solver: _SemiNormal) -> float:
    """Return the share of a coefficient error that remains after a correction: norm of I - inv(R'R) P'P, by power
    iteration.

    The iteration starts near the weakest direction of the regressors, which is corrected worst.
    """
    error = np.where(np.arange(solver.scale.size) % 2 == 0, 1.0, -1.0)
    for _ in range(_TRIALS):
        error = solver.gram_solve(error / float(np.linalg.norm(error)))
    left = 0.0
    for _ in range(_TRIALS):
        size = float(np.linalg.norm(error))
        if size == 0.0:
            break
        error = error / size
        seen = solver.scale * solver.regressors.adjoint(solver.regressors.apply(solver.scale * error))
        error = error - solver.gram_solve(seen)
        left = max(left, float(np.linalg.norm(error)))
    return left


@dataclass(frozen=True, eq=False)
class _Householder:
    """P S = Q1 R1 with reflectors kept, R1 = Q2 R2 with pivots, and for a rank below p, R2 = L Q3'."""

    reflectors: Array  # (rows, p), as LAPACK leaves them
    weights: Array  # (p,)
    small: Array  # Q2 (p, rank)
    triangle: Array  # R2 (rank, rank), or L' when the rank is below p
    row_space: Array | None  # Q3 (p, rank), None at full rank
    pivots: NDArray[np.intp]

    def solve(self, y: Array) -> Array:
        column = np.asfortranarray(y[:, None])
        turned, _, _ = linalg.lapack.dormqr("L", "T", self.reflectors, self.weights, column, 64)
        right = self.small.T @ turned[: self.small.shape[0], 0]
        theta = np.empty(self.pivots.size)
        if self.row_space is None:
            theta[self.pivots] = linalg.solve_triangular(self.triangle, right, check_finite=False)
        else:
            theta[self.pivots] = self.row_space @ linalg.solve_triangular(
                self.triangle, right, trans="T", check_finite=False
            )
        return theta

    def gram_solve(self, right: Array) -> Array:
        half = self.half_inverse()
        return np.asarray(half @ (half.T @ right), dtype=np.float64)

    def half_inverse(self) -> Array:
        inverse = _triangular_inverse(self.triangle)  # (rank, rank)
        half = np.empty((self.pivots.size, inverse.shape[0]))
        half[self.pivots] = inverse if self.row_space is None else self.row_space @ inverse.T
        return half


def _householder(regressors: Regressors, scale: Array) -> Factor:
    """Return the factor by QR of the explicit matrix.

    The tall matrix is factored without pivoting, mostly in blocked operations, and its small triangle with pivoting.
    """
    p = scale.size
    explicit = np.asfortranarray(regressors.matrix() * scale)  # (rows, p)
    largest = max(explicit.shape)
    (reflectors, weights), first = linalg.qr(explicit, mode="raw", overwrite_a=True, check_finite=False)
    small, second, pivots = linalg.qr(np.triu(first[:p]), mode="economic", pivoting=True, check_finite=False)
    size = np.abs(np.diag(second))
    rank = int(np.count_nonzero(size > _PRECISION * largest * size[0])) if size.size else 0
    warnings: tuple[str, ...] = ()
    row_space = None
    triangle = second[:rank, :rank]
    if rank < p:
        row_space, triangle = linalg.qr(second[:rank].T, mode="economic", check_finite=False)
        warnings = (
            Message(
                "least_squares.rank",
                "the input does not excite every combination of lags: only {rank} of {coefficients} coefficients are "
                "determined, and the solution of smallest norm is given",
                rank=rank,
                coefficients=p,
            ),
        )
    reciprocal, _ = linalg.lapack.dtrcon(triangle) if rank else (0.0, 0)
    condition = 1.0 / float(reciprocal) if rank == p and reciprocal > 0.0 else math.inf
    solver = _Householder(reflectors, weights, small[:, :rank], triangle, row_space, pivots)
    return Factor(rank, condition, 0.0, "householder", warnings, scale, solver)


def _triangular_inverse(upper: Array) -> Array:
    inverse, _ = linalg.lapack.dtrtri(upper)
    return np.asarray(np.triu(inverse), dtype=np.float64)
