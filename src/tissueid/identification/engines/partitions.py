"""Engines whose kernels depend on depth (``depth``), and on depth and direction of motion (``direction``)."""

from __future__ import annotations

from typing import ClassVar, Literal

from tissueid.identification.base import option
from tissueid.identification.memory import MemoryEngine
from tissueid.identification.model_family import Family
from tissueid.identification.partitions.cells import Breakpoints
from tissueid.identification.partitions.fit import Offset, fit_partitions
from tissueid.identification.partitions.model import PartitionedModel
from tissueid.identification.registry import engine
from tissueid.language import marked
from tissueid.records import Record


class PartitionEngine(MemoryEngine):
    """Options and fit that both engines share."""

    directional: ClassVar[bool]
    usual_memory_s: ClassVar[float] = 0.06
    memory_margin: ClassVar[float] = 1.0

    partitions: int = option(7, marked("Partitions"), marked("Number of depth partitions"), ge=1, le=100)
    breakpoints: Breakpoints = option(
        "count", marked("Breakpoints"), marked("Partitions with equal counts of samples, or of equal width")
    )
    breakpoints_m: tuple[float, ...] | None = option(
        None,
        marked("Given breakpoints"),
        marked("Increasing positions of the cuts, m; replace the number of partitions"),
    )
    filter_hz: float | None = option(
        None,
        marked("Low-pass"),
        marked("Cutoff of the low-pass for the output that selects the partition; no low-pass if not given"),
        gt=0.0,
        le=1e6,
    )
    downsample: int | None = option(
        None,
        marked("Downsampling"),
        marked("Samples between the lags of the kernels; from the input if not given"),
        ge=1,
        le=1000,
    )
    offset: Offset = option(
        "auto",
        marked("Offset"),
        marked(
            "One offset and the force as measured (common, Eq. 5.1), one offset and the force about its mean (mean), "
            "or a linear model with an offset for each partition (partition); auto uses partition for stepped records"
        ),
    )
    correct: bool = option(
        True,
        marked("Bias correction"),
        marked("Subtract the bias of the estimator, found on a simulated tissue with the estimated parameters"),
    )

    def fit(self, record: Record, fit_part: slice | None = None) -> PartitionedModel:
        """Fit the kernels to a record, or to a contiguous part of it.

        Raises:
            UnusableInputError: nothing varies, or too few samples for the memory and the partitions.
        """
        return fit_partitions(self, record, fit_part)


@engine
class Depth(PartitionEngine):
    """Depth engine.

    Assumes that the dynamics depend on the position of the probe but not on its history, that the output is a monotone
    function of the input in steady state, and that the response decays within ``memory``.
    """

    name: ClassVar[str] = "depth"
    label: ClassVar[str] = marked("Depth")
    title: ClassVar[str] = marked("Kernels that depend on depth (Chen 2010, 5.1-5.3).")
    family: ClassVar[Family] = Family.DEPTH
    directional: ClassVar[bool] = False


@engine
class Direction(PartitionEngine):
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
    directional: ClassVar[bool] = True

    partitions: int = option(
        5, marked("Partitions"), marked("Number of depth partitions; there are twice as many kernels"), ge=1, le=50
    )
    filter_hz: float | None = option(
        50.0,
        marked("Low-pass"),
        marked("Cutoff of the low-pass for the output that selects the partition"),
        gt=0.0,
        le=1e6,
    )
    offset: Literal["common", "mean"] = option(  # type: ignore[assignment]  # fewer choices than the base
        "common",
        marked("Offset"),
        marked("The force as measured (Eq. 5.3), or about its mean; all kernels share one offset"),
    )
