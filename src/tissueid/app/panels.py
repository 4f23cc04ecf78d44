"""Help and log next to the page, opened and closed by keys or buttons. Help is Markdown of this package only."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from platformdirs import user_log_path
from PySide6.QtCore import QObject, Qt, QUrl, Signal
from PySide6.QtGui import QFontDatabase, QGuiApplication, QHideEvent, QShowEvent
from PySide6.QtWidgets import (
    QApplication,
    QDockWidget,
    QFrame,
    QLabel,
    QMainWindow,
    QPlainTextEdit,
    QTextBrowser,
    QToolButton,
    QWidget,
)

from tissueid.app import build
from tissueid.app.context import AppContext
from tissueid.app.navigation_bar import NavigationBar
from tissueid.app.notice import Notice
from tissueid.app.theme import appearance
from tissueid.app.words import in_words
from tissueid.atomic_write import write_private
from tissueid.formatting import clean
from tissueid.language import _, current_language, marked

FOLDER = Path(__file__).with_name("help")
MISSING = marked("There is no help for this page.")
_LEAST_WIDTH = 220


class HelpText(QTextBrowser):
    """A text browser that follows no links and loads nothing from network or files."""

    def loadResource(self, _kind: int, _url: QUrl | str) -> Any:  # noqa: N802
        """Nothing."""
        return None


class HelpPanel(QFrame):
    """Purpose, steps, colours and keys of the shown page. ``turned`` carries whether the panel is shown."""

    turned = Signal(bool)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        heading = build.styled(QLabel(_("Help")), role="heading")
        self.close_button = build.styled(
            QToolButton(), text="✕", auto_raise=True, name=_("Close help"), tip=_("Close help")
        )
        self.close_button.clicked.connect(self.hide)
        self.reader = HelpText()
        build.styled(self.reader, open_links=False, name=_("Help for this page"), minimum_width=_LEAST_WIDTH)
        self.reader.document().setDocumentMargin(10)
        build.column(
            build.row((heading, 1), self.close_button, spacing=0, margins=(10, 4, 4, 2)),
            (self.reader, 1),
            spacing=0,
            parent=self,
        )
        self._page = ""
        appearance.follow(self._paint)

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

    def _paint(self) -> None:
        self.reader.document().setDefaultStyleSheet(f"a {{ color: {appearance.theme.accent}; }}")
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


MOST_LINES = 2_000
MOST_DETAILS = 100_000
"""Characters of a defect's details that are shown."""


class LogPanel(QDockWidget):
    """Lines with their times. ``saved`` carries what became of saving them, and whether that was a problem."""

    saved = Signal(str, bool)

    def __init__(self, now: Callable[[], datetime], folder: Path, parent: QWidget | None = None) -> None:
        super().__init__(_("Log of the window"), parent)
        self.setObjectName("log")
        self._now, self._folder, self._last = now, folder, ""
        self.lines = _reader(_("Log of the window"))
        self.lines.setMaximumBlockCount(MOST_LINES)
        self.copy = build.button(_("Copy"), self._copy, name=_("Copy all lines"))
        self.save = build.button(_("Save…"), self._choose, name=_("Save all lines to a file"))
        self.fold = build.styled(
            QToolButton(),
            text=_("Details of the last defect"),
            role="fold",
            checkable=True,
            focus_policy=Qt.FocusPolicy.TabFocus,
            tool_button_style=Qt.ToolButtonStyle.ToolButtonTextBesideIcon,
        )
        self.details = _reader(_("Details of the last defect"))
        about = build.styled(
            QLabel(
                _("Since the program was started; the last {count} lines").format(
                    count=f"{MOST_LINES:,}".replace(",", "\u202f")
                )
            ),
            role="muted",
        )
        inside = QWidget()
        build.column(
            build.row((about, 1), self.fold, self.copy, self.save, spacing=4),
            build.row((self.lines, 1), (self.details, 1), spacing=4),
            spacing=4,
            margins=(10, 2, 10, 8),
            parent=inside,
        )
        self.setWidget(inside)
        self._newest = True
        self.lines.verticalScrollBar().rangeChanged.connect(self._show_newest)
        self.lines.verticalScrollBar().actionTriggered.connect(self._scrolled)
        self.fold.toggled.connect(self._unfold)
        self._unfold(False)
        self.fold.hide()

    def showEvent(self, event: QShowEvent) -> None:  # noqa: N802
        """Show the newest lines."""
        super().showEvent(event)
        self._newest = True
        self._show_newest()

    def _show_newest(self) -> None:
        if self._newest:
            self.lines.verticalScrollBar().setValue(self.lines.verticalScrollBar().maximum())

    def _scrolled(self) -> None:
        self._newest = False  # the user reads older lines

    def note(self, text: str, problem: bool = False) -> None:
        """Add a line; what was said just before is not said again."""
        text = clean(text).strip()
        if not text or text == self._last:
            return
        self._last = text
        mark = "!" if problem else " "
        self.lines.appendPlainText(f"{self._now():%H:%M:%S} {mark} {text}")
        if str(_defect_path()) in text:
            self.fold.show()
            self._unfold(self.fold.isChecked())

    def _unfold(self, opened: bool) -> None:
        self.fold.setArrowType(Qt.ArrowType.DownArrow if opened else Qt.ArrowType.RightArrow)
        self.details.setVisible(opened)
        if opened:
            try:
                with _defect_path().open(encoding="utf-8", errors="replace") as file:
                    self.details.setPlainText(f"{_defect_path()}\n\n{file.read(MOST_DETAILS)}")
            except OSError as error:
                self.details.setPlainText(in_words(error))

    def _copy(self) -> None:
        QGuiApplication.clipboard().setText(self.lines.toPlainText())
        self.saved.emit(_("The lines are copied."), False)

    def _choose(self) -> None:
        name = f"tissueid-log-{self._now():%Y-%m-%d_%H-%M-%S}.txt"
        title, kinds = _("Save the log"), _("Text (*.txt)")
        build.ask_path(self, title, self._folder, self.save_to, kinds, save=name, default_suffix="txt")

    def save_to(self, path: Path) -> None:
        """Write all lines to a file."""
        try:
            write_private(path, self.lines.toPlainText() + "\n")
        except OSError as error:
            self.saved.emit(in_words(error), True)
        else:
            self.saved.emit(_("The log is saved in {path}.").format(path=path), False)


def _defect_path() -> Path:
    """Where the details of the newest defect are; :func:`tissueid.app.words.in_words` writes them."""
    return user_log_path("tissueid", appauthor=False) / "last-defect.txt"


def _reader(name: str) -> QPlainTextEdit:
    return build.styled(
        QPlainTextEdit(),
        read_only=True,
        tab_changes_focus=True,
        name=name,
        font=QFontDatabase.systemFont(QFontDatabase.SystemFont.FixedFont),
        minimum_height=32,
    )


HELP_KEY = "F1"
LOG_KEY = "F9"
_LOG_HEIGHT = 230


class Panels(QObject):
    """The two panels of the window."""

    def __init__(self, context: AppContext, window: QMainWindow, rail: NavigationBar, notice: Notice) -> None:
        super().__init__(window)
        self._context, self._window, self._notice = context, window, notice
        self.help = HelpPanel()
        self.log = LogPanel(context.services.now, context.services.folder, window)
        self._before: QWidget | None = None
        self.log.hide()
        features = QDockWidget.DockWidgetFeature
        self.log.setFeatures(features.DockWidgetClosable | features.DockWidgetMovable)
        window.addDockWidget(Qt.DockWidgetArea.BottomDockWidgetArea, self.log)
        self.help_button = rail.add_foot(_("Help"), HELP_KEY, _("Help for this page"))
        self.log_button = rail.add_foot(_("Log"), LOG_KEY, _("Log of the window"))
        for panel, button in ((self.help, self.help_button), (self.log, self.log_button)):
            button.clicked.connect(partial(self._toggle, panel))
        self.help.turned.connect(partial(self._follow, self.help, self.help_button))
        self.log.visibilityChanged.connect(partial(self._follow, self.log, self.log_button))
        notice.said.connect(self.log.note)
        context.jobs.failed.connect(partial(self.log.note, problem=True))
        self.log.saved.connect(self._tell_saved)
        self.log.note(_("TissueID was started."))

    def _toggle(self, panel: QWidget, _checked: bool = False) -> None:
        """Open a panel and give it the keyboard focus, or close it. During a test the focus does not move."""
        show = panel.isHidden()
        focus = QApplication.focusWidget()
        if show:
            panel.show()
            if panel is self.log:
                height = min(_LOG_HEIGHT, self._window.height() // 3)
                self._window.resizeDocks([self.log], [height], Qt.Orientation.Vertical)
            if not self._context.state.testing:
                self._before = focus
                text = self.help.reader if panel is self.help else self.log.lines
                text.setFocus()
            return
        inside = focus is not None and panel.isAncestorOf(focus)
        panel.hide()
        if inside and self._before is not None and self._before.isVisible():
            self._before.setFocus()

    def _follow(self, panel: QWidget, button: QToolButton, _visible: bool) -> None:
        button.setChecked(not panel.isHidden())

    def _tell_saved(self, message: str, problem: bool) -> None:
        self._notice.say(message, problem=problem)
