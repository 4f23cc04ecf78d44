"""Report of a calibration: static (lines with residuals, every value) or dynamic sweep (the coil by position)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial

import numpy as np
from matplotlib.figure import FigureBase
from numpy.typing import NDArray

from tissueid.analysis.curves.calibration_plots import (
    REPEATED,
    Columns,
    Region,
    bode_plots,
    force_constant_plots,
    line_plots,
    parameter_plots,
    static_repeat_plot,
    sweep_repeat_plots,
)
from tissueid.calibration.comparison import Residuals, residuals
from tissueid.calibration.file import CalibratedQuantity, Calibration
from tissueid.calibration.status import headline_of, label_of, notes_of, problems_of, readable, verdict_of
from tissueid.errors import UnusableInputError
from tissueid.formatting import fixed, number
from tissueid.language import _, marked
from tissueid.messages import Message, translated
from tissueid.reports.page import Panel, missing_panel
from tissueid.reports.plot_renderer import draw_plot, draw_plots, draw_row, key_over
from tissueid.reports.stimulus_page import StimulusReport
from tissueid.reports.tables import Table, named_text, readable_date

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
        lambda figure: draw_plots(
            figure, force_constant_plots(tables["force_constant"], tables["sweep"], region), heights=(3.0, 2.0)
        ),
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
            lambda figure: draw_plots(figure, bode_plots(tables["response"], tables["sweep"])),
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
            lambda figure: draw_row(figure, sweep_repeat_plots(tables["repeats"])),
            height=2.7,
        )


def _draw_parameters(figure: FigureBase, sweep: Columns, region: Region) -> None:
    """Draw VAF and mass over damping and stiffness."""
    grid = figure.subplots(2, 2, sharex=True)
    for axes, plot in zip(grid.flat, parameter_plots(sweep, region), strict=True):
        draw_plot(axes, plot)
    for axes in grid[0]:
        axes.set_xlabel("")


_GROUPS = (
    (marked("Voltage to current"), ("coil_resistance", "current_", "voltage_")),
    (marked("Current to force"), ("force_", "calibration_relative", "spring_", "hysteresis")),
    (marked("Position and range of motion"), ("position_", "stroke_", "carrying_", "moving_")),
    (marked("Thermometer and accelerometer"), ("temperature_", "heat_", "acceleration_", "gravity_")),
    (marked("Supplies, noise and mains"), ("supply_", "noise_", "mains_")),
    (marked("Other quantities"), ("",)),
)


def static_report(calibration: Calibration) -> StimulusReport:
    """Return the report of a static calibration.

    Raises:
        UnusableInputError: the calibration is of another kind.
    """
    if calibration.kind != "static":
        raise UnusableInputError(
            "report.not_static", "this is not a static calibration but one of kind {kind}", kind=calibration.kind
        )
    return StimulusReport(
        title=_("Static calibration of {model}, {serial}").format(
            model=calibration.model, serial=calibration.serial_number
        ),
        facts=calibration_facts(calibration),
        headline=translated(headline_of(calibration)),
        level="poor" if calibration.verdict == "failed" else "good",
        concerns=tuple(translated(line) for line in problems_of(calibration) + notes_of(calibration)),
        summary=(
            _(
                "Force is the force constant times the current, after the zero offset of the current channel is "
                "subtracted. Volts and amperes are the readings of the channels: a gain error of the current channel "
                "is contained in the force constant and the resistance."
            ),
        ),
        tables=tuple(_static_tables(calibration)),
        panels=tuple(_panels(calibration)),
    )


def calibration_facts(calibration: Calibration) -> tuple[tuple[str, str], ...]:
    """Return date, validity, firmware and software of a calibration as label and value."""
    return (
        (_("Date"), readable_date(calibration.date)),
        (_("Valid for"), _("{days} days").format(days=calibration.valid_days)),
        (_("Firmware"), calibration.firmware_version or _("not reported")),
        (_("Software"), calibration.software),
    )


def quantity_row(name: str, quantity: CalibratedQuantity) -> tuple[str, str, str]:
    """Return label, value with its deviation, and unit of a quantity of a calibration."""
    label, value, unit = readable(name, quantity)
    return translated(label), value, _(unit)


def condition_rows(calibration: Calibration) -> tuple[tuple[str, str], ...]:
    """Return the conditions of a calibration as label and value, without its notes."""
    return tuple(
        named_text(name, value) for name, value in calibration.conditions.items() if not name.startswith("note_")
    )


def _static_tables(calibration: Calibration) -> list[Table]:
    tables = []
    rest = dict(calibration.quantities)
    for caption, begins in _GROUPS:
        rows = tuple(quantity_row(name, rest.pop(name)) for name in [*rest] if name.startswith(begins))
        if rows:
            tables.append(Table(_(caption), (_("Quantity"), _("Value"), _("Unit")), rows))
    if "repeats" in calibration.tables:
        tables.append(_repeats_table(calibration.tables["repeats"]))
    return [*tables, Table(_("Conditions"), (), condition_rows(calibration))]


def _repeats_table(columns: dict[str, tuple[float, ...]]) -> Table:
    rows = []
    for name in REPEATED:
        if name in columns:
            values = np.array(columns[name])
            spread = float(np.std(values, ddof=1)) / abs(float(values.mean()))
            reach = float(np.ptp(values)) / abs(float(values.mean()))
            rows.append((translated(label_of(name)), number(100.0 * spread, 2), number(100.0 * reach, 2)))
    runs = len(columns["run"])
    head = (_("Quantity"), _("Standard deviation (%)"), _("Peak to peak (%)"))
    return Table(_("Repeatability over {runs} runs").format(runs=runs), head, tuple(rows))


def _panels(calibration: Calibration) -> list[Panel]:
    panels = []
    for line in residuals(calibration):
        heading, alt, caption = map(_, _LINES[line.table])
        panels.append(Panel(line.table, heading, alt, caption, partial(_draw_line, line=line), height=2.9))
    if "repeats" in calibration.tables:
        columns = {name: np.array(values) for name, values in calibration.tables["repeats"].items()}

        def draw(figure: FigureBase) -> None:
            axes = figure.subplots()
            draw_plot(axes, static_repeat_plot(columns), key=False)
            key_over(figure, axes)

        panels.append(
            Panel(
                "repeats",
                _("Repeatability"),
                _("Deviation of each repeat from the mean, in percent, for resistance, force constant and gains."),
                _("Every run of the calibration relative to the mean of all runs."),
                draw,
                height=2.9,
            )
        )
    return panels


_LINES = {
    "electrical": (
        marked("Voltage to current"),
        marked("Current against voltage at every steady level with the fitted line, and the residuals of the levels."),
        marked(
            "Each point is a steady level; all but the outermost were approached from below and from above. Right: "
            "residual from the line. Crosses: outliers, not used for the line."
        ),
    ),
    "force": (
        marked("Current to force, against the spring"),
        marked("Position against current at every steady level with the fitted line, and the residuals of the levels."),
        marked(
            "The spring converts force to position: the slope times its stiffness is the force constant. Two points "
            "at one current are the same level, approached from either side."
        ),
    ),
    "position": (
        marked("Position along the stroke"),
        marked("Reading of the position sensor at known positions with the fitted line, and the residuals."),
        marked("Readings at rest at known positions of the fixture, with the coil released."),
    ),
}
"""Heading, text for screen readers and caption of the line of each table."""


def _draw_line(figure: FigureBase, line: Residuals) -> None:
    """Draw a line with its readings, and their residuals on the right."""
    draw_row(figure, line_plots(line))


_NEEDED = {
    "sweep": ("position_m", "vaf_percent", "mass_kg", "damping_n_s_per_m", "stiffness_n_per_m"),
    "force_constant": ("position_m", "value_n_per_a", "std_n_per_a"),
}
_THESIS = (
    (marked("VAF (%)"), "vaf_percent", 1.0, 1, (95.0, 98.0), (70.0, 95.0)),
    ("M (g)", "mass_kg", 1e3, 0, (60.0, 80.0), (60.0, 100.0)),
    ("B (N·s/m)", "damping_n_s_per_m", 1.0, 2, (3.0, 4.0), (5.0, 50.0)),
    ("K (N/m)", "stiffness_n_per_m", 1.0, 0, (1000.0, 1200.0), (100.0, 7000.0)),
)
"""Label, column, scale and decimals of a parameter; its range for instrument and skin (Chen 2010, Table 2.1)."""
_REPEATED = (
    ("force_constant_n_per_a", 1.0, "N per A", 4),
    ("linear_region_min_m", 1e3, "mm", 3),
    ("linear_region_max_m", 1e3, "mm", 3),
    ("moving_mass_kg", 1e3, "g", 3),
    ("bearing_damping_n_s_per_m", 1.0, "N·s/m", 4),
    ("coil_inductance_h", 1e3, "mH", 4),
)


def sweep_report(calibration: Calibration) -> StimulusReport:
    """Return the report of a dynamic sweep.

    Raises:
        UnusableInputError: the calibration is of another kind, or lacks the tables of a sweep.
    """
    if calibration.kind != "sweep":
        raise UnusableInputError(
            "report.not_a_sweep", "this is not a dynamic sweep but a calibration of kind {kind}", kind=calibration.kind
        )
    for name, columns in _NEEDED.items():
        missing = [column for column in columns if not calibration.tables.get(name, {}).get(column)]
        if missing:
            raise _incomplete(f"{name}: {missing[0]}")
    region = _region(calibration)
    tables = {
        name: {key: np.abs(values) if "_std_" in key else np.array(values) for key, values in columns.items()}
        for name, columns in calibration.tables.items()
    }
    return StimulusReport(
        title=_("Dynamic sweep of {model}, {serial}").format(model=calibration.model, serial=calibration.serial_number),
        facts=(
            *calibration_facts(calibration),
            (_("Positions"), number(float(len(tables["sweep"]["position_m"])))),
        ),
        headline=translated(
            Message(
                "calibration.sweep.headline",
                "Linear from {low:.1f} to {high:.1f} mm. Calibration {verdict}",
                low=1e3 * region.min_m,
                high=1e3 * region.max_m,
                verdict=verdict_of(calibration),
            )
        ),
        level="good" if calibration.verdict == "passed" else "poor",
        concerns=tuple(translated(line) for line in problems_of(calibration) + notes_of(calibration)),
        summary=(
            _(
                "M, B and K of coil and calibration spring are computed with the same force constant at every "
                "position: where the coil leaves its magnetic field, all three rise together. Tests that leave the "
                "linear region are flagged."
            ),
        ),
        tables=tuple(_tables(calibration, tables, region)),
        panels=tuple(sweep_panels(tables, region)),
    )


def _incomplete(what: str) -> UnusableInputError:
    return UnusableInputError("report.sweep_incomplete", "the calibration lacks {what}: repeat the sweep", what=what)


def _region(calibration: Calibration) -> Region:
    """Return the linear region and its force constant.

    Raises:
        UnusableInputError: the calibration does not have them.
    """
    names = ("linear_region_min_m", "linear_region_max_m", "force_constant_n_per_a")
    for name in names:
        if name not in calibration.quantities:
            raise _incomplete(name)
    return Region(*(calibration.quantities[name].value for name in names))


def _tables(calibration: Calibration, tables: Mapping[str, Columns], region: Region) -> Iterator[Table]:
    sweep = tables["sweep"]
    inside = (sweep["position_m"] >= region.min_m) & (sweep["position_m"] <= region.max_m)
    yield Table(
        _("Comparison with the thesis"),
        ("", _("This instrument"), _("Thesis, instrument"), _("Thesis, skin")),
        tuple(
            (_(label), _span(scale * sweep[name][inside], digits), _range(instrument), _range(skin))
            for label, name, scale, digits, instrument, skin in _THESIS
        ),
        _(
            "This instrument: within the linear region; mass and damping are those of coil and spring together. "
            "Thesis: Chen 2010, Table 2.1."
        ),
    )
    rows = tuple(quantity_row(name, quantity) for name, quantity in calibration.quantities.items())
    yield Table(_("Results"), (_("Quantity"), _("Value"), _("Unit")), rows)
    yield _by_position(tables)
    if "repeats" in tables:
        yield _repeatability(tables["repeats"])
    yield Table(_("Conditions"), (), condition_rows(calibration))


def _range(ends: tuple[float, float]) -> str:
    return _("{low} to {high}").format(low=number(ends[0]), high=number(ends[1]))


def _span(values: NDArray[np.float64], digits: int) -> str:
    if not values.size:
        return _("none")
    low, high = fixed(float(values.min()), digits), fixed(float(values.max()), digits)
    return low if low == high else _("{low} to {high}").format(low=low, high=high)


def _by_position(tables: Mapping[str, Columns]) -> Table:
    sweep, profile = tables["sweep"], tables["force_constant"]
    here = np.interp(sweep["position_m"], profile["position_m"], profile["value_n_per_a"])
    rows = tuple(
        (
            fixed(1e3 * position, 1),
            *(fixed(scale * sweep[name][row], max(1, digits)) for _label, name, scale, digits, *_rest in _THESIS),
            fixed(here[row], 3),
        )
        for row, position in enumerate(sweep["position_m"])
    )
    head = (_("Position (mm)"), *(_(label) for label, *_rest in _THESIS), f"k ({_('N per A')})")
    return Table(_("By position"), head, rows, _("k is the combined estimate of the force constant."))


def _repeatability(columns: Columns) -> Table:
    rows = []
    for name, scale, unit, digits in _REPEATED:
        if name in columns and columns[name].size > 1:
            values = scale * columns[name]
            rows.append(
                (
                    translated(label_of(name)),
                    fixed(float(values.mean()), digits),
                    fixed(float(np.std(values, ddof=1)), digits),
                    fixed(float(np.ptp(values)), digits),
                    _(unit),
                )
            )
    head = (_("Quantity"), _("Mean"), _("Standard deviation"), _("Peak to peak"), _("Unit"))
    return Table(_("Repeatability over {count} sweeps").format(count=columns["run"].size), head, tuple(rows))
