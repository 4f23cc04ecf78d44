"""Stimuli that are generated during the test from the measured signals (Chen 2010, 6.3).

Set-points are sent in blocks, a few blocks ahead of the measurement because of the transport delay. A
:class:`FeedbackSource` is stateful; its specification is frozen like any other.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Self

from pydantic import Field, model_validator

from tissueid.language import marked
from tissueid.stimuli.base import Array, StimulusKind, check_range_order

BLOCK = 50
"""Samples in a block of set-points: 25 ms at 2 kHz, the thesis' feedback cycle (6.3.1)."""


class FeedbackSource(ABC):
    """Generator of one stimulus: takes measured samples and returns blocks of set-points. Reads no clock."""

    @abstractmethod
    def take(self, force: Array, position: Array, first: int) -> None:
        """Process measured force (k,), N, and position (k,), m, in time order; NaN where a sample was lost.

        ``first`` is the index of the first sample relative to the first set-point: negative during the preload.
        """

    @abstractmethod
    def next_block(self) -> Array:
        """Return the next set-points, N, shape (BLOCK,), within the force range of the specification."""

    @abstractmethod
    def report(self) -> dict[str, Any]:
        """Return the results so far as plain values, JSON-serialisable."""


class FeedbackKind(StimulusKind):
    """Specification of a stimulus that is generated during the test."""

    seconds: float = Field(5.0, gt=0.0, le=600.0, description=marked("Length without the preload, s"))
    sample_rate: float = Field(2000.0, gt=0.0, le=1e6, description=marked("Sample rate, Hz"))
    seed: int = Field(
        0,
        ge=0,
        le=2**63 - 1,
        description=marked("Random seed: the same seed and the same measurements give the same samples"),
    )
    lead: int = Field(
        3, ge=1, le=20, description=marked("Number of blocks by which the set-points precede the measurement")
    )
    force_min_n: float = Field(0.0, ge=-100.0, le=100.0, description=marked("Lower limit of the set-points, N"))
    force_max_n: float = Field(10.0, ge=-100.0, le=100.0, description=marked("Upper limit of the set-points, N"))

    @model_validator(mode="after")
    def _check_range(self) -> Self:
        check_range_order("force", self.force_min_n, self.force_max_n, "N")
        return self

    @property
    @abstractmethod
    def preload_n(self) -> float:
        """Load, N, of the preload, also applied when set-points are missing."""

    @abstractmethod
    def start(self, surface_m: float) -> FeedbackSource:
        """Return a source for one test. ``surface_m`` is the position of the tissue surface, m."""
