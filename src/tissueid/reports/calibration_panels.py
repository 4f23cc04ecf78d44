"""Panels of a dynamic sweep: parameters and Bode diagrams by position, force constant by method (Fig. 2.12)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from matplotlib.figure import FigureBase

from tissueid.analysis.curves.calibration_plots import (
    Columns,
    Region,
    bode_plots,
    force_constant_plots,
    parameter_plots,
    sweep_repeat_plots,
)
from tissueid.language import _
from tissueid.messages import Message
from tissueid.reports.page import Panel, missing_panel
from tissueid.reports.plot_renderer import draw_plot, draw_plots, draw_row

NO_RESPONSES = Message("report.no_responses", "the calibration holds no frequency responses")


def sweep_panels(tables: Mapping[str, Columns], region: Region) -> Iterator[Panel]:
    """Yield all panels of a sweep from the tables of its calibration."""
    yield Panel(
        "parameters",
        _("The coil by position"),
        _("Variance accounted for, mass, damping and stiffness against the position on the stroke, with 95 % bars."),
        _(
            "Linear identification on the calibration spring at each position; the force is the force constant in "
            "use before the sweep times the current. Shaded: linear region. Bars: 95 %. Dotted: the ranges that the "
            "thesis gives for its instrument (Chen 2010, Table 2.1, Fig. 2.12a)."
        ),
        lambda figure: _draw_parameters(figure, tables["sweep"], region),
        height=4.6,
    )
    yield Panel(
        "force-constant",
        _("Force constant along the stroke"),
        _("Force constant against position by the spring, by flux linkage and by both, and their differences below."),
        _(
            "By the spring: from the balance of forces in all tests at once. By flux linkage: from voltage, current "
            "and position alone, without a spring. Points: from the stiffness at each position, averaged over the "
            "amplitude. Bands and bars: 95 % of the repeatability; an error in the scale of a method is not included. "
            "Dashed: ±5 % of the mean in the linear region."
        ),
        lambda figure: _draw_force_constant(figure, tables["force_constant"], tables["sweep"], region),
        height=5.0,
    )
    if "response" in tables:
        yield Panel(
            "bode",
            _("Bode diagrams by position"),
            _("Compliance and phase against frequency, one colour for each position: measured points, fitted lines."),
            _(
                "Points: measured, from the impulse responses. Lines: second-order systems. Middle: measured "
                "compliance relative to mid-stroke. The lower the position, the further the coil is inside the "
                "bearing (Chen 2010, Fig. 2.12b)."
            ),
            lambda figure: _draw_bode(figure, tables["response"], tables["sweep"]),
            height=6.0,
        )
    else:
        yield missing_panel("bode", _("Bode diagrams by position"), NO_RESPONSES)
    if "repeats" in tables:
        yield Panel(
            "repeats",
            _("Repeatability"),
            _("Force constant and ends of the linear region of each repeat of the sweep."),
            _("Each repeat of the whole sweep, analysed separately, relative to the mean of all repeats."),
            lambda figure: _draw_repeats(figure, tables["repeats"]),
            height=2.7,
        )


def _draw_parameters(figure: FigureBase, sweep: Columns, region: Region) -> None:
    """Draw VAF and mass over damping and stiffness."""
    grid = figure.subplots(2, 2, sharex=True)
    for axes, plot in zip(grid.flat, parameter_plots(sweep, region), strict=True):
        draw_plot(axes, plot)
    for axes in grid[0]:
        axes.set_xlabel("")


def _draw_force_constant(figure: FigureBase, profile: Columns, sweep: Columns, region: Region) -> None:
    """Draw the force constant by each method, and below it each relative to the combined estimate."""
    draw_plots(figure, force_constant_plots(profile, sweep, region), heights=(3.0, 2.0))


def _draw_bode(figure: FigureBase, response: Columns, sweep: Columns) -> None:
    """Draw compliance, compliance relative to mid-stroke, and phase by position."""
    draw_plots(figure, bode_plots(response, sweep))


def _draw_repeats(figure: FigureBase, columns: Columns) -> None:
    """Draw each repeat relative to the mean."""
    draw_row(figure, sweep_repeat_plots(columns))
