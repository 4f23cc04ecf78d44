"""Stimuli that are generated while the test runs, from what it measures (Chen 2010, 6.3).

Set-points go out in blocks, a few blocks ahead of what was measured, because a cable lies between the two. The source
of a running test is the one thing here that changes; its specification is frozen like any other.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Self

from pydantic import Field, model_validator

from tissueid.language import marked
from tissueid.stimuli.base import Array, StimulusKind, check_rising

BLOCK = 50
"""Samples in a block of set-points: 25 ms at 2 kHz, the thesis' feedback cycle (6.3.1)."""


class FeedbackSource(ABC):
    """One stimulus under way: what was measured goes in, blocks of set-points come out. Reads no clock."""

    @abstractmethod
    def take(self, force: Array, position: Array, first: int) -> None:
        """Take in measured force (k,), N, and position (k,), m, in the order of time; NaN where a sample was lost.

        ``first`` is the number of the first of them, counted from the first set-point: negative during the preload.
        """

    @abstractmethod
    def next_block(self) -> Array:
        """The next ``BLOCK`` set-points, N, shape (BLOCK,), within the range of the specification."""

    @abstractmethod
    def report(self) -> dict[str, Any]:
        """What came of it so far, plain values fit for JSON."""


class FeedbackKind(StimulusKind):
    """The specification of a stimulus that is generated while the test runs."""

    seconds: float = Field(5.0, gt=0.0, le=600.0, description=marked("Length, s; the preload comes before it"))
    sample_rate: float = Field(2000.0, gt=0.0, le=1e6, description=marked("Samples a second"))
    seed: int = Field(
        0, ge=0, le=2**63 - 1, description=marked("The same seed and the same answers give the same samples")
    )
    lead: int = Field(
        3, ge=1, le=20, description=marked("Blocks by which the set-points are ahead of what was measured")
    )
    force_min_n: float = Field(0.0, ge=-100.0, le=100.0, description=marked("Least force that is ever asked for, N"))
    force_max_n: float = Field(
        10.0, ge=-100.0, le=100.0, description=marked("Greatest force that is ever asked for, N")
    )

    @model_validator(mode="after")
    def _range_holds(self) -> Self:
        check_rising("force", self.force_min_n, self.force_max_n, "N")
        return self

    @property
    @abstractmethod
    def preload_n(self) -> float:
        """The load, N, that is held before, and again when set-points fail to come."""

    @abstractmethod
    def start(self, surface_m: float) -> FeedbackSource:
        """A source for one test. ``surface_m`` is the position where the tissue begins."""
