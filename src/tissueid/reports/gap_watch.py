"""Report of the gap of several sessions against one twin: one self-contained page."""

from __future__ import annotations

from collections.abc import Iterator

from matplotlib.figure import FigureBase

from tissueid.formatting import number
from tissueid.gap.diagnosis_plots import history_plot
from tissueid.gap.history import GapHistory, HistoryEntry, history_headline
from tissueid.gap.statement import effect_title
from tissueid.instrument.twin_file import TwinFile
from tissueid.language import _, marked
from tissueid.messages import MISSING, joined, translated
from tissueid.reports.page import RESEARCH_LINE, FigureGroup, Panel, template
from tissueid.reports.plot_renderer import draw_plot
from tissueid.reports.tables import Row, Table, readable_date
from tissueid.version import SOFTWARE

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


def _result(entry: HistoryEntry) -> str:
    if entry.answer is not None and not entry.combination:
        return _VERDICTS[entry.answer["verdict"]]
    return joined([effect_title(name) for name in entry.combination])
