"""Cascades of linear and static blocks: structure, simulation and derivatives with respect to all parameters.

N is a static nonlinearity and L a linear dynamic block, in the order of the signal: Hammerstein is NL, Wiener is LN.
The value of every static curve at rest is subtracted, so that all signals between blocks are zero at rest; the constant
``offset`` is the output at the operating point.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import fft, interpolate, signal

from tissueid.identification.base import Array, Mask
from tissueid.identification.preparation import PreparedRecord, prepare
from tissueid.identification.static_nonlinearity import (
    ExponentialCurve,
    Form,
    Spline,
    StaticNonlinearity,
    fit_exponential,
    fit_polynomial,
)
from tissueid.records import Record

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
    for index in range(curve.coefficients.size if beyond.size else 0):
        unit = np.zeros(curve.coefficients.size)
        unit[index] = 1.0
        steepness = curve.with_coefficients(unit).slope(inside[beyond])
        slopes[index, beyond] += steepness * (z[beyond] - inside[beyond])
    return slopes


def with_zero_at(curve: StaticNonlinearity, argument: float) -> StaticNonlinearity:
    """Return the curve with a constant subtracted so that its value at ``argument`` is zero."""
    return with_offset(curve, -float(curve(np.array([argument]))[0]))


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


_POWER = 0.999
"""Share of the input's power below its band edge."""

_DENSE = 0.1
"""Share of the memory over which the knots keep their closest spacing."""

_GROWTH = 8.0
"""Spacing of the knots at the end of the memory, relative to the closest spacing."""


def band_edge(x: Array, sample_rate_hz: float) -> float:
    """Return the frequency, Hz, below which 99.9 % of the power of x (n,) lies; missing samples of x must be replaced
    by 0.
    """
    power = (
        np.abs(fft.rfft((x - x.mean()) * signal.windows.hann(x.size))) ** 2
    )  # step at the ends of the record would spread over all frequencies
    running = np.cumsum(power)
    bin_of_edge = int(np.searchsorted(running, _POWER * running[-1]))
    return bin_of_edge * sample_rate_hz / x.size


def lag_basis(lags: int, spacing: float) -> Array:
    """Return cubic B-splines over the lags, shape (lags, q), q <= lags; ``spacing`` of the first knots is in samples.

    If the splines would be as many as the lags, the identity is returned: one function per lag.
    """
    spacing = max(1.0, spacing)
    last = lags - 1.0
    knots = [0.0]
    while knots[-1] < last:
        lag = knots[-1]
        knots.append(lag + spacing * (1.0 + _GROWTH * max(0.0, lag / max(last, 1.0) - _DENSE)))
    inner = np.array(knots[1:-1])
    if inner.size and last - inner[-1] < 0.5 * spacing:
        inner = inner[:-1]
    if inner.size + 4 >= lags:
        return np.eye(lags)
    padded = np.concatenate([[0.0] * 4, inner, [last] * 4])
    return np.asarray(interpolate.BSpline.design_matrix(np.arange(lags), padded, 3).toarray(), dtype=np.float64)


class LagBank:
    """Convolutions of signals (n,) with every function of a basis (lags, q), at rest before the first sample."""

    def __init__(self, basis: Array, n: int) -> None:
        self.basis = basis
        self._n = n
        self._length = fft.next_fast_len(n + basis.shape[0] - 1, real=True)
        self._spectra: NDArray[np.complex128] = fft.rfft(basis.T, self._length)  # (q, bins)
        self._last: list[tuple[Array, Array]] = []  # the last two signals with their rows: that of a first block stays

    @property
    def size(self) -> int:
        """Number of basis functions q."""
        return int(self.basis.shape[1])

    def rows(self, driven: Array) -> Array:
        """Return each basis function convolved with a signal (n,), shape (q, n), not to be changed."""
        cached = next((pair for pair in self._last if np.array_equal(pair[0], driven)), None)
        if cached is None:
            spectrum = fft.rfft(driven, self._length)
            convolved = fft.irfft(self._spectra * spectrum, self._length, overwrite_x=True)[:, : self._n]
            cached = driven.copy(), np.asarray(convolved, dtype=np.float64)
        self._last = [cached, *(pair for pair in self._last if pair is not cached)][:2]
        return cached[1]

    def apply(self, weights: Array, signals: Array) -> Array:
        """Return signals, shape (..., n), convolved with the kernel of the weights (q,); the same shape."""
        kernel = fft.rfft(self.basis @ weights, self._length)
        return np.asarray(fft.irfft(fft.rfft(signals, self._length) * kernel, self._length)[..., : self._n])

    def nearest(self, kernel: Array) -> Array:
        """Return the least-squares weights (q,) that approximate a kernel (lags,)."""
        return np.asarray(np.linalg.lstsq(self.basis, kernel, rcond=None)[0], dtype=np.float64)


Structure = Literal["linear", "wiener", "hammerstein", "lnl", "nln"]

STRUCTURES: tuple[Structure, ...] = ("linear", "wiener", "hammerstein", "lnl", "nln")
"""Structures in order of complexity; of two that explain a record equally well, the first is preferred."""

SPECIAL_CASES: dict[Structure, frozenset[Structure]] = {
    "linear": frozenset(),
    "wiener": frozenset({"linear"}),
    "hammerstein": frozenset({"linear"}),
    "lnl": frozenset({"linear", "wiener", "hammerstein"}),
    "nln": frozenset({"linear", "wiener", "hammerstein"}),
}
"""Special cases of each structure."""

_KNOTS_PER_PERIOD = 2.25
"""Knots per period of the highest frequency of the input; two are the minimum."""


@dataclass(frozen=True, eq=False)
class Blocks:
    """The blocks of a cascade; None for blocks that its structure does not have.

    ``inner`` is the static curve of the absolute input, ``first`` (q,) the basis weights of the first linear block,
    ``outer`` the static curve of its output, ``second`` (q,) the basis weights of the second linear block.
    """

    inner: StaticNonlinearity | None
    first: Array
    outer: StaticNonlinearity | None
    second: Array | None
    offset: float

    @property
    def structure(self) -> Structure:
        """The structure that these blocks form."""
        if self.second is not None:
            return "lnl"
        if self.inner is None:
            return "linear" if self.outer is None else "wiener"
        return "hammerstein" if self.outer is None else "nln"

    @property
    def vector(self) -> Array:
        """All parameters, shape (p,): offset, inner curve, first block, outer curve, second block."""
        parts = [np.array([self.offset])]
        parts += [] if self.inner is None else [self.inner.coefficients]
        parts += [self.first]
        parts += [] if self.outer is None else [self.outer.coefficients]
        parts += [] if self.second is None else [self.second]
        return np.concatenate(parts)

    def with_vector(self, vector: Array) -> Blocks:
        """Return the same structure with other parameters, shape (p,) as :attr:`vector`."""
        start = 1
        inner, outer, second = self.inner, self.outer, self.second
        if inner is not None:
            inner = inner.with_coefficients(vector[start : start + inner.coefficients.size])
            start += inner.coefficients.size
        first = vector[start : start + self.first.size]
        start += first.size
        if outer is not None:
            outer = outer.with_coefficients(vector[start : start + outer.coefficients.size])
            start += outer.coefficients.size
        if second is not None:
            second = vector[start:]
        return Blocks(inner, first, outer, second, float(vector[0]))

    @property
    def n_parameters(self) -> int:
        """Number of free parameters: without the constant of each curve and one gain per curve, which other blocks
        determine.
        """
        count = 1 + self.first.size
        count += 0 if self.second is None else self.second.size
        for curve in (self.inner, self.outer):
            count += 0 if curve is None else curve.coefficients.size - 2
        return count - (0 if self.second is None else 1)


@dataclass(frozen=True, eq=False)
class CascadeData:
    """A prepared record for fits of cascades.

    ``input`` (n,) holds the mean for samples that were not received; no fitted output depends on them. ``rows`` are the
    indices of the fitted samples. ``bank`` holds the basis of every linear block, whose first knots are ``spacing``
    samples apart.
    """

    prepared: PreparedRecord
    input: Array
    output: Array
    rows: NDArray[np.intp]
    bank: LagBank
    spacing: float
    edge_hz: float

    @property
    def rest(self) -> float:
        """The input at rest."""
        return self.prepared.input_mean

    @property
    def measured(self) -> Array:
        """The fitted outputs, shape (rows,)."""
        return np.asarray(self.output[self.rows])

    def without(self, held_out: Mask) -> CascadeData:
        """Return the data without the samples of a mask (n,) in the fit."""
        return replace(self, rows=self.rows[~held_out[self.rows]])

    def first(self, rows: int) -> CascadeData:
        """Return the data up to the given number of rows, without later samples."""
        if self.rows.size <= rows:
            return self
        end = int(self.rows[rows - 1]) + 1
        bank = LagBank(self.bank.basis, end)
        return replace(self, input=self.input[:end], output=self.output[:end], rows=self.rows[:rows], bank=bank)

    def thinned(self, rows: int) -> CascadeData:
        """Return the data with about ``rows`` evenly spaced rows."""
        return replace(self, rows=self.rows[:: max(1, self.rows.size // rows)])


def prepare_cascade(
    record: Record, fit_part: slice | None, lags: int, whole: int, n_parameters: Callable[[int], int]
) -> tuple[PreparedRecord, float]:
    """Prepare a record for cascades whose blocks have ``lags`` lags each, and choose the spacing of their basis.

    Args:
        record: the data.
        fit_part: contiguous part to fit, or None.
        lags: lags of one linear block.
        whole: lags of the whole cascade, on which an output sample depends.
        n_parameters: returns the number of parameters of the largest cascade to fit, from the size q of the basis.

    Returns:
        The prepared record, and the spacing of the first knots of the basis in samples.

    Raises:
        UnusableInputError: as :func:`~tissueid.identification.preparation.prepare`.
    """
    rate = record.sample_rate_hz
    x = record.input[fit_part or slice(None)]
    received = x[np.isfinite(x)]
    edge = band_edge(np.where(np.isfinite(x), x, received.mean()), rate) if received.size else 0.0
    spacing = min(rate / (_KNOTS_PER_PERIOD * max(edge, 1e-9)), lags / 8.0)
    return prepare(record, fit_part, whole / rate, n_parameters(lag_basis(lags, spacing).shape[1])), spacing


def input_levels(prepared: PreparedRecord) -> int:
    """Return the number of different input values in the fitted part: the most coefficients of an inner curve."""
    x = prepared.record.input[prepared.part]
    return int(np.unique(x[np.isfinite(x)]).size)


def cascade_data(prepared: PreparedRecord, lags: int, spacing: float) -> CascadeData:
    """Return the data for fits of cascades whose linear blocks have ``lags`` lags each.

    ``spacing`` is the distance of the first knots of their basis, in samples.
    """
    record = prepared.record
    end = prepared.part.stop  # samples after the fitted part are not needed
    x = np.where(np.isfinite(record.input), record.input, prepared.input_mean)[:end]
    return CascadeData(
        prepared=prepared,
        input=x,
        output=record.output[:end],
        rows=np.flatnonzero(prepared.used[:end]),
        bank=LagBank(lag_basis(lags, spacing), end),
        spacing=spacing,
        edge_hz=band_edge(x[prepared.part.start :], record.sample_rate_hz),
    )


@dataclass(frozen=True, eq=False)
class Signals:
    """Signals within a cascade, each (n,): ``driven`` is the input of the first linear block, ``inside`` its output."""

    driven: Array
    inside: Array
    output: Array


def run(blocks: Blocks, data: CascadeData) -> Signals:
    """Simulate a cascade in free run over the input, at rest before the first sample."""
    driven = data.input - data.rest
    if blocks.inner is not None:
        driven = blocks.inner(data.input) - blocks.inner(np.array([data.rest]))
    inside = data.bank.apply(blocks.first, driven)
    passed = inside
    if blocks.outer is not None:
        passed = blocks.outer(inside) - blocks.outer(np.zeros(1))
    if blocks.second is not None:
        passed = data.bank.apply(blocks.second, passed)
    return Signals(driven, inside, blocks.offset + passed)


def slopes(blocks: Blocks, data: CascadeData, signals: Signals) -> Array:
    """Return the derivatives of the output with respect to :attr:`Blocks.vector`, shape (p, rows)."""
    bank, rows = data.bank, data.rows
    everywhere = blocks.second is not None  # the memory of a second block needs all samples
    here: slice | NDArray[np.intp] = slice(None) if everywhere else rows
    changes = []
    if blocks.inner is not None:
        by_inner = curve_slopes(blocks.inner, data.input) - curve_slopes(blocks.inner, np.array([data.rest]))
        changes.append(bank.apply(blocks.first, by_inner)[:, here])
    changes.append(bank.rows(signals.driven)[:, here])
    stacked = np.concatenate(changes)
    if blocks.outer is not None:
        inside = signals.inside[here]
        by_outer = curve_slopes(blocks.outer, inside) - curve_slopes(blocks.outer, np.zeros(1))
        stacked = np.concatenate([stacked * blocks.outer.slope(inside), by_outer])
    if blocks.second is not None:
        passed = signals.inside
        if blocks.outer is not None:
            passed = blocks.outer(signals.inside) - blocks.outer(np.zeros(1))
        stacked = bank.apply(blocks.second, stacked)[:, rows]
        stacked = np.concatenate([stacked, bank.rows(passed)[:, rows]])
    return np.concatenate([np.ones((1, rows.size)), stacked])
