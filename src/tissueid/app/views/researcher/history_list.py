"""Former results in a list, and how the state of the panel is kept."""

from __future__ import annotations

import json
from collections.abc import Sequence

from PySide6.QtCore import Signal
from PySide6.QtWidgets import (
    QAbstractItemView,
    QComboBox,
    QHeaderView,
    QTabWidget,
    QWidget,
)

from tissueid.app import build
from tissueid.app.views.researcher.engine_form import EngineForm
from tissueid.app.views.researcher.engine_outcome import AnalysisTask, Preparation, changed_options
from tissueid.app.views.researcher.recommendation_view import RecommendationView
from tissueid.app.views.researcher.results_store import MOST_ENTRIES, HistoryEntry
from tissueid.errors import TissueIDError
from tissueid.formatting import clean, plain_text
from tissueid.identification import engine_label
from tissueid.language import _, marked
from tissueid.messages import translated

STATE = "research/analysis"
_LONGEST_STATE = 100_000


def saved_state(form: EngineForm, verdicts: RecommendationView, picture: QComboBox, tabs: QTabWidget) -> str:
    """Return the state as one line of JSON."""
    state = {
        "engine": form.name,
        "options": form.all_options(),
        "signals": form.signals,
        "together": form.together.isChecked(),
        "preparation": form.preparation.value().model_dump(),
        "compared": verdicts.compared,
        "picture": picture.currentData(),
        "tab": tabs.currentIndex(),
    }
    return json.dumps(state)


def restore_state(
    saved: object, form: EngineForm, verdicts: RecommendationView, picture: QComboBox, tabs: QTabWidget
) -> None:
    """Restore the saved state; invalid content is ignored."""
    try:
        state = json.loads(saved) if isinstance(saved, str) and len(saved) <= _LONGEST_STATE else {}
        form.restore(dict(state.get("options", {})))
        form.choose(str(state.get("engine", form.name)))
        into, out = map(str, state.get("signals", form.signals))
        form.take_signals(into, out, state.get("together") is True)
        form.preparation.set_value(Preparation.model_validate(state.get("preparation", {})))
        verdicts.take_compared([str(name) for name in state.get("compared", ())])
        picture.setCurrentIndex(max(0, picture.findData(str(state.get("picture", "")))))
        tabs.setCurrentIndex(int(state.get("tab", 0)))
    except (TissueIDError, ValueError, TypeError, AttributeError, RecursionError):
        form.restore({})


_COLUMNS = (
    marked("When"),
    marked("Engine"),
    marked("Tests"),
    marked("Result"),
    marked("Options that differ from the defaults"),
)
_ROW = 22
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
        build.fill_table(self.table, [[text[:_LONGEST] for text in _texts(entry)] for entry in self._entries])
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
