"""Readings of commercial probes on a page: table, step and decay (docs/readings.md)."""

from __future__ import annotations

from collections.abc import Sequence

from tissueid import __version__
from tissueid.analysis.curves.plot import Plot
from tissueid.analysis.curves.readings import decay_plots, recorded_step_plot, release_plot, step_plot
from tissueid.analysis.readings.device_readings import DeviceReadings, RecordedReadings
from tissueid.analysis.readings.reading import NOT_COMPARABLE, Reading
from tissueid.device import SIMULATED_LINE
from tissueid.errors import UnusableInputError
from tissueid.formatting import fixed, plus_minus
from tissueid.language import _
from tissueid.messages import MISSING, translated
from tissueid.reports.blocks import FigureGroup, Picture, picture
from tissueid.reports.html import RESEARCH_LINE, template
from tissueid.reports.plot_renderer import column_figure, row_figure
from tissueid.reports.tables import Table, readable_date
from tissueid.sessions import Session
from tissueid.units import display_unit


def readings_page(session: Session, found: DeviceReadings) -> str:
    """Return the page of all readings of a session as HTML text."""
    facts = [
        (_("Subject"), session.subject.pseudonym or _("not recorded")),
        (_("Date"), readable_date(session.created)),
        (_("Instrument"), f"{session.instrument.model}, {session.instrument.serial_number}"),
    ]
    if found.recorded is not None:
        facts.append((_("Step test"), str(found.recorded.test.number)))
    if found.analysis is not None:
        facts.append((_("Model"), f"{found.analysis.model.report.engine}, {_('test')} {found.analysis.test}"))
    if found.course is not None:
        low, high = fixed(found.course.low_n, 2), fixed(found.course.high_n, 2)
        facts.append((_("Force"), _("{low} to {high} N").format(low=low, high=high)))
        facts.append((_("Hold"), f"{fixed(found.course.hold_s, 2)} s"))
    pictures = [_step_picture("step", step_plot(found)), _decay_picture(found)]
    if found.recorded is not None:
        pictures.append(_release_picture("release", found.recorded))
    return template("readings.html.j2").render(
        title=_("Readings for comparison with other probes"),
        facts=facts,
        session_id=session.session_id,
        simulated=_(SIMULATED_LINE) if session.instrument.simulated else "",
        research_line=_(RESEARCH_LINE),
        software=f"tissueid {__version__}",
        notes=[translated(note) for note in found.notes],
        table=readings_table(found.rows()),
        group=FigureGroup("figures", _("Figures"), tuple(one.block for one in pictures)),
    )


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
    pictures = _step_picture(f"{key}-step", recorded_step_plot(found)), _release_picture(f"{key}-release", found)
    return table, pictures


def _step_picture(key: str, plot: Plot) -> Picture:
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


def _decay_picture(found: DeviceReadings) -> Picture:
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


def _release_picture(key: str, found: RecordedReadings) -> Picture:
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
