"""Fitting the chain to all signals of all tests at once: bounded least squares with priors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tissueid.gap.observed import Observed, ObservedTest, Purpose
from tissueid.gap.parameters import Parametrisation, parametrise
from tissueid.twin.effect import Effect
from tissueid.twin.simulation import Start, simulate

FloatArray = NDArray[np.float64]
Predictions = list[dict[str, FloatArray]]

STEP_S = 1.25e-4
"""Longest integration step: at 2 kHz four in a sample."""
MOST_STEPS = 40
TOLERANCE = 1e-4
"""A step that lowers the cost by less than this share of it is the last."""
WORST = 1e6
"""Residuals are held below so many noise deviations, so that a simulation that ran away still has a cost."""


def predict(parameters: Parametrisation, theta: FloatArray, tests: Sequence[ObservedTest] | None = None) -> Predictions:
    """What the twin of a vector predicts for each test, channel by channel, from the command alone."""
    instrument = parameters.instrument(theta)
    found = []
    for test in parameters.observed.tests if tests is None else tests:
        substeps = max(1, int(np.ceil(1.0 / (test.sample_rate_hz * STEP_S))))
        result = simulate(
            test.command,
            test.sample_rate_hz,
            instrument,
            parameters.met(theta, test),
            starting_point(test, instrument.resistance_ohm),
            parameters.acting(theta, test),
            on_tissue=test.fixture == "tissue",
            substeps=substeps,
        ).readings
        found.append({name: getattr(result, name) for name in parameters.observed.channels})
    return found


def starting_point(test: ObservedTest, resistance_ohm: float) -> Start:
    """Where a test starts: at rest at the surface, unless its first readings lie elsewhere."""
    position = test.signals["position"]
    first = position[np.isfinite(position)][:3]
    at = float(np.median(first)) if first.size else test.surface_m
    if abs(at - test.surface_m) < 1e-4:
        at = test.surface_m
    return Start(float(test.command[0]) / resistance_ohm, at, 0.0)


@dataclass(frozen=True)
class Fit:
    """A fitted twin: where it lies, its cost, and what it predicts for each test."""

    parameters: Parametrisation = field(repr=False)
    theta: FloatArray
    cost: float
    """Sum of squares of residuals in noise deviations on the fitted samples, with the priors."""
    predictions: Predictions = field(repr=False)
    residuals: FloatArray = field(repr=False)
    """On the fitted samples, in noise deviations, test by test and channel by channel."""
    jacobian: FloatArray = field(repr=False)
    steps: int

    def value(self, name: str) -> float:
        """A coordinate by its name, as it is fitted."""
        return float(self.theta[self.parameters.index[name]])


class Cancelled(Exception):  # noqa: N818 - a signal to stop, not an error that a user meets
    """The work was cancelled."""


def fit(
    observed: Observed,
    effects: Sequence[Effect] = (),
    starts: Sequence[int] = (),
    *,
    near: Fit | None = None,
    most_steps: int = MOST_STEPS,
    cancelled: Callable[[], bool] = lambda: False,
) -> Fit:
    """Fit baseline and effects together to the samples that serve the fit.

    Args:
        observed: the tests.
        effects: candidates to add to the baseline.
        starts: which starting point of each.
        near: another fit whose common coordinates are where this one starts.
        most_steps: most accepted steps.
        cancelled: asked now and then; True stops with ``Cancelled``.
    """
    parameters = parametrise(observed, effects, starts)
    theta = parameters.array("start")
    if near is not None:
        for k, item in enumerate(parameters.coordinates):
            if item.name in near.parameters.index:
                theta[k] = near.value(item.name)
    low, high = parameters.array("low"), parameters.array("high")
    theta = np.clip(theta, low, high)
    return _Search(parameters, low, high, cancelled).run(theta, near, most_steps)


def differences(baseline: Fit, effect: Effect, start: int) -> FloatArray:
    """By how much an effect at a starting point changes the residuals of a fit, shape as ``Fit.residuals``."""
    effects = [*baseline.parameters.effects, effect]
    starts = [0] * len(baseline.parameters.effects) + [start]
    parameters = parametrise(baseline.parameters.observed, effects, starts)
    theta = parameters.array("start")
    for name, k in baseline.parameters.index.items():
        theta[parameters.index[name]] = baseline.theta[k]
    search = _Search(parameters, parameters.array("low"), parameters.array("high"), lambda: False)
    return search.residuals(theta)[0] - baseline.residuals


class _Search:
    """Levenberg-Marquardt steps within bounds; the Jacobian is renewed by secants while that serves."""

    def __init__(
        self, parameters: Parametrisation, low: FloatArray, high: FloatArray, cancelled: Callable[[], bool]
    ) -> None:
        self._parameters = parameters
        self._low, self._high = low, high
        self._cancelled = cancelled
        self._steps = parameters.array("step")
        self._reach = parameters.array("reach")
        self._prior, self._std = parameters.array("prior"), parameters.array("prior_std")
        observed = parameters.observed
        self._tests = observed.tests
        self._channels = observed.channels
        self._weights = {name: 1.0 / max(observed.noise.get(name, 0.0), _least(name)) for name in self._channels}
        self._masks = [
            {name: test.serving(Purpose.FIT) & np.isfinite(test.signals[name]) for name in self._channels}
            for test in self._tests
        ]
        counts = [sum(int(mask.sum()) for mask in masks.values()) for masks in self._masks]
        self._ends = np.cumsum([0, *counts])

    def run(self, theta: FloatArray, near: Fit | None, most_steps: int) -> Fit:
        residuals, predictions = self.residuals(theta)
        cost = self._cost(theta, residuals)
        jacobian = self._jacobian(theta, residuals, near)
        fresh = near is None
        damping, steps = 1e-3, 0
        while steps < most_steps:
            step, damping = self._step(theta, residuals, jacobian, cost, damping)
            trial = np.clip(theta + step, self._low, self._high)
            then, predicted = self.residuals(trial)
            gain = cost - self._cost(trial, then)
            if gain > 0.0:
                moved = trial - theta
                expected = residuals + jacobian @ moved
                promised = cost - self._cost(trial, expected)
                # Broyden: the secant that was just seen, the rest as it was.
                scaled = moved / self._steps
                jacobian += np.outer(then - expected, scaled / self._steps) / float(scaled @ scaled)
                small, poor = gain < TOLERANCE * cost, gain < 0.3 * promised
                theta, residuals, predictions, cost = trial, then, predicted, cost - gain
                steps += 1
                if small and fresh:
                    break
                fresh = small or poor
                if fresh:
                    jacobian = self._jacobian(theta, residuals, None)
                damping = max(damping / 5.0, 1e-9)
            elif not fresh:
                jacobian, fresh = self._jacobian(theta, residuals, None), True
            else:
                damping *= 10.0
                if damping > 1e5:
                    break
        return Fit(self._parameters, theta, cost, predictions, residuals, jacobian, steps)

    def _cost(self, theta: FloatArray, residuals: FloatArray) -> float:
        from_priors = (theta - self._prior) / self._std
        return float(residuals @ residuals + from_priors @ from_priors)

    def _step(
        self, theta: FloatArray, residuals: FloatArray, jacobian: FloatArray, cost: float, damping: float
    ) -> tuple[FloatArray, float]:
        # A step within the reach of every coordinate, and the damping that made it so.
        normal = jacobian.T @ jacobian + np.diag(self._std**-2.0)
        slope = jacobian.T @ residuals + (theta - self._prior) * self._std**-2.0
        # A coordinate that pushes against its bound takes no part.
        free = ~(((theta <= self._low) & (slope > 0.0)) | ((theta >= self._high) & (slope < 0.0)))
        step = np.zeros_like(theta)
        if not free.any():
            return step, damping
        inner, reach = normal[np.ix_(free, free)], self._reach[free]
        # What the data hardly feels may not be thrown about: going as far as its reach costs a share of the whole.
        scale = np.diag(inner) + cost / reach**2
        while True:
            part = -np.linalg.solve(inner + damping * np.diag(scale), slope[free])
            if np.all(np.abs(part) <= reach):
                step[free] = part
                return step, damping
            damping *= 3.0

    def _jacobian(self, theta: FloatArray, residuals: FloatArray, near: Fit | None) -> FloatArray:
        jacobian = np.empty((residuals.size, theta.size))
        for k, item in enumerate(self._parameters.coordinates):
            known = None if near is None else near.parameters.index.get(item.name)
            if near is not None and known is not None:
                jacobian[:, k] = near.jacobian[:, known]
                continue
            if self._cancelled():
                raise Cancelled
            step = self._steps[k] if theta[k] + self._steps[k] <= self._high[k] else -self._steps[k]
            other = theta.copy()
            other[k] += step
            moved, _ = self.residuals(other, item.test, residuals)
            jacobian[:, k] = (moved - residuals) / step
        return jacobian

    def residuals(
        self, theta: FloatArray, only: int | None = None, others: FloatArray | None = None
    ) -> tuple[FloatArray, Predictions]:
        """Residuals and predictions of all tests, or of one while the others' residuals stay as they are."""
        chosen = [k for k, test in enumerate(self._tests) if only is None or test.number == only]
        predictions = predict(self._parameters, theta, [self._tests[k] for k in chosen])
        values = np.empty(self._ends[-1]) if others is None else others.copy()
        for k, predicted in zip(chosen, predictions, strict=True):
            rows = []
            for name in self._channels:
                mask = self._masks[k][name]
                error = (predicted[name][mask] - self._tests[k].signals[name][mask]) * self._weights[name]
                rows.append(np.clip(np.nan_to_num(error, nan=WORST, posinf=WORST, neginf=-WORST), -WORST, WORST))
            values[self._ends[k] : self._ends[k + 1]] = np.concatenate(rows)
        return values, predictions


def _least(channel: str) -> float:
    # No converter is finer; a channel without any noise would otherwise weigh without end.
    return {"voltage": 1e-4, "current": 1e-5, "position": 1e-8}[channel]
