"""Stochastic interchange, 10,000 uniform samples, 200 Hz at 2 kHz, 500 lags: against the full autocorrelation for each
swap.

With the same drawn pairs, the signals must be equal. For a given error, the plain implementation starts with randomly
ordered samples, as published; the product starts with its surrogate and reaches an error a hundred thousand times
smaller.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from benchmarks import plain_interchange
from benchmarks.base import Comparison
from tissueid.stimuli.distributions import Uniform
from tissueid.stimuli.interchange import InterchangeResult, interchange
from tissueid.stimuli.kinds.interchange import Interchange
from tissueid.stimuli.spectra import Band

SAMPLES, LAGS, RATE, CUTOFF_HZ = 10_000, 500, 2000.0, 200.0
SAME_PAIRS = 20_000
COARSE, FINE = 0.1, 1e-6


def scrambled() -> np.ndarray:
    return np.random.Generator(np.random.PCG64(1)).permutation(Uniform().levels(SAMPLES))


def target() -> np.ndarray:
    return Band(CUTOFF_HZ).autocorrelation(LAGS, RATE)


def other_samples(ours: InterchangeResult, theirs: plain_interchange.Arranged) -> float:
    """Return the number of different samples."""
    return float(np.count_nonzero(ours.values != theirs.values))


def excess(ours: InterchangeResult, theirs: plain_interchange.Arranged) -> float:
    """Return the amount by which an error exceeds its target."""
    return max(ours.error - FINE, theirs.error - COARSE, 0.0)


def comparisons() -> Iterable[Comparison]:
    start, wanted = scrambled(), target()
    size = f"{SAMPLES} samples, {LAGS} lags"
    yield Comparison(
        f"interchange, the same {SAME_PAIRS} drawn pairs",
        f"{size}; differ by: samples",
        lambda: interchange(start, wanted, tolerance=0.0, max_trials=SAME_PAIRS, seed=2, guided=False),
        lambda: plain_interchange.interchange(start, wanted, 2, 0.0, SAME_PAIRS),
        other_samples,
        0.0,
        50.0,
        blocks=2,
        runs_in_block=1,
    )
    kind = Interchange(spectrum="band", cutoff_hz=CUTOFF_HZ, seconds=SAMPLES / RATE, lags=LAGS, tolerance=FINE)
    yield Comparison(
        f"interchange, whole, to an error of {FINE:g}; plain to {COARSE:g}",
        f"{size}; differ by: error above that",
        kind.design,
        lambda: plain_interchange.interchange(start, wanted, 2, COARSE, 10**7),
        excess,
        0.0,
        blocks=1,
        runs_in_block=1,
    )
