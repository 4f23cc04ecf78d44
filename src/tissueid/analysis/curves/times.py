"""Plot of computing times by size."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tissueid.analysis.computing_times import Timing
from tissueid.analysis.curves.plot import Axis, Curve, Plot
from tissueid.language import marked
from tissueid.messages import Verbatim

_COLOURS, _MARKERS = ("measured", "good", "check", "muted", "poor"), "os^Dv"


def time_plot(found: Sequence[Timing], size: str) -> Plot:
    """Return seconds against size for each method (Chen 2010, Figs. 4.2 and 6.2a).

    Args:
        found: timings; those of this program are drawn in the colour of models.
        size: label of the abscissa.
    """
    curves = [
        Curve(
            np.array(one.sizes, np.float64),
            np.array(one.seconds),
            Verbatim(one.method),
            "model" if one.here else _COLOURS[place % len(_COLOURS)],
            marker=_MARKERS[place % len(_MARKERS)],
        )
        for place, one in enumerate(found)
    ]
    return Plot("", Axis(size, log=True), Axis(marked("Time"), "s", log=True), tuple(curves))


__all__ = ["time_plot"]
