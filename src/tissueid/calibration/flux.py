"""Electrical half of a sweep: resistance, inductance and force constant, independent of the spring.

The voltage across the coil is R i + L di/dt + k(x) dx/dt; k(x) is the slope of the flux linkage Phi(x). Commands are
held between samples. Voltage and position, which have little noise, are the regressors; the noisy current is the
output. The least squares problem is therefore linear, without errors in the variables:

    i[n] = sum_m a[m] v[n - m] + i0 - (1 / R) d/dt Phi(x) at t[n] - L / R,      1 / R = sum_m a[m].

The a[m] are the increments of the step response of coil and anti-alias filter, which give the inductance. Each test has
its own current offset and resistance, because the coil warms up; k(x) is common to all tests.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize
from scipy.interpolate import BSpline

from tissueid.calibration.spring_points import SweepTest
from tissueid.errors import UnusableInputError
from tissueid.identification.impulse_response import dependence_samples, long_run_covariance
from tissueid.records import Estimate

Array = NDArray[np.float64]

MIN_SPACING_M = 2.0e-3
"""Minimum spacing of knots, m: the magnetic field changes over about the width of the air gap."""
RIDGE = 1e-7
"""Weight of the smoothness penalty relative to the data; effective only where there are no data."""
_DEGREE = 3


@dataclass(frozen=True, eq=False)
class SplineBasis:
    """Cubic B-splines on equally spaced knots (k,), m, with fourfold ends."""

    knots: Array

    @classmethod
    def covering(cls, visited_m: Sequence[Array], spacing_m: float) -> SplineBasis:
        """Return the basis over all visited positions, m, with knots about ``spacing_m`` apart, at least
        ``MIN_SPACING_M``.
        """
        low = min(float(np.nanmin(part)) for part in visited_m)
        high = max(float(np.nanmax(part)) for part in visited_m)
        pieces = max(1, int(np.ceil((high - low) / max(spacing_m, MIN_SPACING_M) - 1e-9)))
        inner = np.linspace(low, high, pieces + 1)
        return cls(np.concatenate([[low] * _DEGREE, inner, [high] * _DEGREE]))

    @property
    def size(self) -> int:
        """Number of splines."""
        return self.knots.size - _DEGREE - 1

    @property
    def span_m(self) -> tuple[float, float]:
        """First and last position."""
        return float(self.knots[0]), float(self.knots[-1])

    def values(self, position_m: Array) -> Array:
        """Return each spline at positions (n,), shape (n, size); NaN stays NaN."""
        return self._of(position_m, BSpline(self.knots, np.eye(self.size), _DEGREE))

    def integrals(self, position_m: Array) -> Array:
        """Return the integral of each spline from the first knot, m, to positions (n,), shape (n, size)."""
        return self._of(position_m, BSpline(self.knots, np.eye(self.size), _DEGREE).antiderivative())

    def _of(self, position_m: Array, spline: BSpline) -> Array:
        low, high = self.span_m
        return np.asarray(spline(np.clip(position_m, low, high)), dtype=np.float64)

    def roughness(self) -> Array:
        """Return the matrix (size, size) of the sum of squared second differences of the coefficients."""
        differences = np.diff(np.eye(self.size), 2, axis=0)
        return np.asarray(differences.T @ differences, dtype=np.float64)


def solve_least_squares(
    design: Array, target: Array, basis: SplineBasis, instruments: Array | None = None
) -> tuple[Array, Array]:
    """Return the least-squares solution (p,) and the inverse of its normal matrix (p, p).

    Args:
        design: regressors (n, p); the first are the splines of the basis, which are regularised where there are no
            data.
        target: output (n,).
        basis: of the splines.
        instruments: noise-free regressors (n, p) as instrumental variables, which avoids attenuation bias.
    """
    clean = design if instruments is None else instruments
    gram = clean.T @ design
    gram[: basis.size, : basis.size] += RIDGE * np.mean(np.diag(gram)[: basis.size]) * basis.roughness()
    inverse = np.linalg.inv(gram)
    return np.asarray(inverse @ (clean.T @ target)), np.asarray(inverse.T)


def solution_covariance(influence: Array, residual: Array, rate: float) -> Array:
    """Return the covariance (p, p) of a solution from the influence (n, p) of its rows, for
    autocorrelated residuals.
    """
    return long_run_covariance(influence, dependence_samples(residual, rate))


ANTI_ALIAS_HZ = 2000.0
"""Cut-off of the first-order filters before all converters, Hz (Chen 2010, 2.3)."""
ANTI_ALIAS_TOLERANCE = 0.05
"""Relative standard deviation of that cutoff: capacitors of 5 %."""
FILTER_S = 1.0 / (2.0 * np.pi * ANTI_ALIAS_HZ)
"""Time constant of the filters, s."""
_LAG_S = (5e-6, 1e-3)
"""Shortest and longest L / R, s."""


@dataclass(frozen=True)
class TimeConstant:
    """L / R, s, with its standard deviation due to noise, and including the tolerance of the filters."""

    seconds: float
    noise_s: float
    std_s: float


def without_filter(readings: Array, rate: float) -> Array:
    """Return the voltage held over each interval, shape (n,), from low-pass filtered readings at the interval ends.

    NaN where the reading or the previous one was not received.
    """
    remaining = float(np.exp(-1.0 / (rate * FILTER_S)))  # of a step, after one interval
    before = np.concatenate([[np.nan], readings[:-1]])
    return np.asarray((readings - remaining * before) / (1.0 - remaining))


def fit_time_constant(responses: Sequence[Array], rate: float) -> TimeConstant:
    """Fit L / R to the mean step response of the current over all tests, (lags,) each."""
    steps = np.array([answer / answer.sum() for answer in responses])  # (tests, lags)
    mean, lags = steps.mean(axis=0), steps.shape[1]

    def time_constant_s(filter_s: float) -> float:
        def miss(lag: float) -> float:
            return float(np.sum((mean - _increments(lag, filter_s, lags, rate)) ** 2))

        return float(optimize.minimize_scalar(miss, bounds=_LAG_S, method="bounded", options={"xatol": 1e-9}).x)

    seconds, shift = time_constant_s(FILTER_S), 1e-6
    slope = (_increments(seconds + shift, FILTER_S, lags, rate) - _increments(seconds, FILTER_S, lags, rate)) / shift
    scatter = steps.std(axis=0, ddof=1) / np.sqrt(len(steps)) if len(steps) > 1 else np.zeros(lags)
    noise = float(np.linalg.norm(scatter * slope) / (slope @ slope))
    by_filter = time_constant_s(FILTER_S * (1.0 + ANTI_ALIAS_TOLERANCE)) - seconds
    return TimeConstant(seconds, noise, float(np.hypot(noise, by_filter)))


def _increments(lag_s: float, filter_s: float, lags: int, rate: float) -> Array:
    """Return the increment of the filtered current in each interval after a step, shape (lags,), with the sum 1."""
    ends = step_response(np.arange(lags + 1) / rate, lag_s, filter_s)
    increments = np.diff(ends)
    return np.asarray(increments / increments.sum())


def step_response(time_s: Array, lag_s: float, filter_s: float) -> Array:
    """Return the response of two first-order lags in series to a unit step at 0 s."""
    if abs(lag_s - filter_s) < 1e-3 * filter_s:
        lag_s = filter_s * 1.001
    return np.asarray(
        1.0 - (lag_s * np.exp(-time_s / lag_s) - filter_s * np.exp(-time_s / filter_s)) / (lag_s - filter_s)
    )


def held_equivalent(lag_s: float, filter_s: float, lags: int, rate: float) -> Array:
    """Return weights (lags + 2,) of the voltages, from one sample ahead to ``lags`` back, for an equivalent held
    current.

    Held over each interval, it acts on a slow system like the real current, which changes within the interval: it has
    the same mean over the interval and, with the two neighbours, the same first moment.
    """
    nodes, weights = np.polynomial.legendre.leggauss(12)
    time = (np.arange(lags + 1)[:, None] + 0.5 + 0.5 * nodes) / rate  # (intervals, nodes)
    risen = step_response(time, lag_s, filter_s)
    mean, moment = 0.5 * risen @ weights, 0.5 * risen @ (0.5 * nodes * weights)
    moment = np.concatenate([[0.0, 0.0], moment, [0.0]])  # from one interval before the neighbour of the step
    level = np.concatenate([[0.0], mean]) + 0.5 * (moment[:-2] - moment[2:])
    return np.diff(level, prepend=0.0)


STENCIL_S = 0.5e-3
"""Spacing of the positions for a derivative, s: a compromise between noise and resolution."""
_RESPONSE_S = 1.5e-3
"""Duration of the step response of the current, s."""
_ROUNDS = 3
"""Alternations between force constant and step response."""
_MIN_CONDUCTANCE = 1e-4
"""Minimum conductance of an intact coil, A/V."""
_MIN_ROWS = 400
"""Minimum number of samples of a test whose neighbours were also received."""


@dataclass(frozen=True, eq=False)
class FluxFit:
    """Result of the electrical fit.

    ``coefficients`` (p,) of the basis are the force constant, N/A, with ``covariance`` (p, p). ``resistance_ohm`` has
    one value per test. Readings belong to the end of the interval in which a command was held; ``mean_currents`` are,
    for each test, the readings (n,) converted to the mean over that interval, and ``modelled_currents`` the noise-free
    currents of the fitted equation.
    """

    basis: SplineBasis
    coefficients: Array
    covariance: Array
    resistance_ohm: tuple[Estimate, ...]
    lag: TimeConstant
    inductance_h: Estimate
    noise_a: float
    mean_currents: tuple[Array, ...]
    modelled_currents: tuple[Array, ...]


@dataclass(frozen=True, eq=False)
class _RegressionPart:
    """One test in the regression: complete rows, the output, and both kinds of regressors."""

    rows: Array
    current: Array
    drive: Array  # (rows, lags + 1): voltages and one for the offset
    velocity: Array  # (rows, splines): d/dt of each spline's integral at t[n]
    acceleration: Array  # (rows, splines): its second derivative


def fit_flux(tests: Sequence[SweepTest], basis: SplineBasis) -> FluxFit:
    """Fit resistance, inductance and force constant to all tests at once.

    Raises:
        UnusableInputError: too many samples are missing, or the current does not follow the voltage.
    """
    parts = [_regression_part(test, basis) for test in tests]
    lag, resistance = TimeConstant(0.0, 0.0, 0.0), np.array([_resistance(part, part.current) for part in parts])
    coefficients = np.zeros(basis.size)
    for _ in range(_ROUNDS):
        coefficients = solve_least_squares(*_without_drive(parts, resistance, lag.seconds), basis)[0]
        rests = [
            part.current + (part.velocity - lag.seconds * part.acceleration) @ coefficients / r
            for part, r in zip(parts, resistance, strict=True)
        ]
        responses = [_drive_response(part, rest) for part, rest in zip(parts, rests, strict=True)]
        resistance = np.array([_resistance_from_response(answer) for answer in responses])
        lag = fit_time_constant([answer[:-1] for answer in responses], tests[0].sample_rate_hz)
    design, target = _without_drive(parts, resistance, lag.seconds)
    coefficients, inverse = solve_least_squares(design, target, basis)
    residual = target - design @ coefficients
    noise = float(np.std(residual))
    spread = [
        _resistance_std(part, coefficients, lag.seconds, noise, r) for part, r in zip(parts, resistance, strict=True)
    ]
    currents = [_currents(test, basis, coefficients, r, lag.seconds) for test, r in zip(tests, resistance, strict=True)]
    mean_resistance = float(np.mean(resistance))
    return FluxFit(
        basis=basis,
        coefficients=coefficients,
        covariance=solution_covariance((design @ inverse) * residual[:, None], residual, tests[0].sample_rate_hz),
        resistance_ohm=tuple(Estimate(float(r), float(s)) for r, s in zip(resistance, spread, strict=True)),
        lag=lag,
        inductance_h=Estimate(lag.seconds * mean_resistance, lag.std_s * mean_resistance),
        noise_a=noise,
        mean_currents=tuple(mean for mean, _ in currents),
        modelled_currents=tuple(modelled for _, modelled in currents),
    )


def _regression_part(test: SweepTest, basis: SplineBasis) -> _RegressionPart:
    rate = test.sample_rate_hz
    lags = max(3, round(_RESPONSE_S * rate))
    held = without_filter(test.voltage, rate)
    voltages = [_shifted(held, lag) for lag in range(lags)]
    velocity, acceleration = _derivatives(basis.integrals(test.position), rate)
    drive = np.stack([*voltages, np.ones(test.voltage.size)], axis=1)
    whole = np.isfinite(drive).all(axis=1) & np.isfinite(velocity).all(axis=1) & np.isfinite(test.current)
    rows = np.flatnonzero(whole)
    if rows.size < _MIN_ROWS:
        raise UnusableInputError(
            "sweep.many_lost", "too many samples of a test were lost: check the cable and repeat the sweep"
        )
    return _RegressionPart(rows.astype(np.float64), test.current[rows], drive[rows], velocity[rows], acceleration[rows])


def _shifted(values: Array, lag: int) -> Array:
    """Return values (n,) delayed by ``lag`` samples; NaN where there are none."""
    if lag < 0:
        return np.concatenate([values[-lag:], np.full(-lag, np.nan)])
    return np.concatenate([np.full(lag, np.nan), values[: values.size - lag]])


def _derivatives(values: Array, rate: float) -> tuple[Array, Array]:
    """Return first and second time derivative of columns (n, p), by five rows ``STENCIL_S`` apart; NaN at the ends."""
    stride = max(1, round(STENCIL_S * rate))
    step = stride / rate
    first, second = np.full_like(values, np.nan), np.full_like(values, np.nan)
    inner = slice(2 * stride, values.shape[0] - 2 * stride)
    at = [values[2 * stride + k * stride : values.shape[0] - 2 * stride + k * stride] for k in (-2, -1, 0, 1, 2)]
    first[inner] = (at[0] - 8.0 * at[1] + 8.0 * at[3] - at[4]) / (12.0 * step)
    second[inner] = (-at[0] + 16.0 * at[1] - 30.0 * at[2] + 16.0 * at[3] - at[4]) / (12.0 * step**2)
    return first, second


def _drive_response(part: _RegressionPart, current: Array) -> Array:
    """Return the response of the current to present and past voltages, A/V, and the offset, A: shape (lags + 1,)."""
    return np.asarray(np.linalg.lstsq(part.drive, current, rcond=1e-12)[0])


def _resistance_std(part: _RegressionPart, coefficients: Array, lag: float, noise: float, resistance: float) -> float:
    """Return the standard deviation of the resistance of a test, ohm, with motion as an additional regressor."""
    moving = (part.velocity - lag * part.acceleration) @ coefficients
    inverse = np.linalg.pinv(_gram(np.column_stack([part.drive, moving])))
    voltages = part.drive.shape[1] - 1
    return float(noise * resistance**2 * np.sqrt(inverse[:voltages, :voltages].sum()))


def _gram(columns: Array) -> Array:
    return np.asarray(columns.T @ columns)


def _resistance(part: _RegressionPart, current: Array) -> float:
    return _resistance_from_response(_drive_response(part, current))


def _resistance_from_response(answer: Array) -> float:
    """Return the resistance from a response (lags + 1,), whose last element is the offset.

    Raises:
        UnusableInputError: the current is inverted or does not follow the voltage.
    """
    conductance = float(answer[:-1].sum())
    if not conductance > _MIN_CONDUCTANCE:
        raise UnusableInputError(
            "sweep.conductance",
            "the current changes by {current:.2g} A per volt: check that the coil is connected and the current "
            "channel is not inverted",
            current=conductance,
        )
    return 1.0 / conductance


def _without_drive(parts: Sequence[_RegressionPart], resistance: Array, lag: float) -> tuple[Array, Array]:
    """Return the effect of motion on the current by spline, and the current, both orthogonal to the voltages.

    The coefficients of the splines are unchanged (Frisch-Waugh theorem), without the responses of all tests as
    unknowns.
    """
    columns, explained = [], []
    for part, r in zip(parts, resistance, strict=True):
        moving = -(part.velocity - lag * part.acceleration) / r
        orthogonal, _ = np.linalg.qr(part.drive)
        columns.append(moving - orthogonal @ (orthogonal.T @ moving))
        explained.append(part.current - orthogonal @ (orthogonal.T @ part.current))
    return np.concatenate(columns), np.concatenate(explained)


def _currents(
    test: SweepTest, basis: SplineBasis, coefficients: Array, resistance: float, lag: float
) -> tuple[Array, Array]:
    """Return the mean current over the interval before each reading, shape (n,): measured, and modelled.

    The response to the held voltage is known exactly at the end of an interval and as its mean; the response to the
    motion is smooth.
    """
    rate = test.sample_rate_hz
    lags = max(3, round(_RESPONSE_S * rate))
    at_end = np.diff(step_response(np.arange(lags + 1) / rate, lag, FILTER_S))
    held = held_equivalent(lag, FILTER_S, lags, rate)
    voltages = np.stack([_shifted(without_filter(test.voltage, rate), m) for m in range(-1, lags + 1)], axis=1)
    velocity, acceleration = (part @ coefficients for part in _derivatives(basis.integrals(test.position), rate))
    half = 0.5 / rate
    mean = test.current + (voltages @ held - voltages[:, 1:-1] @ at_end + half * acceleration) / resistance
    modelled = (voltages @ held - velocity + (lag + half) * acceleration) / resistance
    offset = float(np.nanmean(mean - modelled))
    return mean, modelled + offset
