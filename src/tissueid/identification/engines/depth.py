"""Depth partitions: a kernel for every stretch of depth, and mass, damping and stiffness against depth."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from tissueid.identification.base import Engine
from tissueid.identification.family import Family
from tissueid.identification.partitions.cells import Breakpoints
from tissueid.identification.partitions.fit import Offset, PartitionChoice, fit_partitions
from tissueid.identification.partitions.model import PartitionedModel
from tissueid.identification.registry import engine
from tissueid.identification.second_order import Hold
from tissueid.records import Record


@engine
class Depth(Engine):
    """Kernels that depend on depth (Chen 2010, 5.1-5.3).

    Assumes that the dynamics depend on where the probe is, not on how it came there, that the output rises or falls
    with the input throughout, and a response that is over within ``memory``.
    """

    name: ClassVar[str] = "depth"
    family: ClassVar[Family] = Family.DEPTH

    memory: float = Field(0.06, gt=0.0, le=10.0, description="How long the kernels last, s")
    partitions: int = Field(7, ge=1, le=100, description="Stretches of depth")
    breakpoints: Breakpoints = Field(
        "count", description="Cut depth so that every partition has as many samples, or is as wide"
    )
    breakpoints_m: tuple[float, ...] | None = Field(
        None, description="Positions to cut at, rising, m; in place of the number of partitions"
    )
    filter_hz: float | None = Field(
        None,
        gt=0.0,
        le=1e6,
        description="Cutoff of the low-pass that the output passes before it chooses a partition; none when not given",
    )
    downsample: int | None = Field(
        None, ge=1, le=1000, description="Samples between the lags of the kernels; chosen by the input when not given"
    )
    offset: Offset = Field(
        "auto",
        description="One offset and the force as measured (common, Eq. 5.1), one offset and the force about its mean, "
        "or a linear model with an offset of its own for each partition; auto takes that for stepped records",
    )
    correct: bool = Field(
        True, description="Take off the bias that the estimator shows on a tissue simulated with what it found"
    )
    hold: Hold = Field(
        "band-limited",
        description="What the input does between samples: a measured force is band-limited, a command is held",
    )

    def fit(self, record: Record, fit_part: slice | None = None) -> PartitionedModel:
        """Fit the kernels to a record, or to a contiguous part of it.

        Raises:
            UnusableInputError: nothing varies, too few samples, a memory longer than the part, breakpoints that do not
                cut the motion, or a partition that was hardly visited.
        """
        choice = PartitionChoice(
            memory=self.memory,
            partitions=self.partitions,
            breakpoints=self.breakpoints,
            breakpoints_m=self.breakpoints_m,
            filter_hz=self.filter_hz,
            downsample=self.downsample,
            offset=self.offset,
            correct=self.correct,
            hold=self.hold,
            directional=False,
        )
        return fit_partitions(self.name, self.options(), choice, record, fit_part)
