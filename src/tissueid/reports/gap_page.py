"""Report of a diagnosis of the sim-to-real gap, and of several sessions against one twin: self-contained pages."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import FigureBase

from tissueid.formatting import fixed, label_and_unit, number, share_text, subject_text, with_unit
from tissueid.gap.answer import content_of
from tissueid.gap.decision import Candidate
from tissueid.gap.diagnosis import Diagnosis, Ranked, effect_in, parameters_of
from tissueid.gap.diagnosis_plots import history_plot
from tissueid.gap.statement import (
    GapHistory,
    GapHistoryEntry,
    effect_title,
    history_headline,
    ordered_candidates,
    percent,
    shown_probability,
    size_of,
)
from tissueid.gap.twin_export import stds_of
from tissueid.instrument.twin_file import TwinFile
from tissueid.language import _, marked
from tissueid.messages import MISSING, Message, joined, translated
from tissueid.reports.gap_panels import gap_panels
from tissueid.reports.page import RESEARCH_LINE, FigureGroup, Panel, template
from tissueid.reports.plot_renderer import draw_plot
from tissueid.reports.tables import Row, Table, readable_date
from tissueid.sessions import Session
from tissueid.twin.catalogue import all_effects
from tissueid.twin.effect import STAGE_NAMES, STAGES
from tissueid.units import display_unit
from tissueid.version import SOFTWARE

_TASKS = {
    "drive": marked("command to voltage"),
    "coil": marked("voltage to current and force"),
    "mechanics": marked("force to motion, without tissue"),
    "tissue": marked("what the probe presses on"),
    "sensing": marked("motion to recorded number"),
    "environment": marked("disturbances"),
}
_QUESTIONS = {
    "drive": marked("Voltage, from the command"),
    "coil": marked("Current, from voltage and motion"),
    "free current": marked("Current, from the voltage alone"),
    "spring": marked("Motion off the tissue (spring or air), from the current"),
    "tissue": marked("Motion on tissue, from the current"),
    "quiet": marked("Motion while nothing is played (quiet test)"),
}
_WIDEST_STD = 1e5
"""A standard deviation above this, SI, means that the data does not hold the parameter at all."""


def times_noise(ratio: float) -> str:
    """An error as a multiple of the noise floor."""
    return _("{ratio} × noise").format(ratio=number(ratio, 3))


def tables_of(diagnosis: Diagnosis, called: Callable[[str], str]) -> Iterator[Table]:
    """The figures of a diagnosis.

    Args:
        diagnosis: the diagnosis.
        called: what an effect is called in a sentence, by its name.
    """
    where = diagnosis.where
    shares = tuple(
        (f"{_(STAGE_NAMES[item])}: {_(_TASKS[item])}", f"{fixed(100.0 * where.shares[item], 0)} %") for item in STAGES
    )
    if diagnosis.verdict != "no_gap":
        yield Table(
            _("Stages"), (), shares, _("Shares of what noise does not explain, as logarithms of error over noise.")
        )
    for name in diagnosis.combination:
        # parameters of the accepted combination; they differ from those of single effects in the ranking
        if diagnosis.best is not None and (table := _parameters(diagnosis.best, name, called(name))):
            yield table
    if diagnosis.detection_limits:
        yield _limits(diagnosis, called)
    if where.errors:
        unasked = set() if any(test.quiet for test in diagnosis.dataset.tests) else {"quiet"}
        asked = {name: times for name, times in where.errors.items() if name not in unasked}
        errors = tuple((_(_QUESTIONS.get(name, name)), times_noise(times)) for name, times in asked.items())
        whole = ""
        if diagnosis.verdict == "no_gap":
            whole = _(
                "The simulation of the whole chain leaves only noise. An error here is no gap: noise of "
                "the measured signals causes it in a single stage."
            )
        note = Message(
            "report.gap.not_shares",
            "How far one signal is missed when everything upstream of it is as measured; 1 × noise is what "
            "noise alone leaves. These are not the shares of the stages: an error counts there only by its logarithm, "
            "only above the noise, and for the stage whose kind of force explains it, so motion on tissue may speak "
            "against the moving part.",
        )
        yield Table(_("Errors by question"), (), errors, " ".join(filter(None, [whole, translated(note)])))


def _limits(diagnosis: Diagnosis, called: Callable[[str], str]) -> Table:
    rows = []
    for name, limit in diagnosis.detection_limits.items():
        if limit is None:
            rows.append((called(name), _("not visible at any size, or estimated from the record"), ""))
            continue
        bound = _("below {size}") if limit.below else _("above {size}")
        meanings = {item.name: item.meaning for item in all_effects()[name].parameters}
        rows.append((called(name), bound.format(size=size_of(limit)), translated(meanings[limit.parameter])))
    note = _("Size from which an effect that is not named would have been named in this session, at its usual form.")
    return Table(_("Detection limits"), (_("Effect"), _("Visible"), _("Meaning")), tuple(rows), note)


def _parameters(best: Candidate, name: str, label: str) -> Table | None:
    values = parameters_of(best, name)
    definitions = {item.name: item for item in effect_in(best, name).parameters}
    stds = stds_of(best)
    rows = []
    for key, value in values.items():
        unit, scale = display_unit("" if definitions[key].unit == "1" else definitions[key].unit)
        std = stds.get(f"{name}.{key}", 0.0)
        text = number(scale * value, 3)
        if 0.0 < std < _WIDEST_STD and np.isfinite(std):
            text += f" ± {number(scale * std, 2)}"
        rows.append((_(label_and_unit(key)[0]), with_unit(text, unit), translated(definitions[key].meaning)))
    if not rows:
        return None
    head = (_("Parameter"), _("Value"), _("Meaning"))
    return Table(
        _("Parameters of {effect}").format(effect=label),
        head,
        tuple(rows),
        _("± is one standard deviation, where the fit has one."),
    )


_LISTED = 8


@dataclass(frozen=True)
class DiagnosisOrigin:
    """What was diagnosed: the session and the file that it was read from."""

    session: Session
    file: Path


def gap_html(diagnosis: Diagnosis, title: str = "", origin: DiagnosisOrigin | None = None) -> str:
    """The page as HTML text: where, which, how far, and what to do next.

    Args:
        diagnosis: the diagnosis.
        title: heading of the page.
        origin: what was diagnosed, to be named on the page and in what to type next.
    """
    content = content_of(diagnosis, None if origin is None else origin.file)
    figures = {panel.key: panel.picture().block for panel in gap_panels(diagnosis, content)}
    places = ("frequency", "depth", "speed", "surface", "time", "current", "amplitude", "mains", "where")
    groups = (
        FigureGroup("g-where", _("Where it lies"), tuple(figures[key] for key in places if key in figures)),
        FigureGroup("g-which", _("Which cause"), tuple(figures[key] for key in ("ranking",) if key in figures)),
        FigureGroup(
            "g-far", _("How far it closes"), tuple(figures[key] for key in ("budget", "overlay") if key in figures)
        ),
    )
    return template("gap.html.j2").render(
        title=title or _("Simulated and recorded"),
        research_line=_(RESEARCH_LINE),
        software=SOFTWARE,
        facts=tuple(_facts(diagnosis, origin)),
        headline=translated(content.headline),
        level=content.level,
        sentences=tuple(map(translated, content.means)),
        numbers=tuple(_numbers(diagnosis)),
        chain=FigureGroup("g-chain", "", (figures["chain"],)),
        findings=_findings(diagnosis),
        groups=tuple(group for group in groups if group.figures),
        ranking=_ranking(diagnosis),
        remedies=tuple(map(translated, content.todo)),
        tables=tuple(tables_of(diagnosis, _effect)),
        remarks=tuple(map(translated, content.remarks)),
    )


def _effect(name: str) -> str:
    """Return what an effect is called, in the language of the report."""
    return translated(effect_title(name))


def _percent(share: float) -> str:
    return _("not determined") if not np.isfinite(share) else f"{fixed(100.0 * share, 0)} %"


def _interval(item: tuple[float, float]) -> str:
    low, high = item
    if not (np.isfinite(low) and np.isfinite(high)):
        return ""
    return _("{low} to {high} %").format(low=fixed(100 * low, 0), high=fixed(100 * high, 0))


def _facts(diagnosis: Diagnosis, origin: DiagnosisOrigin | None) -> Iterator[tuple[str, str]]:
    device, tests = diagnosis.dataset.instrument, diagnosis.dataset.tests
    if origin is not None:
        numbers = {test.number for test in tests}
        sites = dict.fromkeys(test.site for test in origin.session.tests if test.number in numbers and test.site)
        yield _("Session file"), origin.file.name
        yield _("Session"), origin.session.session_id or MISSING
        yield _("Recorded"), readable_date(origin.session.created)
        yield _("Site"), ", ".join(sites) or MISSING
        yield _("Subject"), subject_text(origin.session.subject.pseudonym) or MISSING
    yield _("Instrument"), f"{device.model}, {device.serial_number}"
    yield _("Tests"), ", ".join(f"{test.number} {_kind(test.kind)}" for test in tests)
    yield _("Signals"), ", ".join(_(name) for name in diagnosis.dataset.channels)
    yield _("Computing time"), f"{fixed(diagnosis.seconds, 0)} s"


def _kind(kind: str) -> str:
    return _("quiet (nothing is played)") if kind == "quiet" else _(kind.replace("_", " "))


def _numbers(diagnosis: Diagnosis) -> Iterator[tuple[str, str, str]]:
    """Label, value and note."""
    gap = diagnosis.gap
    yield _("Gap before"), share_text(gap.before), _("error over the signal's deviation, on data held out")
    if diagnosis.verdict != "no_gap":
        yield _("Gap after"), share_text(gap.after), _("with the leading explanation added")
    yield _("Noise alone"), share_text(gap.floor), _("what the sensors' noise alone leaves")
    if diagnosis.verdict != "no_gap" and np.isfinite(gap.closed):
        note = f"95 %: {_interval(gap.closed_ci)}" if _interval(gap.closed_ci) else _("of what noise does not explain")
        chosen_by = translated(
            Message(
                "report.gap.predicted",
                "; {percent} predicted on the data used for the choice",
                percent=_percent(gap.predicted_closed),
            )
        )
        yield _("Closed"), _percent(gap.closed), note + (chosen_by if np.isfinite(gap.predicted_closed) else "")


def _findings(diagnosis: Diagnosis) -> Table | None:
    where = diagnosis.where
    if not where.findings:
        return None
    rows = tuple(
        (_(STAGE_NAMES[item.stage]), translated(item.what), _(item.channel), times_noise(item.error / item.floor))
        for item in where.findings[:_LISTED]
    )
    note = _("× noise: error as a multiple of the noise, which is what the sensors' noise alone would leave.")
    return Table(
        translated(Message("report.gap.findings", "What speaks against each stage")),
        (_("Stage"), _("Finding"), _("Signal"), _("Error")),
        rows,
        note,
    )


def _ranking(diagnosis: Diagnosis) -> Table | None:
    candidates = ordered_candidates(diagnosis)[:_LISTED]
    if not candidates:
        return None
    places = {item.effect: str(number) for number, item in enumerate(candidates, 1)}
    rows = tuple(_ranked(diagnosis, item, places) for item in candidates)
    head = ("", _("Effect"), _("Stage"), _("Probability"), _("Closed"), "95 %", _("Not separable"))
    # A column that says nothing in any row only makes the others narrow.
    kept = [column for column in range(len(head)) if column == 0 or any(row[column] for row in rows)]
    narrowed = tuple(tuple(row[column] for column in kept) for row in rows)
    shown = tuple(head[column] for column in kept)
    note = (
        _("Not separable: candidates, by number, that this data cannot separate from it.")
        if _("Not separable") in shown
        else ""
    )
    return Table(_("Candidates"), shown, narrowed, note)


def _ranked(diagnosis: Diagnosis, item: Ranked, places: Mapping[str, str]) -> tuple[str, ...]:
    alike = ", ".join(places.get(name) or _effect(name) for name in item.indistinguishable)
    share = shown_probability(diagnosis, item.effect, item.probability)
    probability = f"{percent(share)} %" if np.isfinite(share) else ""
    closed = f"{fixed(100.0 * item.closed, 0)} %" if np.isfinite(item.closed) else ""
    name, stage = _effect(item.effect), _(STAGE_NAMES[item.stage])
    return (places[item.effect], name, stage, probability, closed, _interval(item.closed_ci), alike)


_VERDICTS = {"no_gap": marked("no gap"), "unexplained": marked("unexplained")}


def watch_html(history: GapHistory, twin: TwinFile) -> str:
    """Return the page as HTML text: the gap over time, the first session in which it grew, and a table."""
    headline, level = history_headline(history)
    effects = joined([effect_title(item.name) for item in twin.effects]) if twin.effects else marked("none")
    return template("gap_watch.html.j2").render(
        title=_("Gap against an accepted twin"),
        research_line=_(RESEARCH_LINE),
        software=SOFTWARE,
        facts=(
            (_("Twin"), _("{name}, version {version}").format(name=twin.name, version=twin.version)),
            (_("Accepted effects"), translated(effects)),
        ),
        headline=translated(headline),
        level=level,
        figures=FigureGroup("g-history", "", (history_panel(history).picture().block,)),
        sessions=Table(
            _("Sessions"),
            (_("Session"), _("Recorded"), _("Gap (%)"), _("Noise floor (%)"), _("Result")),
            tuple(_rows(history)),
            _(
                "Gap: error of the twin on held-out data. The noise floor includes the error that the twin left in its "
                "own session."
            ),
        ),
    )


def history_panel(history: GapHistory) -> Panel:
    """Return the figure of the gap over time."""
    return Panel(
        "history",
        _("Gap over time"),
        _("Gap and noise floor of {count} sessions in order of time.").format(count=len(history.entries)),
        _("The vertical line marks the first session in which the gap is more than noise."),
        lambda figure: _draw(figure, history),
        height=3.0,
    )


def _draw(figure: FigureBase, history: GapHistory) -> None:
    draw_plot(figure.subplots(1, 1), history_plot(history), title=False)


def _rows(history: GapHistory) -> Iterator[Row]:
    for entry in history.entries:
        date = readable_date(entry.created) if entry.created else MISSING
        if entry.answer is None:
            yield entry.file, date, MISSING, MISSING, translated(entry.reason)
            continue
        gap, floor = (number(100.0 * entry.gap(name), 3) for name in ("before", "floor"))
        yield entry.file, date, gap, floor, translated(_result(entry))


def _result(entry: GapHistoryEntry) -> str:
    if entry.answer is not None and not entry.combination:
        return _VERDICTS[entry.answer["verdict"]]
    return joined([effect_title(name) for name in entry.combination])
