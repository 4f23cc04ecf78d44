"""Recursive least squares: the response is updated at each sample."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, nan
from typing import ClassVar

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissueid.identification.base import Array, Family, option
from tissueid.identification.impulse_response import convolve_at_rest, kernel_std, memory_warnings
from tissueid.identification.online_identifier import Identifier, OnlineEngine, OnlineModel
from tissueid.identification.preparation import SAMPLES_PER_PARAMETER, PreparedRecord, prepare
from tissueid.identification.registry import engine
from tissueid.identification.second_order_fit import fit_second_order
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Record

# Rows of the work array.
_COEFFICIENTS, _REGRESSOR, _PENDING, _RIDGE_PENDING, _PRODUCT = range(5)
_WORK_ROWS = 5

# Scalars.
_FORGETTING, _RIDGE = 0, 1  # ridge of one coefficient: one over its initial variance
_SCALE, _WEIGHT, _RIDGE_WEIGHT = 2, 3, 4  # V = scale triangle - weight pending pending' - ridge_weight ridge ridge'
_RECEIVED, _UPDATES = 5, 6  # inputs since the last gap; total updates
_SCALARS = 7


def _start_recursion(taps: int, variance: float, constant: float, forgetting: float) -> tuple[Array, Array, Array]:
    """Return the triangle, work array and scalars of a new identifier.

    Args:
        taps: lags of the response.
        variance: initial variance of every coefficient, for output noise of unit variance.
        constant: the regressor of the offset, after those of the lags.
        forgetting: factor of Eq. 6.3, at most 1.
    """
    count = taps + 1
    triangle = np.zeros(count * (count + 1) // 2)
    triangle[_diagonal(count)] = variance
    work = np.zeros((_WORK_ROWS, count))
    work[_REGRESSOR, taps] = constant
    scalars = np.zeros(_SCALARS)
    scalars[[_FORGETTING, _RIDGE, _SCALE]] = forgetting, 1.0 / variance, 1.0
    return triangle, work, scalars


def _recursion_covariance(triangle: Array, work: Array, scalars: Array) -> Array:
    """Return V (taps + 1, taps + 1), including the stored update; the state is not changed."""
    count = work.shape[1]
    full = np.zeros((count, count))
    full[np.triu_indices(count)] = scalars[_SCALE] * triangle
    full += np.triu(full, 1).T
    for row, weight in ((_PENDING, _WEIGHT), (_RIDGE_PENDING, _RIDGE_WEIGHT)):
        full -= scalars[weight] * np.outer(work[row], work[row])
    return full


def _diagonal(count: int) -> NDArray[np.intp]:
    rows = np.arange(count)
    return rows * count - rows * (rows - 1) // 2


# Reordering of sums is allowed, so that the compiler can use vector instructions.
@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def _advance_recursion(triangle: Array, work: Array, scalars: Array, u: Array, y: Array, errors: Array) -> None:
    """Add samples u (n,) and y (n,), minus their operating point, and store the prediction errors (n,) before each
    update.

    An error is NaN, and no update is made, if the output or any input in the memory is NaN.
    """
    taps = work.shape[1] - 1
    x = work[_REGRESSOR]
    coefficients = work[_COEFFICIENTS]
    for n in range(u.size):
        for k in range(taps - 1, 0, -1):
            x[k] = x[k - 1]
        x[0] = u[n]
        scalars[_RECEIVED] = scalars[_RECEIVED] + 1.0 if isfinite(u[n]) else 0.0
        errors[n] = nan
        if scalars[_RECEIVED] < taps or not isfinite(y[n]):
            continue
        predicted = 0.0
        for k in range(taps + 1):
            predicted += coefficients[k] * x[k]
        errors[n] = y[n] - predicted  # Eq. 6.2
        _multiply(triangle, work, scalars)
        _learn(triangle, work, scalars, errors[n])
        scalars[_UPDATES] += 1.0


@njit(cache=True, fastmath={"reassoc", "contract"})
def _multiply(triangle: Array, work: Array, scalars: Array) -> None:
    """Apply the stored update, and compute the product of V with the regressor, in one pass.

    Two rows are processed at a time, so that common factors are read once.
    """
    count = work.shape[1]
    scale, weight, ridge_weight = scalars[_SCALE], scalars[_WEIGHT], scalars[_RIDGE_WEIGHT]
    for k in range(count):
        work[_PRODUCT, k] = 0.0
    first = 0
    for i in range(0, count - 1, 2):
        rest = count - i - 2
        upper, lower = triangle[first : first + rest + 2], triangle[first + rest + 2 : first + 2 * rest + 3]
        x, pending, ridge, product = (
            work[_REGRESSOR, i:],
            work[_PENDING, i:],
            work[_RIDGE_PENDING, i:],
            work[_PRODUCT, i:],
        )
        a, a_ridge, a_x = weight * pending[0], ridge_weight * ridge[0], x[0]
        b, b_ridge, b_x = weight * pending[1], ridge_weight * ridge[1], x[1]
        upper[0] = scale * upper[0] - a * pending[0] - a_ridge * ridge[0]
        upper[1] = scale * upper[1] - a * pending[1] - a_ridge * ridge[1]
        lower[0] = scale * lower[0] - b * pending[1] - b_ridge * ridge[1]
        a_total = upper[0] * a_x + upper[1] * b_x
        b_total = upper[1] * a_x + lower[0] * b_x
        above, below = upper[2:], lower[1:]
        x, pending, ridge, product = x[2:], pending[2:], ridge[2:], product[2:]
        for k in range(rest):
            from_a = scale * above[k] - a * pending[k] - a_ridge * ridge[k]
            from_b = scale * below[k] - b * pending[k] - b_ridge * ridge[k]
            above[k], below[k] = from_a, from_b
            a_total += from_a * x[k]
            b_total += from_b * x[k]
            product[k] += from_a * a_x + from_b * b_x
        work[_PRODUCT, i] += a_total
        work[_PRODUCT, i + 1] += b_total
        first += 2 * rest + 3
    if count % 2 == 1:
        last = count - 1
        triangle[first] = (
            scale * triangle[first]
            - weight * work[_PENDING, last] ** 2
            - ridge_weight * work[_RIDGE_PENDING, last] ** 2
        )
        work[_PRODUCT, last] += triangle[first] * work[_REGRESSOR, last]


# Reordering of sums is allowed, as above.
@njit(cache=True, fastmath={"reassoc", "contract"})
def _learn(triangle: Array, work: Array, scalars: Array, error: float) -> None:
    """Correct the coefficients by the error, and store the update of V."""
    count = work.shape[1]
    coefficients, x, pending, ridge, product = work[0], work[1], work[2], work[3], work[4]
    forgetting = scalars[_FORGETTING]
    spread = forgetting
    for k in range(count):
        spread += x[k] * product[k]
    gain = error / spread  # Eqs. 6.3 and 6.5
    for k in range(count):
        coefficients[k] += product[k] * gain
        pending[k] = product[k]
    scalars[_SCALE] = 1.0 / forgetting
    scalars[_WEIGHT] = 1.0 / (forgetting * spread)  # Eq. 6.4
    if forgetting == 1.0:
        return
    turn = int(scalars[_UPDATES]) % count
    index = turn  # in the triangle: down column ``turn`` to the diagonal, then along its row
    for k in range(count):
        ridge[k] = triangle[index] / forgetting - scalars[_WEIGHT] * pending[k] * pending[turn]
        index += count - 1 - k if k < turn else 1
    returned = scalars[_RIDGE] * count * (1.0 - forgetting)
    scalars[_RIDGE_WEIGHT] = 1.0 / (1.0 / returned + ridge[turn])
    away = coefficients[turn] * scalars[_RIDGE_WEIGHT]
    for k in range(count):
        coefficients[k] -= ridge[k] * away


_RETAINED_TIME_CONSTANTS = 4.0
"""Time constants of forgetting after which the weight of a residual is neglected."""


@dataclass(frozen=True, eq=False)
class RlsModel(OnlineModel):
    """The response after the last sample, with its standard deviations ``impulse_response_std`` (lags,)."""

    impulse_response_std: Array


class RlsIdentifier(Identifier):
    """State of recursive least squares during a record; created by :meth:`Rls.start`.

    ``first_variance`` is the initial variance of every lag of the response per sample, for output noise of unit
    variance: one over the ridge.
    """

    options: Rls

    def __init__(
        self,
        options: Rls,
        sample_rate_hz: float,
        input_std: float,
        operating_point: tuple[float | None, float | None],
        units: tuple[str, str] = ("N", "m"),
        begin: int = 0,
    ) -> None:
        super().__init__(options, sample_rate_hz, operating_point, units, begin)
        self._constant = input_std
        self.first_variance = options.covariance / input_std**2
        self._triangle, self._work, self._scalars = _start_recursion(
            self.lags, self.first_variance, self._constant, options.forgetting
        )

    def _advance(self, u: Array, y: Array, errors: Array) -> None:
        _advance_recursion(self._triangle, self._work, self._scalars, u, y, errors)

    def _response(self) -> Array:
        return self._work[_COEFFICIENTS, : self.lags]

    @property
    def offset(self) -> float:
        """Output at the operating point of the input."""
        return self.output_mean + self._constant * float(self._work[_COEFFICIENTS, self.lags])

    @property
    def covariance(self) -> Array:
        """Covariance of the response per sample, (lags, lags), for white output noise of unit variance (Eq. 6.4)."""
        return _recursion_covariance(self._triangle, self._work, self._scalars)[: self.lags, : self.lags]

    @property
    def updates(self) -> int:
        """Number of samples used for updates."""
        return int(self._scalars[_UPDATES])


@engine
class Rls(OnlineEngine):
    """RLS engine.

    Assumes a linear system whose response decays within ``memory``, and output noise that is independent of the input.
    With a forgetting factor of 1 the response equals the regularised least-squares solution over all samples, to
    rounding; below 1, older samples weigh less but the ridge does not, so that the covariance is bounded.
    """

    name: ClassVar[str] = "rls"
    label: ClassVar[str] = "RLS"
    title: ClassVar[str] = marked(
        "Recursive least-squares finite impulse response (Chen 2010, Eqs. 6.1-6.5) with an offset."
    )
    family: ClassVar[Family] = Family.LINEAR
    identifier: ClassVar[type[RlsIdentifier]] = RlsIdentifier

    forgetting: float = option(
        1.0,
        marked("Forgetting factor"),
        marked("Weight of each sample relative to the next; 1 forgets nothing"),
        ge=0.9,
        le=1.0,
    )
    covariance: float = option(
        200.0,
        marked("Initial variance"),
        marked("Initial variance of the response, relative to the ratio of noise and input variance"),
        gt=0.0,
        le=1e6,
    )

    def fit(self, record: Record, fit_part: slice | None = None) -> RlsModel:
        """Run the recursion over a record, or over a contiguous part of it.

        Raises:
            UnusableInputError: nothing varies, too few samples, or a memory longer than the part.
        """
        prepared = prepare(record, fit_part, self.memory_s)
        return self.model_of(self.run(prepared), prepared)

    def model_of(self, identifier: RlsIdentifier, prepared: PreparedRecord) -> RlsModel:
        """Return the model of an identifier, scored on a prepared record."""
        record, used = prepared.record, prepared.used
        lags, rate = identifier.lags, identifier.sample_rate_hz
        kernel = identifier.impulse_response / rate
        x = record.input - identifier.input_mean
        modelled = identifier.offset + convolve_at_rest(kernel, x)
        residuals = np.where(used, record.output - modelled, np.nan)
        covariance = identifier.covariance
        second_order = fit_second_order(record, used, self.hold)
        warnings, findings = self._warnings(identifier, covariance)
        trajectory, trajectory_s, trajectory_position = identifier.trajectory
        return RlsModel(
            report=self.report(
                record,
                used,
                modelled,
                lags + 1,
                parameters=second_order.parameters,
                warnings=(*prepared.warnings, *warnings, *memory_warnings(kernel), *second_order.warnings),
                findings=findings,
                details={
                    "vaf_tracking_percent": identifier.tracking_vaf_percent,
                    "vaf_parametric_percent": second_order.vaf_percent,
                },
            ),
            sample_rate_hz=rate,
            memory_samples=lags,
            impulse_response=kernel * rate,
            impulse_response_std=self.response_std(identifier, covariance, x, residuals, prepared.part) * rate,
            lag_s=identifier.lag_s,
            input_mean=identifier.input_mean,
            output_mean=identifier.offset,
            trajectory=trajectory,
            trajectory_s=trajectory_s,
            trajectory_position=trajectory_position,
            second_order=second_order,
        )

    def response_std(
        self, identifier: RlsIdentifier, covariance: Array, x: Array, residuals: Array, part: slice
    ) -> Array:
        """Return the standard deviation of each lag (lags,) for coloured noise, with the weights of forgetting."""
        forgetting, n = self.forgetting, identifier.updates
        weight = weight_squares = float(n)
        begin = part.start
        if forgetting < 1.0:
            weight = (1.0 - forgetting**n) / (1.0 - forgetting)
            weight_squares = (1.0 - forgetting ** (2 * n)) / (1.0 - forgetting**2)
            remembered = round(_RETAINED_TIME_CONSTANTS / (1.0 - forgetting))
            begin = max(begin, part.stop - max(remembered, 4 * identifier.lags))
        recent = slice(begin, part.stop)
        count = int(np.isfinite(residuals[recent]).sum())
        about = x[recent] - np.nanmean(
            x[recent]
        )  # during a test the operating point may differ from the mean; the offset compensates
        std = kernel_std(covariance * weight, about, residuals[recent])
        return std * float(np.sqrt(count * weight_squares) / weight)

    def _warnings(self, identifier: RlsIdentifier, covariance: Array) -> tuple[list[str], tuple[str, ...]]:
        """Return a warning if the memory exceeds the retained samples, and a finding on directions that are not
        excited.
        """
        lags = identifier.lags
        warnings: list[str] = []
        remembered = 1.0 / (1.0 - self.forgetting) if self.forgetting < 1.0 else np.inf
        if remembered < SAMPLES_PER_PARAMETER * lags:
            warnings.append(
                Message(
                    "rls.short_memory",
                    "a forgetting factor of {forgetting:g} retains {samples:.0f} samples for {lags} lags, fewer than "
                    "{fewest} for each: raise it, or shorten the memory",
                    forgetting=self.forgetting,
                    samples=remembered,
                    lags=lags,
                    fewest=SAMPLES_PER_PARAMETER,
                )
            )
        unexcited = min(lags, round(float(np.trace(covariance)) / identifier.first_variance))
        if unexcited == 0:
            return warnings, ()
        if self.forgetting < 1.0:
            finding = Message(
                "rls.bounded",
                "the input does not excite {unexcited} of {lags} directions of the response: the ridge determines "
                "them and is not forgotten, so that the covariance stays bounded",
                unexcited=unexcited,
                lags=lags,
            )
        else:
            finding = Message(
                "rls.unexcited",
                "the input does not excite {unexcited} of {lags} directions of the response: the ridge determines them",
                unexcited=unexcited,
                lags=lags,
            )
        return warnings, (finding,)
