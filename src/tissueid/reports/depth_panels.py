"""Panels of mass, damping and stiffness against depth, of one engine or of several on the same axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase

from tissueid.analysis.curves.depth import profile_plots
from tissueid.analysis.curves.plot import Array, Plot
from tissueid.identification.depth_profile import DepthProfile
from tissueid.reports.plot_renderer import draw_plot, key_over
from tissueid.reports.style import FULL_WIDTH, SHADE, drawing, new_figure


@drawing
def depth_panels(
    profiles: Mapping[str, DepthProfile], surface_position_m: float = float("nan"), visited: Array | None = None
) -> Figure:
    """Return a figure of the depth panels; arguments as :func:`draw_depth_panels`.

    Raises:
        UnusableInputError: no row holds a value.
    """
    figure = new_figure(FULL_WIDTH, 4.3)
    draw_depth_panels(figure, profiles, surface_position_m, visited)
    return figure


def draw_depth_panels(
    figure: FigureBase,
    profiles: Mapping[str, DepthProfile],
    surface_position_m: float = float("nan"),
    visited: Array | None = None,
) -> None:
    """Draw mass, damping and stiffness against depth with 95 % bars or bands (Chen 2010, Figs. 5.9 to 5.11).

    Args:
        figure: the figure to draw into.
        profiles: profiles by legend label.
        surface_position_m: origin of depth, m; NaN to show positions on the actuator.
        visited: output (n,), m, whose distribution is drawn below; None for the support of the profiles.

    Raises:
        UnusableInputError: no row holds a value.
    """
    *quantities, samples = profile_plots(profiles, surface_position_m, visited)
    key_over(figure, draw_over_samples(figure, quantities, samples)[0])


def draw_over_samples(figure: FigureBase, plots: Sequence[Plot], samples: Plot, *, key: bool = False) -> list[Axes]:
    """Draw plots next to each other and the number of samples below each; return the axes of the plots.

    Args:
        figure: the figure to draw into.
        plots: plots over the same abscissa as ``samples``.
        samples: bars of the number of samples.
        key: whether plots with several named curves get a key.
    """
    grid = np.atleast_2d(figure.subplots(2, len(plots), sharex=True, height_ratios=(3.2, 1.0)))
    for axes, plot in zip(grid[0], plots, strict=True):
        draw_plot(axes, plot, key=key and sum(bool(curve.name) for curve in plot.curves) > 1)
        axes.set_xlabel("")
    for axes in grid[1]:
        draw_plot(axes, samples)
        axes.set_facecolor(SHADE)
        axes.locator_params(axis="y", nbins=3)
        axes.set_ylabel("" if axes is not grid[1, 0] else axes.get_ylabel())
    figure.align_ylabels()
    return list(grid[0])
