"""Families of descriptions, from the simplest to the richest."""

from __future__ import annotations

from enum import StrEnum


class Family(StrEnum):
    """What kind of description an engine gives, in the order in which simpler ones are preferred.

    An engine declares its family by ``family: ClassVar[Family]``; one that does not is ``OTHER``, the last.
    """

    LINEAR = "linear"
    STATIC = "linear blocks and static nonlinearities"
    PARAMETRIC = "parameters that follow depth"
    DEPTH = "depth partitions"
    DIRECTION = "depth and direction partitions"
    KERNELS = "Volterra kernels"
    OTHER = "other"

    @property
    def rank(self) -> int:
        """Place among the families: 0 is the simplest."""
        return list(Family).index(self)

    @property
    def interpretability(self) -> str:
        """How well answers on different tests can be compared as numbers (Chen 2010, Table 8.1)."""
        return {Family.KERNELS: "poor", Family.OTHER: "not rated"}.get(self, "good")
