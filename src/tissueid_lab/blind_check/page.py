"""Report of the sealed check of the diagnosis: one self-contained page with scores, controls and failures."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.figure import FigureBase

from tissueid.analysis.curves.plot import Axis, Curve, Plot, steps
from tissueid.errors import UnusableInputError
from tissueid.formatting import clean, fixed, number
from tissueid.gap.statement import effect_title
from tissueid.language import _, marked
from tissueid.messages import MISSING, Message, translated
from tissueid.reports.page import RESEARCH_LINE, FigureGroup, Panel, template, write_text_atomically
from tissueid.reports.plot_renderer import draw_plot
from tissueid.reports.style import INK, ORANGE, SEQUENTIAL
from tissueid.reports.tables import Row, Table
from tissueid.version import SOFTWARE
from tissueid_lab.blind_check.answers import BlindCheck
from tissueid_lab.blind_check.scoring import BlindScore, Measured, Rate

Level = Literal["good", "check", "poor"]


_VERDICTS = {"unexplained": marked("unexplained"), "no_gap": marked("no gap")}
"""Answers that name no effect, and their labels."""
_ROW_INCHES = 0.24
_MOST_ANSWERS = 40
"""Number of answers from which they are drawn without points."""
_MOST_LETTERS = 26
"""Letters of an effect's name on an axis; longer names are cut."""
NO_EFFECT = Message("report.no_single_effect", "there was no single effect whose gap survives the refit")


def blind_html(check: BlindCheck, title: str = "") -> str:
    """Return the page as HTML text: for each kind of session scores with intervals, figures, controls and failures."""
    headline, level = headline_of(check)
    return template("blind_check.html.j2", "tissueid_lab.blind_check").render(
        title=title or _("Sealed check of the diagnosis"),
        research_line=_(RESEARCH_LINE),
        software=SOFTWARE,
        facts=(
            (_("Scenarios"), str(check.begun.n)),
            (_("Seed"), str(check.begun.seed)),
            (_("SHA-256 of the labels"), clean(check.begun.seal)),
        ),
        headline=headline,
        level=level,
        sentences=tuple(_sentences(check)),
        sections=tuple(_section(key, *item) for key, item in check.scores.items()),
    )


def write_blind_report(check: BlindCheck, path: Path) -> None:
    """Write the page atomically.

    Raises:
        OSError: the folder is missing, or the disk is full or not writable; nothing is left behind.
    """
    write_text_atomically(path, blind_html(check))


def headline_of(check: BlindCheck) -> tuple[str, Level]:
    """Return the share of targets that were reached as a sentence, and its level."""
    judged = [
        item.reached
        for _, _, score in check.scores.values()
        for item in (*score.rates, *score.figures)
        if item.reached is not None
    ]
    if not judged:
        return translated(Message("blind.none_judged", "No case could be judged")), "check"
    text = _("{reached} of {count} targets were reached").format(reached=sum(judged), count=len(judged))
    return text, "good" if all(judged) else "poor"


def _sentences(check: BlindCheck) -> Iterator[str]:
    for title, count, score in check.scores.values():
        missed = "; ".join(translated(item.what) for item in (*score.rates, *score.figures) if item.reached is False)
        text = _("{kind}, {count} scenarios: all targets that could be judged were reached.")
        if missed:
            text = _("{kind}, {count} scenarios: not reached: {missed}.")
        yield text.format(kind=translated(title), count=count, missed=missed)
    yield _("An interval that contains its target leaves open whether the target is reached.")


def _section(key: str, title: str, count: int, score: BlindScore) -> dict[str, Any]:
    """Return the results of one kind of session for the template."""
    return {
        "key": key,
        "title": _("{kind}: {count} scenarios").format(kind=translated(title), count=count),
        "numbers": score_table(score),
        "controls": Table(
            _("Controls"),
            (_("First place by"), _("Share"), _("Cases")),
            tuple((translated(item.what), _percent(item.value), str(item.cases)) for item in score.controls),
            _("Scores of chance (permuted labels), of a constant answer, and of a search without held-out data."),
        ),
        "figures": FigureGroup(f"g-{key}", "", tuple(panel.picture().block for panel in blind_panels(key, score))),
        "failures": tuple(translated(line) for line in score.failures),
    }


def score_table(score: BlindScore) -> Table:
    """Return the table of targets and measured values."""
    columns = ("", _("Target"), _("Measured"), _("95 % (Wilson)"), _("Cases"), "")
    return Table(_("Score"), columns, tuple(_rows(score)))


def _rows(score: BlindScore) -> Iterator[Row]:
    for rate in score.rates:
        low, high = (fixed(100.0 * end, 0) for end in rate.interval)
        interval = _("{low} to {high} %").format(low=low, high=high) if rate.cases else MISSING
        cases = _("{hits} of {cases}").format(hits=rate.hits, cases=rate.cases)
        yield _row(rate, _percent, interval, cases)
    for figure in score.figures:
        yield _row(figure, lambda value: number(value, 3), MISSING, str(figure.cases))


def _row(item: Rate | Measured, text: Callable[[float], str], interval: str, cases: str) -> Row:
    target = MISSING if item.target is None else text(item.target)
    if item.target is not None and not item.at_least:
        target = _("at most {value}").format(value=target)
    kept = MISSING if item.reached is None else _("reached") if item.reached else _("not reached")
    return translated(item.what), target, text(item.value), interval, cases, kept


def _percent(share: float) -> str:
    return f"{fixed(100.0 * share, 0)} %" if share == share else MISSING


def blind_panels(key: str, score: BlindScore) -> Iterator[Panel]:
    """Yield both figures of one kind of session."""
    rows, columns = confusion_names(score)
    yield Panel(
        f"{key}-confusion",
        _("Confusion matrix"),
        _("Counts of the answers ({columns} columns) for each of {rows} true effects.").format(
            columns=len(columns), rows=len(rows)
        ),
        _(
            "Rows: true effects. Columns: answers. Single effects whose gap survives the refit. Marked cells: correct "
            "answers."
        ),
        lambda figure: draw_confusion(figure, score),
        height=2.1 + _ROW_INCHES * len(rows),
    )
    yield Panel(
        f"{key}-risk",
        _("Risk and coverage"),
        _("Share of wrong names among the answers against the share of scenarios that are answered."),
        _(
            "Share of wrong names among the answers, in order of decreasing probability. A diagnosis with reliable "
            "probabilities begins at zero and rises late; the dotted line is the share among all answers."
        ),
        lambda figure: draw_risk(figure, score),
        height=3.0,
    )


def confusion_names(score: BlindScore) -> tuple[list[str], list[str]]:
    """Return true effects, and answers: the true effects in the same order, then other names, then abstentions."""
    rows = sorted(score.confusion)
    said = {name for row in score.confusion.values() for name in row}
    others = sorted(said - set(rows) - set(_VERDICTS))
    named = [name for name in rows if name in said]
    return rows, [*named, *others, *(verdict for verdict in _VERDICTS if verdict in said)]


def draw_confusion(figure: FigureBase, score: BlindScore) -> None:
    """Draw the confusion matrix with its counts.

    Raises:
        UnusableInputError: there is no single effect whose gap survives the refit.
    """
    rows, columns = confusion_names(score)
    if not rows:
        raise UnusableInputError(NO_EFFECT)
    axes = figure.subplots(1, 1)
    counts = np.array([[score.confusion[row].get(column, 0) for column in columns] for row in rows], np.float64)
    axes.grid(visible=False)
    axes.imshow(counts, cmap=SEQUENTIAL, vmin=0.0, vmax=1.8 * float(counts.max()), aspect="auto", alpha=0.9)
    for k, j in zip(*np.nonzero(counts), strict=True):
        axes.text(j, k, f"{counts[k, j]:.0f}", ha="center", va="center", color=INK, fontsize=8.5)
    for k, row in enumerate(rows):
        if row in columns:
            j = columns.index(row)
            outline = ([j - 0.5, j + 0.5, j + 0.5, j - 0.5, j - 0.5], [k - 0.5, k - 0.5, k + 0.5, k + 0.5, k - 0.5])
            axes.plot(*outline, color=ORANGE, linewidth=1.1)
    axes.set_yticks(np.arange(len(rows)), [_shown(name) for name in rows])
    axes.set_xticks(np.arange(len(columns)), [_shown(name) for name in columns], rotation=90)
    axes.set_xlim(-0.55, len(columns) - 0.45)
    axes.set_ylim(len(rows) - 0.45, -0.55)
    axes.set_ylabel(_("True effect"))
    axes.set_xlabel(_("Answer"))


def draw_risk(figure: FigureBase, score: BlindScore) -> None:
    """Draw risk against coverage.

    Raises:
        UnusableInputError: nothing was answered.
    """
    if not score.risk_coverage:
        raise UnusableInputError(NO_EFFECT)
    draw_plot(figure.subplots(1, 1), risk_plot(score))


def risk_plot(score: BlindScore) -> Plot:
    """Return the share of wrong names among the answers against the share of answered scenarios; the score has some."""
    coverage, risk = 100.0 * np.array(score.risk_coverage).T
    parts = [
        Curve(np.array([0.0, 100.0]), np.full(2, risk[-1]), "", "muted", "dotted", width=0.8),
        Curve(*steps(coverage, risk)),
    ]
    if risk.size < _MOST_ANSWERS:
        parts.append(Curve(coverage, risk, kind="points", marker="o", width=0.9))
    return Plot(
        "",
        Axis(marked("Answered (% of scenarios, most probable first)"), limits=(0.0, 101.0)),
        Axis(marked("Wrong among them"), "%", limits=(-1.0, max(1.15 * float(risk.max()), 10.0))),
        tuple(parts),
    )


def _shown(name: str) -> str:
    label = _(_VERDICTS[name]) if name in _VERDICTS else translated(effect_title(name))
    return label if len(label) <= _MOST_LETTERS else f"{label[: _MOST_LETTERS - 1]}…"
