"""Input panel of the Gap page, and the loading of kept diagnoses and of titles of sessions."""

from __future__ import annotations

import contextlib
import functools
import itertools
import os
import threading
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from PySide6.QtCore import QObject, QSettings, Qt, Signal
from PySide6.QtWidgets import (
    QFrame,
    QLabel,
    QLineEdit,
    QToolButton,
    QWidget,
)

from tissueid.app import build
from tissueid.app.build import button, styled
from tissueid.app.jobs import Jobs
from tissueid.app.small_window import FoldingBox
from tissueid.app.user_files import stamp_of
from tissueid.app.views.gap.diagnosis_result import KeptDiagnoses, read_kept
from tissueid.app.views.researcher.selected_test import local_time
from tissueid.app.views.researcher.session_search import SessionEntry, entry_of
from tissueid.app.widgets import BigButton
from tissueid.app.window_state import load_texts, save_texts
from tissueid.formatting import clean, subject_text
from tissueid.language import _, marked, plural
from tissueid.messages import Message, translated
from tissueid.procedures.gap_plans import DiagnosisPlan, read_test_number

_LONGEST_PART = 40
"""Maximum length of one part of a title, characters."""


def read_titles(paths: Sequence[Path], cancelled: threading.Event) -> dict[Path, str | None]:
    """Return the titles of sessions that were read before ``cancelled`` was set.

    The title of a file that is no session, or says nothing of itself, is empty; that of a missing file is None.
    """
    titles: dict[Path, str | None] = {}
    for path in paths:
        if cancelled.is_set():
            break
        stamp = stamp_of(path)
        titles[path] = None if stamp is None else title_of(entry_of(path, stamp))
    return titles


def title_of(entry: SessionEntry) -> str:
    """Return subject, site, date and test of a session; "" if the file has none of the first three."""
    sites = dict.fromkeys(clean(test.site).strip() for test in entry.tests)
    details = [subject_text(entry.pseudonym), *sites, local_time(entry.when)]
    parts = [part[:_LONGEST_PART] for part in details if part]
    return ", ".join([*parts, _tests(entry)]) if parts else ""


def unique_titles(titles: Mapping[Path, str]) -> dict[Path, str]:
    """Return the text of each file in the list: its title, with the file name where titles are equal."""
    count = Counter(titles.values())
    named = {}
    for path, title in titles.items():
        name = clean(path.name)
        named[path] = name if not title else f"{title}, {name}" if count[title] > 1 else title
    return named


def _tests(entry: SessionEntry) -> str:
    if len(entry.tests) == 1:
        test = entry.tests[0]
        return _("test {number} ({kind})").format(number=test.number, kind=_(test.kind))
    return plural("{count} test", "{count} tests", len(entry.tests)).format(count=len(entry.tests))


class DiagnosisLoader(QObject):
    """Loader with one job at a time; :meth:`load_next` starts the next one.

    ``kept_read`` carries the kept diagnoses, ``titles_read`` the titles of sessions by their paths; ``failed`` says in
    words why kept diagnoses cannot be read. ``wanted`` is whether they are still to be read.
    """

    kept_read = Signal(object)
    titles_read = Signal(object)
    failed = Signal(str)

    def __init__(self, jobs: Jobs, folder: Path, parent: QObject) -> None:
        super().__init__(parent)
        self._jobs, self._folder = jobs, folder
        self.wanted = True
        self._cancelled = threading.Event()
        self.running = False

    def load_next(self, untitled: Sequence[Path]) -> bool:
        """Read the stored diagnoses once, then missing titles of sessions; return False if nothing remains."""
        if not self.running and self.wanted:
            self.wanted = False
            self._begin(functools.partial(read_kept, self._folder), self._kept_ended)
        elif not self.running and untitled:
            self._cancelled = threading.Event()
            self._begin(functools.partial(read_titles, tuple(untitled), self._cancelled), self._titles_ended)
        return self.running

    def cancel(self) -> None:
        """Request cancellation of the running job."""
        self._cancelled.set()

    def _begin(self, work: Callable[[], Any], ended: Callable[[Any], None]) -> None:
        self.running = True
        self._jobs.do(work, ended, self._broke)

    def _kept_ended(self, kept: KeptDiagnoses) -> None:
        self.running = False
        self.kept_read.emit(kept)

    def _titles_ended(self, titles: dict[Path, str | None]) -> None:
        self.running = False
        self.titles_read.emit(titles)

    def _broke(self, message: str) -> None:
        self.running = False
        self.failed.emit(message)


NOMINAL = marked("Nominal twin")
_NEWEST = 20
"""Maximum number of listed files of the folder."""
_MOST_FOLDERS, _MOST_ENTRIES = 200, 5000
_RECENT = 10
"""Maximum number of listed files from other folders."""
_LONGEST = 120
_SETTING = "gap"
_ONE_ROW = 640
_FIELDS_IN_A_ROW = 480


class RequestPanel(QFrame):
    """Input of a diagnosis. Signals: ``wanted`` for Run, ``unwanted`` for Cancel, ``changed`` for the selection."""

    wanted = Signal()
    unwanted = Signal()
    changed = Signal()

    def __init__(
        self, folder: Path, others: Callable[[], Sequence[Path]] = tuple, parent: QWidget | None = None
    ) -> None:
        super().__init__(parent)
        self.setProperty("role", "card")
        self._folder, self._others = folder, others
        self.session = _FileChoice(_("Session"), folder)
        self.twin = _FileChoice(_("Baseline twin"), folder, first=_(NOMINAL))
        self.open = button(_("Open…"), self._ask, name=_("Open a session or a twin…"))
        self.run = styled(
            BigButton(_("Run")),
            name=_("Run the diagnosis"),
            tip=_("Find out where simulated and recorded differ, and why (half a minute to some minutes)"),
            clicked=self.wanted,
        )
        self.fold = styled(
            QToolButton(),
            text=_("Advanced"),
            role="fold",
            checkable=True,
            tool_button_style=Qt.ToolButtonStyle.ToolButtonTextBesideIcon,
            name=_("Advanced: which tests to fit and to check"),
        )
        self.fit, self.check = QLineEdit(), QLineEdit()
        self._choices = {"session": self.session, "twin": self.twin}
        self._numbers = {"fit": self.fit, "check": self.check}
        self.more = QWidget()
        names = _("Progress of the diagnosis"), _("Cancel the diagnosis")
        self.progress = build.ProgressRow(QLabel(), *names, self.unwanted)
        self.doing, self.bar, self.stop = self.progress.parts
        self._arrange()
        self.fold.toggled.connect(self._unfold)
        self.session.changed.connect(self.changed)
        self._unfold(False)
        self.look()

    @property
    def fields(self) -> list[QWidget]:
        """Widgets in tab order."""
        return [self.session.choice, self.twin.choice, self.open, self.run, self.stop, self.fold, self.fit, self.check]

    def asked(self) -> DiagnosisPlan:
        """Return the current plan.

        Raises:
            UnusableInputError: what is typed are no numbers of tests.
        """
        fit, check = (
            tuple(read_test_number(what, part) for part in field.text().replace(",", " ").split())
            for what, field in ((_("Tests to fit"), self.fit), (_("Tests to check"), self.check))
        )
        session, twin = self.session.path or Path(), self.twin.path
        return DiagnosisPlan(
            session=session.absolute(), twin=None if twin is None else twin.absolute(), fit=fit, check=check
        )

    def put(self, asked: DiagnosisPlan) -> None:
        """Select the values of an earlier request."""
        self.session.choose(asked.session)
        if asked.twin is None:
            self.twin.choice.setCurrentIndex(0)
        else:
            self.twin.choose(asked.twin)
        for field, numbers in ((self.fit, asked.fit), (self.check, asked.check)):
            field.setText(", ".join(map(str, numbers)))
        self.fold.setChecked(bool(asked.fit or asked.check))

    def look(self) -> None:
        """List the newest files of the folder; the selection stays."""
        folders = dict.fromkeys((self._folder, *self._others()))
        self.session.offer(_newest(folders, ".h5"))
        self.twin.offer(_newest(folders, ".toml"))

    def take(self, path: Path) -> None:
        """Select a file: a twin by its suffix, else a session."""
        (self.twin if path.suffix == ".toml" else self.session).choose(path)

    def _ask(self) -> None:
        kinds = _("Sessions and twins (*.h5 *.toml);;All files (*)")
        folder = self._folder if self.session.path is None else self.session.path.parent
        build.ask_path(self, _("Open a session or a twin"), folder, self.take, kinds)

    def on_session_saved(self, path: Path) -> None:
        """List a file that was saved."""
        (self.twin if path.suffix == ".toml" else self.session).add_recent(path)
        self.look()

    def show_progress(self, fraction: float | None, step: str) -> None:
        """Show the step and its completed share from 0 to 1; None where that is not known.

        A step of which nothing is done yet is shown without its count.
        """
        if isinstance(step, Message) and step.values.get("done") == 0:
            step, fraction = step.values["step"], None
        self.progress.show_progress(fraction, translated(step) + ("…" if fraction is None else ""))

    def update_enabled(self, *, busy: bool, testing: bool) -> None:
        """Enable or disable the controls."""
        for widget in (self.session.choice, self.twin.choice, self.open, self.fold, self.fit, self.check):
            widget.setEnabled(not testing)
        self.run.setEnabled(not busy and self.session.path is not None)

    def restore(self, settings: QSettings) -> None:
        """Restore the selection of the last start, as far as its files exist."""
        for name, files in self._choices.items():
            for recent in reversed(load_texts(settings, f"{_SETTING}/recent_{name}s")[:_RECENT]):
                files.add_recent(Path(recent))
            kept = str(settings.value(f"{_SETTING}/{name}", ""))
            if kept and Path(kept).is_file():
                files.choose(Path(kept))
        self.look()
        for name, field in self._numbers.items():
            field.setText(str(settings.value(f"{_SETTING}/{name}", "")))
        self.fold.setChecked(bool(self.fit.text() or self.check.text()))

    def save(self, settings: QSettings) -> None:
        """Save the selection."""
        for name, files in self._choices.items():
            settings.setValue(f"{_SETTING}/{name}", str(files.path or ""))
            save_texts(settings, f"{_SETTING}/recent_{name}s", [str(path) for path in files.recent])
        for name, field in self._numbers.items():
            settings.setValue(f"{_SETTING}/{name}", field.text())

    def _unfold(self, opened: bool) -> None:
        self.fold.setArrowType(Qt.ArrowType.DownArrow if opened else Qt.ArrowType.RightArrow)
        self.more.setVisible(opened)

    def _arrange(self) -> None:
        parts = []
        for files, share in ((self.session, 3), (self.twin, 2)):
            label = styled(QLabel(files.choice.accessibleName()), role="field")
            parts.append((build.column(label, files.choice, spacing=2), share))
        buttons = build.column(None, build.row(None, self.open, self.run, spacing=8))
        choices = build.fill(FoldingBox(_ONE_ROW), *parts, buttons, spacing=8)
        inside = build.fill(FoldingBox(_FIELDS_IN_A_ROW, self.more), spacing=None)
        for title, field in ((_("Tests to fit"), self.fit), (_("Tests to check"), self.check)):
            label = styled(QLabel(title), buddy=field)
            build.styled(
                field,
                name=_("{field}, numbers with commas between").format(field=title),
                placeholder_text=_("chosen by itself"),
                max_length=200,
                fixed_width=130,
            )
            pair = build.row(label, field, spacing=None)
            pair.addSpacing(10)
            inside.addLayout(pair)
        self.bar.setFixedWidth(150)
        build.column(
            choices,
            build.row(self.fold, self.more, None, self.doing, self.bar, self.stop, spacing=10),
            spacing=4,
            margins=(12, 6, 12, 6),
            parent=self,
        )


class _FileChoice(QObject):
    """A list of files.

    ``recent`` are files from outside the folder that were saved or opened, newest first.
    """

    changed = Signal()

    def __init__(self, name: str, folder: Path, first: str = "") -> None:
        super().__init__()
        self._folder = folder
        self._titles: dict[Path, str] = {}
        self.recent: list[Path] = []
        self._first = {"": first} if first else {}
        nothing = _("No session: open one, or drop its file here")
        self.choice = build.choice(self._first, self._tell, 12, name=name, placeholder_text=nothing)

    @property
    def path(self) -> Path | None:
        """The selected file; None for no selection or the first entry."""
        file = self.choice.currentData()
        return Path(file) if file else None

    @property
    def untitled(self) -> list[Path]:
        """Listed files whose titles were not read yet."""
        return [path for path in self._offered if path not in self._titles]

    def offer(self, paths: list[Path]) -> None:
        """List recent files from other folders, then ``paths``; the selection stays."""
        listed = dict.fromkeys([*(path for path in self.recent if path not in paths), *paths])
        build.offer(self.choice, self._first | {str(path): "" for path in listed})
        self._show_titles()
        self._tell()

    def choose(self, path: Path) -> None:
        """Select a file from any folder."""
        index = self.choice.findData(str(path))
        self._remember(path)  # a listed one too: newer files may displace it from the list
        if index < 0:
            self._titles.pop(path, None)
            index = len(self._first)
            self.choice.insertItem(index, "", str(path))
            self._show_titles()
        self.choice.setCurrentIndex(index)

    def add_recent(self, path: Path) -> None:
        """Add a file from another folder, and mark its title for reading."""
        self._titles.pop(path, None)
        self._remember(path)

    def _remember(self, path: Path) -> None:
        if path.parent != self._folder:
            self.recent = [path, *(other for other in self.recent if other != path)][:_RECENT]

    def entitle(self, titles: Mapping[Path, str | None]) -> None:
        """Show titles in place of file names; remove missing files (None) from the recent ones."""
        self._titles |= {path: title or "" for path, title in titles.items()}
        self.recent = [path for path in self.recent if titles.get(path, "") is not None]
        self._show_titles()

    @property
    def _offered(self) -> list[Path]:
        return [Path(file) for index in range(self.choice.count()) if (file := self.choice.itemData(index))]

    def _show_titles(self) -> None:
        called = unique_titles({path: self._titles.get(path, "") for path in self._offered})
        for index in range(self.choice.count()):
            if file := self.choice.itemData(index):
                self.choice.setItemText(index, called[Path(file)][:_LONGEST])
                self.choice.setItemData(index, clean(file), Qt.ItemDataRole.ToolTipRole)

    def _tell(self) -> None:
        self.choice.setToolTip(clean(str(self.path or "")))
        self.changed.emit()


def _newest(folders: Iterable[Path], suffix: str) -> list[Path]:
    """Return the newest files with a suffix in folders and the folders in them, as far as these can be read."""
    dated: list[tuple[float, Path]] = []
    waiting = [(folder, True) for folder in folders]
    for folder, deeper in waiting:
        with contextlib.suppress(OSError), os.scandir(folder) as entries:
            for entry in itertools.islice(entries, _MOST_ENTRIES):
                with contextlib.suppress(OSError):  # it has just gone
                    if entry.name.startswith("."):
                        continue
                    if entry.name.endswith(suffix):
                        dated.append((entry.stat().st_mtime, Path(entry.path)))
                    elif deeper and len(waiting) < _MOST_FOLDERS and entry.is_dir(follow_symlinks=False):
                        waiting.append((Path(entry.path), False))
    return [path for _, path in sorted(dated, reverse=True)][:_NEWEST]
