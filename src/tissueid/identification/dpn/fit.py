"""Fit of the dynamic parameter nonlinearity by its simulation error.

Output-error method: the free run over each uninterrupted stretch of input is fitted to the measured position by
Gauss-Newton with damped steps (Levenberg 1944; Marquardt 1963); the initial state of every stretch is estimated too.
The fit starts from the linear system of :mod:`second_order_fit`, the best set of constant curves, and degrees are added
one by one if the record supports them; each fit starts from the one before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.identification import levenberg_marquardt
from tissueid.identification.base import Array
from tissueid.identification.dpn.curves import LogCurves
from tissueid.identification.dpn.simulation import MOST_STEPS, NO_OWNERS, NO_SLOPES, integrate, intersample
from tissueid.identification.preparation import finite_runs
from tissueid.identification.second_order import Hold
from tissueid.records import Record

_ITERATIONS = 30
TOLERANCE = 1e-7
"""Relative decrease of the cost below which a fit has converged."""

PRIOR = 3.0
"""Prior standard deviation of a coefficient of a logarithm.

It corresponds to a factor of 20: much wider than any uncertainty of a usable record, and narrow enough to keep
undetermined curves finite.
"""

_SHORTEST = 16
"""Shortest uninterrupted stretch that is fitted, samples: each has two unknown initial values."""


@dataclass(frozen=True, eq=False)
class _Run:
    """A stretch of received input, with the fitted outputs in it."""

    input: Array
    local: NDArray[np.intp]
    output: Array
    start: Array


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Errors (m,) of the free run and their derivatives (m, p), both after projecting out the initial states.

    ``rss`` is the squared error for the given initial states; ``error_projected`` (m,) and ``slopes`` are the projected
    errors and derivatives. ``starts`` gives, for each run, the change of its initial state due to the errors and per
    change of the coefficients: shapes (2,) and (2, p).
    """

    rss: float
    error: Array
    error_projected: Array
    slopes: Array
    starts: list[tuple[Array, Array]]


class DpnData:
    """A record prepared for repeated simulation and fitting."""

    def __init__(self, record: Record, part: slice, hold: Hold) -> None:
        self.rate = record.sample_rate_hz
        self.hold = hold
        self._pushes: dict[int, list[Array]] = {}
        inside = np.zeros(len(record), dtype=np.bool_)
        inside[part] = True
        self.runs: list[_Run] = []
        used: list[NDArray[np.intp]] = []
        for first, end in finite_runs(inside & np.isfinite(record.input)):
            local = np.flatnonzero(np.isfinite(record.output[first:end]))
            if local.size < _SHORTEST:
                continue
            start = _start(local, record.output[first:end][local], self.rate)
            self.runs.append(_Run(record.input[first:end], local, record.output[first:end][local], start))
            used.append(first + local)
        self.samples = np.concatenate(used) if used else np.zeros(0, dtype=np.intp)

    def starts(self) -> list[Array]:
        """Return the initial state of every run, estimated from its first outputs: position (m) and speed (m/s), (2,)
        each.
        """
        return [run.start for run in self.runs]

    def evaluate(self, curves: LogCurves, starts: list[Array]) -> Evaluation | None:
        """Simulate every run; return None if the curves cannot be integrated or the motion diverges."""
        tables = curves.tables
        steps = tables.steps(self.rate)
        if steps > MOST_STEPS:
            return None
        table, bounds, owner = tables.table(), tables.bounds(), curves.owner
        slopes = curves.slopes()
        errors, projected, sensitivities, changes = [], [], [], []
        for run, push, start in zip(self.runs, self._push(steps), starts, strict=True):
            position, _, sensitivity, done = integrate(tables, table, slopes, owner, push, self.rate, start, bounds)
            if done < run.input.size:
                return None
            error = run.output - position[run.local]
            errors.append(error)
            by_all = sensitivity[run.local]  # (m, p + 2)
            by_theta, by_start = by_all[:, :-2], by_all[:, -2:]
            scale = np.linalg.norm(by_start, axis=0)
            q, r = np.linalg.qr(by_start / scale)
            on_error, on_theta = q.T @ error, q.T @ by_theta
            inverse = np.linalg.pinv(r, rcond=1e-8) / scale[:, None]
            changes.append((inverse @ on_error, -inverse @ on_theta))
            projected.append(error - q @ on_error)
            sensitivities.append(by_theta - q @ on_theta)
        error = np.concatenate(errors)
        return Evaluation(float(error @ error), error, np.concatenate(projected), np.vstack(sensitivities), changes)

    def speeds(self, fitted: FittedDpn) -> Array:
        """Return the simulated speed at every fitted sample, m/s, shape (m,)."""
        tables = fitted.curves.tables
        table, bounds = tables.table(), tables.bounds()
        pushes = self._push(tables.steps(self.rate))
        parts = [
            integrate(tables, table, NO_SLOPES, NO_OWNERS, push, self.rate, start, bounds)[1][run.local]
            for run, push, start in zip(self.runs, pushes, fitted.starts, strict=True)
        ]
        return np.concatenate(parts)

    def _push(self, steps: int) -> list[Array]:
        if steps not in self._pushes:
            self._pushes = {steps: [intersample(run.input, steps, self.hold) for run in self.runs]}
        return self._pushes[steps]


@dataclass(frozen=True, eq=False)
class FittedDpn:
    """Curves with the least squared simulation error, the initial state of every run, and the derivatives at the
    solution.
    """

    curves: LogCurves
    starts: list[Array]
    evaluation: Evaluation
    converged: bool


def _start(local: NDArray[np.intp], output: Array, rate: float) -> Array:
    """Return the position and speed at the first sample of a run, from a parabola through its first outputs."""
    t = (local[:_SHORTEST]) / rate
    reach = float(t[-1]) or 1.0
    coefficients = np.linalg.lstsq(np.vander(t / reach, 3, increasing=True), output[:_SHORTEST], rcond=None)[0]
    return np.array([coefficients[0], coefficients[1] / reach])


def prior_weights(curves: LogCurves, rss: float, samples: int) -> Array:
    """Return the weight of the squared deviation of each coefficient from the prior mean, shape (p,)."""
    weights = np.full(curves.theta.size, rss / max(1, samples) / PRIOR**2)
    weights[curves.places["level"]] = 0.0
    return weights


def minimise(
    data: DpnData, curves: LogCurves, starts: list[Array], centre: Array, tolerance: float = TOLERANCE
) -> FittedDpn | None:
    """Return the curves of the same degrees with the least squared simulation error; None if the start diverges.

    Every coefficient has the prior mean ``centre`` (p,), see :data:`PRIOR`. The iteration ends when a step decreases
    the cost by less than the share ``tolerance``.
    """
    problem = _SimulationError(data, centre)
    start = problem.point(curves, starts)
    if start is None:
        return None
    found = levenberg_marquardt.minimise(problem, start, most_steps=_ITERATIONS, tolerance=tolerance, damping=1e-4)
    return FittedDpn(found.point.curves, found.point.starts, found.point.evaluation, found.converged)


@dataclass(frozen=True, eq=False)
class _Point:
    """Curves and starting values with their evaluation; ``cost`` includes the prior."""

    curves: LogCurves
    starts: list[Array]
    evaluation: Evaluation
    cost: float

    @property
    def theta(self) -> Array:
        return self.curves.theta


class _SimulationError:
    """The squared simulation error by the coefficients of the curves, each with a weak prior at its centre.

    The prior is relative to the variance of the error, so that it multiplies the squared error.
    """

    def __init__(self, data: DpnData, centre: Array) -> None:
        self._data, self._centre = data, centre

    def point(self, curves: LogCurves, starts: list[Array]) -> _Point | None:
        """Evaluate curves and starting values; None where the simulation diverges."""
        found = self._data.evaluate(curves, starts)
        if found is None:
            return None
        weights = prior_weights(curves, found.rss, found.error.size)
        return _Point(curves, starts, found, found.rss + float(weights @ (curves.theta - self._centre) ** 2))

    def linearised(self, at: _Point) -> tuple[Array, Array]:
        slopes = at.evaluation.slopes
        weights = prior_weights(at.curves, at.evaluation.rss, at.evaluation.error.size)
        descent = slopes.T @ at.evaluation.error_projected - weights * (at.theta - self._centre)
        return slopes.T @ slopes + np.diag(weights), descent

    def attempt(self, at: _Point, step: Array) -> _Point | None:
        starts = [
            s + by_error + by_theta @ step
            for s, (by_error, by_theta) in zip(at.starts, at.evaluation.starts, strict=True)
        ]
        return self.point(at.curves.with_theta(at.theta + step), starts)

    def refresh(self, _at: _Point) -> bool:
        return False
