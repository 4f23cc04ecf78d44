"""Files that are opened or dropped anywhere in the window: sessions, folders of sessions, records to import."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QObject
from PySide6.QtGui import QDropEvent
from PySide6.QtWidgets import QWidget

from tissueid.app.context import AppContext
from tissueid.app.jobs import JobControl
from tissueid.app.pages import Pages
from tissueid.app.words import sentence
from tissueid.atomic_write import private_folder, unused_path
from tissueid.formatting import clean
from tissueid.language import _, plural
from tissueid.messages import translated

if TYPE_CHECKING:  # imports are seldom: the window starts without their readers
    from tissueid.app.import_dialog import ImportDialog, Preview
    from tissueid.procedures.import_export import ImportPlan
    from tissueid.sessions.imports import ImportedSession


def dropped_paths(event: QDropEvent) -> list[Path]:
    """Return the local files and folders that are dragged."""
    return [Path(url.toLocalFile()) for url in event.mimeData().urls() if url.isLocalFile()]


class FileDrops(QObject):
    """Opens what a person drops or chooses: each kind of file where it belongs."""

    def __init__(self, context: AppContext, pages: Pages, folder: Callable[[], Path], window: QWidget) -> None:
        super().__init__(window)
        self._context, self._pages, self._folder, self._window = context, pages, folder, window
        self.dialog: ImportDialog | None = None
        self._out = Path()
        self._control = JobControl()

    def can_take(self, paths: list[Path]) -> bool:
        """Return whether these may be opened now: not while a coil may be energised or work goes on."""
        return bool(paths) and not self._context.busy

    def take(self, paths: list[Path]) -> None:
        """Open what was dropped on the page that is shown, which may have a use of its own for it."""
        if self.can_take(paths) and not self._pages.offer_files(paths):
            self.open(paths)

    def open(self, paths: list[Path]) -> None:
        """Open each kind of file where it belongs."""
        from tissueid.sessions.imports import is_record

        records = [path for path in paths if path.is_file() and is_record(path)]
        others = [path for path in paths if path not in records]
        if records:
            self.import_records(records)
        elif len(others) == 1 and not others[0].is_dir():
            self._context.open_session(others[0])
        else:
            self._pages.list_sessions(others)

    def import_records(self, paths: list[Path]) -> None:
        """Look into records, then ask what their columns are."""
        from tissueid.app.import_dialog import preview_of

        work, context = functools.partial(preview_of, paths), self._context
        context.jobs.do(work, self._ask, context.say_failed, why=_("A record is being read: wait a few seconds."))

    def _ask(self, preview: Preview) -> None:
        from tissueid.app.import_dialog import ImportDialog

        out = unused_path(self._folder() / f"{preview.paths[0].stem}.h5")
        self.dialog = dialog = ImportDialog(preview, out, self._window)
        dialog.wanted.connect(self._import)
        dialog.finished.connect(self._closed)
        dialog.open()

    def _closed(self) -> None:
        self.dialog = None

    def _import(self, plan: ImportPlan) -> None:
        from tissueid.procedures.import_export import run_import

        self._out, self._control = plan.out, JobControl()
        if plan.out.parent == self._context.services.folder:
            private_folder(plan.out.parent)
        why = _("Records are being imported: wait a moment.")
        work = functools.partial(run_import, plan, self._control, self._context.trail)
        self._context.jobs.do(work, self._imported, self._not_imported, why=why)

    def _imported(self, made: ImportedSession) -> None:
        problems = self._control.notices
        if self.dialog is not None:
            self.dialog.accept()
        count = len(made.session.tests)
        said = plural("Imported {count} test into {path}.", "Imported {count} tests into {path}.", count)
        doubts = [*(notice for test in made.tests for notice in test.notices), *made.notices, *problems]
        words = [said.format(count=count, path=clean(str(self._out))), *(sentence(translated(one)) for one in doubts)]
        self._pages.on_session_saved(self._out)
        if not self._pages.show_new(self._out):
            self._context.open_session(self._out)
        self._context.say(" ".join(words), problem=bool(problems))

    def _not_imported(self, words: str) -> None:
        if self.dialog is not None:
            self.dialog.say(words)
        else:
            self._context.say(words, problem=True)
