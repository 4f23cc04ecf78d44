"""Plots of the results of engines, laid over each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tissueid.analysis.curves.plot import Curve, Plot
from tissueid.app.words import sentence
from tissueid.language import marked
from tissueid.messages import translated

if TYPE_CHECKING:
    from tissueid.analysis.curves.results import Panel

Array = NDArray[np.float64]
KERNELS = marked("Kernel image")
OUTPUT = marked("Model output")
DEPTH = marked("Against depth")
PICTURES: Mapping[str, tuple[Panel, ...]] = {
    OUTPUT: ("output", "residual"),
    marked("Impulse response"): ("impulse",),
    marked("Bode diagram"): ("magnitude", "phase", "coherence"),
    marked("Static nonlinearity"): ("nonlinearity",),
    DEPTH: ("mass", "damping", "stiffness"),
    marked("Residual tests"): ("autocorrelation", "cross"),
    KERNELS: (),
}


@dataclass(frozen=True, eq=False)
class PlotData:
    """Plots of one analysis; ``units`` holds the units of the panels that have one."""

    panels: dict[Panel, Plot] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    kernels: tuple[Plot, ...] = ()

    @property
    def empty(self) -> bool:
        """Whether there is nothing to draw."""
        return not self.kernels and not any(plot.parts for plot in self.panels.values())


def overlay(plots: Sequence[Plot], colours: Sequence[str], names: Sequence[str], *, same_data: bool) -> Plot:
    """Return the plots of several results in one.

    Args:
        plots: plots of the same panel; those without curves are left out.
        colours: colour of each result.
        names: name of each result in the key.
        same_data: whether all were fitted to the same data, whose measurement is then drawn once.
    """
    under: list[Curve] = []
    over: list[Curve] = []
    said: set[str] = set()
    for plot, colour, name in zip(plots, colours, names, strict=False):
        named = False
        for curve in plot.curves:
            text = "" if curve.name in said else curve.name
            said.add(curve.name)
            if curve.colour != "measured":
                own = name if not named and not curve.name else text
                named = named or not curve.name
                over.append(replace(curve, colour=colour, name=own))
            elif not same_data:
                under.append(replace(curve, colour=colour, name=text, opacity=0.3, width=2.0))
            elif not under:
                under.append(replace(curve, colour="muted", opacity=0.6, width=2.0))
        if not named:  # the key names every result
            over.append(Curve(np.zeros(0), np.zeros(0), name, colour))
    first = next((plot for plot in plots if plot.parts), None)
    if first is None:
        reasons = dict.fromkeys(sentence(translated(plot.missing)) for plot in plots if plot.missing)
        return replace(plots[0], parts=tuple(over), missing=" ".join(reasons))
    return replace(first, parts=(*under, *over))
