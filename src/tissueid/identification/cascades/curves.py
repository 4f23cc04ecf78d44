"""Static nonlinearities of cascades: those of the Wiener engine, and a spline that need not be monotone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tissueid.identification.base import Array
from tissueid.identification.static_nonlinearity import (
    ExponentialCurve,
    Form,
    Spline,
    StaticNonlinearity,
    fit_exponential,
    fit_polynomial,
)

_RIDGE = 1e-9
"""Ridge of the spline fit, as a share of the mean curvature; determines pieces with few data."""


class FreeSpline(Spline):
    """A cubic spline without monotonicity constraint."""

    def refit(self, z: Array, y: Array) -> FreeSpline:
        """Return a spline with the same number of pieces, fitted to z (n,) and y (n,)."""
        return fit_free_spline(z, y, self.coefficients.size - 3)


def fit_free_spline(z: Array, y: Array, pieces: int) -> FreeSpline:
    """Fit a cubic spline of ``pieces`` pieces, with knots at quantiles of z (n,), to y (n,)."""
    low, high = float(z.min()), float(z.max())
    inner = np.quantile(z, np.linspace(0.0, 1.0, pieces + 1)[1:-1])
    knots = np.concatenate([[low] * 4, inner, [high] * 4])
    shape = FreeSpline(np.zeros(pieces + 3), low, high, tuple(knots.tolist()))
    basis = shape.jacobian(z)
    gram = basis.T @ basis
    ridge = _RIDGE * float(np.trace(gram)) / gram.shape[0]
    coefficients = np.linalg.solve(gram + ridge * np.eye(gram.shape[0]), basis.T @ y)
    return FreeSpline(np.asarray(coefficients, dtype=np.float64), low, high, tuple(knots.tolist()))


def fit_curve(form: Form, z: Array, y: Array, degree: int) -> StaticNonlinearity:
    """Fit a static curve y = g(z) to z (n,) and y (n,); a ``spline`` need not be monotone.

    Args:
        form: family of curves.
        z: input of the block.
        y: output of the block.
        degree: degree of the polynomial, or pieces of the spline; not used by the exponential.
    """
    if form == "exponential":
        return fit_exponential(z, y)
    if form == "polynomial":
        return fit_polynomial(z, y, degree)
    return fit_free_spline(z, y, degree)


def curve_slopes(curve: StaticNonlinearity, z: Array) -> Array:
    """Return the derivatives of a curve at z (n,) with respect to its coefficients, shape (p, n), also where it is
    extrapolated.
    """
    if isinstance(curve, ExponentialCurve):
        return np.ascontiguousarray(curve.jacobian(z).T)
    inside = np.clip(z, curve.low, curve.high)
    slopes = np.ascontiguousarray(curve.jacobian(inside).T)
    beyond = np.flatnonzero(inside != z)
    for place in range(curve.coefficients.size if beyond.size else 0):
        one = np.zeros(curve.coefficients.size)
        one[place] = 1.0
        steepness = curve.with_coefficients(one).slope(inside[beyond])
        slopes[place, beyond] += steepness * (z[beyond] - inside[beyond])
    return slopes


def with_zero_at(curve: StaticNonlinearity, place: float) -> StaticNonlinearity:
    """Return the curve with a constant subtracted so that its value at ``place`` is zero."""
    return with_offset(curve, -float(curve(np.array([place]))[0]))


def with_offset(curve: StaticNonlinearity, by: float) -> StaticNonlinearity:
    """Return the curve plus the constant ``by``."""
    return curve.with_coefficients(curve.coefficients + by * _constant(curve))


def multiplied(curve: StaticNonlinearity, factor: float) -> StaticNonlinearity:
    """Return the curve times ``factor``; the curvature constant of an exponential does not change."""
    factors = np.full(curve.coefficients.size, factor)
    if isinstance(curve, ExponentialCurve):
        factors[2] = 1.0
    return curve.with_coefficients(curve.coefficients * factors)


def with_scaled_argument(curve: StaticNonlinearity, factor: float) -> StaticNonlinearity:
    """Return the curve of a scaled argument: its value at ``factor * z`` equals the value of the given curve at z."""
    low, high = sorted((factor * curve.low, factor * curve.high))
    mirrored = factor < 0.0
    if isinstance(curve, ExponentialCurve):
        y0, s, c2 = curve.coefficients
        return replace(
            curve,
            coefficients=np.array([y0, s / factor, c2 / factor]),
            low=low,
            high=high,
            centre=factor * curve.centre,
        )
    if isinstance(curve, FreeSpline):
        turn = slice(None, None, -1) if mirrored else slice(None)
        knots = tuple(factor * knot for knot in curve.knots)[turn]
        return replace(curve, coefficients=curve.coefficients[turn], low=low, high=high, knots=knots)
    signs = (-1.0) ** np.arange(curve.coefficients.size) if mirrored else 1.0
    return replace(curve, coefficients=curve.coefficients * signs, low=low, high=high)


def _constant(curve: StaticNonlinearity) -> Array:
    """Return the change of the coefficients (p,) that adds 1 to the curve at every argument."""
    if isinstance(curve, FreeSpline):
        return np.ones(curve.coefficients.size)
    first = np.zeros(curve.coefficients.size)
    first[0] = 1.0
    return first
