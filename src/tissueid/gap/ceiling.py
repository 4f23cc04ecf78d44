"""Upper bound of the closed share: a flexible regression of the baseline's residual on held-out data.

The discrepancy between simulator and reality is a Gaussian process of inputs and states (Kennedy and O'Hagan, J. Royal
Statistical Society B 63 (2001) 425-464), computed by random features (Rahimi and Recht, NIPS 20 (2007) 1177-1184). It
uses the past of the command and of the baseline's own states, never the recorded output, so that its closed share
refers to free-run simulation. The remaining gap comes from disturbances or unobserved states.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tissueid.gap.dataset import DatasetTest, Purpose
from tissueid.gap.scoring import Candidate, ChannelError, closed, floor, gap, quiet_tests

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
    left: dict[str, FloatArray]


def ceiling(baseline: Candidate) -> float:
    """Return the share of the gap that a flexible regression closes on the samples for the check, at least 0.

    NaN without a gap.
    """
    dataset = baseline.fit.parameters.dataset
    quiet = quiet_tests(dataset.tests)
    before, least = gap(baseline.checked_by, quiet), floor(baseline.checked_by, quiet)
    courses = [
        _course(test, predicted, dataset.channels)
        for test, predicted in zip(dataset.tests, baseline.fit.predictions, strict=True)
    ]
    fitted = [one.test.serving(Purpose.FIT) for one in courses]
    count = sum(int(mask.sum()) for mask in fitted)
    if not before > least or count < FEATURES:
        return float("nan")
    chosen = [np.flatnonzero(mask)[:: max(1, -(-count // MOST_FITTED))] for mask in fitted]
    known = np.concatenate([one.inputs[rows] for one, rows in zip(courses, chosen, strict=True)])
    middle, spread = known.mean(axis=0), np.maximum(known.std(axis=0), 1e-12)
    best: dict[str, tuple[float, list[FloatArray]]] = {}
    for length in LENGTHS:
        random = np.random.default_rng(0)
        waves = random.standard_normal((known.shape[1], FEATURES)) / (length * np.sqrt(known.shape[1]) / 2.0)
        phases = random.uniform(0.0, 2.0 * np.pi, FEATURES)
        features = [_random_features((one.inputs - middle) / spread, waves, phases) for one in courses]
        design = np.concatenate([rows[k] for rows, k in zip(features, chosen, strict=True)])
        inner = design.T @ design
        for name in dataset.channels:
            target = np.concatenate([one.left[name][k] for one, k in zip(courses, chosen, strict=True)])
            good = np.isfinite(target)
            squares = inner if good.all() else design[good].T @ design[good]
            toward = design[good].T @ target[good]
            for ridge in RIDGES:
                weights = np.linalg.solve(squares + ridge * good.sum() * np.eye(toward.size), toward)
                predicted = [rows @ weights for rows in features]
                error = _error(courses, predicted, name)
                if name not in best or error < best[name][0]:
                    best[name] = (error, predicted)
    after = _checked(courses, {name: predicted for name, (_, predicted) in best.items()}, baseline.checked_by)
    share = closed(before, gap(after, quiet), least)
    return max(share, 0.0)


def _course(test: DatasetTest, predicted: dict[str, FloatArray], channels: Sequence[str]) -> _Course:
    position = predicted["position"]
    speed = np.gradient(position)
    states = [position, speed, *([predicted["current"]] if "current" in predicted else [])]
    rows = [*_past(test.command), *(column for state in states for column in _past(state)[:5])]
    seconds = np.arange(test.command.size) / test.sample_rate_hz
    left = {name: test.signals[name] - predicted[name] for name in channels}
    return _Course(test, np.stack([*rows, seconds], axis=1), left)


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


def _error(courses: Sequence[_Course], predicted: Sequence[FloatArray], name: str) -> float:
    total = 0.0
    for one, values in zip(courses, predicted, strict=True):
        mask = one.test.serving(Purpose.CHOICE) & np.isfinite(one.left[name])
        total += float(np.sum((one.left[name][mask] - values[mask]) ** 2))
    return total


def _checked(
    courses: Sequence[_Course], predicted: dict[str, list[FloatArray]], before: Sequence[ChannelError]
) -> list[ChannelError]:
    places = {one.test.number: k for k, one in enumerate(courses)}
    found = []
    for item in before:
        k = places[item.test]
        mask = courses[k].test.serving(Purpose.CHECK) & np.isfinite(courses[k].left[item.channel])
        rest = courses[k].left[item.channel][mask] - predicted[item.channel][k][mask]
        found.append(replace(item, square=float(np.mean(rest**2))))
    return found
