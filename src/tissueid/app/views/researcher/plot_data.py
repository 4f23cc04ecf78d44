"""Plot data of an analysis: decimated lines, and kernels in display units."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from tissueid.analysis.curves import Plot

Array = NDArray[np.float64]

Panel = Literal[
    "output",
    "residual",
    "impulse",
    "magnitude",
    "phase",
    "coherence",
    "nonlinearity",
    "mass",
    "damping",
    "stiffness",
    "autocorrelation",
    "cross",
]
"""A plot, whatever is laid over another in it."""


@dataclass(frozen=True, eq=False)
class Line:
    """One curve; all arrays have shape (n,). ``low`` and ``high`` bound an optional band.

    ``out_x`` and ``out_y`` (m,) are a second curve, drawn faint: over depth that of the way out of the tissue, where it
    differs; of a model's output that of the simulation scheduled by the measured output. ``dots`` says that points
    stand for themselves, and no line joins them.
    """

    x: Array
    y: Array
    low: Array | None = None
    high: Array | None = None
    out_x: Array | None = None
    out_y: Array | None = None
    dots: bool = False


@dataclass(frozen=True, eq=False)
class PlotData:
    """Plot data of one analysis; ``units`` holds the units of the panels that have one.

    ``missing`` says in words why a panel has no line; ``measured`` is the measurement that a panel's line is laid over.
    """

    lines: dict[Panel, Line]
    units: dict[Panel, str]
    kernels: tuple[Plot, ...]
    missing: dict[Panel, str]
    measured: dict[Panel, Line] = field(default_factory=dict)


__all__ = ["Array", "Line", "Panel", "PlotData"]
