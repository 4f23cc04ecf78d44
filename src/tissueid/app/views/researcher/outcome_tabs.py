"""The tabs "Recommendation", of a comparison of engines, and "History", of earlier analyses."""

from __future__ import annotations

from collections.abc import Sequence

from PySide6.QtCore import Signal
from PySide6.QtWidgets import (
    QAbstractItemView,
    QHeaderView,
    QMenu,
    QPlainTextEdit,
    QWidget,
)

from tissueid.app import build
from tissueid.app.build import button, choice, label, offer, row, splitter, styled, table
from tissueid.app.views.researcher.batch import COLUMNS, ComparisonSummary
from tissueid.app.views.researcher.engine_outcome import AnalysisTask, changed_options
from tissueid.app.views.researcher.results_store import MOST_ENTRIES, HistoryEntry
from tissueid.app.views.researcher.results_table import in_two_lines
from tissueid.app.widgets import fill_table
from tissueid.formatting import clean, plain_text
from tissueid.identification import engine_label, engine_names
from tissueid.language import _, marked
from tissueid.messages import translated

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
        self._actions = {name: build.add_check(menu, engine_label(name), True, self._count) for name in engine_names()}
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
        build.column(top, self.headline, (parts, 1), margins=(0, 6, 0, 0), parent=self)
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


_COLUMNS = (
    marked("When"),
    marked("Engine"),
    marked("Tests"),
    marked("Result"),
    marked("Options that differ from the defaults"),
)
_LONGEST = 200


class HistoryList(QWidget):
    """Earlier analyses. ``again`` carries a task to repeat, ``wanted`` one to put into the form."""

    again = Signal(object)
    wanted = Signal(object)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._entries: list[HistoryEntry] = []
        self._busy = False
        self.run = build.button(_("Run again"), self._again)
        self.fill = build.button(_("Put into the form"), self._fill)
        self.remark = build.label("muted")
        self.table = build.table([_(name) for name in _COLUMNS], _("History of analyses"))
        self.table.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
        interactive = QHeaderView.ResizeMode.Interactive
        build.styled(self.table.horizontalHeader(), section_resize_mode=interactive, stretch_last_section=True)
        build.column(
            build.row(self.fill, self.run, (self.remark, 1)), (self.table, 1), margins=(0, 6, 0, 0), parent=self
        )
        self.table.itemSelectionChanged.connect(self._settle)
        self.table.activated.connect(self._fill)
        self._settle()

    def show_entries(self, entries: Sequence[HistoryEntry], bad: int = 0) -> None:
        """Show entries, newest first; ``bad`` is the number of unreadable lines."""
        self._entries = list(entries)[:MOST_ENTRIES]
        self.remark.setText(
            _("{count} lines of the history could not be read and are passed over.").format(count=bad) if bad else ""
        )
        fill_table(self.table, [[text[:_LONGEST] for text in _texts(entry)] for entry in self._entries])
        for column in range(len(_COLUMNS) - 1):
            self.table.resizeColumnToContents(column)
            self.table.setColumnWidth(column, min(240, self.table.columnWidth(column) + 6))
        self._settle()

    def add(self, entry: HistoryEntry) -> None:
        """Add the newest run."""
        self.show_entries([entry, *self._entries])

    def update_enabled(self, *, busy: bool) -> None:
        """Disable "Run again" while other work runs."""
        self._busy = busy
        self._settle()

    def _chosen(self) -> AnalysisTask | None:
        rows = self.table.selectionModel().selectedRows()
        return self._entries[rows[0].row()].task if rows else None

    def _settle(self) -> None:
        chosen = self._chosen() is not None
        self.fill.setEnabled(chosen)
        self.run.setEnabled(chosen and not self._busy)

    def _again(self) -> None:
        if (task := self._chosen()) is not None and not self._busy:
            self.again.emit(task)

    def _fill(self) -> None:
        if (task := self._chosen()) is not None:
            self.wanted.emit(task)


def _texts(entry: HistoryEntry) -> tuple[str, str, str, str, str]:
    task = entry.task
    when = entry.time.astimezone().strftime("%Y-%m-%d %H:%M:%S")
    names = ", ".join(engine_label(clean(name)) for name in task.engines)
    what = _("{count} compared").format(count=len(task.engines)) if task.kind == "compare" else names
    first = clean(task.tests[0].label or str(task.tests[0].path)) if task.tests else _("none")
    tests = first if len(task.tests) < 2 else f"{len(task.tests)}: {first} …"
    return when, what, tests, clean(translated(entry.headline)), names if task.kind == "compare" else _changed(task)


def _changed(task: AnalysisTask) -> str:
    """Return the settings that differ from the defaults; all of them if the engine is not installed."""
    name = task.engines[0]
    options = changed_options(name, task.options) | task.preparation.changed
    words = [plain_text(options)] if options else []
    if (task.input_name, task.output_name) != ("force", "position"):
        words.append(_("{input} to {output}").format(input=clean(task.input_name), output=clean(task.output_name)))
    if task.together:
        words.append(_("tests of a file together"))
    return "; ".join(words) or _("default options")
