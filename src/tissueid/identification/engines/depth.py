"""Depth partitions: a kernel for every range of depth, and mass, damping and stiffness against depth."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from tissueid.identification.base import Engine
from tissueid.identification.model_family import Family
from tissueid.identification.partitions.cells import Breakpoints
from tissueid.identification.partitions.fit import Offset, PartitionChoice, fit_partitions
from tissueid.identification.partitions.model import PartitionedModel
from tissueid.identification.registry import engine
from tissueid.identification.second_order import HOLD_DESCRIPTION, HOLD_TITLE, Hold
from tissueid.language import marked
from tissueid.records import Record


@engine
class Depth(Engine):
    """Depth engine.

    Assumes that the dynamics depend on the position of the probe but not on its history, that the output is a monotone
    function of the input in steady state, and that the response decays within ``memory``.
    """

    name: ClassVar[str] = "depth"
    label: ClassVar[str] = marked("Depth")
    title: ClassVar[str] = marked("Kernels that depend on depth (Chen 2010, 5.1-5.3).")
    family: ClassVar[Family] = Family.DEPTH

    memory: float = Field(0.06, gt=0.0, le=10.0, title=marked("Memory"), description=marked("Length of the kernels, s"))
    partitions: int = Field(
        7, ge=1, le=100, title=marked("Partitions"), description=marked("Number of depth partitions")
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
        None,
        gt=0.0,
        le=1e6,
        title=marked("Low-pass"),
        description=marked(
            "Cutoff of the low-pass for the output that selects the partition; no low-pass if not given"
        ),
    )
    downsample: int | None = Field(
        None,
        ge=1,
        le=1000,
        title=marked("Downsampling"),
        description=marked("Samples between the lags of the kernels; from the input if not given"),
    )
    offset: Offset = Field(
        "auto",
        title=marked("Offset"),
        description=marked(
            "One offset and the force as measured (common, Eq. 5.1), one offset and the force about its mean (mean), "
            "or a linear model with an offset for each partition (partition); auto uses partition for stepped records"
        ),
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
                motion, or a partition with too few samples.
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
