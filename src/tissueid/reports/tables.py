"""Tables of reports: parameters, scores, settings. Cells are plain text."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from datetime import datetime
from typing import Any

import numpy as np

from tissueid.analysis import Analysis
from tissueid.analysis.curves.signals import lost_samples
from tissueid.configuration import has_depth
from tissueid.device import DeviceDescription
from tissueid.formatting import (
    axis_label,
    fixed,
    grouped,
    label_and_unit,
    label_and_value,
    local_time,
    number,
    plain_text,
    plus_minus,
    subject_text,
    with_unit,
    zone_offset,
)
from tissueid.identification import engine_label
from tissueid.identification.base import FitReport
from tissueid.language import _, marked
from tissueid.messages import MISSING, Message, translated
from tissueid.records import Estimate
from tissueid.reports.page import spring_line
from tissueid.sessions import Session, Test
from tissueid.test_settings import PROPERTIES, label_of, setting_of
from tissueid.units import display_unit
from tissueid.version import SOFTWARE

Row = tuple[str, ...]

_NO_SURFACE = ("surface_position_m", None)
"""An option that says nothing where it is not set: there may be no surface to count from."""


@dataclass(frozen=True)
class Table:
    """A table: the first cell of a row is its header. ``head`` is empty for a list of names and values."""

    caption: str
    head: Row
    rows: tuple[Row, ...]
    note: str = ""


@dataclass(frozen=True)
class ComparisonRow:
    """One quantity, SI: what a small-amplitude test found, what the plant has, what the large test averages to.

    ``quantity`` is a parameter's name, such as ``mass_kg``, or a word.
    """

    quantity: str
    unit: str
    small: Estimate
    truth: float
    large: Estimate


@dataclass(frozen=True)
class ComparisonTable:
    """A small-amplitude test about ``position_m`` on the actuator, held against a plant that knows its own values."""

    position_m: float
    rows: tuple[ComparisonRow, ...]


_PLUS_MINUS = marked(
    "± is one standard deviation; a value without it has no estimate of its uncertainty, and one that is no larger "
    "than two of them is called uncertain: it cannot be distinguished from zero."
)
_SHARED_FIT = marked(
    "{engines} share one second-order fit to the record: their mass, damping and stiffness are one answer, not "
    "several, and not those of each engine's response."
)
UNCERTAIN_DEVIATIONS = 2.0
"""Number of standard deviations from zero within which a parameter counts as uncertain."""

MONTHS = (
    marked("January"),
    marked("February"),
    marked("March"),
    marked("April"),
    marked("May"),
    marked("June"),
    marked("July"),
    marked("August"),
    marked("September"),
    marked("October"),
    marked("November"),
    marked("December"),
)
STATUSES = (marked("completed"), marked("aborted"), marked("recovered"))
"""How a test can have ended, as a session file has it."""
_TOLD_ELSEWHERE = ("events", "quality", "reason_message", "samples_lost", "stimulus_report")
"""Notes of a test that have a row of their own, or are data for programs."""


def parameter_table(analyses: Mapping[str, Analysis]) -> Table | None:
    """Return a table of all parameters with standard deviations; None if no engine has any."""
    names = list(dict.fromkeys(name for a in analyses.values() for name in a.model.report.reportable_parameters))
    if not names:
        return None
    rows = []
    for name in names:
        label, si_unit = label_and_unit(name)
        unit, scale = display_unit(si_unit)
        cells = [
            _parameter_text(parameters[name], scale) if name in parameters else MISSING
            for parameters in (a.model.report.reportable_parameters for a in analyses.values())
        ]
        rows.append((_(label), unit, *cells))
    return Table(
        _("Parameters"),
        (_("Quantity"), _("Unit"), *map(engine_label, analyses)),
        tuple(rows),
        " ".join(filter(None, [_(_PLUS_MINUS), _shared_fit(analyses), spring_line(analyses.values())])),
    )


def _shared_fit(analyses: Mapping[str, Analysis]) -> str:
    """Say which engines show the mass, damping and stiffness of one fit; "" if no two do."""
    engines: dict[tuple[float, float], list[str]] = {}
    for name, analysis in analyses.items():
        parameters = analysis.model.report.reportable_parameters
        if {"mass_kg", "stiffness_n_per_m"} <= parameters.keys():
            key = parameters["mass_kg"].value, parameters["stiffness_n_per_m"].value
            engines.setdefault(key, []).append(engine_label(name))
    alike = [_(_SHARED_FIT).format(engines=", ".join(names)) for names in engines.values() if len(names) > 1]
    return " ".join(alike)


def _parameter_text(parameter: Estimate, scale: float) -> str:
    """Return a parameter with its standard deviation, marked as uncertain where it does not differ from zero."""
    text = plus_minus(parameter, scale)
    uncertain = parameter.std is not None and abs(parameter.value) <= UNCERTAIN_DEVIATIONS * parameter.std
    return _("{value}, uncertain").format(value=text) if uncertain else text


def score_table(analyses: Mapping[str, Analysis]) -> Table:
    """Return a table of fitted and held-out scores, parameters and seconds of each engine."""
    reports = [(name, a.model.report) for name, a in analyses.items()]
    scheduled = any(report.vaf_scheduled_percent is not None for _name, report in reports)
    head = [_("Engine"), _("VAF, fitted (%)"), _("VAF, held out (%)")]
    head += [_("VAF, held out, scheduled (%)")] if scheduled else []
    head += ["AICc", _("Parameters"), _("Samples fitted"), _("Seconds")]
    rows = []
    for name, report in reports:
        cells = [engine_label(name), fixed(report.vaf_percent, 2), held_out_cell(report)]
        cells += [fixed(report.vaf_scheduled_percent, 2)] if scheduled else []
        cells += [grouped(report.aicc), grouped(report.n_parameters), grouped(report.n_samples)]
        rows.append((*cells, fixed(report.seconds, 3)))
    held_out = next((translated(a.validated_on) for a in analyses.values()), "")
    return Table(
        _("Model scores"),
        tuple(head),
        tuple(rows),
        _(
            "Held out: {held_out}. VAF is the variance accounted for by a simulation that sees the input alone. Among "
            "models fitted to the same samples the lowest AICc is the best. An engine whose held-out VAF is not above "
            "zero at the 5 % level predicts nothing, and its parameters are left out."
        ).format(held_out=held_out),
    )


def held_out_cell(report: FitReport, decimals: int = 2) -> str:
    """Return the held-out VAF in percent, marked if the fit predicts nothing."""
    text = fixed(report.vaf_validation_percent, decimals)
    return _("{score}, predicts nothing").format(score=text) if report.predicts_nothing else text


def comparison_table(comparison: ComparisonTable) -> Table:
    """Return a comparison with its errors as a table."""
    rows = []
    for row in comparison.rows:
        unit, scale = display_unit(row.unit)
        error = row.small.value - row.truth
        relative = 100.0 * error / row.truth if row.truth else None
        deviations = error / row.small.std if row.small.std else None
        cells = (
            plus_minus(row.small, scale),
            number(scale * row.truth),
            with_sign(relative, 1),
            with_sign(deviations, 1),
        )
        rows.append((axis_label(row.quantity, unit), *cells, plus_minus(row.large, scale)))
    return Table(
        f"Small-amplitude test about {number(1e3 * comparison.position_m)} mm on the actuator",
        ("Quantity", "Small-amplitude estimate", "Plant’s own value", "Error (%)", "Error (deviations)", "Large test"),
        tuple(rows),
        "An error within two deviations is what the stated uncertainty allows. The large test averages over all the "
        "depths that it visits, so it differs from the value at one depth.",
    )


def with_sign(value: float | None, decimals: int) -> str:
    """Return a number with its sign."""
    text = fixed(value, decimals)
    return text if text == MISSING or text.startswith("−") else f"+{text}"


# -- what was done with which settings -------------------------------------------------------------------------


def readable_date(created: str) -> str:
    """Return an ISO date as people write it, in local time with its offset; a text that is no date as it stands."""
    try:
        moment = local_time(created) or datetime.fromisoformat(created)
    except ValueError:
        return created or _("date not recorded")
    said = _("{day} {month} {year}, {time}").format(
        day=moment.day, month=_(MONTHS[moment.month - 1]), year=moment.year, time=f"{moment:%H:%M}"
    )
    return f"{said} {zone_offset(moment) if moment.tzinfo else ''}".rstrip()


def status_text(status: str) -> str:
    """Return how a test ended, in the language of the report."""
    return _(status)


def settings_tables(session: Session, test: Test, analyses: Mapping[str, Analysis]) -> tuple[Table, ...]:
    """Return the settings needed to repeat a test and its analysis."""
    sitting: list[Row] = [
        (_("Session"), session.session_id or MISSING),
        (_("Recorded"), readable_date(session.created)),
        (_("Recorded with"), session.software or MISSING),
        (_("Analysed with"), SOFTWARE),
        (_("Subject"), subject_text(session.subject.pseudonym) or MISSING),
        *(named_text(name, value) for name, value in session.subject.demographics.items()),
    ]
    tables = [
        Table(_("Session"), (), tuple(sitting)),
        Table(_("Test"), (), _test_rows(test)),
        Table(
            _("Stimulus"),
            (),
            _named_rows(
                test.stimulus, translated(Message("report.no_stimulus", "The session does not describe the stimulus."))
            ),
        ),
        Table(_("Instrument"), (), _instrument_rows(session.instrument)),
        Table(
            _("Active calibration"),
            (),
            _named_rows(_shown_calibration(session.instrument), _("None recorded: nominal figures were used.")),
        ),
    ]
    for name, analysis in analyses.items():
        report = analysis.model.report
        rows: list[Row] = [(_("Held out"), translated(analysis.validated_on))]
        options = {option: value for option, value in report.options.items() if (option, value) != _NO_SURFACE}
        rows += [named_text(option, value) for option, value in options.items()]
        rows += [named_text(detail, value) for detail, value in report.details.items()]
        tables.append(Table(_("Engine: {name}").format(name=engine_label(name)), (), tuple(rows)))
    return tuple(tables)


def _shown_calibration(device: DeviceDescription) -> dict[str, Any]:
    """Return the entries of the calibration in force, with a readable date and translated warnings."""
    shown: dict[str, Any] = {}
    for name, value in device.calibration.items():
        if name == "warnings":
            shown[name] = "; ".join(translated(warning) for warning in device.calibration_warnings)
        elif name != "warning_messages":
            shown[name] = readable_date(str(value)) if name == "date" else value
    return shown


def _named_rows(settings: Mapping[str, Any], otherwise: str) -> tuple[Row, ...]:
    rows: dict[str, str] = {}
    _flatten(settings, rows, "")
    return tuple(rows.items()) or ((_("Settings"), otherwise),)


def _flatten(settings: Mapping[str, Any], rows: dict[str, str], parent: str) -> None:
    """Add rows for nested settings, up to two levels deep; a repeated name gets its parent as prefix."""
    for name, value in settings.items():
        if isinstance(value, dict) and value and parent.count(":") < 2:
            _flatten(value, rows, f"{parent}{_(label_and_unit(str(name))[0])}: ")
            continue
        label, text = named_text(str(name), value)
        rows[f"{parent}{label}" if label in rows else label] = text


def named_text(name: str, value: Any) -> tuple[str, str]:
    """Return a named setting of any kind as label and text, both in the language of the report where it has them."""
    label, text = label_and_value(name, value)
    if name in PROPERTIES:
        label, text = label_of(name), setting_of(name).choices.get(value, text)
    return _(label).replace("&", ""), _(text)  # a form marks the key of a label


def _instrument_rows(device: DeviceDescription) -> tuple[Row, ...]:
    rows = []
    for item in fields(device):
        value = getattr(device, item.name)
        if item.name != "calibration" and value != "":
            rows.append(named_text(item.name, value))
    return tuple(rows)


def _test_rows(test: Test) -> tuple[Row, ...]:
    lost = int(lost_samples(test).sum())
    force = test.signals.get("force", np.zeros(0))
    force = force[np.isfinite(force)]
    surface = test.surface_position_m
    length_s = test.samples / test.sample_rate_hz
    repeated = _("no other test") if test.repeat_of is None else _("test {number}")
    first = _("Surface of the tissue") if has_depth(test.configuration) else _("Where it began")
    rows: list[Row] = [
        (_("Number"), str(test.number)),
        (_("Kind"), _(plain_text(test.kind).replace("_", " "))),
        (_("Configuration"), _(plain_text(test.configuration))),
        (_("Site"), plain_text(test.site)),
        (_("Status"), status_text(test.status)),
        (_("Sample rate"), with_unit(number(test.sample_rate_hz), "Hz")),
        (_("Length"), _("{seconds} s, {samples} samples").format(seconds=number(length_s), samples=test.samples)),
        (_("Preload"), with_unit(number(test.preload_s), "s") if test.preload_s else _("none")),
        (first, with_unit(fixed(1e3 * surface, 2), "mm") if np.isfinite(surface) else _("not recorded")),
        (_("Seed of the stimulus"), str(test.seed)),
        (_("Repeats the command of"), repeated.format(number=test.repeat_of)),
    ]
    if force.size:
        low, high = fixed(float(force.min()), 1), fixed(float(force.max()), 1)
        rows.append((_("Force reached"), _("{low} to {high} N").format(low=low, high=high)))
    rows.append((_("Samples not received"), f"{lost} ({100 * lost / test.samples:.2f} %)" if lost else _("none")))
    rows += [named_text(name, value) for name, value in test.notes.items() if name not in _TOLD_ELSEWHERE]
    rows.append((_("Events"), "; ".join(_events(test.notes.get("events", ""))) or _("none")))
    return tuple(rows)


def _events(recorded: str | float) -> Sequence[str]:
    """Return events as lines; the note contains a JSON list, or any other text."""
    try:
        events = json.loads(str(recorded)) if recorded else []
    except (ValueError, RecursionError):
        return (str(recorded),)
    return [plain_text(event) for event in events] if isinstance(events, list) else (plain_text(events),)
