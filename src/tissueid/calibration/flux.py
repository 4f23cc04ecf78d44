"""The electrical half of a sweep: resistance, inductance and force constant along the stroke, without any spring.

The voltage across the coil is R i + L di/dt + k(x) dx/dt; k(x) is the slope of the flux linkage Phi(x). Commands are
held between samples. Voltage and position, which are known almost without error, are put on one side, and the current,
which is noisy, is what is explained: a linear least squares without errors in its variables,

    i[n] = sum_m a[m] v[n - m] + i0 - (1 / R) d/dt Phi(x) at t[n] - L / R,      1 / R = sum_m a[m].

The a[m] are the samples of the answer of coil and anti-alias filter to a step, by which the inductance is known. Each
test has a zero of the current channel and, since the coil warms, a resistance of its own; k(x) is common.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tissueid.calibration.coil_answer import FILTER_S, Lag, find_lag, held_equivalent, step_answer, unfiltered
from tissueid.calibration.spline_basis import Array, SplineBasis
from tissueid.calibration.spline_regression import covariance_of, solved
from tissueid.calibration.sweep_test import SweepTest
from tissueid.errors import UnusableInputError
from tissueid.records import Estimate

STENCIL_S = 0.5e-3
"""Spacing of the positions that a derivative is taken from: nearer ones would add noise, farther ones blur."""
_MEMORY_S = 1.5e-3
"""After this long nothing is left of a step in the current."""
_ROUNDS = 3
_LEAST_CONDUCTANCE = 1e-4
"""A/V; with less than this the coil's wire is broken."""
_LEAST_ROWS = 400
"""Without so many samples whose neighbours were received a test tells too little of its coil."""


@dataclass(frozen=True, eq=False)
class FluxFit:
    """What the electrical equation says.

    ``coefficients`` (p,) of the basis are the force constant, N/A, with ``covariance`` (p, p). ``resistance_ohm`` has
    one value for each test. Readings stand for the end of the interval in which a command was held; ``mean_currents``
    are, for each test, the readings (n,) brought to the mean over that interval, and ``modelled_currents`` what the
    equation gives for them, which holds no noise.
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
    """One test in the regression: rows that are whole, what is explained, and the two kinds of regressors."""

    rows: Array
    current: Array
    drive: Array  # (rows, lags + 1): voltages and one for the offset
    velocity: Array  # (rows, splines): d/dt of each spline's integral at t[n]
    bend: Array  # (rows, splines): its second derivative


def fit_flux(tests: Sequence[SweepTest], basis: SplineBasis) -> FluxFit:
    """Fit resistance, inductance and force constant to all tests at once.

    Raises:
        UnusableInputError: too many samples are lacking, or the current does not follow the voltage.
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
        raise UnusableInputError("too many samples of a test were lost; check the link and repeat the sweep")
    return _Part(rows.astype(np.float64), test.current[rows], drive[rows], velocity[rows], bend[rows])


def _shifted(values: Array, lag: int) -> Array:
    """Values (n,) as they were ``lag`` samples before, NaN where nothing was."""
    if lag < 0:
        return np.concatenate([values[-lag:], np.full(-lag, np.nan)])
    return np.concatenate([np.full(lag, np.nan), values[: values.size - lag]])


def _derivatives(values: Array, rate: float) -> tuple[Array, Array]:
    """First and second derivative by time of columns (n, p), from five rows ``STENCIL_S`` apart; NaN at the ends."""
    stride = max(1, round(STENCIL_S * rate))
    step = stride / rate
    first, second = np.full_like(values, np.nan), np.full_like(values, np.nan)
    inner = slice(2 * stride, values.shape[0] - 2 * stride)
    at = [values[2 * stride + k * stride : values.shape[0] - 2 * stride + k * stride] for k in (-2, -1, 0, 1, 2)]
    first[inner] = (at[0] - 8.0 * at[1] + 8.0 * at[3] - at[4]) / (12.0 * step)
    second[inner] = (-at[0] + 16.0 * at[1] - 30.0 * at[2] + 16.0 * at[3] - at[4]) / (12.0 * step**2)
    return first, second


def _answer(part: _Part, current: Array) -> Array:
    """Answer of the current to voltages now and before, A/V, and the offset, A: shape (lags + 1,)."""
    return np.asarray(np.linalg.lstsq(part.drive, current, rcond=1e-12)[0])


def _spread(part: _Part, coefficients: Array, lag: float, noise: float, resistance: float) -> float:
    """Standard deviation of a test's resistance, ohm: that of the sum of its answers, with the motion beside them."""
    moving = (part.velocity - lag * part.bend) @ coefficients
    inverse = np.linalg.pinv(_gram(np.column_stack([part.drive, moving])))
    voltages = part.drive.shape[1] - 1
    return float(noise * resistance**2 * np.sqrt(inverse[:voltages, :voltages].sum()))


def _gram(columns: Array) -> Array:
    return np.asarray(columns.T @ columns)


def _resistance(part: _Part, current: Array) -> float:
    return _ohms(_answer(part, current))


def _ohms(answer: Array) -> float:
    """Resistance from an answer, shape (lags + 1,), the last of which is the offset.

    Raises:
        UnusableInputError: the current goes against the voltage, or hardly with it.
    """
    conductance = float(answer[:-1].sum())
    if not conductance > _LEAST_CONDUCTANCE:
        raise UnusableInputError(
            f"for each volt the current changes by {conductance:.2g} A: see that the coil is connected, and the "
            "current channel the right way round"
        )
    return 1.0 / conductance


def _separated(parts: Sequence[_Part], resistance: Array, lag: float) -> tuple[Array, Array]:
    """What motion does to the current, by spline, and the current; what the voltages explain is taken out of both.

    This leaves the solution as it is (Frisch and Waugh), and the answers of all tests out of it.
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
    """Mean current over the interval before each reading, shape (n,): by the reading, and by the equation.

    What follows the held voltage is known exactly at the end of an interval and over it; what follows the motion is
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
