"""Families of models, in order of complexity."""

from __future__ import annotations

from enum import StrEnum

from tissueid.language import marked


class Family(StrEnum):
    """Kind of model that an engine fits, in order of complexity; of equally good models the simpler is preferred.

    An engine declares its family by ``family: ClassVar[Family]``; the default is ``OTHER``, the last.
    """

    LINEAR = marked("linear")
    STATIC = marked("linear blocks and static nonlinearities")
    PARAMETRIC = marked("parameters that follow depth")
    DEPTH = marked("depth partitions")
    DIRECTION = marked("depth and direction partitions")
    KERNELS = marked("Volterra kernels")
    OTHER = marked("other")

    @property
    def rank(self) -> int:
        """Position in the order of complexity: 0 is the simplest."""
        return list(Family).index(self)

    @property
    def interpretability(self) -> str:
        """How well results of different tests can be compared as numbers (Chen 2010, Table 8.1)."""
        if self is Family.KERNELS:
            return marked("poor")
        return marked("not rated") if self is Family.OTHER else marked("good")
