"""The electrical half of a sweep: resistance, inductance and force constant, independent of the spring.

The voltage across the coil is R i + L di/dt + k(x) dx/dt; k(x) is the slope of the flux linkage Phi(x). Commands are
held between samples. Voltage and position, which are almost free of noise, are the regressors; the current, which is
noisy, is the output. So the least squares are linear and without errors in the variables,

    i[n] = sum_m a[m] v[n - m] + i0 - (1 / R) d/dt Phi(x) at t[n] - L / R,      1 / R = sum_m a[m].

The a[m] are the increments of the step response of coil and anti-alias filter, which give the inductance. Each test has
its own zero of the current channel and its own resistance, because the coil warms; k(x) is common.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import optimize

from tissueid.calibration.spline_basis import Array, SplineBasis, covariance_of, solved
from tissueid.calibration.sweep_test import SweepTest
from tissueid.errors import UnusableInputError
from tissueid.messages import Message
from tissueid.records import Estimate

ANTI_ALIAS_HZ = 2000.0
"""Cut-off of the first-order filters before all converters, Hz (Chen 2010, 2.3)."""
ANTI_ALIAS_TOLERANCE = 0.05
"""Relative standard deviation of that cut-off: capacitors of 5 %."""
FILTER_S = 1.0 / (2.0 * np.pi * ANTI_ALIAS_HZ)
"""Time constant of the filters, s."""
_LAG_S = (5e-6, 1e-3)
"""Shortest and longest L / R, s."""


@dataclass(frozen=True)
class Lag:
    """L / R, s, with its standard deviation by noise alone, and including the tolerance of the filters."""

    seconds: float
    noise_s: float
    std_s: float


def unfiltered(readings: Array, rate: float) -> Array:
    """Return the voltage held over each interval, shape (n,), from filtered readings at their ends.

    NaN where the reading or the one before it was not received.
    """
    left = float(np.exp(-1.0 / (rate * FILTER_S)))  # of a step, after one interval
    before = np.concatenate([[np.nan], readings[:-1]])
    return np.asarray((readings - left * before) / (1.0 - left))


def find_lag(answers: Sequence[Array], rate: float) -> Lag:
    """Return L / R from the mean step response of the current of all tests, (lags,) each."""
    steps = np.array([answer / answer.sum() for answer in answers])  # (tests, lags)
    mean, lags = steps.mean(axis=0), steps.shape[1]

    def found(filter_s: float) -> float:
        def miss(lag: float) -> float:
            return float(np.sum((mean - _increments(lag, filter_s, lags, rate)) ** 2))

        return float(optimize.minimize_scalar(miss, bounds=_LAG_S, method="bounded", options={"xatol": 1e-9}).x)

    seconds, shift = found(FILTER_S), 1e-6
    slope = (_increments(seconds + shift, FILTER_S, lags, rate) - _increments(seconds, FILTER_S, lags, rate)) / shift
    scatter = steps.std(axis=0, ddof=1) / np.sqrt(len(steps)) if len(steps) > 1 else np.zeros(lags)
    noise = float(np.linalg.norm(scatter * slope) / (slope @ slope))
    by_filter = found(FILTER_S * (1.0 + ANTI_ALIAS_TOLERANCE)) - seconds
    return Lag(seconds, noise, float(np.hypot(noise, by_filter)))


def _increments(lag_s: float, filter_s: float, lags: int, rate: float) -> Array:
    """Return the increment of the filtered current in each interval after a step, shape (lags,), with the sum 1."""
    ends = step_answer(np.arange(lags + 1) / rate, lag_s, filter_s)
    increments = np.diff(ends)
    return np.asarray(increments / increments.sum())


def step_answer(time_s: Array, lag_s: float, filter_s: float) -> Array:
    """Return the response of two lags in series to a unit step at 0 s."""
    if abs(lag_s - filter_s) < 1e-3 * filter_s:
        lag_s = filter_s * 1.001
    return np.asarray(
        1.0 - (lag_s * np.exp(-time_s / lag_s) - filter_s * np.exp(-time_s / filter_s)) / (lag_s - filter_s)
    )


def held_equivalent(lag_s: float, filter_s: float, lags: int, rate: float) -> Array:
    """Return weights (lags + 2,) of the voltages from one sample ahead to ``lags`` back for an equivalent current.

    Held over each interval, that current acts on a slow system as the real one does, which changes within the interval:
    it has the same mean over the interval, and the same first moment by the two neighbours.
    """
    nodes, weights = np.polynomial.legendre.leggauss(12)
    time = (np.arange(lags + 1)[:, None] + 0.5 + 0.5 * nodes) / rate  # (intervals, nodes)
    risen = step_answer(time, lag_s, filter_s)
    mean, moment = 0.5 * risen @ weights, 0.5 * risen @ (0.5 * nodes * weights)
    moment = np.concatenate([[0.0, 0.0], moment, [0.0]])  # from one interval before the neighbour of the step
    level = np.concatenate([[0.0], mean]) + 0.5 * (moment[:-2] - moment[2:])
    return np.diff(level, prepend=0.0)


STENCIL_S = 0.5e-3
"""Spacing of the positions for a derivative, s: a compromise of noise and resolution."""
_MEMORY_S = 1.5e-3
"""Duration of the step response of the current, s."""
_ROUNDS = 3
"""Alternations between force constant and step response."""
_LEAST_CONDUCTANCE = 1e-4
"""Least conductance of a coil that is not broken, A/V."""
_LEAST_ROWS = 400
"""Least number of samples of a test whose neighbours were received as well."""


@dataclass(frozen=True, eq=False)
class FluxFit:
    """Result of the electrical equation.

    ``coefficients`` (p,) of the basis are the force constant, N/A, with ``covariance`` (p, p). ``resistance_ohm`` has
    one value for each test. Readings belong to the end of the interval in which a command was held; ``mean_currents``
    are, for each test, the readings (n,) converted to the mean over that interval, and ``modelled_currents`` the same
    currents by the equation, without noise.
    """

    basis: SplineBasis
    coefficients: Array
    covariance: Array
    resistance_ohm: tuple[Estimate, ...]
    lag: Lag
    inductance_h: Estimate
    noise_a: float
    mean_currents: tuple[Array, ...]
    modelled_currents: tuple[Array, ...]


@dataclass(frozen=True, eq=False)
class _Part:
    """One test in the regression: complete rows, the output, and both kinds of regressors."""

    rows: Array
    current: Array
    drive: Array  # (rows, lags + 1): voltages and one for the offset
    velocity: Array  # (rows, splines): d/dt of each spline's integral at t[n]
    bend: Array  # (rows, splines): its second derivative


def fit_flux(tests: Sequence[SweepTest], basis: SplineBasis) -> FluxFit:
    """Fit resistance, inductance and force constant to all tests at once.

    Raises:
        UnusableInputError: too many samples are missing, or the current does not follow the voltage.
    """
    parts = [_part(test, basis) for test in tests]
    lag, resistance = Lag(0.0, 0.0, 0.0), np.array([_resistance(part, part.current) for part in parts])
    coefficients = np.zeros(basis.size)
    for _ in range(_ROUNDS):
        coefficients = solved(*_separated(parts, resistance, lag.seconds), basis)[0]
        rests = [
            part.current + (part.velocity - lag.seconds * part.bend) @ coefficients / r
            for part, r in zip(parts, resistance, strict=True)
        ]
        answers = [_answer(part, rest) for part, rest in zip(parts, rests, strict=True)]
        resistance = np.array([_ohms(answer) for answer in answers])
        lag = find_lag([answer[:-1] for answer in answers], tests[0].sample_rate_hz)
    design, target = _separated(parts, resistance, lag.seconds)
    coefficients, inverse = solved(design, target, basis)
    residual = target - design @ coefficients
    noise = float(np.std(residual))
    spread = [_spread(part, coefficients, lag.seconds, noise, r) for part, r in zip(parts, resistance, strict=True)]
    currents = [_currents(test, basis, coefficients, r, lag.seconds) for test, r in zip(tests, resistance, strict=True)]
    mean_resistance = float(np.mean(resistance))
    return FluxFit(
        basis=basis,
        coefficients=coefficients,
        covariance=covariance_of((design @ inverse) * residual[:, None], residual, tests[0].sample_rate_hz),
        resistance_ohm=tuple(Estimate(float(r), float(s)) for r, s in zip(resistance, spread, strict=True)),
        lag=lag,
        inductance_h=Estimate(lag.seconds * mean_resistance, lag.std_s * mean_resistance),
        noise_a=noise,
        mean_currents=tuple(mean for mean, _ in currents),
        modelled_currents=tuple(modelled for _, modelled in currents),
    )


def _part(test: SweepTest, basis: SplineBasis) -> _Part:
    rate = test.sample_rate_hz
    lags = max(3, round(_MEMORY_S * rate))
    held = unfiltered(test.voltage, rate)
    voltages = [_shifted(held, lag) for lag in range(lags)]
    velocity, bend = _derivatives(basis.integrals(test.position), rate)
    drive = np.stack([*voltages, np.ones(test.voltage.size)], axis=1)
    whole = np.isfinite(drive).all(axis=1) & np.isfinite(velocity).all(axis=1) & np.isfinite(test.current)
    rows = np.flatnonzero(whole)
    if rows.size < _LEAST_ROWS:
        raise UnusableInputError(
            Message("sweep.many_lost", "too many samples of a test were lost: check the cable and repeat the sweep")
        )
    return _Part(rows.astype(np.float64), test.current[rows], drive[rows], velocity[rows], bend[rows])


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


def _answer(part: _Part, current: Array) -> Array:
    """Return the response of the current to present and past voltages, A/V, and the offset, A: shape (lags + 1,)."""
    return np.asarray(np.linalg.lstsq(part.drive, current, rcond=1e-12)[0])


def _spread(part: _Part, coefficients: Array, lag: float, noise: float, resistance: float) -> float:
    """Return the standard deviation of the resistance of a test, ohm, with the motion as a further regressor."""
    moving = (part.velocity - lag * part.bend) @ coefficients
    inverse = np.linalg.pinv(_gram(np.column_stack([part.drive, moving])))
    voltages = part.drive.shape[1] - 1
    return float(noise * resistance**2 * np.sqrt(inverse[:voltages, :voltages].sum()))


def _gram(columns: Array) -> Array:
    return np.asarray(columns.T @ columns)


def _resistance(part: _Part, current: Array) -> float:
    return _ohms(_answer(part, current))


def _ohms(answer: Array) -> float:
    """Return the resistance for a response (lags + 1,), the last element of which is the offset.

    Raises:
        UnusableInputError: the current is inverted or does not follow the voltage.
    """
    conductance = float(answer[:-1].sum())
    if not conductance > _LEAST_CONDUCTANCE:
        raise UnusableInputError(
            Message(
                "sweep.conductance",
                "the current changes by {current:.2g} A per volt: check that the coil is connected and the current "
                "channel is not inverted",
                current=conductance,
            )
        )
    return 1.0 / conductance


def _separated(parts: Sequence[_Part], resistance: Array, lag: float) -> tuple[Array, Array]:
    """Return the effect of motion on the current by spline, and the current, both orthogonal to the voltages.

    The solution for the splines is unchanged (Frisch and Waugh), without the responses of all tests as unknowns.
    """
    columns, explained = [], []
    for part, r in zip(parts, resistance, strict=True):
        moving = -(part.velocity - lag * part.bend) / r
        orthogonal, _ = np.linalg.qr(part.drive)
        columns.append(moving - orthogonal @ (orthogonal.T @ moving))
        explained.append(part.current - orthogonal @ (orthogonal.T @ part.current))
    return np.concatenate(columns), np.concatenate(explained)


def _currents(
    test: SweepTest, basis: SplineBasis, coefficients: Array, resistance: float, lag: float
) -> tuple[Array, Array]:
    """Return the mean current over the interval before each reading, shape (n,): by the reading, and by the equation.

    The response to the held voltage is known exactly at the end of an interval and as its mean; that to the motion is
    smooth.
    """
    rate = test.sample_rate_hz
    lags = max(3, round(_MEMORY_S * rate))
    at_end = np.diff(step_answer(np.arange(lags + 1) / rate, lag, FILTER_S))
    held = held_equivalent(lag, FILTER_S, lags, rate)
    voltages = np.stack([_shifted(unfiltered(test.voltage, rate), m) for m in range(-1, lags + 1)], axis=1)
    velocity, bend = (part @ coefficients for part in _derivatives(basis.integrals(test.position), rate))
    half = 0.5 / rate
    mean = test.current + (voltages @ held - voltages[:, 1:-1] @ at_end + half * bend) / resistance
    modelled = (voltages @ held - velocity + (lag + half) * bend) / resistance
    offset = float(np.nanmean(mean - modelled))
    return mean, modelled + offset
