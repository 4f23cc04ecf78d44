"""One ``update(u, y)`` of the online engines with 250 taps at 2 kHz: high percentiles of the duration."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from benchmarks import plain_online, records
from benchmarks.base import Latency
from tissueid.identification.engines.als import Als
from tissueid.identification.engines.rls import Rls

LAGS = 250
UPDATES = 20_000
PERIOD_S = 1.0 / records.RATE
SHARE = 0.1
"""Share of a sample period that a recursive update may take at the 99.9th percentile."""

_FLOOR = 0.01 * LAGS
"""Regularisation of :class:`Als` for an input of unit variance."""


def latencies() -> Iterable[Latency]:
    record = records.broadband()
    std = float(np.std(record.input))
    u = np.resize((record.input - record.input.mean()) / std, UPDATES).tolist()
    y = np.resize((record.output - record.output.mean()) / np.std(record.output), UPDATES).tolist()
    memory = LAGS / records.RATE

    def timed(update: Callable[[float, float], float]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        seconds, errors = np.empty(UPDATES), np.empty(UPDATES)
        for n in range(UPDATES):
            begin = time.perf_counter()
            errors[n] = update(u[n], y[n])
            seconds[n] = time.perf_counter() - begin
        return seconds[LAGS:], errors[LAGS:]  # earlier updates have an incomplete memory and do no work

    for forgetting in (1.0, 0.999):
        yield Latency(
            "RLS update",
            f"{LAGS} taps, forgetting {forgetting:g}, {UPDATES} updates",
            lambda f=forgetting: timed(
                Rls(memory=memory, forgetting=f).start(records.RATE, input_mean=0.0, output_mean=0.0).update
            ),
            lambda f=forgetting: timed(plain_online.Rls(LAGS, 200.0, 1.0, f).update),
            tolerance=1e-6 if forgetting == 1.0 else None,
            limit_s=SHARE * PERIOD_S,
        )
    yield Latency(
        "ALS update",
        f"{LAGS} taps, {UPDATES} updates",
        lambda: timed(Als(memory=memory).start(records.RATE, input_mean=0.0, output_mean=0.0).update),
        lambda: timed(plain_online.Als(LAGS, 0.2, _FLOOR).update),
        tolerance=1e-6,
        limit_s=SHARE * PERIOD_S,
    )
