"""Report of a static calibration: verdict, calibration lines with their residuals, every value with its deviation."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import FigureBase

from tissueid.analysis.curves.calibration_plots import REPEATED, Columns, line_plots, static_repeat_plot
from tissueid.calibration.comparison import Residuals, residuals
from tissueid.calibration.file import Calibration, Quantity
from tissueid.calibration.labels import headline_of, label_of, notes_of, problems_of, readable
from tissueid.errors import UnusableInputError
from tissueid.formatting import number
from tissueid.language import _, marked
from tissueid.messages import translated
from tissueid.reports.page import Panel
from tissueid.reports.plot_renderer import draw_plot, draw_row, key_over
from tissueid.reports.stimulus_report import StimulusReport
from tissueid.reports.tables import Table, named_text, readable_date

_GROUPS = (
    (marked("Voltage to current"), ("coil_resistance", "current_", "voltage_")),
    (marked("Current to force"), ("force_", "calibration_relative", "spring_", "hysteresis")),
    (marked("Position and range of motion"), ("position_", "stroke_", "carrying_", "moving_")),
    (marked("Thermometer and accelerometer"), ("temperature_", "heat_", "acceleration_", "gravity_")),
    (marked("Supplies, noise and mains"), ("supply_", "noise_", "mains_")),
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
        tables=tuple(_tables(calibration)),
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


def quantity_row(name: str, found: Quantity) -> tuple[str, str, str]:
    """Return label, value with its deviation, and unit of a quantity of a calibration."""
    label, value, unit = readable(name, found)
    return translated(label), value, _(unit)


def condition_rows(calibration: Calibration) -> tuple[tuple[str, str], ...]:
    """Return the conditions of a calibration as label and value, without its notes."""
    return tuple(
        named_text(name, value) for name, value in calibration.conditions.items() if not name.startswith("note_")
    )


def _tables(calibration: Calibration) -> list[Table]:
    tables, shown = [], set()
    head = (_("Quantity"), _("Value"), _("Unit"))
    for caption, begins in _GROUPS:
        names = [name for name in calibration.quantities if name.startswith(begins) and name not in shown]
        shown |= set(names)
        rows = tuple(quantity_row(name, calibration.quantities[name]) for name in names)
        if rows:
            tables.append(Table(_(caption), head, rows))
    rest = [name for name in calibration.quantities if name not in shown]
    if rest:
        rows = tuple(quantity_row(name, calibration.quantities[name]) for name in rest)
        tables.append(Table(_("Other quantities"), head, rows))
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
    panels = [_line_panel(found) for found in residuals(calibration)]
    if "repeats" in calibration.tables:
        columns = {name: np.array(values) for name, values in calibration.tables["repeats"].items()}
        panels.append(_repeats_panel(columns))
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


def _line_panel(found: Residuals) -> Panel:
    """Return a line with its readings, and their residuals on the right."""
    heading, alt, caption = (_(text) for text in _LINES[found.table])

    def draw(figure: FigureBase) -> None:
        draw_row(figure, line_plots(found))

    return Panel(found.table, heading, alt, caption, draw, height=2.9)


def _repeats_panel(columns: Columns) -> Panel:
    def draw(figure: FigureBase) -> None:
        axes = figure.subplots()
        draw_plot(axes, static_repeat_plot(columns), key=False)
        key_over(figure, axes)

    return Panel(
        "repeats",
        _("Repeatability"),
        _("Deviation of each repeat from the mean, in percent, for resistance, force constant and gains."),
        _("Every run of the calibration relative to the mean of all runs."),
        draw,
        height=2.9,
    )
