"""Session browser: folders, list of sessions, and selected tests."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from queue import Empty

from PySide6.QtCore import QByteArray, QItemSelection, QModelIndex, Qt, Signal
from PySide6.QtGui import QKeySequence
from PySide6.QtWidgets import QComboBox, QLineEdit, QMenu, QPushButton, QWidget

from tissueid.app import build
from tissueid.app.context import AppContext
from tissueid.app.views.researcher.background_work import ProgressStrip
from tissueid.app.views.researcher.selected_test import SelectedTest
from tissueid.app.views.researcher.session_search import SessionEntry, SessionSearch, TestEntry
from tissueid.app.views.researcher.session_tree import DATE, ITEM, SessionFilter, SessionModel, SessionTree
from tissueid.app.widgets import plain_tip
from tissueid.app.window_state import RESEARCH_FOLDERS, load_texts, save_texts, visited_studies
from tissueid.formatting import clean, grouped, subject_text
from tissueid.language import _, marked, plural
from tissueid.messages import Message, translated

_NAMES = (marked("Subject"), marked("Site"), marked("Kind"))
_ALL = (marked("All subjects"), marked("All sites"), marked("All kinds"))
_LONGEST_FILTER = 200
_MOST_OFFERED = 2000


class FilterBar(QWidget):
    """Search and filters; ``changed`` is emitted on each change."""

    changed = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.search = build.styled(
            QLineEdit(),
            max_length=_LONGEST_FILTER,
            placeholder_text=_("Search in all columns"),
            name=_("Search in all columns"),
            tip=_("Rows that have every word (Ctrl+F)"),
            clear_button_enabled=True,
        )
        filtering = _("Filter by {column}")
        self.choices = tuple(
            build.choice({"": _(name)}, self._chosen, 4, name=filtering.format(column=_(name))) for name in _NAMES
        )
        self.subject, self.site, self.kind = self.choices
        self.clear = build.button(_("Clear"), self._clear, name=_("Clear search and filters"))
        for choice in self.choices:
            choice.view().setTextElideMode(Qt.TextElideMode.ElideRight)
        choices = build.row(*[(choice, 1) for choice in self.choices])
        build.column(build.row((self.search, 1), self.clear), choices, parent=self)
        self.search.textChanged.connect(self._chosen)
        self._chosen()

    @property
    def asked(self) -> tuple[str, str, str, str]:
        """Search words, subject, site and kind; "" for no filter."""
        subject, site, kind = (str(choice.currentData() or "") for choice in self.choices)
        return self.search.text(), subject, site, kind

    def ask(self, search: str, subject: str, site: str, kind: str) -> None:
        """Set the search words and filters."""
        for choice, value in zip(self.choices, (subject, site, kind), strict=True):
            if value and choice.findData(value) < 0:
                choice.addItem(self._text(choice, value), value)
            choice.setCurrentIndex(choice.findData(value))
        self.search.setText(search)

    def offer(self, entries: Iterable[SessionEntry]) -> None:
        """Offer the values found in these files; the selection stays."""
        sessions = [entry for entry in entries if not entry.problem]
        tests = [test for entry in sessions for test in entry.tests]
        offered = {entry.pseudonym for entry in sessions}, {test.site for test in tests}, {test.kind for test in tests}
        for choice, values in zip(self.choices, offered, strict=True):
            self._fill(choice, (values | {choice.currentData()}) - {""})

    def _fill(self, choice: QComboBox, values: set[str]) -> None:
        wanted = sorted(values, key=str.casefold)[:_MOST_OFFERED]
        if [choice.itemData(index) for index in range(1, choice.count())] != wanted:
            build.offer(choice, {"": choice.itemText(0)} | {value: self._text(choice, value) for value in wanted})

    def _text(self, choice: QComboBox, value: str) -> str:
        if choice is self.subject:
            return subject_text(value)
        return _(clean(value)) if choice is self.kind else clean(value)

    def _chosen(self) -> None:
        self.clear.setEnabled(any(self.asked))
        for choice, anything in zip(self.choices, _ALL, strict=True):
            choice.setToolTip(plain_tip(choice.currentText() if choice.currentIndex() else _(anything)))
        self.changed.emit()

    def _clear(self) -> None:
        self.ask("", "", "", "")
        self.search.setFocus()


_LONGEST = 70


class FolderButton(QPushButton):
    """Button with a menu to add and remove folders; ``changed`` is emitted on each change."""

    changed = Signal()

    def __init__(self, paths: Sequence[Path], parent: QWidget | None = None) -> None:
        super().__init__(_("Folders"), parent)
        self.paths = list(paths)
        self.setMenu(QMenu(self))
        self._fill()

    def add(self, path: Path) -> None:
        """Add a folder."""
        self._take([*self.paths, path] if path not in self.paths else self.paths)

    def remove(self, path: Path) -> None:
        """Remove a folder."""
        self._take([other for other in self.paths if other != path])

    def _take(self, paths: list[Path]) -> None:
        if paths != self.paths:
            self.paths = paths
            self._fill()
            self.changed.emit()

    def _fill(self) -> None:
        menu = self.menu()
        menu.clear()
        menu.addAction(_("Add a folder…"), self._choose)
        menu.addSeparator()
        for path in self.paths:
            text = clean(str(path))
            text = text if len(text) <= _LONGEST else f"…{text[-_LONGEST:]}"
            menu.addAction(_("Remove {path}").format(path=text).replace("&", "&&"), partial(self.remove, path))
        listed = "\n".join(clean(str(path)) for path in self.paths)
        build.styled(
            self,
            tip=plain_tip(f"{_('Sessions are looked for in these folders, and below them:')}\n{listed}"),
            name=_("Folders that are looked through: {count}").format(count=len(self.paths)),
        )

    def _choose(self) -> None:
        at = self.paths[-1] if self.paths else None
        build.ask_path(self.window(), _("Look for sessions in"), at, self.add)


_ASKED, _HEADER = "research/asked", "research/columns"
_WIDTHS = "research/widths"
_SETTLED_MS = 120
"""A selection that stands so long is what was meant; the arrow keys pass over many."""
_DRAIN_MS = 80
_AT_ONCE = 200
_LONGEST_LABEL = 60


class Browser(QWidget):
    """Session browser. ``selected``: the selection changed; ``opened``: the file to open.

    ``work_waits`` says that :meth:`go_on` has something to begin.
    """

    selected = Signal()
    opened = Signal(object)
    work_waits = Signal()

    def __init__(self, context: AppContext, strip: ProgressStrip, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._context = context
        self._strip = strip
        self._search: SessionSearch | None = None
        self._all_wanted = True
        self._heard: list[Path] = []
        self._single: list[Path] = []
        self._to_choose: Path | None = None
        self.model = SessionModel(self)
        self.shown = SessionFilter(self.model, self)
        self.bar = FilterBar()
        self.tree = SessionTree(self.shown)
        self.count = build.label("muted")
        self.picked = build.label("muted", _("Nothing selected"))
        folders = [Path(text) for text in load_texts(context.settings, RESEARCH_FOLDERS)]
        self.folders = FolderButton(folders or [context.services.folder], self)
        self.again = build.button(
            _("Search again"), self.look_again, tip=_("Look for new sessions in the folders (F5)")
        )
        self._restore()
        self._arrange()
        self._drain = build.timer(self, _DRAIN_MS, self._take_found, repeat=True)
        self._settled = build.timer(self, _SETTLED_MS, self._tell_selected)
        self._connect()
        self._tell_count()

    # -- for the page ---------------------------------------------------------------------------------------

    def chosen(self) -> list[SelectedTest]:
        """Return the selected tests in the order of the list; a session stands for its listed tests."""
        tops: dict[int, set[int]] = {}
        for index in self.tree.selectionModel().selectedRows(DATE):
            below = index.parent().isValid()
            tops.setdefault(index.parent().row() if below else index.row(), set()).add(index.row() if below else -1)
        chosen = []
        for row in sorted(tops):
            top = self.shown.index(row, DATE)
            entry = self.shown.data(top, ITEM)
            rows = range(self.shown.rowCount(top))
            wanted = rows if -1 in tops[row] else sorted(tops[row])
            chosen += [
                self._chosen(entry, self.shown.data(self.shown.index(test_row, DATE, top), ITEM)) for test_row in wanted
            ]
        return chosen

    def go_on(self) -> bool:
        """Start waiting work; return whether a job was started."""
        if not (self._all_wanted or self._heard):
            return False
        whole = self._all_wanted
        self._single = list(dict.fromkeys([*self._single, *self._heard]))
        files = self._single if whole else self._heard
        self._all_wanted, self._heard = False, []
        # Before the first test the folder of new sessions is not there yet: that is no problem.
        folders = [path for path in self.folders.paths if path != self._context.services.folder or path.is_dir()]
        resolved = [folder.resolve() for folder in folders]
        visited = [study for study in visited_studies(self._context.settings) if study.is_dir()]
        folders += [
            study for study in visited if not any(study.resolve().is_relative_to(folder) for folder in resolved)
        ]
        self._search = SessionSearch(folders if whole else (), files, self.model.by_path if whole else {})
        self._whole = whole
        self._seen: set[Path] = set()
        self._strip.watch(self._search)
        self._drain.start()
        why = _("Sessions are being read on Research: cancel it there, or wait.")
        self._context.jobs.do(self._search.run, self._ended, self._failed, why=why)
        return True

    def on_session_saved(self, path: Path) -> None:
        """List a new session as soon as no other job runs."""
        self._heard.append(path)
        self.work_waits.emit()

    def list_sessions(self, paths: list[Path]) -> None:
        """Add folders and single sessions to the list."""
        for path in paths:
            if path.is_dir():
                self.folders.add(path)
            else:
                self.on_session_saved(path)

    def choose(self, path: Path) -> None:
        """List a new session, then select it alone."""
        self._to_choose = path
        self.on_session_saved(path)

    def _choose_listed(self) -> None:
        path, self._to_choose = self._to_choose, None
        if all(entry.path != path for _index, entry in self.shown.shown()):
            self.bar.ask("", "", "", "")
            self._ask()
        for index, entry in self.shown.shown():
            if entry.path == path:
                self.tree.setCurrentIndex(index)
                self.tree.scrollTo(index)

    def look_again(self) -> None:
        """Search all folders as soon as no other job runs."""
        self._all_wanted = True
        self.work_waits.emit()

    def update_enabled(self, *, testing: bool) -> None:
        """Disable the controls during a test."""
        self.setEnabled(not testing)
        if self._all_wanted:
            self._tell_count()

    def save_state(self) -> None:
        """Save folders, filters and columns."""
        self._save_folders()
        save_texts(self._context.settings, _ASKED, list(self.bar.asked))
        self._context.settings.setValue(_HEADER, self.tree.header().saveState())
        save_texts(self._context.settings, _WIDTHS, self.tree.widths())

    def _save_folders(self) -> None:
        save_texts(self._context.settings, RESEARCH_FOLDERS, [str(path) for path in self.folders.paths])

    # -- searching ------------------------------------------------------------------------------------------

    def _take_found(self) -> None:
        """List the new files, a limited number at a time."""
        if self._search is None:
            return
        entries: list[SessionEntry] = []
        with suppress(Empty):
            while len(entries) < _AT_ONCE:
                entries.append(self._search.entries.get_nowait())
        if entries:
            self._seen |= {entry.path for entry in entries}
            self.model.add(entries)
            self._show_entries()

    def _show_entries(self) -> None:
        self.tree.span_problems()
        self.bar.offer(self.model.entries)
        self._tell_count()

    def _ended(self, search: SessionSearch) -> None:
        self._drain.stop()
        self._strip.clear()
        while not search.entries.empty():
            self._take_found()
        if self._whole and not search.cancelled() and self._seen != set(self.model.by_path):
            self.model.show([entry for entry in self.model.entries if entry.path in self._seen])
        self._search = None
        self._show_entries()
        if self._to_choose in self.model.by_path:
            self._choose_listed()
        if search.remarks:
            self._context.say(" ".join(search.remarks), problem=not search.cancelled())

    def _failed(self, message: str) -> None:
        self._drain.stop()
        self._strip.clear()
        self._search = None
        self._context.say(message, problem=True)

    # -- what is shown --------------------------------------------------------------------------------------

    def _ask(self) -> None:
        self.shown.ask(*self.bar.asked)
        self.tree.span_problems()
        self._tell_count()

    def _tell_count(self) -> None:
        entries = self.model.entries
        bad = sum(bool(entry.problem) for entry in entries)
        shown = self.shown.rowCount()
        listed = len(entries) - bad
        text = plural("{count} session", "{count} sessions", listed).format(count=grouped(listed))
        if bad:
            text += _(", {count} unreadable").format(count=grouped(bad))
        if shown != len(entries):
            text += _("; {count} shown").format(count=grouped(shown))
        waits = self._all_wanted and self._context.busy
        self.count.setText(self._context.unread if waits else text)
        empty = "" if entries or self._search is not None or self._all_wanted else _("No sessions in these folders.")
        if entries and not shown:
            empty = _("Nothing matches.")
        self.tree.say_empty(empty)

    def _select(self, _now: QItemSelection, _before: QItemSelection) -> None:
        self._settled.start()

    def _tell_selected(self) -> None:
        chosen = self.chosen()
        sessions = len({test.path for test in chosen})
        tests = plural("{count} test", "{count} tests", len(chosen)).format(count=len(chosen))
        of = plural("{count} session", "{count} sessions", sessions).format(count=sessions)
        picked = Message("research.selected", "{tests} of {sessions} selected", tests=tests, sessions=of)
        self.picked.setText(translated(picked) if chosen else _("Nothing selected"))
        self.selected.emit()

    def _chosen(self, entry: SessionEntry, test: TestEntry) -> SelectedTest:
        parts = subject_text(entry.pseudonym), clean(test.site), _("test {number}").format(number=test.number)
        label = f"{', '.join(part[:_LONGEST_LABEL] for part in parts if part)} ({clean(entry.path.stem)[:40]})"
        when = entry.when if math.isfinite(entry.when) else None
        return SelectedTest(entry.path, test.number, test.site, entry.pseudonym, label, when)

    # -- building -------------------------------------------------------------------------------------------

    def _restore(self) -> None:
        state = self._context.settings.value(_HEADER)
        if isinstance(state, QByteArray):
            self.tree.header().restoreState(state)  # order and sorting; widths stand apart, where no room bends them
        self.tree.restore(load_texts(self._context.settings, _WIDTHS))
        asked = load_texts(self._context.settings, _ASKED)
        if len(asked) == 4:
            self.bar.ask(*asked)
            self.shown.ask(*self.bar.asked)

    def _arrange(self) -> None:
        top = build.row(self.folders, self.again, None)
        self.foot = build.row((build.column(self.count, self.picked, spacing=0), 1))
        build.column(top, self.bar, (self.tree, 1), self.foot, parent=self)

    def _connect(self) -> None:
        self.bar.changed.connect(self._ask)
        self.folders.changed.connect(self._save_folders)
        self.folders.changed.connect(self.look_again)
        self.tree.opened.connect(self._open)
        self.tree.selectionModel().selectionChanged.connect(self._select)
        in_window = Qt.ShortcutContext.WindowShortcut
        build.shortcut(self, QKeySequence.StandardKey.Find, self._find, in_window)
        build.shortcut(self, QKeySequence.StandardKey.Refresh, self.look_again, in_window)

    def _find(self) -> None:
        self.bar.search.setFocus()
        self.bar.search.selectAll()

    def _open(self, index: QModelIndex) -> None:
        top = index.parent() if index.parent().isValid() else index
        entry = self.shown.data(top.siblingAtColumn(DATE), ITEM)
        if isinstance(entry, SessionEntry) and not entry.problem:
            self.opened.emit(entry.path)
