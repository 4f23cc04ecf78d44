"""Fitting the chain to all signals of all tests at once: bounded least squares with priors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tissueid.gap.observed import LEAST_NOISE, Observed, ObservedTest, Purpose
from tissueid.gap.parameters import Parametrisation, parametrise
from tissueid.gap.playing import played
from tissueid.twin.effect import Effect

FloatArray = NDArray[np.float64]
Predictions = list[dict[str, FloatArray]]

MOST_STEPS = 100
TOLERANCE = 1e-4
"""A step that lowers the cost by less than this share of it is the last."""
READINGS = 4
"""So many times an effect is read again."""
WORST = 1e6
"""Residuals are held below so many noise deviations, so that a simulation that ran away still has a cost."""


def predict(parameters: Parametrisation, theta: FloatArray, tests: Sequence[ObservedTest] | None = None) -> Predictions:
    """What the twin of a vector predicts for each test, channel by channel, from what drives it alone."""
    found = []
    for test in parameters.observed.tests if tests is None else tests:
        readings = played(parameters, theta, test)
        found.append({name: getattr(readings, name) for name in parameters.observed.channels})
    return found


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
    starts: Sequence[Sequence[float]] = (),
    *,
    near: Fit | None = None,
    most_steps: int = MOST_STEPS,
    cancelled: Callable[[], bool] = lambda: False,
) -> Fit:
    """Fit baseline and effects together to the samples that serve the fit.

    Args:
        observed: the tests.
        effects: candidates to add to the baseline.
        starts: where the search starts in each one's parameters; its first declared starting point where none is given.
        near: another fit whose common coordinates are where this one starts.
        most_steps: most accepted steps.
        cancelled: asked now and then; True stops with ``Cancelled``.
    """
    before, known = ((), None) if near is None else (near.predictions, near.parameters)
    parameters = parametrise(observed, effects, starts, before, known)
    theta = parameters.array("start")
    if near is not None:
        for k, item in enumerate(parameters.coordinates):
            if item.name in near.parameters.index:
                theta[k] = near.value(item.name)
    low, high = parameters.array("low"), parameters.array("high")
    theta = np.clip(theta, low, high)
    return _Search(parameters, low, high, cancelled).run(theta, near, most_steps)


def read_again(found: Fit, most_steps: int = MOST_STEPS, readings: int = READINGS) -> Fit:
    """A fit, after what its effects are read to be was read once more from where it lies, if that fits better.

    Args:
        found: the fit; the same is returned where none of its effects is read again.
        most_steps: most accepted steps of each fit that follows.
        readings: so many times at most.
    """
    parameters = found.parameters
    again = [effect for effect in parameters.effects if effect.read_again]
    for _ in range(readings if again else 0):
        for effect in again:
            without = predict(found.parameters.without(effect.name), found.theta)
            parameters = parameters.read_again(effect, without)
        if parameters.constants == found.parameters.constants:
            break
        from_there = replace(found, parameters=parameters)
        better = fit(parameters.observed, parameters.effects, near=from_there, most_steps=most_steps)
        if better.cost >= found.cost:
            break
        found, parameters = better, better.parameters
    return _read_where_nothing_is_fitted(found) if again else found


def _read_where_nothing_is_fitted(found: Fit) -> Fit:
    # What is a held-out test's own is read once more from where the fit ended: it costs the fit nothing.
    parameters = found.parameters
    held_out = [test for test in parameters.observed.tests if not test.serving(Purpose.FIT).any()]
    if not held_out:
        return found
    for effect in parameters.effects:
        if effect.read_again:
            fresh = parameters.read_again(effect, predict(parameters.without(effect.name), found.theta)).constants
            own = {name: fresh[name] for name in fresh if name.endswith(tuple(f"@{test.number}" for test in held_out))}
            parameters = replace(parameters, constants=parameters.constants | own)
    again = {
        test.number: value for test, value in zip(held_out, predict(parameters, found.theta, held_out), strict=True)
    }
    predictions = [
        again.get(test.number, kept) for test, kept in zip(parameters.observed.tests, found.predictions, strict=True)
    ]
    return replace(found, parameters=parameters, predictions=predictions)


def differences(
    baseline: Fit, effect: Effect, start: Sequence[float], *, slopes: bool = True
) -> tuple[FloatArray, FloatArray]:
    """By how much an effect at a starting point changes the residuals of a fit, shape as ``Fit.residuals``.

    And its derivatives there by the effect's own coordinates, shape (residuals, coordinates); none without ``slopes``.
    """
    before = baseline.parameters
    effects = [*before.effects, effect]
    starts = [*(item.starts[0] for item in before.effects), start]
    parameters = parametrise(before.observed, effects, starts, baseline.predictions, before)
    theta = parameters.array("start")
    for name, k in before.index.items():
        theta[parameters.index[name]] = baseline.theta[k]
    search = _Search(parameters, parameters.array("low"), parameters.array("high"), lambda: False, before)
    residuals = search.residuals(theta)[0]
    new = [k for k, item in enumerate(parameters.coordinates) if slopes and item.name not in before.index]
    return residuals - baseline.residuals, search.slopes(theta, residuals, new)


class _Search:
    """Levenberg-Marquardt steps within bounds; the Jacobian is renewed by secants while that serves."""

    def __init__(
        self,
        parameters: Parametrisation,
        low: FloatArray,
        high: FloatArray,
        cancelled: Callable[[], bool],
        weighed_as: Parametrisation | None = None,
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
        self._weights = [self._weights_of(weighed_as or parameters, test) for test in self._tests]
        self._masks = [
            {name: test.serving(Purpose.FIT) & np.isfinite(test.signals[name]) for name in self._channels}
            for test in self._tests
        ]
        counts = [sum(int(mask.sum()) for mask in masks.values()) for masks in self._masks]
        self._fitted = [count > 0 for count in counts]
        self._ends = np.cumsum([0, *counts])

    def _weights_of(self, parameters: Parametrisation, test: ObservedTest) -> dict[str, float]:
        beside = parameters.irreducible(parameters.array("start"), test.number)
        return {
            name: 1.0 / max(float(np.hypot(parameters.observed.noise[name], beside.get(name, 0.0))), LEAST_NOISE[name])
            for name in self._channels
        }

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
        predictions = self._unfitted(theta, predictions)
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
        # Columns that another fit has already are taken from there.
        names = [item.name for item in self._parameters.coordinates]
        known = {} if near is None else {k: near.parameters.index.get(name) for k, name in enumerate(names)}
        new = [k for k in range(theta.size) if known.get(k) is None]
        jacobian = np.empty((residuals.size, theta.size))
        jacobian[:, new] = self.slopes(theta, residuals, new)
        for k, column in known.items():
            if near is not None and column is not None:
                jacobian[:, k] = near.jacobian[:, column]
        return jacobian

    def slopes(self, theta: FloatArray, residuals: FloatArray, places: Sequence[int]) -> FloatArray:
        """Derivatives of the residuals by the coordinates at some places, shape (residuals, places)."""
        found = np.empty((residuals.size, len(places)))
        for column, k in enumerate(places):
            if self._cancelled():
                raise Cancelled
            step = self._steps[k] if theta[k] + self._steps[k] <= self._high[k] else -self._steps[k]
            other = theta.copy()
            other[k] += step
            moved, _ = self.residuals(other, self._parameters.coordinates[k].test, residuals)
            found[:, column] = (moved - residuals) / step
        return found

    def residuals(
        self, theta: FloatArray, only: int | None = None, others: FloatArray | None = None
    ) -> tuple[FloatArray, Predictions]:
        """Residuals and predictions of the tests that are fitted, or of one while the others' residuals stay.

        The predictions of a test that was left alone are empty.
        """
        chosen = [k for k, test in enumerate(self._tests) if self._fitted[k] and only in (None, test.number)]
        predictions: Predictions = [{} for _ in self._tests]
        for k, predicted in zip(
            chosen, predict(self._parameters, theta, [self._tests[k] for k in chosen]), strict=True
        ):
            predictions[k] = predicted
        values = np.empty(self._ends[-1]) if others is None else others.copy()
        for k in chosen:
            rows = []
            for name in self._channels:
                mask = self._masks[k][name]
                error = (predictions[k][name][mask] - self._tests[k].signals[name][mask]) * self._weights[k][name]
                rows.append(np.clip(np.nan_to_num(error, nan=WORST, posinf=WORST, neginf=-WORST), -WORST, WORST))
            values[self._ends[k] : self._ends[k + 1]] = np.concatenate(rows)
        return values, predictions

    def _unfitted(self, theta: FloatArray, predictions: Predictions) -> Predictions:
        # With what the fitted twin predicts for the tests that are held out whole.
        others = [k for k, is_fitted in enumerate(self._fitted) if not is_fitted]
        found = list(predictions)
        for k, predicted in zip(
            others, predict(self._parameters, theta, [self._tests[k] for k in others]), strict=True
        ):
            found[k] = predicted
        return found
