"""Gap before and after an explanation: the share that it closes, the budget by effect, and the upper bound.

Budget: A share depends on the order in which effects are added. Two are given for each: when it is added in the order
of the waterfall, and when it alone is removed from the complete set. Both are measured on the samples for the check.

Upper bound: a flexible regression of the baseline's residual on held-out data. The discrepancy between simulator and
reality is a Gaussian process of inputs and states (Kennedy and O'Hagan, J. Royal Statistical Society B 63 (2001)
425-464), computed by random features (Rahimi and Recht, NIPS 20 (2007) 1177-1184). It uses the past of the command and
of the baseline's own states, never the recorded output, so that its closed share refers to free-run simulation. The
remaining gap comes from disturbances or unobserved states.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from tissueid.gap.dataset import DatasetTest, Purpose
from tissueid.gap.decision import (
    GAP_CHANNELS,
    Candidate,
    ChannelError,
    closed,
    errors,
    floor,
    gap,
    gap_left,
)
from tissueid.twin.catalogue import effect
from tissueid.twin.effect import Stage

Interval = tuple[float, float]


@dataclass(frozen=True)
class BudgetStep:
    """One effect of the waterfall: the gap with it, and its closed shares with 95 % intervals (NaN where unknown)."""

    effect: str
    stage: Stage
    gap_after: float
    added: float
    added_ci: Interval
    removed: float
    removed_ci: Interval


@dataclass(frozen=True)
class Budget:
    """The gap from the baseline to the noise floor, on the samples for the check.

    ``remains`` is the share that the set leaves, ``remains_in`` the stage that shows it; None where it is noise.
    """

    before: float
    after: float
    floor: float
    steps: tuple[BudgetStep, ...]
    remains: float
    remains_in: Stage | None


def removal_path(
    complete: Candidate,
    baseline_effects: Sequence[str],
    remove: Callable[[Candidate, Sequence[str]], Sequence[Candidate]],
) -> tuple[tuple[Candidate, ...], dict[str, Candidate]]:
    """Return nested sets from one effect to all, and the set without each effect.

    At each step the effect is removed whose removal widens the gap least, so that the first step of the waterfall is
    that of the most important effect.

    Args:
        complete: the complete set.
        baseline_effects: effects of the baseline, which stay.
        remove: refits a set without each of some effects.
    """
    quiet = complete.quiet
    path: list[Candidate] = [complete]
    without: dict[str, Candidate] = {}
    while len(names := [name for name in path[-1].effects if name not in baseline_effects]) > 1:
        smaller = remove(path[-1], names)
        if not without:
            without = dict(zip(names, smaller, strict=True))
        path.append(min(smaller, key=lambda item: gap(item.checked_by, quiet)))
    return tuple(reversed(path)), without


def budget(
    baseline: Candidate, path: Sequence[Candidate], without: dict[str, Candidate], remains_in: Stage | None
) -> Budget:
    """Return the budget of nested sets, from the smallest to the complete one.

    Args:
        baseline: the baseline without effects.
        path: nested sets, each with one effect more.
        without: the complete set without each effect.
        remains_in: stage that shows what the complete set leaves.
    """
    complete = path[-1]
    quiet = baseline.quiet
    in_stretches = stretches(baseline)
    draws = draws_of(len(in_stretches))

    def share(item: Candidate) -> tuple[float, FloatArray]:
        if item is baseline:
            return 0.0, np.zeros(len(draws))
        return item.closed(baseline), closed_in_draws(in_stretches, stretches(item), draws, quiet)

    shares = {id(item): share(item) for item in (baseline, *path, *without.values())}

    def difference(more: Candidate, less: Candidate) -> tuple[float, Interval]:
        (middle, drawn), (from_there, drawn_there) = shares[id(more)], shares[id(less)]
        return middle - from_there, widened(middle - from_there, drawn - drawn_there, len(in_stretches))

    steps, before = [], baseline
    for item in path:
        name = next(name for name in item.effects if name not in before.effects)
        added, added_ci = difference(item, before)
        removed, removed_ci = difference(complete, without[name]) if name in without else (added, added_ci)
        gap_after = gap_left(baseline.checked_by, item.checked_by, quiet)
        steps.append(BudgetStep(name, effect(name).stage, gap_after, added, added_ci, removed, removed_ci))
        before = item
    return Budget(
        gap(baseline.checked_by, quiet),
        gap_left(baseline.checked_by, complete.checked_by, quiet),
        floor(baseline.checked_by, quiet),
        tuple(steps),
        1.0 - shares[id(complete)][0],
        remains_in,
    )


FloatArray = NDArray[np.float64]

FEATURES = 256
MOST_FITTED = 8_000
LENGTHS = (2.0, 6.0)
"""Length scales of the process, in standard deviations of the inputs."""
RIDGES = (1e-6, 1e-4, 1e-2, 1.0)
_EDGES = (0, 1, 2, 4, 8, 16, 32, 64, 128)
"""Edges of windows in the past, samples; the means in the windows represent the memory."""


@dataclass(frozen=True)
class _Course:
    """One test: inputs of the regression, shape (n, inputs), and the baseline's residual by channel, shape (n,)."""

    test: DatasetTest
    inputs: FloatArray
    residuals: dict[str, FloatArray]


def ceiling(baseline: Candidate) -> float:
    """Return the share of the gap that a flexible regression closes on the samples for the check, at least 0.

    NaN without a gap.
    """
    dataset = baseline.fit.parameters.dataset
    quiet = baseline.quiet
    before, least = gap(baseline.checked_by, quiet), floor(baseline.checked_by, quiet)
    courses = [
        _course(test, predicted, dataset.channels)
        for test, predicted in zip(dataset.tests, baseline.fit.predictions, strict=True)
    ]
    fitted = [course.test.serving(Purpose.FIT) for course in courses]
    count = sum(int(mask.sum()) for mask in fitted)
    if not before > least or count < FEATURES:
        return float("nan")
    chosen = [np.flatnonzero(mask)[:: max(1, -(-count // MOST_FITTED))] for mask in fitted]
    inputs = np.concatenate([course.inputs[rows] for course, rows in zip(courses, chosen, strict=True)])
    middle, spread = inputs.mean(axis=0), np.maximum(inputs.std(axis=0), 1e-12)
    best: dict[str, tuple[float, list[FloatArray]]] = {}
    for length in LENGTHS:
        random = np.random.default_rng(0)
        waves = random.standard_normal((inputs.shape[1], FEATURES)) / (length * np.sqrt(inputs.shape[1]) / 2.0)
        phases = random.uniform(0.0, 2.0 * np.pi, FEATURES)
        features = [_random_features((course.inputs - middle) / spread, waves, phases) for course in courses]
        design = np.concatenate([rows[k] for rows, k in zip(features, chosen, strict=True)])
        inner = design.T @ design
        for name in dataset.channels:
            target = np.concatenate([course.residuals[name][k] for course, k in zip(courses, chosen, strict=True)])
            good = np.isfinite(target)
            squares = inner if good.all() else design[good].T @ design[good]
            toward = design[good].T @ target[good]
            for ridge in RIDGES:
                weights = np.linalg.solve(squares + ridge * good.sum() * np.eye(toward.size), toward)
                predicted = [rows @ weights for rows in features]
                parts = (
                    _left(course, name, part, Purpose.CHOICE) for course, part in zip(courses, predicted, strict=True)
                )
                error = sum(float(np.sum(part**2)) for part in parts)
                if name not in best or error < best[name][0]:
                    best[name] = (error, predicted)
    places = {course.test.number: k for k, course in enumerate(courses)}
    after = []
    for item in baseline.checked_by:
        k = places[item.test]
        rest = _left(courses[k], item.channel, best[item.channel][1][k], Purpose.CHECK)
        after.append(replace(item, square=float(np.mean(rest**2))))
    share = closed(before, gap(after, quiet), least)
    return max(share, 0.0)


def _course(test: DatasetTest, predicted: dict[str, FloatArray], channels: Sequence[str]) -> _Course:
    position = predicted["position"]
    speed = np.gradient(position)
    states = [position, speed, *([predicted["current"]] if "current" in predicted else [])]
    rows = [*_past(test.command), *(column for state in states for column in _past(state)[:5])]
    seconds = np.arange(test.command.size) / test.sample_rate_hz
    residuals = {name: test.signals[name] - predicted[name] for name in channels}
    return _Course(test, np.stack([*rows, seconds], axis=1), residuals)


def _past(values: FloatArray) -> list[FloatArray]:
    longest = _EDGES[-1]
    before = np.concatenate([np.full(longest, values[0]), np.nan_to_num(values)])
    sums = np.concatenate([[0.0], np.cumsum(before)])
    ends = np.arange(values.size) + longest + 1
    return [(sums[ends - a] - sums[ends - b]) / (b - a) for a, b in pairwise(_EDGES)]


def _random_features(inputs: FloatArray, waves: FloatArray, phases: FloatArray) -> FloatArray:
    # The inputs themselves as linear features.
    turned = inputs @ waves + phases
    return np.concatenate([np.ones((inputs.shape[0], 1)), inputs, np.cos(turned)], axis=1)


def _left(course: _Course, name: str, predicted: FloatArray, purpose: Purpose) -> FloatArray:
    # What the regression leaves of the residual on the samples of a purpose.
    mask = course.test.serving(purpose) & np.isfinite(course.residuals[name])
    return course.residuals[name][mask] - predicted[mask]


IntArray = NDArray[np.int64]
Stretch = Sequence[ChannelError]

RESAMPLES = 400
STRETCH_S = 0.25
"""Least length of the stretches that a bootstrap draws, s. In a simulation of errors whose size changes within 0.3 s,
intervals from stretches of 0.1 s hold the true share in 87 to 89 %, from those of 0.3 s in 92 to 93 %."""


@dataclass(frozen=True)
class GapFigures:
    """The gap on the samples for the check. ``closed_ci`` is the 95 % interval (NaN where there is no gap to close)."""

    before: float
    after: float
    floor: float
    closed: float
    closed_ci: tuple[float, float]
    predicted_closed: float
    """Closed share on the samples for the choice, which the check verifies."""


def figures_of(baseline: Candidate, best: Candidate | None) -> GapFigures:
    """Return the gap before and after, with a bootstrap interval of the closed share over stretches of the check."""
    quiet = baseline.quiet
    before, least = gap(baseline.checked_by, quiet), floor(baseline.checked_by, quiet)
    after = before if best is None else gap_left(baseline.checked_by, best.checked_by, quiet)
    shut = closed(before, after, least)
    if best is None:
        return GapFigures(before, after, least, shut, (float("nan"), float("nan")), float("nan"))
    in_stretches = stretches(baseline)
    drawn = closed_in_draws(in_stretches, stretches(best), draws_of(len(in_stretches)), quiet)
    interval = widened(best.closed(baseline), drawn, len(in_stretches))
    return GapFigures(before, after, least, shut, interval, best.predicted_closed(baseline))


def draws_of(count: int) -> IntArray:
    """Return bootstrap draws of ``count`` stretches, the same each time, shape (RESAMPLES, count); none of one."""
    random = np.random.default_rng(0)
    return random.integers(count, size=(RESAMPLES if count > 1 else 0, count))


def closed_in_draws(
    before: Sequence[Stretch], after: Sequence[Stretch], draws: IntArray, quiet: Sequence[int]
) -> FloatArray:
    """Return the closed share in each draw of stretches, shape (draws,); NaN where there was no gap.

    Args:
        before: errors of the baseline in every stretch.
        after: those of a candidate.
        draws: numbers of the drawn stretches, shape (draws, stretches).
        quiet: tests that are left out, as in ``decision.gap``.
    """
    wide, remaining = _gaps(before, draws, quiet), _gaps(after, draws, quiet)
    least = _gaps(before, draws, quiet, lambda item: item.noise**2 + item.irreducible**2)
    room = np.where(wide > least, wide - least, np.nan)
    return 1.0 - np.sqrt(np.maximum(remaining - least, 0.0) / room)


def _gaps(
    errors_by_stretch: Sequence[Stretch],
    draws: IntArray,
    quiet: Sequence[int],
    square: Callable[[ChannelError], float] = lambda item: item.square,
) -> FloatArray:
    # The squared gap in each draw, as ``decision.gap`` pools it, shape (draws,).
    sums = np.zeros((2, len(errors_by_stretch), len(GAP_CHANNELS)))
    for k, stretch in enumerate(errors_by_stretch):
        for item in stretch:
            if item.channel in GAP_CHANNELS and item.test not in quiet and item.spread > 0.0:
                of_channel = sums[:, k, GAP_CHANNELS.index(item.channel)]
                of_channel += item.samples * np.array([square(item), item.spread**2])
    errors_drawn, spreads_drawn = sums[:, draws].sum(axis=2)
    has_spread = spreads_drawn > 0.0
    shares = np.where(has_spread, errors_drawn / np.where(has_spread, spreads_drawn, 1.0), 0.0)
    channels = has_spread.sum(axis=1)
    return np.where(channels > 0, shares.sum(axis=1) / np.maximum(channels, 1), np.nan)


def widened(middle: float, drawn: np.ndarray, count: int) -> tuple[float, float]:
    """Return the 95 % interval around a closed share from bootstrap draws over ``count`` stretches, shape (draws,).

    A test has four or five stretches. A bootstrap of so few has too small a spread; it is widened by the factor between
    the normal distribution and Student's t. Draws without a share are left out; NaN where these are most.
    """
    drawn = drawn[np.isfinite(drawn)]
    if drawn.size < RESAMPLES // 2:
        return float("nan"), float("nan")
    low, high = np.quantile(drawn, [0.025, 0.975])
    wider = float(stats.t.ppf(0.975, count - 1) / stats.norm.ppf(0.975) * np.sqrt(count / (count - 1)))
    return middle - wider * max(middle - float(low), 0.0), min(middle + wider * max(float(high) - middle, 0.0), 1.0)


def stretches(candidate: Candidate) -> list[list[ChannelError]]:
    """Return the errors of every stretch of the check: successive blocks of a test, ``STRETCH_S`` or longer."""
    errors_by_stretch = []
    tests = candidate.fit.parameters.dataset.tests
    for k, test in enumerate(tests):
        serving = test.serving(Purpose.CHECK)
        samples = np.flatnonzero(serving)
        count = max(1, int(samples.size / (STRETCH_S * test.sample_rate_hz)))
        for stretch in np.array_split(samples, count) if samples.size else ():
            alone = [replace(other, purpose=np.zeros_like(other.purpose)) for other in tests]
            alone[k].purpose[stretch] = Purpose.CHECK
            errors_by_stretch.append(errors(candidate.fit, Purpose.CHECK, tests=alone))
    return errors_by_stretch
