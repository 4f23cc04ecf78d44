"""Static nonlinearities y = g(z) of a Wiener system: exponential, polynomial, monotone spline.

Chen 2010, Eqs. 3.26-3.27 for the exponential. Each is fitted by least squares over the z of the data and continues
along a straight line, or its own formula, beyond it. The inverse is trusted on the range where g was fitted and
rises or falls throughout, and a quarter of it more.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, Self

import numpy as np
from numpy.polynomial import legendre
from scipy import interpolate, optimize

from tissueid.identification.base import Array

Form = Literal["exponential", "polynomial", "spline"]

_TABLE = 4097
_MARGIN = 0.25


@dataclass(frozen=True, eq=False)
class StaticNonlinearity(ABC):
    """A fitted g. ``coefficients`` (p,) are linear in g or become so; ``low`` and ``high`` bound the fitted z."""

    coefficients: Array
    low: float
    high: float

    @abstractmethod
    def __call__(self, z: Array) -> Array:
        """Return g(z), shape of z."""

    @abstractmethod
    def slope(self, z: Array) -> Array:
        """Return dg/dz, shape of z."""

    @abstractmethod
    def jacobian(self, z: Array) -> Array:
        """Return the derivatives of g(z) by the coefficients, shape (n, p)."""

    @abstractmethod
    def refit(self, z: Array, y: Array) -> Self:
        """Fit the same form anew to z (n,) and y (n,)."""

    def with_coefficients(self, coefficients: Array) -> Self:
        """Return the same form with other coefficients, for derivatives by them."""
        return replace(self, coefficients=coefficients)

    @cached_property
    def _monotone(self) -> tuple[Array, Array]:
        """Table of z and g(z), both (m,), over the longest stretch where g keeps to its main direction."""
        reach = _MARGIN * (self.high - self.low)
        z = np.linspace(self.low - reach, self.high + reach, _TABLE)
        y = self(z)
        inside = (z >= self.low) & (z <= self.high)
        direction = 1.0 if y[inside][-1] >= y[inside][0] else -1.0
        along = np.concatenate([[0], (direction * np.diff(y) > 0.0).astype(np.int8), [0]])
        stretches = np.flatnonzero(np.diff(along)).reshape(-1, 2)
        first, last = max(stretches, key=lambda ends: ends[1] - ends[0], default=(0, 1))
        return z[first : last + 1], y[first : last + 1]

    @property
    def monotone_range(self) -> tuple[float, float]:
        """Lowest and highest z where the inverse is defined."""
        z, _ = self._monotone
        return float(z[0]), float(z[-1])

    @property
    def invertible(self) -> bool:
        """True when g keeps its direction over all of the fitted z."""
        low, high = self.monotone_range
        step = (self.high - self.low) / _TABLE
        return low <= self.low + step and high >= self.high - step

    def inverse(self, y: Array) -> Array:
        """Return z with g(z) = y, shape of y; beyond the monotone range, the nearest end of it."""
        z_table, y_table = self._monotone
        if y_table[0] > y_table[-1]:
            z_table, y_table = z_table[::-1], y_table[::-1]
        return np.asarray(np.interp(y, y_table, z_table), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Exponential(StaticNonlinearity):
    """y = y0 + s (1 - exp(-C2 (z - z0))) / C2, which is Eq. 3.26 about the middle of the data.

    The coefficients are y0, s (the slope at z0) and C2. Written so, a straight line is the plain case C2 = 0, and
    the three do not trade against each other as C1, C2 and an offset do.
    """

    centre: float

    def __call__(self, z: Array) -> Array:
        """Return g(z), shape of z."""
        y0, s, c2 = self.coefficients
        return np.asarray(y0 + s * _bend(z - self.centre, c2))

    def slope(self, z: Array) -> Array:
        """Return dg/dz, shape of z."""
        _, s, c2 = self.coefficients
        return np.asarray(s * np.exp(_bounded(-c2 * (z - self.centre))))

    def jacobian(self, z: Array) -> Array:
        """Return the derivatives of g(z) by y0, s and C2, shape (n, 3)."""
        _, s, c2 = self.coefficients
        t = z - self.centre
        bend = _bend(t, c2)
        small = np.abs(c2 * t) < 1e-4
        safe = c2 if c2 != 0.0 else 1.0
        by_c2 = np.where(small, -0.5 * t**2 + c2 * t**3 / 3.0, (t * np.exp(_bounded(-c2 * t)) - bend) / safe)
        return np.column_stack([np.ones_like(t), bend, s * by_c2])

    def refit(self, z: Array, y: Array) -> Exponential:
        """Fit y0, s and C2 anew, starting from these."""
        return fit_exponential(z, y, start=self.coefficients[2])

    def thesis_constants(self, surface: float | None, c3: float) -> tuple[float, float, float, float]:
        """C1, C2, C3 and the offset of y = offset + C1 (1 - exp(-C2 (z + C3))).

        The curve has three degrees of freedom and this form four. Known is either the offset, as ``surface``, and
        C3 follows; or, with ``surface`` None, C3, and the offset follows. NaN where no such curve exists.
        """
        y0, s, c2 = self.coefficients
        if c2 == 0.0:
            return float("nan"), 0.0, c3, float("nan")
        asymptote = y0 + s / c2
        amplitude = s / c2 * np.exp(c2 * self.centre)  # of exp(-C2 z)
        if surface is None:
            c1 = amplitude * np.exp(c2 * c3)
            return float(c1), float(c2), c3, float(asymptote - c1)
        c1 = asymptote - surface
        ratio = c1 / amplitude
        return float(c1), float(c2), float(np.log(ratio) / c2) if ratio > 0.0 else float("nan"), surface


@dataclass(frozen=True, eq=False)
class Polynomial(StaticNonlinearity):
    """Legendre series over the fitted range of z, continued beyond it by straight lines."""

    def _scaled(self, z: Array) -> Array:
        return np.asarray(2.0 * (z - self.low) / (self.high - self.low) - 1.0)

    def __call__(self, z: Array) -> Array:
        """Return g(z), shape of z."""
        inside = np.clip(z, self.low, self.high)
        return np.asarray(legendre.legval(self._scaled(inside), self.coefficients) + self.slope(z) * (z - inside))

    def slope(self, z: Array) -> Array:
        """Return dg/dz, shape of z."""
        x = self._scaled(np.clip(z, self.low, self.high))
        return np.asarray(legendre.legval(x, legendre.legder(self.coefficients)) * 2.0 / (self.high - self.low))

    def jacobian(self, z: Array) -> Array:
        """Return the Legendre polynomials at z, shape (n, degree + 1)."""
        return np.asarray(legendre.legvander(self._scaled(np.clip(z, self.low, self.high)), self.coefficients.size - 1))

    def refit(self, z: Array, y: Array) -> Polynomial:
        """Fit a series of the same degree anew."""
        return fit_polynomial(z, y, self.coefficients.size - 1)


@dataclass(frozen=True, eq=False)
class MonotoneSpline(StaticNonlinearity):
    """Cubic spline that never turns back: its B-spline coefficients rise, or fall, from one to the next."""

    knots: tuple[float, ...]

    @cached_property
    def _curve(self) -> interpolate.BSpline:
        return interpolate.BSpline(np.array(self.knots), self.coefficients, 3)

    def __call__(self, z: Array) -> Array:
        """Return g(z), shape of z."""
        inside = np.clip(z, self.low, self.high)
        return np.asarray(self._curve(inside) + self.slope(z) * (z - inside))

    def slope(self, z: Array) -> Array:
        """Return dg/dz, shape of z."""
        return np.asarray(self._curve(np.clip(z, self.low, self.high), nu=1))

    def jacobian(self, z: Array) -> Array:
        """Return the B-splines at z, shape (n, p)."""
        return _b_splines(np.clip(z, self.low, self.high), np.array(self.knots))

    def refit(self, z: Array, y: Array) -> MonotoneSpline:
        """Fit a spline of as many pieces anew."""
        return fit_spline(z, y, self.coefficients.size - 3)


def coefficient_count(form: Form, degree: int) -> int:
    """Return how many coefficients g of a form and degree has."""
    return {"exponential": 3, "polynomial": degree + 1, "spline": degree + 3}[form]


def fit_nonlinearity(form: Form, z: Array, y: Array, degree: int) -> StaticNonlinearity:
    """Fit g to z (n,) and y (n,).

    Args:
        form: which family.
        z: linear output.
        y: measured output.
        degree: degree of the polynomial, or pieces of the spline; the exponential has none.
    """
    if form == "exponential":
        return fit_exponential(z, y)
    if form == "polynomial":
        return fit_polynomial(z, y, degree)
    return fit_spline(z, y, degree)


def fit_exponential(z: Array, y: Array, start: float | None = None) -> Exponential:
    """Fit the exponential of Eq. 3.26 with a free offset, by a grid over C2 (or a start) and Gauss-Newton."""
    low, high, centre = float(z.min()), float(z.max()), float(z.mean())
    reach = max(high - centre, centre - low)
    bends = np.array([start]) if start is not None else np.linspace(-4.0, 4.0, 17) / reach
    trials = [_line_through_bend(z - centre, y, c2) for c2 in bends]
    fitted = Exponential(min(trials, key=lambda trial: trial[0])[1], low, high, centre)
    cost = float(np.sum((y - fitted(z)) ** 2))
    for _ in range(30):
        step = np.linalg.lstsq(fitted.jacobian(z), y - fitted(z), rcond=None)[0][2]
        c2 = fitted.coefficients[2]
        limit = 20.0 / reach
        improved = False
        while abs(step) > 1e-9 / reach:
            tried_cost, tried = _line_through_bend(z - centre, y, float(np.clip(c2 + step, -limit, limit)))
            if tried_cost < cost:
                fitted, cost, improved = fitted.with_coefficients(tried), tried_cost, True
                break
            step *= 0.5
        if not improved:
            break
    return fitted


def fit_polynomial(z: Array, y: Array, degree: int) -> Polynomial:
    """Fit a Legendre series of a degree over the range of z (n,) to y (n,)."""
    shape = Polynomial(np.zeros(degree + 1), float(z.min()), float(z.max()))
    coefficients = np.asarray(np.linalg.lstsq(shape.jacobian(z), y, rcond=None)[0], dtype=np.float64)
    return shape.with_coefficients(coefficients)


def fit_spline(z: Array, y: Array, pieces: int) -> MonotoneSpline:
    """Fit a monotone cubic spline of so many pieces, with knots at quantiles of z (n,), to y (n,).

    The increments between neighbouring B-spline coefficients are held to one sign by non-negative least squares
    (I-splines: Ramsay 1988).
    """
    low, high = float(z.min()), float(z.max())
    inner = np.quantile(z, np.linspace(0.0, 1.0, pieces + 1)[1:-1])
    knots = np.concatenate([[low] * 4, inner, [high] * 4])
    basis = _b_splines(z, knots)  # (n, p)
    steps = np.cumsum(basis[:, ::-1], axis=1)[:, ::-1][:, 1:]  # (n, p - 1): what each increment adds
    direction = 1.0 if np.mean((z - z.mean()) * (y - y.mean())) >= 0.0 else -1.0
    scale = float(np.std(y)) or 1.0
    centred = steps - steps.mean(axis=0)
    q, r = np.linalg.qr(centred)
    increments, _ = optimize.nnls(r, q.T @ (direction * (y - y.mean()) / scale))
    increments = direction * scale * increments
    first = float(y.mean() - steps.mean(axis=0) @ increments)
    coefficients = first + np.concatenate([[0.0], np.cumsum(increments)])
    return MonotoneSpline(coefficients, low, high, tuple(knots.tolist()))


def _b_splines(z: Array, knots: Array) -> Array:
    return np.asarray(interpolate.BSpline.design_matrix(z, knots, 3).toarray(), dtype=np.float64)


def _bounded(exponent: Array) -> Array:
    """Hold an exponent short of overflow; beyond it a curve has long left anything measured."""
    return np.minimum(exponent, 300.0)


def _bend(t: Array, c2: float) -> Array:
    """(1 - exp(-C2 t)) / C2, and t for C2 = 0."""
    return np.asarray(-np.expm1(_bounded(-c2 * t)) / c2) if c2 != 0.0 else t


def _line_through_bend(t: Array, y: Array, c2: float) -> tuple[float, Array]:
    """Best y0 and s at a given C2: residual sum of squares, and the three coefficients."""
    bend = _bend(t, c2)
    mean_bend, mean_y = float(bend.mean()), float(y.mean())
    spread = bend - mean_bend
    s = float(spread @ y) / float(spread @ spread)
    y0 = mean_y - s * mean_bend
    return float(np.sum((y - y0 - s * bend) ** 2)), np.array([y0, s, c2])
