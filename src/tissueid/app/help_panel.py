"""Help beside the page that is shown: Markdown from this package, and nothing from anywhere else."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from PySide6.QtCore import QUrl
from PySide6.QtWidgets import QDockWidget, QTextBrowser, QVBoxLayout, QWidget

from tissueid.app.theme import Theme
from tissueid.language import _, marked, spoken

FOLDER = Path(__file__).with_name("help")
MISSING = marked("There is no help for this page.")
_LEAST_WIDTH = 220


class _Reader(QTextBrowser):
    """A browser that follows no link and loads nothing: neither from the network nor from files."""

    def loadResource(self, _kind: int, _url: QUrl | str) -> Any:  # noqa: N802
        """Nothing."""
        return None


class HelpPanel(QDockWidget):
    """What the page is for, its steps, its colours and its keys."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(_("Help"), parent)
        self.setObjectName("help")
        self.reader = _Reader()
        self.reader.setOpenLinks(False)
        self.reader.setAccessibleName(_("Help for this page"))
        self.reader.setMinimumWidth(_LEAST_WIDTH)
        self.reader.document().setDocumentMargin(10)
        inside = QWidget()
        column = QVBoxLayout(inside)
        column.setContentsMargins(0, 0, 0, 0)
        column.addWidget(self.reader)
        self.setWidget(inside)
        self._page = ""

    def show_page(self, name: str) -> None:
        """Show the help of a page, by its name."""
        if name != self._page:
            self._page = name
            self._fill()

    def paint_with(self, theme: Theme) -> None:
        """Take on the colours of a theme."""
        self.reader.setStyleSheet(f"QTextBrowser {{ background: {theme.panel}; color: {theme.text}; border: none; }}")
        self.reader.document().setDefaultStyleSheet(f"a {{ color: {theme.accent}; }}")
        self._fill()

    def _fill(self) -> None:
        try:
            self.reader.setMarkdown(_help_of(self._page) if self._page else "")
        except OSError:
            self.reader.setPlainText(_(MISSING))


def _help_of(page: str) -> str:
    """The help of a page in the language of the window, else in English.

    Raises:
        OSError: there is none.
    """
    name = f"{page}.md"
    path = FOLDER / spoken() / name
    return (path if path.is_file() else FOLDER / name).read_text(encoding="utf-8")
