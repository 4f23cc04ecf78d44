"""Readings that are off by far, one here and one there: noise that comes in impulses, and is nobody's cause.

The noise of a channel is told from the top of its spectrum, where impulses count as much as everything else; a floor
that has them in it would hide them. Against the refitted baseline they stand out: most of what is left of a
neighbourhood is small, and a few are not (identification of outliers against a scale that they do not move: Davies
and Gather, J. Am. Stat. Assoc. 88 (1993) 782-792).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tissueid.gap.fitting import Fit
from tissueid.gap.noise import coarse_step
from tissueid.gap.observed import Observed

FloatArray = NDArray[np.float64]

_AROUND = np.array([-1.0, 4.0, 0.0, 4.0, -1.0]) / 6.0
"""A cubic through two readings on either side: what is to be expected between them."""
_SPREAD = float(np.sqrt(1.0 + _AROUND @ _AROUND))
"""Of a reading's distance from that, in deviations of the noise."""
_QUARTER = 0.3186
"""A quarter of normal deviations is smaller, in standard deviations; one impulse spoils five distances."""
HEAVY = 1.5
"""A noise so many times what most readings have is made of impulses."""
FAR = 6.0
"""An impulse is so many of the others' deviations away."""


def ordinary_noise(fitted: Fit) -> dict[str, float]:
    """Standard deviation of what most readings of each channel are off by, SI; the least of all tests."""
    found: dict[str, float] = {}
    for test, predicted in zip(fitted.parameters.observed.tests, fitted.predictions, strict=True):
        for name in fitted.parameters.observed.channels:
            if name == "position" and coarse_step(test.signals[name]) > 0.0:
                continue  # most readings are then where their neighbours are
            away = _from_neighbours(test.signals[name] - predicted[name])
            known = np.abs(away[np.isfinite(away)])
            level = float(np.quantile(known, 0.25)) / (_QUARTER * _SPREAD) if known.size else np.inf
            found[name] = min(found.get(name, np.inf), level)
    return found


def without_impulses_in_the_floor(fitted: Fit) -> Observed:
    """What was observed, with the noise that most readings of a channel have; itself where none has impulses."""
    observed = fitted.parameters.observed
    ordinary = ordinary_noise(fitted)
    heavy = {
        name: level for name, level in ordinary.items() if 0.0 < HEAVY * level < observed.noise[name] and level < np.inf
    }
    heavy = {name: level for name, level in heavy.items() if level > 0.05 * observed.noise[name]}
    if not heavy:
        return observed
    remarks = [
        f"the {name} has single readings that are far off, several times what the others are: noise in impulses"
        for name in heavy
    ]
    return replace(
        observed,
        noise=observed.noise | heavy,
        remarks=(*observed.remarks, *remarks),
        impulsive={name: observed.noise[name] for name in heavy},
    )


def cleaned(observed: Observed, fitted: Fit) -> Observed:
    """What was observed without the readings that are impulses: they count as not received."""
    if not observed.impulsive:
        return observed
    tests = []
    for test, predicted in zip(observed.tests, fitted.predictions, strict=True):
        signals = dict(test.signals)
        for name in observed.impulsive:
            away = _from_neighbours(test.signals[name] - predicted[name])
            signals[name] = np.where(np.abs(away) > FAR * _SPREAD * observed.noise[name], np.nan, test.signals[name])
        tests.append(replace(test, signals=signals))
    return replace(observed, tests=tuple(tests))


def _from_neighbours(left: FloatArray) -> FloatArray:
    # Of every reading from the cubic through its neighbours; NaN where one of them is missing.
    away = np.full_like(left, np.nan)
    if left.size >= _AROUND.size:
        away[2:-2] = left[2:-2] - np.convolve(left, _AROUND, "valid")
    return away
