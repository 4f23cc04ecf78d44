"""Engines whose kernels depend on depth (``depth``), and on depth and direction of motion (``direction``)."""

from __future__ import annotations

from typing import ClassVar, Literal

from tissueid.identification.base import option
from tissueid.identification.model_family import Family
from tissueid.identification.partitions.fit import PartitionEngine
from tissueid.identification.registry import engine
from tissueid.language import marked


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
