"""Readings of commercial probes in reports: table, step, decay, and a page of their own (docs/readings.md)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tissueid.analysis.curves.plot import CONFIDENCE, TIME, Array, Axis, Curve, Mark, Plot, banded, thin
from tissueid.analysis.decay_readings import LocalSystem, Release
from tissueid.analysis.device_readings import DeviceReadings, ModelReadings, RecordedReadings
from tissueid.analysis.step_readings import NOT_COMPARABLE, POINTS, Reading, StepCourse, StepPoints
from tissueid.device import SIMULATED_LINE
from tissueid.errors import UnusableInputError
from tissueid.formatting import fixed, plus_minus
from tissueid.language import _, marked
from tissueid.messages import MISSING, Message, translated
from tissueid.reports.page import RESEARCH_LINE, FigureGroup, Picture, absent, picture, template
from tissueid.reports.plot_renderer import column_figure, row_figure
from tissueid.reports.tables import Table, readable_date
from tissueid.sessions import Session
from tissueid.units import display_unit
from tissueid.version import SOFTWARE

_BEFORE_S = 0.15
"""Time before the first step that is drawn, s."""
_PERIODS = 3.0
"""Number of periods of a decay that are drawn."""
_OVERDAMPED = 8.0
"""Number of time constants of a decay without periods that are drawn."""
_DECAY_POINTS = 600

DISPLACEMENT = marked("Displacement")
NO_DECAY = Message("readings.no_decay", "there is neither a free decay nor a second-order model")


def step_plot(readings: DeviceReadings) -> Plot:
    """Return the first cycle of the step, recorded and simulated, with Ue, Uv, Uf and Ur as spans between levels."""
    unit, scale = display_unit("m")
    y = Axis(DISPLACEMENT, unit, zero=True)
    course = readings.course
    if course is None:
        return Plot("", TIME, y, missing=readings.no_recorded)
    parts: list[Curve] = []
    points: StepPoints | None = None
    shown = (-_BEFORE_S, (course.cycles[0].end - course.cycles[0].rise) / course.sample_rate_hz)
    recorded = readings.recorded
    if recorded is not None:
        inside = (recorded.time_s >= shown[0]) & (recorded.time_s <= shown[1])
        x, values = thin(recorded.time_s[inside], scale * recorded.displacement_m[inside])
        parts.append(Curve(x, values, marked("recorded step"), "measured"))
        points = recorded.points
    if readings.model is not None:
        parts.append(_simulated(readings.model, shown, scale))
        points = points or readings.model.points
    marks: tuple[Mark, ...] = ()
    if points is not None:
        spans, marks = _spans(points, course, scale, shown)
        parts += spans
    return Plot("", Axis(TIME.label, TIME.unit, limits=shown), y, tuple(parts), marks=marks)


def recorded_step_plot(recorded: RecordedReadings) -> Plot:
    """Return the recorded step alone, as :func:`step_plot`."""
    return step_plot(DeviceReadings(recorded, "", None, None, "", recorded.course, ()))


def _simulated(model: ModelReadings, shown: tuple[float, float], scale: float) -> Curve:
    inside = np.flatnonzero((model.time_s >= shown[0]) & (model.time_s <= shown[1]))
    inside = inside[:: max(1, inside.size // 2000)]
    half = None if model.std_m is None else CONFIDENCE * scale * model.std_m[inside]
    value = scale * model.response_m[inside]
    return banded(model.time_s[inside], value, half, marked("identified model"), "model", band=marked("95 % band"))


def _spans(
    points: StepPoints, course: StepCourse, scale: float, shown: tuple[float, float]
) -> tuple[list[Curve], tuple[Mark, ...]]:
    """Return vertical lines between the positions of Ue, Uv, Uf and Ur, and their names."""
    at = dict(zip(POINTS, scale * (points.values - points.values[0]), strict=True))
    first, rate = course.cycles[0], course.sample_rate_hz
    times = dict(zip(POINTS, points.times_s - first.rise / rate, strict=True))
    width = shown[1] - shown[0]
    spans: list[Curve] = []
    marks: list[Mark] = []
    hold = times["final"] - times["elastic"]
    wanted = (
        ("Ue", times["elastic"], 0.0, at["elastic"], 0.5),
        ("Uv", times["elastic"] + 0.35 * hold, at["elastic"], at["final"], -0.5),
        ("Uf", times["elastic"] + 0.65 * hold, 0.0, at["final"], 0.5),
        ("Ur", times["retracted"], at["retracted"], at["final"], 0.5),
    )
    for name, x, low, high, fraction in wanted:
        if all(map(math.isfinite, (x, low, high))):
            spans.append(Curve(np.array([x, x]), np.array([low, high]), "", "muted", marker="D", width=0.8))
            marks.append(Mark(x + 0.012 * width, name, low + fraction * (high - low)))
    levels = [at[name] for name in ("elastic", "final") if math.isfinite(at[name])]
    spans += [Curve(np.zeros(1), np.array([level]), "", "muted", "level", width=0.5) for level in levels]
    return spans, tuple(marks)


def decay_plots(readings: DeviceReadings) -> tuple[Plot, Plot]:
    """Return the displacement and the acceleration of the model after an impulse of 1 mN s, with the peaks a1 and a3.

    A model without a second-order system has none; the recorded release is :func:`release_plot`.
    """
    unit, scale = display_unit("m")
    time = Axis(TIME.label, "ms")
    moved, pushed = Axis(DISPLACEMENT, unit, zero=True), Axis(marked("Acceleration"), "m/s²", zero=True)
    local = None if readings.model is None else readings.model.local
    if local is None:
        missing = readings.no_model if readings.model is None else NO_DECAY
        return Plot("", time, moved, missing=missing), Plot("", time, pushed, missing=missing)
    t, x, a = impulse_decay(local)
    parts: list[Curve] = [Curve(1e3 * t, a, marked("identified model"), "model")]
    marks: list[Mark] = []
    decay, squared = local.system.decay_and_frequency
    if squared > 0.0:
        frequency = math.sqrt(squared)
        top = math.atan2(frequency, decay) / frequency
        for name, at in (("a1", top), ("a3", top + 2.0 * math.pi / frequency)):
            value = float(np.interp(at, t, a))
            parts.append(Curve(np.array([1e3 * at]), np.array([value]), "", "muted", "points", width=2.0))
            marks.append(Mark(1e3 * at, name, value))
    return (
        Plot("", time, moved, (Curve(1e3 * t, scale * x, marked("identified model"), "model"),)),
        Plot("", time, pushed, tuple(parts), marks=tuple(marks)),
    )


def impulse_decay(local: LocalSystem, impulse_n_s: float = 1e-3) -> tuple[Array, Array, Array]:
    """Return times (n,), s, displacement (n,), m, and acceleration (n,), m/s2, after an impulse, N s."""
    system = local.system
    decay, squared = system.decay_and_frequency
    length = _PERIODS * 2.0 * math.pi / math.sqrt(squared) if squared > 0.0 else 0.0
    if length <= 0.0 or length * decay > 2.0 * _OVERDAMPED:
        length = _OVERDAMPED / max(decay - math.sqrt(max(-squared, 0.0)), 1e-3 * decay)
    t = np.linspace(0.0, length, _DECAY_POINTS)
    x = impulse_n_s * system.impulse_response(t)
    speed = np.gradient(x, t, edge_order=2)
    a = -(system.damping * speed + system.stiffness * x) / system.mass
    return t, x, a


def release_plot(release: Release) -> Plot:
    """Return the position after the release of a recorded step, with the fitted decay."""
    unit, scale = display_unit("m")
    t = 1e3 * release.time_s
    return Plot(
        "",
        Axis(marked("Time after the release"), "ms"),
        Axis(DISPLACEMENT, unit, zero=True),
        (
            Curve(t, scale * release.position, marked("recorded release"), "measured", "points", width=0.8),
            Curve(t, scale * release.fitted, marked("fitted decay"), "model"),
        ),
    )


def readings_table(rows: Sequence[tuple[Reading, Reading]]) -> Table:
    """Return the readings of the recorded step and of the model, with numbered reasons below."""
    reasons: dict[str, int] = {}
    cells = []
    for pair in rows:
        definition = pair[0].definition
        unit, scale = display_unit(definition.si_unit)
        values = [_cell(reading, scale, reasons) for reading in pair]
        cells.append((definition.symbol, _(definition.meaning), *values, unit))
    return Table(
        _("Readings"),
        (_("Reading"), _("Meaning"), _("Recorded step"), _("Identified model"), _("Unit")),
        tuple(cells),
        _note(reasons),
    )


def _cell(reading: Reading, scale: float, reasons: dict[str, int]) -> str:
    """Return the value of a reading, with the number of its reason in brackets."""
    text = MISSING if reading.estimate is None else plus_minus(reading.estimate, scale)
    if not reading.reason:
        return text
    return f"{text} ({reasons.setdefault(reading.reason, len(reasons) + 1)})"


def _note(reasons: dict[str, int]) -> str:
    said = [f"({number}) {translated(reason)}." for reason, number in reasons.items()]
    return " ".join([_("± is one standard deviation."), *said])


def recorded_group(recorded: RecordedReadings, key: str) -> tuple[Table, tuple[Picture, ...]]:
    """Return the readings of a recorded step and their figures, for the report of a test."""
    reasons: dict[str, int] = {}
    rows = []
    for reading in (*recorded.step, *recorded.decay):
        unit, scale = display_unit(reading.definition.si_unit)
        rows.append((reading.definition.symbol, _(reading.definition.meaning), _cell(reading, scale, reasons), unit))
    table = Table(
        _("Readings for comparison with other probes"),
        (_("Reading"), _("Meaning"), _("Recorded step"), _("Unit")),
        tuple(rows),
        " ".join([translated(NOT_COMPARABLE), _note(reasons)]),
    )
    pictures = step_picture(f"{key}-step", recorded_step_plot(recorded)), release_picture(f"{key}-release", recorded)
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


def decay_picture(readings: DeviceReadings) -> Picture:
    """Return the figure of the decay of a model."""
    return picture(
        "decay",
        _("Free decay of the model"),
        _("Displacement and acceleration of the model after an impulse, with the acceleration peaks a1 and a3."),
        lambda: (
            row_figure([_present(plot) for plot in decay_plots(readings)], 3.0),
            _(
                "After an impulse of 1 mN·s. The decrement is the logarithm of a1/a3, the frequency the inverse of the "
                "time between them."
            ),
        ),
    )


def release_picture(key: str, recorded: RecordedReadings) -> Picture:
    """Return the figure of a recorded release."""
    if recorded.release is None:
        return absent(key, _("Recorded release"), recorded.no_release)
    plot = release_plot(recorded.release)
    return picture(
        key,
        _("Recorded release"),
        _("Position after the release of the force: measured points and the fitted decay."),
        lambda: (
            column_figure([plot], 3.0, wide=True),
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


def readings_page(session: Session, readings: DeviceReadings) -> str:
    """Return the page of all readings of a session as HTML text."""
    facts = [
        (_("Subject"), session.subject.pseudonym or _("not recorded")),
        (_("Date"), readable_date(session.created)),
        (_("Instrument"), f"{session.instrument.model}, {session.instrument.serial_number}"),
    ]
    if readings.recorded is not None:
        facts.append((_("Step test"), str(readings.recorded.test.number)))
    if readings.analysis is not None:
        facts.append((_("Model"), f"{readings.analysis.model.report.engine}, {_('test')} {readings.analysis.test}"))
    if readings.course is not None:
        low, high = fixed(readings.course.low_n, 2), fixed(readings.course.high_n, 2)
        facts.append((_("Force"), _("{low} to {high} N").format(low=low, high=high)))
        facts.append((_("Hold"), f"{fixed(readings.course.hold_s, 2)} s"))
    pictures = [step_picture("step", step_plot(readings)), decay_picture(readings)]
    if readings.recorded is not None:
        pictures.append(release_picture("release", readings.recorded))
    return template("readings.html.j2").render(
        title=_("Readings for comparison with other probes"),
        facts=facts,
        session_id=session.session_id,
        simulated=_(SIMULATED_LINE) if session.instrument.simulated else "",
        research_line=_(RESEARCH_LINE),
        software=SOFTWARE,
        notes=[translated(note) for note in readings.notes],
        table=readings_table(readings.rows()),
        group=FigureGroup("figures", _("Figures"), tuple(drawn.block for drawn in pictures)),
    )
