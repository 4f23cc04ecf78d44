"""A static calibration as a page: the verdict, the lines with what lies off them, every figure with its deviation."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import FigureBase
from numpy.typing import NDArray

from tissueid.calibration.file import Calibration
from tissueid.calibration.words import label_of, notes_of, readable, verdict_of
from tissueid.errors import UnusableInputError
from tissueid.reports.panel_sheet import Panel
from tissueid.reports.panels import markers
from tissueid.reports.stimulus_report import StimulusReport
from tissueid.reports.style import BLUE, GREEN, INK, LOST, MUTED, ORANGE
from tissueid.reports.tables import Table
from tissueid.wording import named_value, number

Columns = dict[str, NDArray[np.float64]]

_GROUPS = (
    ("Voltage to current", ("coil_resistance", "current_", "voltage_")),
    ("Current to force", ("force_", "calibration_relative", "spring_", "hysteresis")),
    ("Position and range of motion", ("position_", "stroke_", "carrying_", "moving_")),
    ("Thermometer and accelerometer", ("temperature_", "heat_", "acceleration_", "gravity_")),
    ("Supplies, noise and mains", ("supply_", "noise_", "mains_")),
)
_REPEATED = ("coil_resistance_ohm", "force_constant_n_per_a", "voltage_gain", "position_gain")


def static_report(calibration: Calibration) -> StimulusReport:
    """The report of a static calibration, from what its file keeps.

    Raises:
        UnusableInputError: it is of another kind.
    """
    if calibration.kind != "static":
        raise UnusableInputError(f"this is a {calibration.kind} calibration, not a static one")
    return StimulusReport(
        title=f"Static calibration of {calibration.model}, {calibration.serial_number}",
        facts=(
            ("Made", calibration.date.replace("T", " ").replace("Z", " UTC")),
            ("Good for", f"{calibration.valid_days} days"),
            ("Firmware", calibration.firmware_version or "not told"),
            ("Software", calibration.software),
        ),
        headline=f"The calibration {verdict_of(calibration)}",
        level="poor" if calibration.verdict == "failed" else "good",
        concerns=calibration.problems + notes_of(calibration),
        summary=(
            "Force is the force constant times the current, less what the current channel reads where none flows. "
            "Volts and amperes are what the channels call so: a gain error of the current channel is within the force "
            "constant and the resistance.",
        ),
        tables=tuple(_tables(calibration)),
        panels=tuple(_panels(calibration)),
    )


def _tables(calibration: Calibration) -> list[Table]:
    tables, told = [], set()
    for caption, begins in _GROUPS:
        names = [name for name in calibration.quantities if name.startswith(begins) and name not in told]
        told |= set(names)
        rows = tuple(readable(name, calibration.quantities[name]) for name in names)
        if rows:
            tables.append(Table(caption, ("Quantity", "Value", "Unit"), rows))
    rest = [name for name in calibration.quantities if name not in told]
    if rest:
        rows = tuple(readable(name, calibration.quantities[name]) for name in rest)
        tables.append(Table("Further figures", ("Quantity", "Value", "Unit"), rows))
    if "repeats" in calibration.tables:
        tables.append(_repeats_table(calibration.tables["repeats"]))
    conditions = tuple(
        named_value(name, value) for name, value in calibration.conditions.items() if not name.startswith("note_")
    )
    return [*tables, Table("Conditions", (), conditions)]


def _repeats_table(columns: dict[str, tuple[float, ...]]) -> Table:
    rows = []
    for name in _REPEATED:
        if name in columns:
            values = np.array(columns[name])
            spread = float(np.std(values, ddof=1)) / abs(float(values.mean()))
            reach = float(np.ptp(values)) / abs(float(values.mean()))
            rows.append((label_of(name), number(100.0 * spread, 2), number(100.0 * reach, 2)))
    runs = len(columns["run"])
    return Table(f"Repeatability over {runs} runs", ("Quantity", "Standard deviation (%)", "Range (%)"), tuple(rows))


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
        "Voltage to current",
        "Current against voltage at every steady level with its line, and the distance of the levels from the line.",
        "Each point is a steady level; all but the outermost were come to from below and from above. Right: how far "
        "off the line. Crossed out: left out of the line.",
        lambda figure: _line(
            figure,
            (columns["voltage_v"], "Voltage (V)"),
            (columns["current_a"], "Current (A)"),
            (1e3 * columns["residual_a"], "Off the line (mA)"),
            columns["outlier"] > 0,
            BLUE,
        ),
        height=2.9,
    )


def _force(columns: Columns) -> Panel:
    return Panel(
        "force",
        "Current to force, against the spring",
        "Position against current at every steady level with its line, and the distance of the levels from the line.",
        "The spring turns force into position: the slope times its stiffness is the force constant. Two points "
        "at one current are the same level come to from either side.",
        lambda figure: _line(
            figure,
            (columns["current_a"], "Current (A)"),
            (1e3 * columns["position_m"], "Reading of position (mm)"),
            (1e6 * columns["residual_m"], "Off the line (µm)"),
            columns["outlier"] > 0,
            ORANGE,
        ),
        height=2.9,
    )


def _position(columns: Columns) -> Panel:
    return Panel(
        "position",
        "Position along the stroke",
        "Reading of the position sensor at known places with its line, and the distance from the line.",
        "Readings at rest, the coil free, at known places of the fixture.",
        lambda figure: _line(
            figure,
            (1e3 * columns["position_m"], "Place (mm)"),
            (1e3 * columns["reading_m"], "Reading (mm)"),
            (1e6 * columns["residual_m"], "Off the line (µm)"),
            columns["outlier"] > 0,
            GREEN,
        ),
        height=2.9,
    )


def _repeats(columns: Columns) -> Panel:
    return Panel(
        "repeats",
        "Repeatability",
        "Deviation of each repeat from the mean, in percent, for resistance, force constant and gains.",
        "Every run of the calibration against the mean of all.",
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
    """Points and their line on the left, how far off they are on the right; ``x``, ``y``, ``off``: values and label."""
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
            markers(axes, columns["run"], share, label=label_of(name), colour=colour, marker=marker)
    axes.axhline(0.0, color=MUTED, linewidth=1.0)
    axes.set_xlabel("Run")
    axes.set_ylabel("From the mean (%)")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
