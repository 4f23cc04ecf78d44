"""Direction partitions: a kernel for every range of depth and each direction of motion."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from tissueid.identification.base import Engine
from tissueid.identification.model_family import Family
from tissueid.identification.partitions.cells import Breakpoints
from tissueid.identification.partitions.fit import PartitionChoice, fit_partitions
from tissueid.identification.partitions.model import PartitionedModel
from tissueid.identification.registry import engine
from tissueid.identification.second_order import HOLD_DESCRIPTION, HOLD_TITLE, Hold
from tissueid.language import marked
from tissueid.records import Record


@engine
class Direction(Engine):
    """Direction engine.

    Damping and stiffness in indentation and retraction are estimated together with kernels that depend on depth only,
    because the kernels of Eq. 5.3 cannot distinguish a damping from a stiffness that depends on direction. The mass is
    assumed to be equal in both directions.
    """

    name: ClassVar[str] = "direction"
    label: ClassVar[str] = marked("Direction")
    title: ClassVar[str] = marked(
        "Kernels that depend on depth and on whether the probe moves in or out (Chen 2010, 5.4, Eqs. 5.3-5.4)."
    )
    family: ClassVar[Family] = Family.DIRECTION

    memory: float = Field(0.06, gt=0.0, le=10.0, title=marked("Memory"), description=marked("Length of the kernels, s"))
    partitions: int = Field(
        5,
        ge=1,
        le=50,
        title=marked("Partitions"),
        description=marked("Number of depth partitions; there are twice as many kernels"),
    )
    breakpoints: Breakpoints = Field(
        "count",
        title=marked("Breakpoints"),
        description=marked("Partitions with equal counts of samples, or of equal width"),
    )
    breakpoints_m: tuple[float, ...] | None = Field(
        None,
        title=marked("Given breakpoints"),
        description=marked("Increasing positions of the cuts, m; replace the number of partitions"),
    )
    filter_hz: float | None = Field(
        50.0,
        gt=0.0,
        le=1e6,
        title=marked("Low-pass"),
        description=marked("Cutoff of the low-pass for the output that selects the partition"),
    )
    downsample: int | None = Field(
        None,
        ge=1,
        le=1000,
        title=marked("Downsampling"),
        description=marked("Samples between the lags of the kernels; from the input if not given"),
    )
    offset: Literal["common", "mean"] = Field(
        "common",
        title=marked("Offset"),
        description=marked("The force as measured (Eq. 5.3), or about its mean; all kernels share one offset"),
    )
    correct: bool = Field(
        True,
        title=marked("Bias correction"),
        description=marked(
            "Subtract the bias of the estimator, found on a simulated tissue with the estimated parameters"
        ),
    )
    hold: Hold = Field(
        "band-limited",
        title=HOLD_TITLE,
        description=HOLD_DESCRIPTION,
    )

    def fit(self, record: Record, fit_part: slice | None = None) -> PartitionedModel:
        """Fit the kernels to a record, or to a contiguous part of it.

        Raises:
            UnusableInputError: nothing varies, too few samples, a memory longer than the part, breakpoints outside the
                motion, or a partition with too few samples in one direction.
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
