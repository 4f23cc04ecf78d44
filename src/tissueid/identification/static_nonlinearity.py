"""Static nonlinearities y = g(z) of a Wiener system: exponential, polynomial, monotone spline.

Chen 2010, Eqs. 3.26-3.27 for the exponential. Each is fitted by least squares over the z of the data and extrapolated
linearly, or by its own formula. The inverse is defined on the range where g was fitted and is monotone, extended by a
quarter of it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, NamedTuple, Self

import numpy as np
from numba import njit
from numpy.polynomial import legendre
from scipy import interpolate, optimize

from tissueid.identification.base import Array, option
from tissueid.language import marked

_SERIES_LIMIT = 1e-4
"""C2 times the range of t below which the derivative with respect to C2 is computed by its series."""


# Reordering of sums is allowed, so that the compiler can use vector instructions.
@njit(cache=True, fastmath={"reassoc", "contract"})
def exponential_sums(
    t: Array, y: Array, fallen: Array, c2: float, reach: float
) -> tuple[float, float, float, float, float, float, float]:
    """Return sums over the samples of b = (1 - exp(-C2 t)) / C2 and of its derivative d with respect to C2.

    Args:
        t: shape (n,), within ``reach`` of zero.
        y: shape (n,).
        fallen: exp(-C2 t) - 1, shape (n,).
        c2: C2; zero for a straight line.
        reach: largest absolute value of t.

    Returns:
        The sums of b, b b, b y, d, d d, d b and d y.
    """
    b_sum = b_b = b_y = d_sum = d_d = d_b = d_y = 0.0
    if abs(c2) * reach < _SERIES_LIMIT:
        for n in range(t.size):
            b = t[n] * (1.0 - c2 * t[n] * (0.5 - c2 * t[n] / 6.0))
            d = t[n] * t[n] * (c2 * t[n] / 3.0 - 0.5)
            b_sum += b
            b_b += b * b
            b_y += b * y[n]
            d_sum += d
            d_d += d * d
            d_b += d * b
            d_y += d * y[n]
    else:
        per_c2 = 1.0 / c2
        for n in range(t.size):
            b = -fallen[n] * per_c2
            d = (t[n] * (1.0 + fallen[n]) - b) * per_c2
            b_sum += b
            b_b += b * b
            b_y += b * y[n]
            d_sum += d
            d_d += d * d
            d_b += d * b
            d_y += d * y[n]
    return b_sum, b_b, b_y, d_sum, d_d, d_b, d_y


Form = Literal["exponential", "polynomial", "spline"]
CURVE = option(
    "polynomial", marked("Nonlinearity"), marked("A polynomial, a spline, or C1 (1 - exp(-C2 x)) with an offset")
)
DEGREE = option(5, marked("Degree"), marked("Degree of the polynomial, or pieces of the spline"), ge=1, le=20)
REFINE = option(
    True, marked("Refinement"), marked("Refine the best pass by minimising the simulation error over both stages")
)
"""Options that engines share."""
_FORMS = (marked("exponential"), marked("polynomial"), marked("spline"))
"""Choices of the option as a form shows them, for translation."""

_STEEPEST = 20.0
"""Largest C2 times half the range of z: a curve that decays by a factor exp(20) is a step."""

_BEND_TOLERANCE, _SMALLEST_BEND = 1e-5, 1e-9
"""Steps of C2 times half the range of z: the fit ends below the first; steps below the second are not tried."""

_GRID_SAMPLES = 1000
"""Number of samples used to choose the starting point of C2."""

_TABLE = 4097
_MARGIN = 0.25


@dataclass(frozen=True, eq=False)
class StaticNonlinearity(ABC):
    """A fitted g with ``coefficients`` (p,); ``low`` and ``high`` bound the fitted z."""

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
        """Return the derivatives of g(z) with respect to the coefficients, shape (n, p)."""

    @abstractmethod
    def refit(self, z: Array, y: Array) -> Self:
        """Return the same form fitted to z (n,) and y (n,)."""

    def with_coefficients(self, coefficients: Array) -> Self:
        """Return the same form with other coefficients."""
        return replace(self, coefficients=coefficients)

    @cached_property
    def _monotone(self) -> tuple[Array, Array]:
        """Table of z and g(z), both (m,), over the longest stretch where g changes in its main direction."""
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
        """Whether g is monotone over all of the fitted z."""
        low, high = self.monotone_range
        step = (self.high - self.low) / _TABLE
        return low <= self.low + step and high >= self.high - step

    def inverse(self, y: Array) -> Array:
        """Return z with g(z) = y, shape of y; outside the monotone range, its nearest end."""
        z_table, y_table = self._monotone
        if y_table[0] > y_table[-1]:
            z_table, y_table = z_table[::-1], y_table[::-1]
        return np.asarray(np.interp(y, y_table, z_table), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class ExponentialCurve(StaticNonlinearity):
    """y = y0 + s (1 - exp(-C2 (z - z0))) / C2: Eq. 3.26 about the middle of the data.

    The coefficients are y0, s (the slope at z0) and C2. In this form a straight line is the regular case C2 = 0, and
    the three are less correlated than C1, C2 and an offset.
    """

    centre: float

    def __call__(self, z: Array) -> Array:
        """Return g(z), shape of z."""
        y0, s, c2 = self.coefficients
        return np.asarray(y0 + s * _bend(z - self.centre, c2))

    def slope(self, z: Array) -> Array:
        """Return dg/dz, shape of z."""
        _, s, c2 = self.coefficients
        return np.asarray(s * np.exp(_limited(-c2 * (z - self.centre))))

    def jacobian(self, z: Array) -> Array:
        """Return the derivatives of g(z) with respect to y0, s and C2, shape (n, 3)."""
        _, s, c2 = self.coefficients
        t = z - self.centre
        bend = _bend(t, c2)
        return np.column_stack([np.ones_like(t), bend, s * _bend_by_c2(t, c2, bend)])

    @cached_property
    def monotone_range(self) -> tuple[float, float]:
        """Lowest and highest z where the inverse is defined: this curve is always monotone."""
        reach = _MARGIN * (self.high - self.low)
        return self.low - reach, self.high + reach

    def inverse(self, y: Array) -> Array:
        """Return z with g(z) = y, shape of y; outside the monotone range, its nearest end."""
        y0, s, c2 = self.coefficients
        low, high = self.monotone_range
        bend = (y - y0) / s
        if c2 != 0.0:
            bend = np.log1p(np.maximum(-c2 * bend, 1e-15 - 1.0)) / -c2  # limited at the asymptote
        return np.asarray(np.clip(self.centre + bend, low, high))

    def refit(self, z: Array, y: Array) -> ExponentialCurve:
        """Return the exponential fitted to z (n,) and y (n,), starting from the present C2."""
        return fit_exponential(z, y, start=self.coefficients[2])

    def thesis_constants(self, surface: float | None, c3: float) -> tuple[float, float, float, float]:
        """Return C1, C2, C3 and the offset of y = offset + C1 (1 - exp(-C2 (z + C3))).

        The curve has three degrees of freedom and this form four constants. Either the offset is given as ``surface``
        and C3 follows, or ``surface`` is None and the offset follows from C3. NaN if no such curve exists.
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
    """Legendre series over the fitted range of z, extrapolated linearly."""

    @cached_property
    def _derivative(self) -> Array:
        return np.asarray(legendre.legder(self.coefficients))

    def _scaled(self, z: Array) -> Array:
        return np.asarray(2.0 * (z - self.low) / (self.high - self.low) - 1.0)

    def __call__(self, z: Array) -> Array:
        """Return g(z), shape of z."""
        inside = np.clip(z, self.low, self.high)
        value: Array = np.asarray(legendre.legval(self._scaled(inside), self.coefficients))
        if not np.array_equal(inside, z):
            value = np.asarray(value + self.slope(z) * (z - inside))
        return value

    def slope(self, z: Array) -> Array:
        """Return dg/dz, shape of z."""
        x = self._scaled(np.clip(z, self.low, self.high))
        return np.asarray(legendre.legval(x, self._derivative) * 2.0 / (self.high - self.low))

    def jacobian(self, z: Array) -> Array:
        """Return the Legendre polynomials at z, shape (n, degree + 1)."""
        return np.asarray(legendre.legvander(self._scaled(np.clip(z, self.low, self.high)), self.coefficients.size - 1))

    def refit(self, z: Array, y: Array) -> Polynomial:
        """Return a series of the same degree fitted to z (n,) and y (n,)."""
        return fit_polynomial(z, y, self.coefficients.size - 1)


@dataclass(frozen=True, eq=False)
class Spline(StaticNonlinearity):
    """Cubic spline, extrapolated linearly."""

    knots: tuple[float, ...]

    @cached_property
    def _curve(self) -> interpolate.BSpline:
        return interpolate.BSpline(np.array(self.knots), self.coefficients, 3)

    def __call__(self, z: Array) -> Array:
        """Return g(z), shape of z."""
        inside = np.clip(z, self.low, self.high)
        value: Array = np.asarray(self._curve(inside))
        if not np.array_equal(inside, z):
            value = np.asarray(value + self.slope(z) * (z - inside))
        return value

    def slope(self, z: Array) -> Array:
        """Return dg/dz, shape of z."""
        return np.asarray(self._curve(np.clip(z, self.low, self.high), nu=1))

    def jacobian(self, z: Array) -> Array:
        """Return the B-splines at z, shape (n, p)."""
        return _b_splines(np.clip(z, self.low, self.high), np.array(self.knots))


class MonotoneSpline(Spline):
    """A monotone spline: its B-spline coefficients increase, or decrease, throughout."""

    def refit(self, z: Array, y: Array) -> MonotoneSpline:
        """Return a spline with the same number of pieces fitted to z (n,) and y (n,)."""
        return fit_spline(z, y, self.coefficients.size - 3)


def coefficient_count(form: Form, degree: int) -> int:
    """Return the number of coefficients of g for a form and degree."""
    return {"exponential": 3, "polynomial": degree + 1, "spline": degree + 3}[form]


def fit_nonlinearity(form: Form, z: Array, y: Array, degree: int) -> StaticNonlinearity:
    """Fit g to z (n,) and y (n,).

    Args:
        form: family of curves.
        z: linear output.
        y: measured output.
        degree: degree of the polynomial, or pieces of the spline; not used by the exponential.
    """
    if form == "exponential":
        return fit_exponential(z, y)
    if form == "polynomial":
        return fit_polynomial(z, y, degree)
    return fit_spline(z, y, degree)


def fit_exponential(z: Array, y: Array, start: float | None = None) -> ExponentialCurve:
    """Fit the exponential of Eq. 3.26 with a free offset, by a grid over C2 (or a start) and Gauss-Newton.

    For a given C2 the other two coefficients follow by linear regression, so that only C2 is searched (variable
    projection: Golub and Pereyra 1973, with the derivative of Kaufman 1975).
    """
    low, high, centre = float(z.min()), float(z.max()), float(z.sum()) / z.size
    t = z - centre
    mean_y = float(y.sum()) / y.size
    y = y - mean_y
    reach = max(high - centre, centre - low)
    limit = _STEEPEST / reach
    if start is None:
        thinned = slice(None, None, max(1, z.size // _GRID_SAMPLES))
        start = _bend_of_grid(t[thinned], y[thinned] - y[thinned].mean(), np.linspace(-4.0, 4.0, 17) / reach)
    energy = float(np.dot(y, y))
    line = _line_through_bend(t, y, energy, reach, min(max(start, -limit), limit))
    for _ in range(30):
        step, improved = line.step, False
        while abs(step) > _SMALLEST_BEND / reach:
            tried = _line_through_bend(t, y, energy, reach, min(max(line.c2 + step, -limit), limit))
            if tried.rss < line.rss:
                line, improved = tried, True
                break
            step *= 0.5
        if not improved or abs(step) < _BEND_TOLERANCE / reach:
            break
    return ExponentialCurve(np.array([mean_y - line.s * line.mean_bend, line.s, line.c2]), low, high, centre)


def fit_polynomial(z: Array, y: Array, degree: int) -> Polynomial:
    """Fit a Legendre series of a degree over the range of z (n,) to y (n,)."""
    shape = Polynomial(np.zeros(degree + 1), float(z.min()), float(z.max()))
    coefficients = np.asarray(np.linalg.lstsq(shape.jacobian(z), y, rcond=None)[0], dtype=np.float64)
    return shape.with_coefficients(coefficients)


def fit_spline(z: Array, y: Array, pieces: int) -> MonotoneSpline:
    """Fit a monotone cubic spline of ``pieces`` pieces, with knots at quantiles of z (n,), to y (n,).

    The increments of the B-spline coefficients are constrained to one sign by non-negative least squares (I-splines:
    Ramsay 1988).
    """
    low, high = float(z.min()), float(z.max())
    inner = np.quantile(z, np.linspace(0.0, 1.0, pieces + 1)[1:-1])
    knots = np.concatenate([[low] * 4, inner, [high] * 4])
    basis = _b_splines(z, knots)  # (n, p)
    steps = np.cumsum(basis[:, ::-1], axis=1)[:, ::-1][:, 1:]  # (n, p - 1): basis of the increments
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


def _limited(exponent: Array) -> Array:
    """Return the exponent, limited to avoid overflow."""
    return np.minimum(exponent, 300.0)


def _bend(t: Array, c2: float) -> Array:
    """Return (1 - exp(-C2 t)) / C2, and t for C2 = 0."""
    return np.asarray(-np.expm1(_limited(-c2 * t)) / c2) if c2 != 0.0 else t


class _Line(NamedTuple):
    """The best straight line y = s (bend - mean bend) at a C2, and the Gauss-Newton step of C2 from there."""

    c2: float
    s: float
    mean_bend: float
    rss: float
    step: float


def _line_through_bend(t: Array, y: Array, energy: float, reach: float, c2: float) -> _Line:
    """Fit s at a given C2 to t (n,) within ``reach`` of zero and y (n,) with zero mean and energy ``energy``."""
    b_sum, b_b, b_y, d_sum, d_d, d_b, d_y = exponential_sums(t, y, np.expm1(-c2 * t), c2, reach)
    mean_bend, mean_d = b_sum / t.size, d_sum / t.size
    size = b_b - b_sum * mean_bend
    shared = d_b - d_sum * mean_bend
    s = b_y / size
    curvature = s * (d_d - d_sum * mean_d - shared * shared / size)
    step = (d_y - shared * s) / curvature if curvature != 0.0 else 0.0
    return _Line(c2, s, mean_bend, energy - s * b_y, step)


def _bend_of_grid(t: Array, y: Array, bends: Array) -> float:
    """Return the C2 of a grid (k,) that fits t (n,) and y (n,), with zero mean, best."""
    spread = np.array([_bend(t, float(c2)) for c2 in bends])  # (k, n)
    spread -= spread.mean(axis=1, keepdims=True)
    explained = (spread @ y) ** 2 / np.einsum("ij,ij->i", spread, spread)
    return float(bends[np.argmax(explained)])


def _bend_by_c2(t: Array, c2: float, bend: Array) -> Array:
    """Return the derivative of (1 - exp(-C2 t)) / C2, which is ``bend``, with respect to C2."""
    if abs(c2) * max(float(t.max()), -float(t.min())) < 1e-4:
        return np.asarray(t**2 * (c2 / 3.0 * t - 0.5))
    return np.asarray((t * (1.0 - c2 * bend) - bend) / c2)
