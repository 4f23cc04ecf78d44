"""Impulsive sensor noise: isolated outliers that belong neither to the noise floor nor to an effect.

The noise of a channel is estimated from the top of its spectrum, to which outliers contribute. A noise floor that
includes them would hide them. Outliers are therefore identified in the residual of the refitted baseline against a
robust scale (Davies and Gather, J. Am. Stat. Assoc. 88 (1993) 782-792).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tissueid.gap.dataset import Dataset
from tissueid.gap.fitting import Fit
from tissueid.gap.noise import channel_noise, coarse_step
from tissueid.messages import Message

FloatArray = NDArray[np.float64]

_NEIGHBOUR_WEIGHTS = np.array([-1.0, 4.0, 0.0, 4.0, -1.0]) / 6.0
"""Weights of the cubic through two readings on either side, which predicts the reading between them."""
_SPREAD = float(np.sqrt(1.0 + _NEIGHBOUR_WEIGHTS @ _NEIGHBOUR_WEIGHTS))
"""Standard deviation of the distance from that cubic, in deviations of white noise."""
_QUARTER = 0.3186
"""Lower quartile of the absolute value of a normal variable, in standard deviations.

The quartile is used instead of the median because one outlier affects five distances."""
HEAVY = 1.5
"""Least ratio of the channel's noise to the robust scale at which the noise is impulsive."""
FAR = 6.0
"""Least distance of an outlier, in robust standard deviations."""


def robust_noise(fitted: Fit) -> dict[str, float]:
    """Return the robust standard deviation of each channel's noise, SI: the least of all tests."""
    found: dict[str, float] = {}
    for test, predicted in zip(fitted.parameters.dataset.tests, fitted.predictions, strict=True):
        for name in fitted.parameters.dataset.channels:
            if name == "position" and coarse_step(test.signals[name]) > 0.0:
                continue  # most neighbouring readings are then equal
            away = _from_neighbours(test.signals[name] - predicted[name])
            known = np.abs(away[np.isfinite(away)])
            level = float(np.quantile(known, 0.25)) / (_QUARTER * _SPREAD) if known.size else np.inf
            found[name] = min(found.get(name, np.inf), level)
    return found


def with_robust_noise(fitted: Fit) -> Dataset:
    """Return the tests with the robust noise of channels with outliers; the same object where there are none."""
    dataset = fitted.parameters.dataset
    ordinary = robust_noise(fitted)
    if dataset.equivalent is not None:
        # Its noise is no less than a share of the motion, which says nothing about outliers.
        measured = channel_noise(dataset.tests)
        ordinary = {name: level for name, level in ordinary.items() if measured[name] >= dataset.noise[name]}
    heavy = {
        name: level for name, level in ordinary.items() if 0.0 < HEAVY * level < dataset.noise[name] and level < np.inf
    }
    heavy = {name: level for name, level in heavy.items() if level > 0.05 * dataset.noise[name]}
    if not heavy:
        return dataset
    remarks = [
        Message(
            "gap.impulsive_noise",
            "the {channel} has isolated outliers, several times the noise of the other readings",
            channel=name,
        )
        for name in heavy
    ]
    return replace(
        dataset,
        noise=dataset.noise | heavy,
        remarks=(*dataset.remarks, *remarks),
        impulsive={name: dataset.noise[name] for name in heavy},
    )


def without_outliers(dataset: Dataset, fitted: Fit) -> Dataset:
    """Return the tests without outliers: they are replaced by NaN, as readings that were not received."""
    if not dataset.impulsive:
        return dataset
    tests = []
    for test, predicted in zip(dataset.tests, fitted.predictions, strict=True):
        signals = dict(test.signals)
        for name in dataset.impulsive:
            away = _from_neighbours(test.signals[name] - predicted[name])
            signals[name] = np.where(np.abs(away) > FAR * _SPREAD * dataset.noise[name], np.nan, test.signals[name])
        tests.append(replace(test, signals=signals))
    return replace(dataset, tests=tuple(tests))


def _from_neighbours(left: FloatArray) -> FloatArray:
    # Distance of every reading from the cubic through its neighbours; NaN where one of them is missing.
    away = np.full_like(left, np.nan)
    if left.size >= _NEIGHBOUR_WEIGHTS.size:
        away[2:-2] = left[2:-2] - np.convolve(left, _NEIGHBOUR_WEIGHTS, "valid")
    return away
