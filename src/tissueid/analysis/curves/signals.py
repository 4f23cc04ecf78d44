"""Plots of recorded signals of several tests over each other: against time, and their power spectra."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tissueid.analysis.curves.plot import Array, Axis, Curve, Plot
from tissueid.analysis.curves.units import FREQUENCY
from tissueid.language import marked
from tissueid.units import display_unit

_DECADES = 9.0
"""Decades below the maximum that are shown of a spectrum; lower values are rounding errors."""
_TIME = marked("Time from the start of the test")
TOO_SHORT = marked("Too few samples for a spectrum.")
Lines = Sequence[tuple[Array, Array] | None]
"""Abscissa and ordinate of each test; None for a test without the signal."""


def time_plot(
    title: str, si_unit: str, lines: Lines, colours: Sequence[str], names: Sequence[str], ends_s: tuple[float, float]
) -> Plot:
    """Return one signal, in ``si_unit``, of several tests against time (s) between two times."""
    unit, scale = display_unit(si_unit)
    every = zip(lines, colours, names, strict=False)
    curves = [Curve(line[0], scale * line[1], name, colour, width=0.6) for line, colour, name in every if line]
    time = Axis(_TIME, "s", limits=ends_s)
    return Plot(title, time, Axis(title, unit), tuple(curves))


def spectrum_plot(title: str, si_unit: str, spectra: Lines, colours: Sequence[str], names: Sequence[str] = ()) -> Plot:
    """Return power densities against frequency (Hz), of a signal in ``si_unit``, down to a share of the largest."""
    unit, scale = display_unit(si_unit)
    curves = []
    for place, (found, colour) in enumerate(zip(spectra, colours, strict=False)):
        if found is None or not found[1].size or not found[1].max() > 0.0:
            continue
        frequency_hz, density = found
        shown = np.maximum(density, density.max() * 10.0**-_DECADES)
        name = names[place] if place < len(names) else ""
        curves.append(Curve(frequency_hz, scale**2 * shown, name, colour, width=0.8))
    density_axis = Axis(title, f"{unit}²/Hz" if unit else "1/Hz", log=True)
    missing = TOO_SHORT if not curves and any(found is not None for found in spectra) else ""
    return Plot(title, FREQUENCY, density_axis, tuple(curves), missing=missing)


__all__ = ["TOO_SHORT", "spectrum_plot", "time_plot"]
