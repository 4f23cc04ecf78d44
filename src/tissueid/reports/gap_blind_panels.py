"""The pictures of a sealed check: what was named for what, and the risk as more is answered."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from matplotlib.figure import FigureBase

from tissueid.errors import UnusableInputError
from tissueid.gap.sealed import Score
from tissueid.reports.panel_sheet import Panel
from tissueid.reports.style import BLUE, DASHES, INK, MUTED, ORANGE, SEQUENTIAL

_VERDICTS = ("unexplained", "no_gap")
_ROW_INCHES = 0.24
_MOST_LETTERS = 26


def blind_panels(key: str, score: Score) -> Iterator[Panel]:
    """Both pictures of one kind of session."""
    rows, columns = confusion_names(score)
    yield Panel(
        f"{key}-confusion",
        "Named for what it was",
        f"Counts of what was named ({len(columns)} columns) for each of {len(rows)} true effects.",
        "A row a true effect, a column what was said; single effects whose gap survives the refit. What lies on the "
        "marked cells was named rightly.",
        lambda figure: draw_confusion(figure, score),
        height=2.1 + _ROW_INCHES * len(rows),
    )
    yield Panel(
        f"{key}-risk",
        "Risk and coverage",
        "Share of wrong names among the answers against the share of scenarios that are answered.",
        "Answers from the surest to the least sure: the share of wrong names among those so far. A diagnosis that "
        "knows when it does not know begins at zero and rises late; the dotted line is what all answers together come "
        "to.",
        lambda figure: draw_risk(figure, score),
        height=3.0,
    )


def confusion_names(score: Score) -> tuple[list[str], list[str]]:
    """True effects, and what was said: the same in the same order, then other names, then abstentions."""
    rows = sorted(score.confusion)
    said = {name for row in score.confusion.values() for name in row}
    others = sorted(said - set(rows) - set(_VERDICTS))
    named = [name for name in rows if name in said]
    return rows, [*named, *others, *(verdict for verdict in _VERDICTS if verdict in said)]


def draw_confusion(figure: FigureBase, score: Score) -> None:
    """Counts in cells.

    Raises:
        UnusableInputError: there is no single effect whose gap survives the refit.
    """
    rows, columns = confusion_names(score)
    if not rows:
        raise UnusableInputError("there was no single effect whose gap survives the refit")
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
    axes.set_ylabel("True effect")
    axes.set_xlabel("Named")


def draw_risk(figure: FigureBase, score: Score) -> None:
    """Risk against coverage.

    Raises:
        UnusableInputError: nothing was answered.
    """
    if not score.risk_coverage:
        raise UnusableInputError("there was no single effect whose gap survives the refit")
    axes = figure.subplots(1, 1)
    coverage, risk = 100.0 * np.array(score.risk_coverage).T
    axes.axhline(risk[-1], color=MUTED, linewidth=1.0, linestyle=DASHES[2])
    axes.plot(coverage, risk, color=BLUE, drawstyle="steps-post", marker="o" if risk.size < 40 else "", markersize=3.5)
    axes.set_xlim(0.0, 101.0)
    axes.set_ylim(-1.0, max(1.15 * float(risk.max()), 10.0))
    axes.set_xlabel("Answered (% of scenarios, the surest first)")
    axes.set_ylabel("Wrong among them (%)")


def _shown(name: str) -> str:
    words = name.replace("_", " ")
    return words if len(words) <= _MOST_LETTERS else f"{words[: _MOST_LETTERS - 1]}…"
