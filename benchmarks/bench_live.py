"""Least mean squares at every quarter of a second of a running test, over windows of two lengths."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from benchmarks import plain_live, records
from benchmarks.base import Comparison
from tissueid.identification.engines.lms import Lms
from tissueid.identification.impulse_response import EXTRA_MEMORY_S, RIDGE
from tissueid.identification.live.sliding import SlidingLms

LAGS = 250
EVERY = 500
TOTAL_S = 60.0

Array = NDArray[np.float64]


def comparisons() -> Iterable[Comparison]:
    record = records.broadband()
    samples = round(TOTAL_S * records.RATE)
    u, y = np.resize(record.input, samples), np.resize(record.output, samples)
    memory = LAGS / records.RATE
    extra = round(EXTRA_MEMORY_S * records.RATE)

    def sliding(window_s: float) -> Array:
        identifier = SlidingLms(Lms(memory=memory), records.RATE, window_s)
        found = []
        for first in range(0, samples, EVERY):
            identifier.batch(u[first : first + EVERY], y[first : first + EVERY])
            found.append(identifier.impulse_response / records.RATE)
        return np.array(found)

    for window_s in (4.0, 30.0):
        yield Comparison(
            "sliding LMS",
            f"{LAGS} lags, {TOTAL_S:g} s of samples, a look every {EVERY}, window {window_s:g} s",
            lambda w=window_s: sliding(w),
            lambda w=window_s: plain_live.responses(u, y, LAGS, extra, round(w * records.RATE), EVERY, 0.05, RIDGE),
            lambda ours, theirs: float(np.linalg.norm(ours - theirs) / np.linalg.norm(theirs)),
            tolerance=1e-7,
        )
