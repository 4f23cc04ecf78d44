"""What a benchmark is, and how two ways of doing one thing are timed against each other."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


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


def _seconds(work: Callable[[], Any]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start
