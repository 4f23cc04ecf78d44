"""Readings of commercial probes in reports: table, step and decay (docs/readings.md)."""

from __future__ import annotations

from collections.abc import Sequence

from tissueid.analysis.curves.plot import Plot
from tissueid.analysis.curves.readings import decay_plots, recorded_step_plot, release_plot
from tissueid.analysis.readings.device_readings import DeviceReadings, RecordedReadings
from tissueid.analysis.readings.reading import NOT_COMPARABLE, Reading
from tissueid.errors import UnusableInputError
from tissueid.formatting import plus_minus
from tissueid.language import _
from tissueid.messages import MISSING, translated
from tissueid.reports.blocks import Picture, picture
from tissueid.reports.plot_renderer import column_figure, row_figure
from tissueid.reports.tables import Table
from tissueid.units import display_unit


def readings_table(rows: Sequence[tuple[Reading, Reading]]) -> Table:
    """Return the readings of the recorded step and of the model, with numbered reasons below."""
    reasons: dict[str, int] = {}
    cells = []
    for pair in rows:
        definition = pair[0].definition
        unit, scale = display_unit(definition.si_unit)
        values = [_cell(one, scale, reasons) for one in pair]
        cells.append((definition.symbol, _(definition.meaning), *values, unit))
    return Table(
        _("Readings"),
        (_("Reading"), _("Meaning"), _("Recorded step"), _("Identified model"), _("Unit")),
        tuple(cells),
        _note(reasons),
    )


def _cell(reading: Reading, scale: float, reasons: dict[str, int]) -> str:
    """Return the value of a reading, with the number of its reason in brackets."""
    text = MISSING if reading.found is None else plus_minus(reading.found, scale)
    if not reading.reason:
        return text
    return f"{text} ({reasons.setdefault(reading.reason, len(reasons) + 1)})"


def _note(reasons: dict[str, int]) -> str:
    said = [f"({number}) {translated(reason)}." for reason, number in reasons.items()]
    return " ".join([_("± is one standard deviation."), *said])


def recorded_group(found: RecordedReadings, key: str) -> tuple[Table, tuple[Picture, ...]]:
    """Return the readings of a recorded step and their figures, for the report of a test."""
    reasons: dict[str, int] = {}
    rows = []
    for one in (*found.step, *found.decay):
        unit, scale = display_unit(one.definition.si_unit)
        rows.append((one.definition.symbol, _(one.definition.meaning), _cell(one, scale, reasons), unit))
    table = Table(
        _("Readings for comparison with other probes"),
        (_("Reading"), _("Meaning"), _("Recorded step"), _("Unit")),
        tuple(rows),
        " ".join([translated(NOT_COMPARABLE), _note(reasons)]),
    )
    pictures = step_picture(f"{key}-step", recorded_step_plot(found)), release_picture(f"{key}-release", found)
    return table, pictures


def step_picture(key: str, plot: Plot) -> Picture:
    """Return the figure of a step with its lengths."""
    return picture(
        key,
        _("Step with Ue, Uv, Uf and Ur"),
        _("Displacement against time during load, hold and release, with the lengths that the readings are made of."),
        lambda: (
            column_figure([_present(plot)], 3.6, wide=True),
            _(
                "First cycle. Ue: displacement 0.1 s after the load. Uv: creep from then to the end of the hold. Uf: "
                "their sum. Ur: recovery 0.1 s after the release. Band: 95 % of the uncertainty of the fit."
            ),
        ),
    )


def decay_picture(found: DeviceReadings) -> Picture:
    """Return the figure of the decay of a model."""
    return picture(
        "decay",
        _("Free decay of the model"),
        _("Displacement and acceleration of the model after an impulse, with the acceleration peaks a1 and a3."),
        lambda: (
            row_figure([_present(plot) for plot in decay_plots(found)], 3.0),
            _(
                "After an impulse of 1 mN·s. The decrement is the logarithm of a1/a3, the frequency the inverse of the "
                "time between them."
            ),
        ),
    )


def release_picture(key: str, found: RecordedReadings) -> Picture:
    """Return the figure of a recorded release."""

    def make() -> Plot:
        if found.release is None:
            raise UnusableInputError(found.no_release)
        return release_plot(found.release)

    return picture(
        key,
        _("Recorded release"),
        _("Position after the release of the force: measured points and the fitted decay."),
        lambda: (
            column_figure([make()], 3.0, wide=True),
            _("From the time when the force has arrived. Line: damped oscillation with creep."),
        ),
    )


def _present(plot: Plot) -> Plot:
    """Return a plot that can be drawn.

    Raises:
        UnusableInputError: there is nothing to draw.
    """
    if plot.missing:
        raise UnusableInputError(plot.missing)
    return plot
