"""Volterra kernels as sums of discrete Laguerre functions (Marmarelis 1993).

About ten decaying functions replace one coefficient per lag: Q + Q (Q + 1) / 2 + ... coefficients for any memory. The
decay (the pole) and the number of functions are selected by five-fold cross-validation over stretches of the record,
which is robust against coloured residuals.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement, pairwise, permutations

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, ndimage, signal

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Mask
from tissueid.identification.impulse_response import long_run_covariance
from tissueid.identification.preparation import SAMPLES_PER_PARAMETER
from tissueid.messages import Message

MOST_FUNCTIONS = {1: 16, 2: 12, 3: 9}
"""Largest number of functions tried for kernels up to first, second and third order."""

_STRETCHES = 5
_POLES = 9
_NARROWINGS = 3
_RIDGE = 1e-12

_EXTRA_FUNCTIONS = 4
"""Number of additional functions by which the truncation error of an expansion is estimated."""

_NEIGHBOURS = 5


@dataclass(frozen=True, eq=False)
class LaguerreKernels:
    """Volterra kernels in output units per input units, per lag, and their expansion.

    ``kernel1`` has shape (L,), ``kernel2`` (L, L), ``kernel3`` (L, L, L), symmetric, None above the order. Standard
    deviations have the shape of their kernel; they include coloured noise and the truncation error. ``functions`` has
    shape (L, Q), ``coefficients`` (p,): the constant, then one per function, per pair and per triple of functions in
    the order of ``combinations_with_replacement``. ``n_parameters`` includes the pole. ``held_out_percent`` is the
    cross-validated variance accounted for.
    """

    kernel0: float
    kernel1: Array
    kernel2: Array | None
    kernel3: Array | None
    kernel0_std: float
    kernel1_std: Array
    kernel2_std: Array | None
    functions: Array
    coefficients: Array
    coefficients_std: Array
    pole: float
    n_parameters: int
    held_out_percent: float
    warnings: tuple[str, ...] = ()


def laguerre_functions(lags: int, count: int, pole: float) -> Array:
    """Return the first ``count`` discrete Laguerre functions at lags 0 .. L - 1, shape (L, count).

    Orthonormal over infinitely many lags. ``pole``, 0 to below 1, is the decay of the first function per lag. Each
    function follows from the previous one by an all-pass filter, which is numerically stable for any number of
    functions.
    """
    impulse = np.zeros(lags)
    impulse[0] = 1.0
    functions = np.empty((lags, count))
    functions[:, 0] = signal.lfilter([np.sqrt(1.0 - pole**2)], [1.0, -pole], impulse)
    for k in range(1, count):
        functions[:, k] = signal.lfilter([-pole, 1.0], [1.0, -pole], functions[:, k - 1])
    return functions


def laguerre_kernels(
    x: Array,
    y: Array,
    used: Mask,
    lags: int,
    spacing: int,
    order: int,
    *,
    functions: int | None = None,
    pole: float | None = None,
) -> LaguerreKernels:
    """Return the kernels of order 0 to ``order`` (1, 2 or 3) by least squares on Laguerre functions.

    Args:
        x: input (n,) with its mean removed.
        y: output (n,).
        used: mask (n,) of the rows; every input of their memory must have been received.
        lags: L, number of lags of a kernel; the functions are truncated there.
        spacing: samples between lags.
        order: of the highest kernel.
        functions: number of functions; None to select it.
        pole: of the functions; None to select it.

    Raises:
        UnusableInputError: the order is not 1 to 3, the pole not from 0 to below 1, or too few rows.
    """
    if order not in MOST_FUNCTIONS:
        raise UnusableInputError(
            "laguerre.order", "a Laguerre expansion is for kernels of order 1, 2 or 3, got {order}", order=order
        )
    if pole is not None and not 0.0 <= pole < 1.0:
        raise UnusableInputError(
            "laguerre.pole", "the pole of Laguerre functions must be at least 0 and below 1, got {pole:g}", pole=pole
        )
    if functions is not None and not 1 <= functions <= lags:
        raise UnusableInputError(
            "laguerre.too_many_functions",
            "{lags} lags do not determine {functions} Laguerre functions: take 1 to {lags}",
            lags=lags,
            functions=functions,
        )
    rows = np.flatnonzero(used)
    most = min(lags, MOST_FUNCTIONS[order]) if functions is None else functions
    while functions is None and most > 1 and _count(most, order) * SAMPLES_PER_PARAMETER > rows.size:
        most -= 1
    if rows.size < max(_count(most, order), 2 * _STRETCHES):
        raise UnusableInputError(
            "laguerre.too_few_rows",
            "{rows} rows are too few for {coefficients} coefficients: record longer, or take fewer functions",
            rows=int(rows.size),
            coefficients=_count(most, order),
        )
    trial = _Trial(np.where(np.isfinite(x), x, 0.0), y[rows] - y[rows].mean(), rows, lags, spacing, order)
    counts = range(1, most + 1) if functions is None else [functions]
    pole, count, unexplained = _choose(trial, counts, pole)
    return _solve(trial, count, pole, 100.0 * (1.0 - unexplained), float(y[rows].mean()))


@dataclass(frozen=True, eq=False)
class _Trial:
    """Data for expansions: input (n,), output (rows,) minus its mean, the rows."""

    x: Array
    output: Array
    rows: NDArray[np.intp]
    lags: int
    spacing: int
    order: int

    def regressors(self, functions: Array) -> Array:
        """Return the products of the inputs filtered by the functions (L, Q), shape (rows, p)."""
        taps = np.zeros(((self.lags - 1) * self.spacing + 1, functions.shape[1]))
        taps[:: self.spacing] = functions
        filtered = signal.oaconvolve(self.x[:, None], taps, axes=0)[self.rows]  # (rows, Q)
        columns = [np.ones((self.rows.size, 1)), filtered]
        for degree in range(2, self.order + 1):
            column = np.array(list(combinations_with_replacement(range(functions.shape[1]), degree))).T
            product = filtered[:, column[0]]
            for factor in column[1:]:
                product = product * filtered[:, factor]
            columns.append(product)
        return np.concatenate(columns, axis=1)

    def held_out(self, pole: float, counts: Sequence[int]) -> Array:
        """Return the cross-validated share of unexplained output power for each number of functions."""
        most = max(counts)
        regressors = self.regressors(laguerre_functions(self.lags, most, pole))
        size = np.sqrt(np.mean(regressors**2, axis=0))
        regressors = regressors / np.where(size > 0.0, size, 1.0)
        edges = np.linspace(0, self.rows.size, _STRETCHES + 1).astype(int)
        parts = [slice(a, b) for a, b in pairwise(edges)]
        grams = [regressors[part].T @ regressors[part] for part in parts]
        rights = [regressors[part].T @ self.output[part] for part in parts]
        powers = [float(self.output[part] @ self.output[part]) for part in parts]
        gram, right = sum(grams, np.zeros_like(grams[0])), sum(rights, np.zeros_like(rights[0]))
        highest = _highest_function(most, self.order)
        order = np.argsort(highest, kind="stable")  # the coefficients of fewer functions come first
        sizes = [int(np.count_nonzero(highest < count)) for count in counts]
        ridge = _RIDGE * self.rows.size * np.eye(order.size)
        missed = np.zeros(len(counts))
        for own, by_output, power in zip(grams, rights, powers, strict=True):
            rest = (gram - own)[np.ix_(order, order)] + ridge
            own_ordered, by_output_ordered = own[np.ix_(order, order)], by_output[order]
            for index, (size, fitted) in enumerate(
                zip(sizes, _nested(rest, (right - by_output)[order], sizes), strict=True)
            ):
                explained = 2.0 * fitted @ by_output_ordered[:size] - fitted @ own_ordered[:size, :size] @ fitted
                missed[index] += power - explained
        return missed / sum(powers)


def _nested(gram: Array, right: Array, sizes: Sequence[int]) -> Iterator[Array]:
    """Yield the solutions (size,) of the normal equations (p, p) of the first coefficients, for several sizes."""
    try:
        factor = linalg.cholesky(gram, lower=True, check_finite=False)
    except linalg.LinAlgError:  # collinear functions
        for size in sizes:
            yield linalg.lstsq(gram[:size, :size], right[:size], check_finite=False)[0]
        return
    half = linalg.solve_triangular(factor, right, lower=True, check_finite=False)
    for size in sizes:
        yield linalg.solve_triangular(factor[:size, :size], half[:size], lower=True, trans="T", check_finite=False)


def _choose(trial: _Trial, counts: Sequence[int], pole: float | None) -> tuple[float, int, float]:
    """Return the pole and number of functions with the smallest cross-validation error, and that error as a share."""
    counts = list(counts)
    tried: dict[float, Array] = {}
    # The slowest function that is tried has decayed to 0.1 at the end of the memory.
    highest = 0.1 ** (1.0 / max(2, trial.lags))
    poles = [pole] if pole is not None else list(np.linspace(0.05, highest, _POLES))
    for candidate in poles:
        tried[candidate] = trial.held_out(candidate, counts)
    step = poles[1] - poles[0] if len(poles) > 1 else 0.0
    for _ in range(_NARROWINGS if pole is None else 0):
        best = min(tried, key=lambda p: float(tried[p].min()))
        step *= 0.5
        for candidate in (best - step, best + step):
            if 0.0 <= candidate < 1.0:
                tried[candidate] = trial.held_out(candidate, counts)
    best = min(tried, key=lambda p: float(tried[p].min()))
    return best, counts[int(np.argmin(tried[best]))], float(tried[best].min())


def _solve(trial: _Trial, count: int, pole: float, held_out: float, offset: float) -> LaguerreKernels:
    functions = laguerre_functions(trial.lags, count, pole)
    regressors = trial.regressors(functions)  # (rows, p)
    rows, p = regressors.shape
    orthonormal, triangle = np.linalg.qr(regressors)
    inverse = np.linalg.pinv(triangle)
    by_direction = orthonormal.T @ trial.output
    coefficients = inverse @ by_direction
    residual = trial.output - orthonormal @ by_direction
    spread = long_run_covariance(orthonormal * residual[:, None], trial.lags * trial.spacing)
    covariance = inverse @ (spread * rows / max(1, rows - p)) @ inverse.T
    constant, kernel1, kernel2 = _kernels(functions, coefficients, trial.order)
    missing0, missing1, missing2 = _truncation_error(trial, count, pole, kernel1, kernel2, constant)
    first = slice(1, 1 + count)
    pairs = slice(1 + count, _count(count, min(2, trial.order)))
    kernel2_std = None
    if missing2 is not None:
        kernel2_std = np.sqrt(_second_variance(functions, covariance[pairs, pairs]) + missing2)
    warnings: tuple[str, ...] = ()
    if rows < SAMPLES_PER_PARAMETER * p:
        warnings = (
            Message(
                "laguerre.few_rows",
                "{rows} rows for {coefficients} coefficients are fewer than {fewest} for each: record longer, or "
                "take fewer functions",
                rows=int(rows),
                coefficients=p,
                fewest=SAMPLES_PER_PARAMETER,
            ),
        )
    coefficients[0] += offset
    return LaguerreKernels(
        kernel0=float(coefficients[0]),
        kernel1=kernel1,
        kernel2=kernel2,
        kernel3=_third(functions, coefficients[_count(count, 2) :]) if trial.order == 3 else None,
        kernel0_std=float(np.sqrt(covariance[0, 0] + missing0)),
        kernel1_std=np.sqrt(_variance(functions, covariance[first, first]) + missing1),
        kernel2_std=kernel2_std,
        functions=functions,
        coefficients=coefficients,
        coefficients_std=np.sqrt(np.diag(covariance)),
        pole=float(pole),
        n_parameters=p + 1,
        held_out_percent=held_out,
        warnings=warnings,
    )


def _kernels(functions: Array, coefficients: Array, order: int) -> tuple[float, Array, Array | None]:
    count = functions.shape[1]
    second = None
    if order >= 2:
        shares = np.zeros((count, count))
        shares[np.triu_indices(count)] = coefficients[1 + count : _count(count, 2)]
        second = functions @ (0.5 * (shares + shares.T)) @ functions.T
    return float(coefficients[0]), functions @ coefficients[1 : 1 + count], second


def _truncation_error(
    trial: _Trial, count: int, pole: float, kernel1: Array, kernel2: Array | None, constant: float
) -> tuple[float, Array, Array | None]:
    """Return the expected squared truncation error: the squared change due to a few more functions.

    Its expectation is the squared bias that they remove plus the variance that they add. It is averaged over
    neighbouring lags to reduce its scatter. Zero if there are no more functions or rows.
    """
    more = min(trial.lags, count + _EXTRA_FUNCTIONS)
    while more > count and _count(more, trial.order) * SAMPLES_PER_PARAMETER > trial.rows.size:
        more -= 1
    functions = laguerre_functions(trial.lags, more, pole)
    coefficients = linalg.lstsq(trial.regressors(functions), trial.output, check_finite=False)[0]
    richer0, richer1, richer2 = _kernels(functions, coefficients, trial.order)
    second = None
    if kernel2 is not None and richer2 is not None:
        second = ndimage.uniform_filter((richer2 - kernel2) ** 2, _NEIGHBOURS, mode="nearest")
    first = ndimage.uniform_filter1d((richer1 - kernel1) ** 2, _NEIGHBOURS, mode="nearest")
    return (richer0 - constant) ** 2, first, second


def _count(functions: int, order: int) -> int:
    """Return the number of coefficients of an expansion to this order, including the constant."""
    return int(_highest_function(functions, order).size)


def _highest_function(functions: int, order: int) -> NDArray[np.intp]:
    """Return the highest function of each coefficient (p,); -1 for the constant."""
    highest = [-1]
    for degree in range(1, order + 1):
        highest += [some[-1] for some in combinations_with_replacement(range(functions), degree)]
    return np.array(highest)


def _second_variance(functions: Array, covariance: Array) -> Array:
    """Return the variance of h2, (L, L), from the covariance of its coefficients."""
    lags, count = functions.shape
    first, second = np.triu_indices(count)
    row, column = np.triu_indices(lags)
    terms = functions[row][:, first] * functions[column][:, second]
    terms = 0.5 * (terms + functions[row][:, second] * functions[column][:, first])  # (L (L + 1) / 2, pairs)
    variance = np.empty((lags, lags))
    variance[row, column] = variance[column, row] = _variance(terms, covariance)
    return variance


def _third(functions: Array, coefficients: Array) -> Array:
    """Return h3, (L, L, L)."""
    count = functions.shape[1]
    shares = np.zeros((count, count, count))
    for some, value in zip(combinations_with_replacement(range(count), 3), coefficients, strict=True):
        positions = set(permutations(some))
        for position in positions:
            shares[position] = value / len(positions)
    kernel = np.einsum("ia,jb,kc,abc->ijk", functions, functions, functions, shares, optimize=True)
    return np.asarray(kernel, dtype=np.float64)


def _variance(terms: Array, covariance: Array) -> Array:
    """Return the variance of each row of terms (k, p) times coefficients of this covariance (p, p)."""
    return np.asarray(np.maximum(np.einsum("ij,ij->i", terms @ covariance, terms), 0.0))
