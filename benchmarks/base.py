"""Benchmarks and their timing: comparisons of two implementations, and latencies of single calls."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Comparison:
    """Two implementations with the same result.

    ``agreement`` returns the difference of the two results, with ``tolerance`` as its bound; ``floor`` is the smallest
    permitted ratio of times, None without a target.
    """

    title: str
    setting: str
    product: Callable[[], Any]
    plain: Callable[[], Any]
    agreement: Callable[[Any, Any], float]
    tolerance: float
    floor: float | None = None
    blocks: int = 3
    runs_in_block: int = 3


@dataclass(frozen=True)
class Outcome:
    comparison: Comparison
    product_s: float
    plain_s: float
    difference: float

    @property
    def ratio(self) -> float:
        return self.plain_s / self.product_s

    @property
    def passed(self) -> bool:
        """Whether the results agree and the ratio reaches its target."""
        floor = self.comparison.floor
        return self.difference <= self.comparison.tolerance and (floor is None or self.ratio >= floor)


def run(comparison: Comparison) -> Outcome:
    """Time both implementations in alternate blocks and take the fastest run of each.

    Other load on the machine can only increase a duration, and delays long runs more often than short ones: a ratio of
    medians would depend on it. Within a block each implementation runs with its own data in the cache.
    """
    difference = comparison.agreement(comparison.product(), comparison.plain())
    product: list[float] = []
    plain: list[float] = []
    for _ in range(comparison.blocks):
        product += [_seconds(comparison.product) for _ in range(comparison.runs_in_block)]
        plain += [_seconds(comparison.plain) for _ in range(comparison.runs_in_block)]
    return Outcome(comparison, min(product), min(plain), difference)


@dataclass(frozen=True)
class Latency:
    """Duration of a single call, over many calls.

    ``product`` and ``plain`` return the seconds of each call (n,) and the results (n,). ``limit_s`` bounds the 99.9th
    percentile of the product; ``tolerance`` bounds the root-mean-square difference of the results relative to those of
    ``plain``; None if the results need not agree.
    """

    title: str
    setting: str
    product: Callable[[], tuple[Array, Array]]
    plain: Callable[[], tuple[Array, Array]]
    tolerance: float | None
    limit_s: float | None = None
    blocks: int = 5
    plain_blocks: int = 2


@dataclass(frozen=True)
class LatencyOutcome:
    """Median, 99th and 99.9th percentile, s, of both, each in its fastest block."""

    latency: Latency
    product_s: tuple[float, float, float]
    plain_s: tuple[float, float, float]
    difference: float

    @property
    def passed(self) -> bool:
        """Whether the results agree and the limit holds."""
        limit, tolerance = self.latency.limit_s, self.latency.tolerance
        agree = tolerance is None or self.difference <= tolerance
        return agree and (limit is None or self.product_s[2] <= limit)


def run_latency(latency: Latency) -> LatencyOutcome:
    """Time both in blocks and take the block with the smallest 99.9th percentile.

    Other load on the machine can only increase a duration; the fastest block is the least affected.
    """
    product = [latency.product() for _ in range(latency.blocks)]
    plain = [latency.plain() for _ in range(latency.plain_blocks)]
    ours, theirs = product[0][1], plain[0][1]
    return LatencyOutcome(
        latency,
        _quietest([seconds for seconds, _ in product]),
        _quietest([seconds for seconds, _ in plain]),
        float(np.sqrt(np.mean((ours - theirs) ** 2) / np.mean(theirs**2))),
    )


def _quietest(blocks: list[Array]) -> tuple[float, float, float]:
    percentiles = [np.percentile(seconds, [50.0, 99.0, 99.9]) for seconds in blocks]
    median, high, highest = min(percentiles, key=lambda block: float(block[2]))
    return float(median), float(high), float(highest)


def _seconds(work: Callable[[], Any]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start
