"""Fit of the chain to all signals of all tests: bounded least squares with priors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import CancelledError
from tissueid.gap.dataset import LEAST_NOISE, Dataset, DatasetTest, Purpose
from tissueid.gap.forward_model import STEP_S, simulate_test, substeps_of
from tissueid.gap.parameters import Parametrisation, parametrise
from tissueid.gap.thresholds import LIMITS
from tissueid.identification.levenberg_marquardt import Bounds, SecantProblem, minimise
from tissueid.twin.effect import Effect

FloatArray = NDArray[np.float64]
Predictions = list[dict[str, FloatArray]]

TOLERANCE = 1e-4
"""Relative decrease of the cost below which the fit ends."""
ESTIMATES = 4
"""Most re-estimates of an effect from the record."""
SLOPE_STEP_S = 2.5e-4
"""Longest integration step for derivatives until a fit has converged, s: twice that of the residuals."""
ABSORBED = 1e-6
"""Share of a column that is left by others below which it is a combination of them: Jacobians have single precision."""
WORST = 1e6
"""Bound of a residual in noise deviations, so that a diverging simulation still has a cost."""


def predict(
    parameters: Parametrisation,
    theta: FloatArray,
    tests: Sequence[DatasetTest] | None = None,
    step_s: float = STEP_S,
) -> Predictions:
    """Return the prediction of each test by channel, simulated from the excitation only in steps of ``step_s``."""
    predictions = []
    for test in parameters.dataset.tests if tests is None else tests:
        readings = simulate_test(parameters, theta, test, substeps=substeps_of(test, step_s))
        predictions.append({name: getattr(readings, name) for name in parameters.dataset.channels})
    return predictions


@dataclass(frozen=True)
class Fit:
    """A fitted twin: its coordinates, its cost, and its prediction of each test."""

    parameters: Parametrisation = field(repr=False)
    theta: FloatArray
    cost: float
    """Sum of squares of residuals in noise deviations on the fitted samples, with the priors."""
    predictions: Predictions = field(repr=False)
    residuals: FloatArray = field(repr=False)
    """Residuals of the fitted samples in noise deviations, by test and channel."""
    jacobian: NDArray[np.float32] = field(repr=False)
    """Derivatives of the residuals by the coordinates, shape (residuals, coordinates), in single precision: a search
    keeps those of dozens of fits, of tens of megabytes each in a full session."""
    steps: int

    @property
    def normal(self) -> FloatArray:
        """Product of the Jacobian with itself, shape (coordinates, coordinates)."""
        slopes = self.jacobian.astype(np.float64)
        return slopes.T @ slopes

    @property
    def prediction_of_test(self) -> dict[int, dict[str, FloatArray]]:
        """Prediction of each test by its number."""
        return {
            test.number: prediction
            for test, prediction in zip(self.parameters.dataset.tests, self.predictions, strict=True)
        }

    def value(self, name: str) -> float:
        """Return a coordinate by name, in fitted units."""
        return float(self.theta[self.parameters.index[name]])


def fit(
    dataset: Dataset,
    effects: Sequence[Effect] = (),
    starts: Sequence[Sequence[float]] = (),
    *,
    near: Fit | None = None,
    most_steps: int = LIMITS.most_steps,
    cancelled: Callable[[], bool] = lambda: False,
) -> Fit:
    """Fit baseline and effects together to the samples for the fit.

    Args:
        dataset: the tests.
        effects: effects in addition to the baseline.
        starts: starting point of each effect; its first declared one where none is given.
        near: another fit that provides the starting values of common coordinates, to the same tests or to others.
        most_steps: most accepted steps.
        cancelled: callback that returns True to stop with ``CancelledError``.
    """
    held = {} if near is None else near.prediction_of_test
    before = [held.get(test.number, {}) for test in dataset.tests]
    parameters = parametrise(dataset, effects, starts, before, None if near is None else near.parameters)
    theta = parameters.array("start")
    if near is not None:
        for k, item in enumerate(parameters.coordinates):
            if item.name in near.parameters.index:
                theta[k] = near.value(item.name)
    theta = np.clip(theta, parameters.array("low"), parameters.array("high"))
    return _Search(parameters, cancelled).run(theta, near, most_steps)


def re_estimate(fitted: Fit, most_steps: int = LIMITS.most_steps, readings: int = ESTIMATES) -> Fit:
    """Re-estimate the per-test parameters at a fit and refit. Return the better of the two fits.

    Args:
        fitted: the fit; returned unchanged where none of its effects is re-estimated.
        most_steps: most accepted steps of each refit.
        readings: most re-estimates; the fit is returned unchanged with 0.
    """
    parameters = fitted.parameters
    again = [effect for effect in parameters.effects if effect.re_estimate]
    if not again or not readings:
        return fitted
    for _ in range(readings):
        for effect in again:
            without = predict(fitted.parameters.without(effect.name), fitted.theta)
            parameters = parameters.re_estimate(effect, without)
        if parameters.constants == fitted.parameters.constants:
            break
        from_there = replace(fitted, parameters=parameters)
        better = fit(parameters.dataset, parameters.effects, near=from_there, most_steps=most_steps)
        if better.cost >= fitted.cost:
            break
        fitted, parameters = better, better.parameters
    return _with_held_out_estimates(fitted)


def _with_held_out_estimates(fitted: Fit) -> Fit:
    # Per-test parameters of held-out tests are re-estimated at the final fit, without a refit.
    parameters = fitted.parameters
    held_out = [test for test in parameters.dataset.tests if not test.serving(Purpose.FIT).any()]
    if not held_out:
        return fitted
    for effect in parameters.effects:
        if effect.re_estimate:
            fresh = parameters.re_estimate(effect, predict(parameters.without(effect.name), fitted.theta)).constants
            own = {name: fresh[name] for name in fresh if name.endswith(tuple(f"@{test.number}" for test in held_out))}
            parameters = replace(parameters, constants=parameters.constants | own)
    again = {
        test.number: value for test, value in zip(held_out, predict(parameters, fitted.theta, held_out), strict=True)
    }
    predictions = [
        again.get(test.number, kept) for test, kept in zip(parameters.dataset.tests, fitted.predictions, strict=True)
    ]
    return replace(fitted, parameters=parameters, predictions=predictions)


def residual_blocks(fitted: Fit) -> list[tuple[int, slice]]:
    """Return the number of the test and the places in ``Fit.residuals`` of each channel of each fitted test."""
    blocks, end = [], 0
    for test in fitted.parameters.dataset.tests:
        for name in fitted.parameters.dataset.channels:
            size = int((test.serving(Purpose.FIT) & np.isfinite(test.signals[name])).sum())
            blocks += [(test.number, slice(end, end + size))] if size else []
            end += size
    return blocks


class LinearRefit:
    """A refit of the coordinates of a fit to first order, which absorbs part of a change of the residuals.

    Coordinates of one test act on its residuals only. Their part is removed test by test, which takes a fraction of the
    time of all columns together. What updates by secants add to these columns elsewhere is left out.

    Args:
        fitted: the fit.
        without: an effect whose coordinates are not refitted.
    """

    def __init__(self, fitted: Fit, without: str = "") -> None:
        slopes = fitted.jacobian.astype(np.float64)
        coordinates = fitted.parameters.coordinates
        refitted = [k for k, item in enumerate(coordinates) if not (without and item.name.startswith(f"{without}."))]
        # Places of the residuals with orthonormal columns that span the derivatives there.
        self._bases: list[tuple[slice, FloatArray]] = []
        places: dict[int, slice] = {}
        for test, block in residual_blocks(fitted):
            places[test] = slice(places.get(test, block).start, block.stop)
        for number, rows in places.items():
            own = slopes[rows, [k for k in refitted if coordinates[k].test == number]]
            self._bases.append((rows, _basis(own, own)))
        shared = slopes[:, [k for k in refitted if coordinates[k].test is None]]
        self._bases.append((slice(None), _basis(self.surviving(shared), shared)))

    def surviving(self, values: FloatArray) -> FloatArray:
        """Return what is left of changes of the residuals, shape (residuals,) or (residuals, changes)."""
        remaining = values.copy()
        for rows, basis in self._bases:
            remaining[rows] -= basis @ (basis.T @ remaining[rows])
        return remaining


def _basis(remaining: FloatArray, columns: FloatArray) -> FloatArray:
    # Orthonormal columns that span what is left of some columns, without those of which hardly anything is left.
    norms = np.linalg.norm(remaining, axis=0)
    kept = norms > ABSORBED * np.linalg.norm(columns, axis=0)
    basis: FloatArray = np.linalg.qr(remaining[:, kept] / norms[kept])[0]
    return basis


def residuals_without(fitted: Fit, name: str) -> FloatArray:
    """Return the residuals of a fit without one of its effects, shape as ``Fit.residuals``, after a refit of the other
    coordinates to first order."""
    parameters = fitted.parameters
    residuals, _ = _Search(parameters.without(name), weighed_as=parameters).residuals(fitted.theta)
    return LinearRefit(fitted, without=name).surviving(residuals)


class Differences:
    """Changes of the residuals of a fit by further effects, by simulations in steps of ``SLOPE_STEP_S``."""

    def __init__(self, baseline: Fit) -> None:
        self._baseline = baseline
        search = _Search(baseline.parameters)
        self._before, _ = search.residuals(baseline.theta, step_s=SLOPE_STEP_S)

    def at(self, effect: Effect, start: Sequence[float], *, slopes: bool = True) -> tuple[FloatArray, FloatArray]:
        """Return the change by an effect at a starting point, shape as ``Fit.residuals``.

        With ``slopes`` also its derivatives by the effect's coordinates, shape (residuals, coordinates).
        """
        before = self._baseline.parameters
        effects = [*before.effects, effect]
        starts = [*(item.starts[0] for item in before.effects), start]
        parameters = parametrise(before.dataset, effects, starts, self._baseline.predictions, before)
        theta = parameters.array("start")
        for name, k in before.index.items():
            theta[parameters.index[name]] = self._baseline.theta[k]
        search = _Search(parameters, weighed_as=before)
        residuals, _ = search.residuals(theta, step_s=SLOPE_STEP_S)
        new = [k for k, item in enumerate(parameters.coordinates) if slopes and item.name not in before.index]
        return residuals - self._before, search.slopes(theta, residuals, new)


class _Search:
    """Residuals of the twin on the fitted samples and their derivatives, for a search within bounds."""

    def __init__(
        self,
        parameters: Parametrisation,
        cancelled: Callable[[], bool] = lambda: False,
        weighed_as: Parametrisation | None = None,
    ) -> None:
        self._parameters = parameters
        self._low, self._high = parameters.array("low"), parameters.array("high")
        self._cancelled = cancelled
        self._slope_step_s = SLOPE_STEP_S
        self._coarser = any(
            test.driven_by != "input" and substeps_of(test, SLOPE_STEP_S) < substeps_of(test, STEP_S)
            for test in parameters.dataset.tests
        )
        self._steps = parameters.array("step")
        dataset = parameters.dataset
        self._tests = dataset.tests
        self._channels = dataset.channels
        self._weights = []
        for test in self._tests:
            irreducible = (weighed_as or parameters).irreducible((weighed_as or parameters).array("start"), test.number)
            floors = {name: np.hypot(dataset.noise[name], irreducible.get(name, 0.0)) for name in self._channels}
            self._weights.append({name: 1.0 / max(float(floor), LEAST_NOISE[name]) for name, floor in floors.items()})
        self._masks = [
            {name: test.serving(Purpose.FIT) & np.isfinite(test.signals[name]) for name in self._channels}
            for test in self._tests
        ]
        self._recorded = [
            {name: test.signals[name][mask] for name, mask in masks.items()}
            for test, masks in zip(self._tests, self._masks, strict=True)
        ]
        counts = [sum(int(mask.sum()) for mask in masks.values()) for masks in self._masks]
        self._fitted = [count > 0 for count in counts]
        self._ends = np.cumsum([0, *counts])

    def run(self, theta: FloatArray, near: Fit | None, most_steps: int) -> Fit:
        prior = self._parameters.array("prior"), self._parameters.array("prior_std")
        bounds = Bounds(self._low, self._high, self._parameters.array("reach"))
        problem = SecantProblem(self.residuals, self._jacobian, self._steps, bounds, prior)
        of_same_tests = near is not None and near.prediction_of_test.keys() == {test.number for test in self._tests}
        first_jacobian = partial(self._jacobian, near=near) if of_same_tests else None
        search = partial(minimise, problem, tolerance=TOLERANCE, bounds=bounds)
        outcome = search(problem.start(theta, first_jacobian), most_steps=most_steps)
        if outcome.converged and self._coarser and (most_steps == LIMITS.most_steps or outcome.steps == 0):
            # A fit to the end needs exact derivatives, and so does one that coarse ones do not let begin.
            self._slope_step_s = STEP_S
            more = search(problem.restart(outcome.point), most_steps=most_steps)
            outcome = replace(more, steps=outcome.steps + more.steps)
        best = outcome.point
        problem.follow(best)
        predictions = list(best.extra)
        # Those of the tests that are held out completely are missing.
        others = [k for k, is_fitted in enumerate(self._fitted) if not is_fitted]
        left_out = predict(self._parameters, best.theta, [self._tests[k] for k in others])
        for k, predicted in zip(others, left_out, strict=True):
            predictions[k] = predicted
        slopes = problem.jacobian.astype(np.float32)
        return Fit(self._parameters, best.theta, best.cost, predictions, best.residuals, slopes, outcome.steps)

    def _jacobian(self, theta: FloatArray, residuals: FloatArray, near: Fit | None = None) -> FloatArray:
        # Columns known from another fit are reused.
        names = [item.name for item in self._parameters.coordinates]
        reused = {} if near is None else {k: near.parameters.index.get(name) for k, name in enumerate(names)}
        new = [k for k in range(theta.size) if reused.get(k) is None]
        jacobian = np.empty((residuals.size, theta.size), order="F")
        if new and self._coarser and self._slope_step_s == SLOPE_STEP_S:
            residuals, _ = self.residuals(theta, step_s=SLOPE_STEP_S)
        jacobian[:, new] = self.slopes(theta, residuals, new)
        for k, column in reused.items():
            if near is not None and column is not None:
                jacobian[:, k] = near.jacobian[:, column]
        return jacobian

    def slopes(self, theta: FloatArray, residuals: FloatArray, places: Sequence[int]) -> FloatArray:
        """Return derivatives of the residuals by some coordinates, shape (residuals, places).

        ``residuals`` are those at ``theta`` by simulations in the same steps as the derivatives.
        """
        derivatives = np.empty((residuals.size, len(places)), order="F")
        for column, k in enumerate(places):
            if self._cancelled():
                raise CancelledError
            step = self._steps[k] if theta[k] + self._steps[k] <= self._high[k] else -self._steps[k]
            other = theta.copy()
            other[k] += step
            moved, _ = self.residuals(other, self._parameters.coordinates[k].test, residuals, self._slope_step_s)
            derivatives[:, column] = (moved - residuals) / step
        return derivatives

    def residuals(
        self,
        theta: FloatArray,
        only: int | None = None,
        others: FloatArray | None = None,
        step_s: float = STEP_S,
    ) -> tuple[FloatArray, Predictions]:
        """Return residuals and predictions of the fitted tests, or of one test with the residuals of the others
        unchanged.

        Predictions of unchanged tests are empty.
        """
        chosen = [k for k, test in enumerate(self._tests) if self._fitted[k] and only in (None, test.number)]
        predictions: Predictions = [{} for _ in self._tests]
        for k, predicted in zip(
            chosen, predict(self._parameters, theta, [self._tests[k] for k in chosen], step_s), strict=True
        ):
            predictions[k] = predicted
        values = np.empty(self._ends[-1]) if others is None else others.copy()
        for k in chosen:
            rows = []
            for name in self._channels:
                mask = self._masks[k][name]
                error = (predictions[k][name][mask] - self._recorded[k][name]) * self._weights[k][name]
                error[np.isnan(error)] = WORST
                rows.append(np.clip(error, -WORST, WORST))
            values[self._ends[k] : self._ends[k + 1]] = np.concatenate(rows)
        return values, predictions
