"""Impulse response of 250 lags from 8,000 samples, with the conditioning of R: Levinson's recursion against
pseudo-inverse.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from benchmarks import records
from benchmarks.base import Comparison
from tissueid.identification.impulse_response import factor_input
from tissueid.identification.preparation import prepare
from tissueid_lab.thesis import published_algorithms as published

LAGS = 250


def comparisons() -> Iterable[Comparison]:
    record = records.broadband()

    def product() -> np.ndarray:
        return factor_input(prepare(record, None, LAGS / record.sample_rate_hz)).kernel(record.output)

    def in_numpy() -> np.ndarray:
        return published.impulse_response(record.input, record.output, LAGS)[0]

    _, condition = published.impulse_response(record.input, record.output, LAGS)
    yield Comparison(
        title="LMS impulse response",
        setting=f"{LAGS} lags, {len(record)} samples, cond R = {condition:.0f}",
        product=product,
        plain=in_numpy,
        agreement=lambda ours, theirs: float(np.linalg.norm(ours - theirs) / np.linalg.norm(theirs)),
        tolerance=1e-8,
        floor=20.0,
        blocks=8,
        runs_in_block=10,
    )
