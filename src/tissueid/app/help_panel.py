"""Help next to the shown page, from Markdown files of this package only."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from PySide6.QtCore import QUrl, Signal
from PySide6.QtGui import QHideEvent, QShowEvent
from PySide6.QtWidgets import QFrame, QHBoxLayout, QLabel, QTextBrowser, QToolButton, QVBoxLayout, QWidget

from tissueid.app.theme import Theme
from tissueid.language import _, current_language, marked

FOLDER = Path(__file__).with_name("help")
MISSING = marked("There is no help for this page.")
_LEAST_WIDTH = 220


class _Reader(QTextBrowser):
    """A text browser that follows no links and loads nothing from network or files."""

    def loadResource(self, _kind: int, _url: QUrl | str) -> Any:  # noqa: N802
        """Nothing."""
        return None


class HelpPanel(QFrame):
    """Purpose, steps, colours and keys of the shown page. ``turned`` carries whether the panel is shown."""

    turned = Signal(bool)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        heading = QLabel(_("Help"))
        heading.setProperty("role", "heading")
        self.close_button = QToolButton()
        self.close_button.setText("✕")
        self.close_button.setAutoRaise(True)
        self.close_button.setAccessibleName(_("Close help"))
        self.close_button.setToolTip(_("Close help"))
        self.close_button.clicked.connect(self.hide)
        self.reader = _Reader()
        self.reader.setOpenLinks(False)
        self.reader.setAccessibleName(_("Help for this page"))
        self.reader.setMinimumWidth(_LEAST_WIDTH)
        self.reader.document().setDocumentMargin(10)
        top = QHBoxLayout()
        top.setContentsMargins(10, 4, 4, 2)
        top.addWidget(heading, 1)
        top.addWidget(self.close_button)
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(0)
        column.addLayout(top)
        column.addWidget(self.reader, 1)
        self._page = ""

    def showEvent(self, event: QShowEvent) -> None:  # noqa: N802
        """Report that the panel is shown."""
        super().showEvent(event)
        self.turned.emit(True)

    def hideEvent(self, event: QHideEvent) -> None:  # noqa: N802
        """Report that the panel is closed, but not that the window is minimised."""
        super().hideEvent(event)
        self.turned.emit(not self.isHidden())

    def show_page(self, name: str) -> None:
        """Show the help of a page, by its name."""
        if name != self._page:
            self._page = name
            self._fill()

    def apply_theme(self, theme: Theme) -> None:
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
    path = FOLDER / current_language() / name
    return (path if path.is_file() else FOLDER / name).read_text(encoding="utf-8")
