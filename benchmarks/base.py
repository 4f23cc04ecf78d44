"""What a benchmark is, and how two ways of doing one thing are timed against each other."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Comparison:
    """Two ways to one answer.

    ``agreement`` takes both answers and returns how far they differ, with ``tolerance`` its bound; ``floor`` is the
    least ratio of times that is promised, None where none is.
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
    def kept(self) -> bool:
        """True when the answers agree and the promised ratio is reached."""
        floor = self.comparison.floor
        return self.difference <= self.comparison.tolerance and (floor is None or self.ratio >= floor)


def run(comparison: Comparison) -> Outcome:
    """Time both ways in alternate blocks and take medians.

    Alternation lets whatever else the machine does fall on both; blocks let each run with its own data in cache.
    """
    difference = comparison.agreement(comparison.product(), comparison.plain())
    product: list[float] = []
    plain: list[float] = []
    for _ in range(comparison.blocks):
        product += [_seconds(comparison.product) for _ in range(comparison.runs_in_block)]
        plain += [_seconds(comparison.plain) for _ in range(comparison.runs_in_block)]
    return Outcome(comparison, statistics.median(product), statistics.median(plain), difference)


@dataclass(frozen=True)
class Latency:
    """One call, many times over: what matters is the slowest, and what is compared is each call alone.

    ``product`` and ``plain`` return the seconds of each call (n,) and the answers (n,). ``limit_s`` bounds the 99.9th
    percentile of the product's; ``tolerance`` the root-mean-square difference of the answers in units of theirs,
    None where the two are not meant to agree.
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
    """Median, 99th and 99.9th percentile, s, of both, each in its quietest block."""

    latency: Latency
    product_s: tuple[float, float, float]
    plain_s: tuple[float, float, float]
    difference: float

    @property
    def kept(self) -> bool:
        """True when the answers agree and the promised limit holds."""
        limit, tolerance = self.latency.limit_s, self.latency.tolerance
        agree = tolerance is None or self.difference <= tolerance
        return agree and (limit is None or self.product_s[2] <= limit)


def run_latency(latency: Latency) -> LatencyOutcome:
    """Time both in blocks and take the block with the smallest 99.9th percentile.

    Whatever else the machine does only ever adds: a process that takes the processor away for a moment would be
    measured otherwise.
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
