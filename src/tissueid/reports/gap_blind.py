"""The sealed check of the diagnosis as one self-contained page."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tissueid import __version__
from tissueid.gap.blind_check import BlindCheck
from tissueid.gap.sealed import Measured, Rate, Score
from tissueid.reports.blocks import FigureGroup
from tissueid.reports.gap_blind_panels import blind_panels
from tissueid.reports.html import RESEARCH_LINE, template, write_whole
from tissueid.reports.tables import Row, Table
from tissueid.wording import MISSING, clean, fixed, number

Level = Literal["good", "check", "poor"]


@dataclass(frozen=True)
class Section:
    """What the page shows of one kind of session."""

    key: str
    title: str
    numbers: Table
    controls: Table
    figures: FigureGroup
    failures: tuple[str, ...]


def blind_html(check: BlindCheck, title: str = "Sealed check of the diagnosis") -> str:
    """The page as HTML text: for each kind of session the score with intervals, pictures, controls and failures."""
    headline, level = headline_of(check)
    return template("gap_blind.html.j2").render(
        title=title,
        research_line=RESEARCH_LINE,
        software=f"tissueid {__version__}",
        facts=(("Scenarios", str(check.n)), ("Seed", str(check.seed)), ("SHA-256 of the labels", clean(check.seal))),
        headline=headline,
        level=level,
        sentences=tuple(_sentences(check)),
        sections=tuple(_section(key, *item) for key, item in check.scores.items()),
    )


def write_blind_report(check: BlindCheck, path: Path) -> None:
    """Write the page so that ``path`` is whole or untouched.

    Raises:
        OSError: the folder is missing, or the disk is full or not writable; nothing is left behind.
    """
    write_whole(path, blind_html(check))


def headline_of(check: BlindCheck) -> tuple[str, Level]:
    """How much of what is asked was reached, in a line, and how that is to be taken."""
    items = [item for _, _, score in check.scores.values() for item in _items(score)]
    judged = [item.kept for item in items if item.kept is not None]
    if not judged:
        return "No case could be judged", "check"
    words = f"{sum(judged)} of {len(judged)} figures that are asked for were reached"
    return words, "good" if all(judged) else "poor"


def _items(score: Score) -> list[Rate | Measured]:
    return [*score.rates, *score.figures]


def _sentences(check: BlindCheck) -> Iterator[str]:
    for title, count, score in check.scores.values():
        missed = [item.what for item in _items(score) if item.kept is False]
        short = f"not reached: {'; '.join(missed)}" if missed else "everything that could be judged was reached"
        yield f"{title}, {count} scenarios: {short}."
    yield "The intervals say how little so many scenarios can tell: where one holds what is asked, it is not settled."


def _section(key: str, title: str, count: int, score: Score) -> Section:
    panels = blind_panels(key, score)
    return Section(
        key,
        f"{title}: {count} scenarios",
        Table("Score", ("", "Asked", "Measured", "95 % (Wilson)", "Cases", ""), tuple(_rows(score))),
        Table(
            "Controls",
            ("First place by", "Share", "Cases"),
            tuple((item.what, _percent(item.value), str(item.cases)) for item in score.controls),
            "What chance (labels dealt out anew), habit, and a search without held-out data would reach.",
        ),
        FigureGroup(f"g-{key}", "", tuple(panel.picture().block for panel in panels)),
        score.failures,
    )


def _rows(score: Score) -> Iterator[Row]:
    for rate in score.rates:
        low, high = rate.interval
        asked = f"{'' if rate.at_least else 'at most '}{_percent(rate.asked)}"
        interval = f"{fixed(100.0 * low, 0)} to {fixed(100.0 * high, 0)} %" if rate.cases else MISSING
        cases = f"{rate.hits} of {rate.cases}"
        yield rate.what, asked, _percent(rate.share), interval, cases, _kept(rate.kept)
    for figure in score.figures:
        yield figure.what, _asked(figure), number(figure.value, 3), MISSING, str(figure.cases), _kept(figure.kept)


def _asked(figure: Measured) -> str:
    return MISSING if figure.asked is None else f"{'' if figure.at_least else 'at most '}{number(figure.asked, 3)}"


def _percent(share: float) -> str:
    return f"{fixed(100.0 * share, 0)} %" if share == share else MISSING


def _kept(kept: bool | None) -> str:
    return MISSING if kept is None else "reached" if kept else "not reached"
