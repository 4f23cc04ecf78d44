"""The report of the shown result: write it next to its session once, open it, and show its path."""

from __future__ import annotations

import functools
from pathlib import Path

from PySide6.QtCore import QObject

from tissueid.app.context import AppContext
from tissueid.app.findings import Findings
from tissueid.app.guidance import Guidance
from tissueid.app.notice import Notice
from tissueid.atomic_write import unused_path
from tissueid.language import _
from tissueid.messages import Message, Verbatim, translated
from tissueid.procedures.report import write_page


def _shown(path: Path, *, opened: bool) -> Message:
    """Return where the report is, and what to do if no program opened it."""
    if opened:
        return Message("report.saved", "The report is saved in {path}.", path=Verbatim(path))
    if path.suffix.lower() == ".pdf":
        return Message(
            "report.no_pdf_viewer",
            "The report is saved in {path}. No program here shows a PDF: open that file with one that does, here or on "
            "another computer.",
            path=Verbatim(path),
        )
    return Message("report.no_browser", "The report is saved in {path}; open it in a browser.", path=Verbatim(path))


class Reports(QObject):
    """Writes and opens reports for the window and its pages."""

    def __init__(self, context: AppContext, notice: Notice, guidance: Guidance, parent: QObject) -> None:
        super().__init__(parent)
        self._context, self._notice, self._guidance = context, notice, guidance
        self._findings: Findings | None = None
        self._written: Path | None = None

    def show_findings(self, findings: Findings | None) -> None:
        """Take the result that is shown now; its report is not written yet."""
        self._findings, self._written = findings, None

    def open(self) -> None:
        """Write the report of the shown result next to its session, and open it."""
        if self._findings is None or self._context.busy:
            return
        if self._written is not None and self._written.exists():
            self.show(self._written)
            return
        self._guidance.say(_("Writing the report."))
        self._context.jobs.do(functools.partial(_written, self._findings), self._show_written, self._context.say_failed)

    def show(self, path: Path) -> None:
        """Open a report and show its path."""
        said = _shown(path, opened=self._context.services.show_file(path))
        show_folder = functools.partial(self._context.services.show_file, path.parent)
        self._notice.say(translated(said), offer=_("Open folder"), act=show_folder)

    def _show_written(self, path: Path) -> None:
        self._written = path
        self._context.show_idle()
        self.show(path)


def _written(findings: Findings) -> Path:
    """Write the page of a test next to its session under an unused name; return its path."""
    page = unused_path(findings.path.with_name(f"{findings.path.stem}-report.html"))
    return write_page(page, findings.analysed)
