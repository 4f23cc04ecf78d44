"""Report of a static calibration: verdict, calibration lines with their residuals, every value with its deviation."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import FigureBase
from numpy.typing import NDArray

from tissueid.calibration.file import Calibration, Quantity
from tissueid.calibration.labels import headline_of, label_of, notes_of, problems_of, readable
from tissueid.errors import UnusableInputError
from tissueid.formatting import number
from tissueid.language import _, marked
from tissueid.messages import Message, translated
from tissueid.reports.panel_sheet import Panel
from tissueid.reports.panels import markers
from tissueid.reports.stimulus_report import StimulusReport
from tissueid.reports.style import BLUE, GREEN, INK, LOST, MUTED, ORANGE
from tissueid.reports.tables import Table, named_text, readable_date

Columns = dict[str, NDArray[np.float64]]

_GROUPS = (
    (marked("Voltage to current"), ("coil_resistance", "current_", "voltage_")),
    (marked("Current to force"), ("force_", "calibration_relative", "spring_", "hysteresis")),
    (marked("Position and range of motion"), ("position_", "stroke_", "carrying_", "moving_")),
    (marked("Thermometer and accelerometer"), ("temperature_", "heat_", "acceleration_", "gravity_")),
    (marked("Supplies, noise and mains"), ("supply_", "noise_", "mains_")),
)
_REPEATED = ("coil_resistance_ohm", "force_constant_n_per_a", "voltage_gain", "position_gain")


def static_report(calibration: Calibration) -> StimulusReport:
    """Return the report of a static calibration.

    Raises:
        UnusableInputError: the calibration is of another kind.
    """
    if calibration.kind != "static":
        raise UnusableInputError(
            Message(
                "report.not_static", "this is not a static calibration but one of kind {kind}", kind=calibration.kind
            )
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
    for name in _REPEATED:
        if name in columns:
            values = np.array(columns[name])
            spread = float(np.std(values, ddof=1)) / abs(float(values.mean()))
            reach = float(np.ptp(values)) / abs(float(values.mean()))
            rows.append((translated(label_of(name)), number(100.0 * spread, 2), number(100.0 * reach, 2)))
    runs = len(columns["run"])
    head = (_("Quantity"), _("Standard deviation (%)"), _("Peak to peak (%)"))
    return Table(_("Repeatability over {runs} runs").format(runs=runs), head, tuple(rows))


def _panels(calibration: Calibration) -> list[Panel]:
    tables = {
        name: {key: np.array(values) for key, values in columns.items()} for name, columns in calibration.tables.items()
    }
    panels = []
    if "electrical" in tables:
        panels.append(_electrical(tables["electrical"]))
    if "force" in tables:
        panels.append(_force(tables["force"]))
    if "position" in tables:
        panels.append(_position(tables["position"]))
    if "repeats" in tables:
        panels.append(_repeats(tables["repeats"]))
    return panels


def _electrical(columns: Columns) -> Panel:
    return Panel(
        "electrical",
        _("Voltage to current"),
        _("Current against voltage at every steady level with the fitted line, and the residuals of the levels."),
        _(
            "Each point is a steady level; all but the outermost were approached from below and from above. Right: "
            "residual from the line. Crosses: outliers, not used for the line."
        ),
        lambda figure: _line(
            figure,
            (columns["voltage_v"], _("Voltage (V)")),
            (columns["current_a"], _("Current (A)")),
            (1e3 * columns["residual_a"], _("Residual (mA)")),
            columns["outlier"] > 0,
            BLUE,
        ),
        height=2.9,
    )


def _force(columns: Columns) -> Panel:
    return Panel(
        "force",
        _("Current to force, against the spring"),
        _("Position against current at every steady level with the fitted line, and the residuals of the levels."),
        _(
            "The spring converts force to position: the slope times its stiffness is the force constant. Two points "
            "at one current are the same level, approached from either side."
        ),
        lambda figure: _line(
            figure,
            (columns["current_a"], _("Current (A)")),
            (1e3 * columns["position_m"], _("Position reading (mm)")),
            (1e6 * columns["residual_m"], _("Residual (µm)")),
            columns["outlier"] > 0,
            ORANGE,
        ),
        height=2.9,
    )


def _position(columns: Columns) -> Panel:
    return Panel(
        "position",
        _("Position along the stroke"),
        _("Reading of the position sensor at known positions with the fitted line, and the residuals."),
        _("Readings at rest at known positions of the fixture, with the coil released."),
        lambda figure: _line(
            figure,
            (1e3 * columns["position_m"], _("Known position (mm)")),
            (1e3 * columns["reading_m"], _("Reading (mm)")),
            (1e6 * columns["residual_m"], _("Residual (µm)")),
            columns["outlier"] > 0,
            GREEN,
        ),
        height=2.9,
    )


def _repeats(columns: Columns) -> Panel:
    return Panel(
        "repeats",
        _("Repeatability"),
        _("Deviation of each repeat from the mean, in percent, for resistance, force constant and gains."),
        _("Every run of the calibration relative to the mean of all runs."),
        lambda figure: _draw_repeats(figure, columns),
        height=2.9,
    )


def _line(
    figure: FigureBase,
    x: tuple[NDArray[np.float64], str],
    y: tuple[NDArray[np.float64], str],
    off: tuple[NDArray[np.float64], str],
    outlier: NDArray[np.bool_],
    colour: str,
) -> None:
    """Draw points and line on the left, residuals on the right; ``x``, ``y`` and ``off`` are values and label."""
    left, right = figure.subplots(1, 2)
    kept = ~outlier
    slope, intercept = np.polyfit(x[0][kept], y[0][kept], 1)
    ends = np.array([x[0].min(), x[0].max()])
    left.plot(ends, intercept + slope * ends, color=MUTED, linewidth=1.0)
    right.axhline(0.0, color=MUTED, linewidth=1.0)
    for axes, values in ((left, y), (right, off)):
        markers(axes, x[0][kept], values[0][kept], label="", colour=colour, marker="o")
        axes.plot(x[0][outlier], values[0][outlier], color=LOST, linestyle="none", marker="x", markersize=6.0)
        axes.set_xlabel(x[1])
        axes.set_ylabel(values[1])


def _draw_repeats(figure: FigureBase, columns: Columns) -> None:
    axes = figure.subplots()
    for name, colour, marker in zip(_REPEATED, (BLUE, ORANGE, GREEN, INK), ("o", "s", "^", "D"), strict=True):
        if name in columns:
            share = 100.0 * (columns[name] / columns[name].mean() - 1.0)
            axes.plot(columns["run"], share, color=colour, linewidth=0.8, alpha=0.6)
            markers(axes, columns["run"], share, label=translated(label_of(name)), colour=colour, marker=marker)
    axes.axhline(0.0, color=MUTED, linewidth=1.0)
    axes.set_xlabel(_("Run"))
    axes.set_ylabel(_("From the mean (%)"))
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
