"""Panels of a dynamic sweep: parameters and Bode diagrams by position, force constant by method (Fig. 2.12)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.ticker import MultipleLocator
from numpy.typing import NDArray

from tissueid.analysis.curves.plot import CONFIDENCE
from tissueid.identification.second_order import SecondOrder
from tissueid.language import _, marked
from tissueid.messages import Message
from tissueid.reports.panel_sheet import Panel, missing_panel
from tissueid.reports.panels import depth_bar, depth_colours, markers
from tissueid.reports.style import BLUE, DASHES, GREEN, INK, MUTED, ORANGE, SHADE, frequency_axis, log_axis

Columns = dict[str, NDArray[np.float64]]
LINEAR_SHARE = 0.05
"""Deviation from the plateau within which the force constant counts as constant."""
_FIT_POINTS = 200
NO_RESPONSES = Message("report.no_responses", "the calibration holds no frequency responses")


@dataclass(frozen=True)
class Region:
    """Linear region (m), its mean force constant, and the one that the instrument used before the sweep (N/A)."""

    min_m: float
    max_m: float
    plateau_n_per_a: float
    believed_n_per_a: float | None


def sweep_panels(tables: dict[str, Columns], region: Region) -> Iterator[Panel]:
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
        lambda figure: draw_parameters(figure, tables["sweep"], region),
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
        lambda figure: draw_force_constant(figure, tables["force_constant"], tables["sweep"], region),
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
            lambda figure: draw_bode(figure, tables["response"], tables["sweep"]),
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
            lambda figure: draw_repeats(figure, tables["repeats"]),
            height=2.7,
        )


def draw_parameters(figure: FigureBase, sweep: Columns, region: Region) -> None:
    """Draw VAF, mass, damping and stiffness against position (Chen 2010, Fig. 2.12a)."""
    shown = (
        ("vaf_percent", "", 1.0, marked("VAF (%)"), (95.0, 98.0)),
        ("mass_kg", "mass_std_kg", 1e3, marked("Mass (g)"), (60.0, 80.0)),
        ("damping_n_s_per_m", "damping_std_n_s_per_m", 1.0, marked("Damping (N·s/m)"), (3.0, 4.0)),
        ("stiffness_n_per_m", "stiffness_std_n_per_m", 1.0, marked("Stiffness (N/m)"), (1000.0, 1200.0)),
    )
    position = 1e3 * sweep["position_m"]
    grid = figure.subplots(2, 2, sharex=True)
    for axes, (name, std, scale, label, thesis) in zip(grid.flat, shown, strict=True):
        _shade(axes, region)
        for end in thesis:
            axes.axhline(end, color=MUTED, linewidth=0.9, linestyle=DASHES[2])
        values = scale * sweep[name]
        if std in sweep:
            axes.errorbar(
                position, values, CONFIDENCE * scale * sweep[std], color=BLUE, linestyle="none", linewidth=1.0
            )
        axes.plot(position, values, color=BLUE, linewidth=0.9, alpha=0.6)
        markers(axes, position, values, label="", colour=BLUE, marker="o")
        low, high = min(values.min(), thesis[0]), max(values.max(), thesis[1])
        axes.set_ylim(low - 0.08 * (high - low), high + 0.08 * (high - low))
        axes.set_ylabel(_(label))
        _stroke(axes)
        if axes in (grid[0, 0], grid[0, 1]):
            axes.set_xlabel("")


def draw_force_constant(figure: FigureBase, profile: Columns, sweep: Columns, region: Region) -> None:
    """Draw the force constant by each method (above), and each relative to the combined estimate (below)."""
    above, below = figure.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": (3, 2)})
    position, value = 1e3 * profile["position_m"], profile["value_n_per_a"]
    for axes in (above, below):
        _shade(axes, region)
    plateau = region.plateau_n_per_a
    for sign in (-1.0, 1.0):
        above.axhline((1.0 + sign * LINEAR_SHARE) * plateau, color=MUTED, linewidth=1.0, linestyle=DASHES[1])
    methods = (
        ("by_flux", _("by flux linkage"), ORANGE, DASHES[1]),
        ("by_spring", _("by the spring"), BLUE, DASHES[0]),
    )
    for name, label, colour, dashes in methods:
        if f"{name}_n_per_a" not in profile:
            continue
        found, reach = profile[f"{name}_n_per_a"], CONFIDENCE * profile[f"{name}_std_n_per_a"]
        above.plot(position, found, color=colour, linestyle=dashes, label=label)
        above.fill_between(position, found - reach, found + reach, color=colour, alpha=0.18, linewidth=0.0)
        off, band = 100.0 * (found / value - 1.0), 100.0 * reach / value
        below.plot(position, off, color=colour, linestyle=dashes)
        below.fill_between(position, off - band, off + band, color=colour, alpha=0.18, linewidth=0.0)
    if "force_constant_n_per_a" in sweep:
        at, points = 1e3 * sweep["position_m"], sweep["force_constant_n_per_a"]
        reach = CONFIDENCE * sweep["force_constant_std_n_per_a"]
        here = np.interp(at, position, value)
        off = 100 * reach / np.abs(here)
        for axes, values, bars in ((above, points, reach), (below, 100 * (points / here - 1), off)):
            axes.errorbar(at, values, bars, color=GREEN, linestyle="none", linewidth=1.0)
            markers(axes, at, values, label=_("by the stiffness at each position"), colour=GREEN, marker="s")
    above.plot(position, value, color=INK, linewidth=0.9, linestyle=DASHES[3], label=_("combined"))
    above.set_ylabel(_("Force constant (N per A)"))
    above.legend(loc="lower center", ncols=2)
    below.axhline(0.0, color=INK, linewidth=0.9, linestyle=DASHES[3])
    below.set_ylabel(_("From combined (%)"))
    above.label_outer()
    _stroke(below)


def draw_bode(figure: FigureBase, response: Columns, sweep: Columns) -> None:
    """Draw compliance, compliance relative to mid-stroke, and phase by position (Chen 2010, Fig. 2.12b)."""
    rows_of_axes = figure.subplots(3, 1, sharex=True)
    above, middle, below = rows_of_axes
    places = np.unique(response["position_m"])
    centre = response["position_m"] == places[int(np.argmin(np.abs(places - np.mean(places))))]
    lowest, highest = float(response["frequency_hz"].min()), float(response["frequency_hz"].max())
    for place, colour in zip(places, depth_colours(places.size), strict=True):
        rows = response["position_m"] == place
        hz, compliance = response["frequency_hz"][rows], response["compliance_m_per_n"][rows]
        row = int(np.argmin(np.abs(sweep["position_m"] - place)))
        system = SecondOrder(*(float(sweep[n][row]) for n in ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m")))
        fit_hz = np.geomspace(lowest, highest, _FIT_POINTS)
        fitted = system.frequency_response(fit_hz)
        phase = np.degrees(np.unwrap(np.angle(fitted)))
        for axes, line, points in (
            (above, 1e3 * np.abs(fitted), 1e3 * compliance),
            (below, phase, np.degrees(response["phase_rad"][rows])),
        ):
            axes.plot(fit_hz, line, color=colour, linewidth=0.9)
            axes.plot(hz, points, color=colour, linestyle="none", marker=".", markersize=3.0, markeredgewidth=0.0)
        middle.plot(hz, 100.0 * compliance / response["compliance_m_per_n"][centre], color=colour, linewidth=0.9)
    log_axis(above)
    above.set_ylabel(_("Compliance (mm/N)"))
    middle.set_ylabel(_("Of mid-stroke (%)"))
    below.set_ylabel(_("Phase (°)"))
    below.set_ylim(-200.0, 20.0)
    below.yaxis.set_major_locator(MultipleLocator(45.0))
    frequency_axis(below, lowest, highest)
    for axes in rows_of_axes:
        axes.label_outer()
        depth_bar(axes, 1e3 * float(places.min()), 1e3 * float(places.max()), _("Position (mm)"))


def draw_repeats(figure: FigureBase, columns: Columns) -> None:
    """Draw each repeat relative to the mean: force constant in percent, ends of the linear region in millimetres."""
    left, right = figure.subplots(1, 2)
    run, constant = columns["run"], columns["force_constant_n_per_a"]
    left.axhline(0.0, color=MUTED, linewidth=0.9)
    markers(left, run, 100.0 * (constant / constant.mean() - 1.0), label="", colour=BLUE, marker="o")
    left.set_ylabel(_("Force constant, from the mean (%)"))
    right.axhline(0.0, color=MUTED, linewidth=0.9)
    for name, label, colour, marker in (
        ("linear_region_min_m", _("beginning"), ORANGE, "s"),
        ("linear_region_max_m", _("end"), GREEN, "^"),
    ):
        ends = columns[name]
        markers(right, run, 1e3 * (ends - ends.mean()), label=label, colour=colour, marker=marker)
    right.set_ylabel(_("Linear region, from the mean (mm)"))
    right.legend(loc="upper right", ncols=2)
    for axes in (left, right):
        axes.set_xlabel(_("Sweep"))
        axes.xaxis.get_major_locator().set_params(integer=True)


def _shade(axes: Axes, region: Region) -> None:
    axes.axvspan(1e3 * region.min_m, 1e3 * region.max_m, color=SHADE, zorder=0)


def _stroke(axes: Axes) -> None:
    axes.set_xlabel(_("Position (mm)"))
    axes.set_xlim(0.0, 32.0)
    axes.xaxis.set_major_locator(MultipleLocator(4.0))
