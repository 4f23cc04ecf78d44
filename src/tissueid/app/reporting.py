"""The report of the shown result: written beside its session once, opened, and in any case said where it is."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QObject

from tissueid.app.errands import write_report_beside
from tissueid.language import _, marked

if TYPE_CHECKING:
    from tissueid.app.main_window import MainWindow

_OPENED = marked("The report is saved in {path}.")
_NOT_OPENED = marked("The report is saved in {path}; open it in a browser.")
_PDF_NOT_OPENED = marked(
    "The report is saved in {path}. No program here shows a PDF: open that file with one that does, here or on "
    "another computer."
)


class Reports(QObject):
    """Stands beside the window; its button and the pages come here."""

    def __init__(self, window: MainWindow) -> None:
        super().__init__(window)
        self._window = window
        self._written: Path | None = None
        window.ui.report.clicked.connect(self.open)

    def forget(self) -> None:
        """Another result is shown, of which no report was written yet."""
        self._written = None

    def open(self) -> None:
        """Write the report of the shown result beside its session, and open it."""
        window = self._window
        if window.findings is None or window.busy:
            return
        if self._written is not None and self._written.exists():
            self.show(self._written)
            return
        window.ui.guidance.say(_("Writing the report."))
        work = functools.partial(write_report_beside, window.findings)
        window.jobs.do(work, self._show_written, window.say_failed)

    def show(self, path: Path) -> None:
        """Open a report, and say where it is."""
        opened = self._window.around.show_file(path)
        words = _OPENED if opened else _PDF_NOT_OPENED if path.suffix.lower() == ".pdf" else _NOT_OPENED
        show_folder = functools.partial(self._window.around.show_file, path.parent)
        self._window.ui.notice.say(_(words).format(path=path), offer=_("Open folder"), act=show_folder)

    def _show_written(self, path: Path) -> None:
        self._written = path
        self._window.rest()
        self.show(path)
