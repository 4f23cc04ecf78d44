"""Tab "Recommendation": the result of a comparison of engines, and the choice of engines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from PySide6.QtWidgets import (
    QHeaderView,
    QMenu,
    QPlainTextEdit,
    QWidget,
)

from tissueid.analysis import EngineComparison
from tissueid.app.build import button, choice, column, fill_table, label, offer, row, splitter, styled, table
from tissueid.app.views.researcher.results_table import in_two_lines
from tissueid.app.views.researcher.selected_test import SelectedTest
from tissueid.app.words import sentence
from tissueid.formatting import clean, fixed, grouped
from tissueid.identification import engine_label, engine_names
from tissueid.identification.recommendation_messages import ModelStanding
from tissueid.language import _, marked
from tissueid.messages import MISSING, translated


@dataclass(frozen=True)
class ComparisonSummary:
    """The recommendation for one test. ``rows`` are the standings, best first: see ``COLUMNS``."""

    label: str
    headline: str
    judged_on: str
    reasons: tuple[str, ...]
    doubts: tuple[str, ...]
    experiments: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


COLUMNS = (
    marked("Engine"),
    marked("Verdict"),
    marked("VAF held out (%)"),
    marked("VAF fitted (%)"),
    marked("Below the best (points)"),
    "AICc",
    marked("Kind"),
)


def summary_of(found: EngineComparison, tests: tuple[SelectedTest, ...]) -> ComparisonSummary:
    """Return the summary of a comparison; refused engines come last, with the reason."""
    said = found.recommendation
    recommended = (said.engine, said.second_order)
    rows = [_row(one, (one.engine, one.second_order) == recommended) for one in said.standings]
    rows += [
        (engine_label(entry.engine), _("refused"), *[MISSING] * 4, sentence(translated(entry.refused)))
        for entry in found.entries
        if entry.refused
    ]
    headline, *reasons = map(translated, said.sentences)
    ceiling = found.ceiling
    if ceiling is not None:
        reasons.append(_("Repeats of the test allow {vaf} % at best.").format(vaf=fixed(ceiling.vaf_percent.value, 2)))
    label = (
        clean(tests[0].label)
        if len(tests) == 1
        else _("{first} and {count} more").format(first=clean(tests[0].label), count=len(tests) - 1)
    )
    return ComparisonSummary(
        label,
        sentence(headline),
        sentence(_("judged on {data}").format(data=translated(said.judged_on))),
        tuple(map(sentence, reasons)),
        tuple(sentence(translated(doubt)) for doubt in said.doubts),
        tuple(sentence(translated(words)) for words in said.experiments),
        tuple(rows),
    )


def _row(one: ModelStanding, recommended: bool) -> tuple[str, ...]:
    name = engine_label(one.engine) + (_(", mass, damping and stiffness") if one.second_order else "")
    behind = one.behind
    how = fixed(behind.points, 2) + (f" ± {fixed(behind.std_points, 2)}" if behind.points else "")
    return (
        name,
        _("recommended") if recommended else _("clearly worse") if one.beaten else _("as good"),
        fixed(one.vaf_percent, 2),
        fixed(one.vaf_fitted_percent, 2),
        how,
        grouped(one.aicc),
        _(str(one.family)),
    )


_NOTHING = marked("No comparison yet. “Compare engines” fits every engine to the chosen tests and recommends one.")
_STATE = 1
_NUMBERS = (2, 3, 4, 5)
"""Columns of the table."""


class RecommendationView(QWidget):
    """Shows one comparison at a time."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._verdicts: dict[str, ComparisonSummary] = {}
        self.choice = choice({}, self._show, 0, name=_("Test whose comparison is shown"))
        self.engines = button(_("En&gines compared"))
        menu = QMenu(self.engines)
        self.engines.setMenu(menu)
        self._actions = {name: menu.addAction(engine_label(name)) for name in engine_names()}
        for action in self._actions.values():
            styled(action, checkable=True, checked=True).toggled.connect(self._count)
        self.save = button(_("Table…"), name=_("Save the recommendation"), tip=_("Save table and reasons as CSV"))
        self.headline = label("headline")
        self.words = styled(
            QPlainTextEdit(), name=_("Reasons of the recommendation"), read_only=True, tab_changes_focus=True
        )
        self.standings = table([in_two_lines(_(name)) for name in COLUMNS], _("Engines by how well they do"))
        self.standings.setWordWrap(True)  # the last column has the reason of a refusal
        header = self.standings.horizontalHeader()
        header.setSectionResizeMode(len(COLUMNS) - 1, QHeaderView.ResizeMode.Stretch)
        header.sectionResized.connect(self.standings.resizeRowsToContents)
        parts = splitter((self.words, 2), (self.standings, 3), upright=True)
        top = row(self.engines, (self.choice, 1), self.save)
        column(top, self.headline, (parts, 1), margins=(0, 6, 0, 0), parent=self)
        self._count()
        self._show()

    @property
    def compared(self) -> tuple[str, ...]:
        """The engines that are compared."""
        return tuple(name for name, action in self._actions.items() if action.isChecked())

    def take_compared(self, engines: Sequence[str]) -> None:
        """Select the engines to compare; unknown names are ignored, an empty selection means all."""
        known = [name for name in engines if name in self._actions] or list(self._actions)
        for name, action in self._actions.items():
            action.setChecked(name in known)

    def add(self, verdicts: Sequence[ComparisonSummary]) -> None:
        """Add summaries and show the first; a later summary of a test replaces the earlier one."""
        if not verdicts:
            return
        self._verdicts |= {verdict.label: verdict for verdict in verdicts}
        offer(self.choice, {label: label for label in self._verdicts}, verdicts[0].label)
        self._show()

    def rows(self) -> list[Sequence[str]]:
        """Return the shown comparison as rows of a table: its engines, then each sentence in a row of its own."""
        verdict = self._verdicts.get(self.choice.currentText())
        if verdict is None:
            return []
        said = (verdict.label, verdict.headline, verdict.judged_on, *verdict.reasons, *verdict.doubts)
        return [list(map(_, COLUMNS)), *verdict.rows, *([line] for line in (*said, *verdict.experiments))]

    def _count(self) -> None:
        count = _("all") if len(self.compared) == len(self._actions) else len(self.compared)
        self.engines.setText(_("En&gines compared: {count}").format(count=count))

    def _show(self) -> None:
        verdict = self._verdicts.get(self.choice.currentText())
        for part in (self.choice, self.standings, self.headline, self.save):
            part.setVisible(verdict is not None)
        if verdict is None:
            self.headline.setText("")
            self.words.setPlainText(_(_NOTHING))
            return
        self.headline.setText(verdict.headline)
        parts = [verdict.judged_on, *verdict.reasons]
        for title, lines in ((_("Caveats"), verdict.doubts), (_("Suggested tests"), verdict.experiments)):
            parts += ["", title, *lines] if lines else []
        self.words.setPlainText("\n".join(parts))
        best = [place for place, texts in enumerate(verdict.rows) if texts[_STATE] == _("recommended")]
        fill_table(self.standings, verdict.rows, bold=best, right=_NUMBERS)
        self.standings.resizeRowsToContents()
