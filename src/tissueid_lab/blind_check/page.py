"""Report of the sealed check of the diagnosis: one self-contained page."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tissueid import __version__
from tissueid.formatting import clean, fixed, number
from tissueid.language import _
from tissueid.messages import MISSING, Message, translated
from tissueid.reports.page import RESEARCH_LINE, FigureGroup, template, write_text_atomically
from tissueid.reports.tables import Row, Table
from tissueid_lab.blind_check.answers import BlindCheck
from tissueid_lab.blind_check.panels import blind_panels
from tissueid_lab.blind_check.scoring import Measured, Rate, Score

Level = Literal["good", "check", "poor"]


@dataclass(frozen=True)
class Section:
    """Results of one kind of session."""

    key: str
    title: str
    numbers: Table
    controls: Table
    figures: FigureGroup
    failures: tuple[str, ...]


def blind_html(check: BlindCheck, title: str = "") -> str:
    """Return the page as HTML text: for each kind of session scores with intervals, figures, controls and failures."""
    headline, level = headline_of(check)
    return template("blind_check.html.j2", "tissueid_lab.blind_check").render(
        title=title or _("Sealed check of the diagnosis"),
        research_line=_(RESEARCH_LINE),
        software=f"tissueid {__version__}",
        facts=(
            (_("Scenarios"), str(check.n)),
            (_("Seed"), str(check.seed)),
            (_("SHA-256 of the labels"), clean(check.seal)),
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
    items = [item for _, _, score in check.scores.values() for item in _items(score)]
    judged = [item.reached for item in items if item.reached is not None]
    if not judged:
        return translated(Message("blind.none_judged", "No case could be judged")), "check"
    text = _("{reached} of {count} targets were reached").format(reached=sum(judged), count=len(judged))
    return text, "good" if all(judged) else "poor"


def _items(score: Score) -> list[Rate | Measured]:
    return [*score.rates, *score.figures]


def _sentences(check: BlindCheck) -> Iterator[str]:
    for title, count, score in check.scores.values():
        missed = "; ".join(translated(item.what) for item in _items(score) if item.reached is False)
        text = _("{kind}, {count} scenarios: all targets that could be judged were reached.")
        if missed:
            text = _("{kind}, {count} scenarios: not reached: {missed}.")
        yield text.format(kind=translated(title), count=count, missed=missed)
    yield _("An interval that contains its target leaves open whether the target is reached.")


def _section(key: str, title: str, count: int, score: Score) -> Section:
    panels = blind_panels(key, score)
    return Section(
        key,
        _("{kind}: {count} scenarios").format(kind=translated(title), count=count),
        Table(
            _("Score"),
            ("", _("Target"), _("Measured"), _("95 % (Wilson)"), _("Cases"), ""),
            tuple(_rows(score)),
        ),
        Table(
            _("Controls"),
            (_("First place by"), _("Share"), _("Cases")),
            tuple((translated(item.what), _percent(item.value), str(item.cases)) for item in score.controls),
            _("Scores of chance (permuted labels), of a constant answer, and of a search without held-out data."),
        ),
        FigureGroup(f"g-{key}", "", tuple(panel.picture().block for panel in panels)),
        tuple(translated(line) for line in score.failures),
    )


def _rows(score: Score) -> Iterator[Row]:
    for rate in score.rates:
        low, high = rate.interval
        interval = _("{low} to {high} %").format(low=fixed(100.0 * low, 0), high=fixed(100.0 * high, 0))
        cases = _("{hits} of {cases}").format(hits=rate.hits, cases=rate.cases)
        yield (
            translated(rate.what),
            _target(_percent(rate.target), at_least=rate.at_least),
            _percent(rate.share),
            interval if rate.cases else MISSING,
            cases,
            _kept(rate.reached),
        )
    for figure in score.figures:
        target = MISSING if figure.target is None else _target(number(figure.target, 3), at_least=figure.at_least)
        value = number(figure.value, 3)
        yield translated(figure.what), target, value, MISSING, str(figure.cases), _kept(figure.reached)


def _target(value: str, *, at_least: bool) -> str:
    return value if at_least else _("at most {value}").format(value=value)


def _percent(share: float) -> str:
    return f"{fixed(100.0 * share, 0)} %" if share == share else MISSING


def _kept(kept: bool | None) -> str:
    return MISSING if kept is None else _("reached") if kept else _("not reached")
