"""Phases of low crest factor from random ones: L-BFGS with Fourier transforms, against Levenberg-Marquardt as
published.

The results are different phases with the same target crest factor.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from benchmarks import plain_multisine
from benchmarks.base import Comparison
from tissueid.stimuli.kinds.multisine import grid_size, minimise_crest_factor, multisine_crest_factor


def comparisons() -> Iterable[Comparison]:
    for count, period, floor in ((31, 512, None), (100, 2000, 5.0)):
        yield _low_crest(count, period, floor)


def _low_crest(count: int, period: int, floor: float | None) -> Comparison:
    lines, flat = np.arange(1, count + 1), np.ones(count)
    start = 2.0 * np.pi * np.random.Generator(np.random.PCG64(2)).random(count)
    size = grid_size(lines, period)

    def difference(ours: np.ndarray, theirs: np.ndarray) -> float:
        return abs(
            multisine_crest_factor(lines, flat, ours, period) - multisine_crest_factor(lines, flat, theirs, period)
        )

    return Comparison(
        "low-crest multisine",
        f"{count} lines, {size} points",
        lambda: minimise_crest_factor(lines, flat, start, period),
        lambda: plain_multisine.low_crest(lines, flat, start, size),
        difference,
        0.03,
        floor,
        blocks=2,
        runs_in_block=2,
    )
