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
from tissueid.identification.depth_profile import DepthProfile
from tissueid.identification.dpn.curves import LogCurves
from tissueid.identification.dpn.simulation import MOST_STEPS, NO_OWNERS, NO_SLOPES, integrate, intersample
from tissueid.identification.impulse_response import dependence_samples, long_run_covariance
from tissueid.identification.preparation import finite_runs
from tissueid.identification.second_order import Hold
from tissueid.records import Estimate, Record

NORMAL_95 = 1.959964
PROFILE_ROWS = 41
_CENTRAL = 0.98
"""Share of the samples within the positions of a profile; there are few samples outside."""


def estimate(value: float, std: float) -> Estimate:
    """Return an estimate whose deviation is None where it is not finite."""
    return Estimate(value, std if np.isfinite(std) else None)


@dataclass(frozen=True, eq=False)
class CurveBand:
    """A curve at k positions with its pointwise 95 % band; all of shape (k,), in the unit of the curve."""

    position: Array
    value: Array
    std: Array
    low: Array
    high: Array


@dataclass(frozen=True, eq=False)
class EstimatedCurves:
    """Fitted curves with the covariance (p, p) of their coefficients, and the positions (m,) of the fitted samples.

    ``speed`` (m,) is the simulated speed at those samples, m/s. The covariance is NaN if it is unknown.
    """

    curves: LogCurves
    covariance: Array
    position: Array
    speed: Array

    def mass(self, position: Array | float) -> CurveBand:
        """Return M(y) at positions (k,), kg."""
        position = _as_positions(position)
        return self._band("mass", self.curves.masses(position), position)

    def damping(self, position: Array | float, direction: int = 0) -> CurveBand:
        """Return B(y) at positions (k,), N s/m, for fast indentation (1) or retraction (-1), or their mean (0)."""
        position = _as_positions(position)
        curves = self.curves
        basis = curves.basis(position, max(curves.damping.size, curves.direction.size))
        slopes = np.zeros((position.size, curves.theta.size))
        slopes[:, curves.places["damping"]] = basis[:, : curves.damping.size]
        slopes[:, curves.places["direction"]] = direction * basis[:, : curves.direction.size]
        turned = basis[:, : curves.direction.size] @ curves.direction
        return self._logarithmic(curves.dampings(position) * np.exp(direction * turned), slopes, position)

    def stiffness(self, position: Array | float) -> CurveBand:
        """Return the tangent stiffness dF/dy at positions (k,), N/m, as a small-signal test there would measure it."""
        position = _as_positions(position)
        return self._band("stiffness", self.curves.stiffnesses(position), position)

    def force(self, position: Array | float) -> CurveBand:
        """Return F(y) at positions (k,), N."""
        position = _as_positions(position)
        slopes = self.curves.force_slopes(position)
        std = self._std(slopes)
        value = self.curves.forces(position)
        return CurveBand(position, value, std, value - NORMAL_95 * std, value + NORMAL_95 * std)

    def secant(self, position: Array | float, surface: float) -> CurveBand:
        """Return K(y) of Eq. 3.33 at positions (k,), N/m: force divided by the depth below a known surface (m).

        NaN at the surface and above it; negative for adhesive tissue that pulls the probe in.
        """
        position = _as_positions(position)
        depth = np.where(position > surface, position - surface, np.nan)
        force = self.force(position)
        return CurveBand(position, force.value / depth, force.std / depth, force.low / depth, force.high / depth)

    def growth(self, name: str, position: float) -> Estimate:
        """Return the derivative of the logarithm of a curve with respect to position, 1/m: A1 to A3 of Chen 2010,
        C.1.4, if D = 0.
        """
        series = getattr(self.curves, name)
        slopes = np.zeros((1, self.curves.theta.size))
        slopes[:, self.curves.places[name]] = self.curves.growths(np.array([position]), series.size)
        return estimate(float(slopes[0] @ self.curves.theta), float(self._std(slopes)[0]))

    def changes(self, low: float, high: float) -> tuple[Array, Array]:
        """Return the changes (3,) of log M, log B, log K from ``low`` to ``high``, and their covariance (3, 3)."""
        slopes = self._log_slopes(np.array([high])) - self._log_slopes(np.array([low]))  # (3, 1, p)
        rows = slopes[:, 0]
        return rows @ self.curves.theta, rows @ self.covariance @ rows.T

    def log_covariance(self, position: float) -> Array:
        """Return the covariance (3, 3) of log M, log B and log K at a position, m."""
        rows = self._log_slopes(np.array([position]))[:, 0]
        return np.asarray(rows @ self.covariance @ rows.T, dtype=np.float64)

    def combined_std(self, position: float, powers: tuple[float, float, float]) -> float:
        """Return the standard deviation of the logarithm of a product of powers of M, B and K at a position."""
        slopes = np.array(powers) @ self._log_slopes(np.array([position]))[:, 0]
        return float(self._std(slopes[None, :])[0])

    def _log_slopes(self, position: Array) -> Array:
        """Return the derivatives of log M, log B and log K at positions (k,) with respect to the coefficients, shape
        (3, k, p).
        """
        slopes = np.zeros((3, position.size, self.curves.theta.size))
        for row, name in enumerate(("mass", "damping", "stiffness")):
            series = getattr(self.curves, name)
            slopes[row][:, self.curves.places[name]] = self.curves.basis(position, series.size)
        return slopes

    def central(self) -> tuple[float, float]:
        """Return the positions between which the central 98 % of the samples lie, m."""
        low, high = np.quantile(self.position, [0.5 - _CENTRAL / 2.0, 0.5 + _CENTRAL / 2.0])
        return float(low), float(high)

    def profile(self) -> DepthProfile:
        """Return the curves at equal steps over the central 98 % of the visited positions, for each direction if they
        differ.

        The support of a row is the number of samples nearest to it that move in its direction.
        """
        low, high = self.central()
        position = np.linspace(low, high, PROFILE_ROWS)
        half = 0.5 * (high - low) / (PROFILE_ROWS - 1)
        edges = np.concatenate([position - half, [high + half]])
        mass, stiffness = self.mass(position), self.stiffness(position)
        parts = []
        for way in (1, -1) if self.curves.direction.size else (0,):
            moving = self.position[np.sign(self.speed) == way] if way else self.position
            parts.append((way, self.damping(position, way), np.histogram(moving, edges)[0]))
        times = len(parts)
        return DepthProfile(
            position=np.tile(position, times),
            low=np.tile(position - half, times),
            high=np.tile(position + half, times),
            direction=np.repeat(np.array([way for way, _, _ in parts]), PROFILE_ROWS),
            mass=np.tile(mass.value, times),
            mass_std=np.tile(mass.std, times),
            damping=np.concatenate([damping.value for _, damping, _ in parts]),
            damping_std=np.concatenate([damping.std for _, damping, _ in parts]),
            stiffness=np.tile(stiffness.value, times),
            stiffness_std=np.tile(stiffness.std, times),
            support=np.concatenate([support for _, _, support in parts]),
        )

    def _band(self, name: str, value: Array, position: Array) -> CurveBand:
        series = getattr(self.curves, name)
        slopes = np.zeros((position.size, self.curves.theta.size))
        slopes[:, self.curves.places[name]] = self.curves.basis(position, series.size)
        return self._logarithmic(value, slopes, position)

    def _logarithmic(self, value: Array, slopes: Array, position: Array) -> CurveBand:
        """Return the band of a positive curve from the derivatives (k, p) of its logarithm."""
        std = self._std(slopes)
        factor = np.exp(np.minimum(NORMAL_95 * std, 300.0))
        return CurveBand(position, value, value * std, value / factor, value * factor)

    def _std(self, slopes: Array) -> Array:
        variance = np.einsum("ij,jk,ik->i", slopes, self.covariance, slopes)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)), dtype=np.float64)


def _as_positions(position: Array | float) -> Array:
    return np.atleast_1d(np.asarray(position, dtype=np.float64))


def coefficient_covariance(data: DpnData, fitted: FittedDpn) -> Array:
    """Return the covariance (p, p) of the coefficients; NaN if the fit did not converge.

    Sandwich estimate for a model that need not be complete (White 1982), with autocorrelated errors and the weak prior.
    """
    here = fitted.evaluation
    n, p = here.slopes.shape
    if not fitted.converged or n <= p:
        return np.full((p, p), np.nan)
    weights = prior_weights(fitted.curves, here.rss, n)
    size = np.sqrt(np.sum(here.slopes**2, axis=0) + weights)
    size[size == 0.0] = 1.0
    directions = here.slopes / size
    inverse = np.linalg.pinv(directions.T @ directions + np.diag(weights / size**2), rcond=1e-14, hermitian=True)
    influence = (directions @ inverse) * here.error_projected[:, None]
    block = dependence_samples(here.error_projected, data.rate)
    held = inverse * (weights / size * PRIOR)
    covariance = long_run_covariance(influence, block) * n / (n - p) + held @ held.T
    return np.asarray(covariance / np.outer(size, size), dtype=np.float64)


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
    minimum = levenberg_marquardt.minimise(problem, start, most_steps=_ITERATIONS, tolerance=tolerance, damping=1e-4)
    return FittedDpn(minimum.point.curves, minimum.point.starts, minimum.point.evaluation, minimum.converged)


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


class _SimulationError(levenberg_marquardt.Problem[_Point]):
    """The squared simulation error by the coefficients of the curves, each with a weak prior at its centre.

    The prior is relative to the variance of the error, so that it multiplies the squared error.
    """

    def __init__(self, data: DpnData, centre: Array) -> None:
        self._data, self._centre = data, centre

    def point(self, curves: LogCurves, starts: list[Array]) -> _Point | None:
        """Evaluate curves and starting values; None where the simulation diverges."""
        evaluation = self._data.evaluate(curves, starts)
        if evaluation is None:
            return None
        weights = prior_weights(curves, evaluation.rss, evaluation.error.size)
        return _Point(curves, starts, evaluation, evaluation.rss + float(weights @ (curves.theta - self._centre) ** 2))

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
