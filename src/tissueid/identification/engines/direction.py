"""Direction partitions: a kernel for every stretch of depth and either direction."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from tissueid.identification.base import Engine
from tissueid.identification.family import Family
from tissueid.identification.partitions.cells import Breakpoints
from tissueid.identification.partitions.fit import PartitionChoice, fit_partitions
from tissueid.identification.partitions.model import PartitionedModel
from tissueid.identification.registry import engine
from tissueid.identification.second_order import Hold
from tissueid.records import Record


@engine
class Direction(Engine):
    """Kernels that depend on depth and on whether the probe moves in or out (Chen 2010, 5.4, Eqs. 5.3-5.4).

    Damping on the way in and on the way out is found beside kernels of depth alone, as those of Eq. 5.3 mix a damping
    that depends on the direction with a stiffness that does. Mass and stiffness are taken to be the same both ways.
    """

    name: ClassVar[str] = "direction"
    family: ClassVar[Family] = Family.DIRECTION

    memory: float = Field(0.06, gt=0.0, le=10.0, description="How long the kernels last, s")
    partitions: int = Field(5, ge=1, le=50, description="Stretches of depth; there are twice as many kernels")
    breakpoints: Breakpoints = Field(
        "count", description="Cut depth so that every partition has as many samples, or is as wide"
    )
    breakpoints_m: tuple[float, ...] | None = Field(
        None, description="Positions to cut at, rising, m; in place of the number of partitions"
    )
    filter_hz: float | None = Field(
        50.0, gt=0.0, le=1e6, description="Cutoff of the low-pass that the output passes before it chooses a partition"
    )
    downsample: int | None = Field(
        None, ge=1, le=1000, description="Samples between the lags of the kernels; chosen by the input when not given"
    )
    offset: Literal["common", "mean"] = Field(
        "common", description="The force as measured (Eq. 5.3), or about its mean; all kernels share one offset"
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
                cut the motion, or a partition that was hardly visited in one direction.
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
            directional=True,
        )
        return fit_partitions(self.name, self.options(), choice, record, fit_part)
