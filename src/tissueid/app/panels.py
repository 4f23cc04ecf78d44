"""Help and log beside the page: shown and taken away by their keys, or by buttons at the foot of the rail."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from PySide6.QtCore import QObject, Qt
from PySide6.QtWidgets import QApplication, QDockWidget, QToolButton, QWidget

from tissueid.app.help_panel import HelpPanel
from tissueid.app.log_panel import LogPanel
from tissueid.app.theme import Theme
from tissueid.language import _

if TYPE_CHECKING:
    from tissueid.app.main_window import MainWindow

HELP_KEY = "F1"
LOG_KEY = "F9"
_HELP_WIDTH, _NARROW_HELP_WIDTH = 320, 240
_NARROW = 1100
"""Width of the window below which the help is narrow."""
_LOG_HEIGHT = 150


class Panels(QObject):
    """The two panels of the window."""

    def __init__(self, window: MainWindow) -> None:
        super().__init__(window)
        self._window = window
        self.help = HelpPanel(window)
        self.log = LogPanel(window.around.now, window.around.folder, window)
        self._before: QWidget | None = None
        sides = Qt.DockWidgetArea
        window.addDockWidget(sides.RightDockWidgetArea, self.help)
        window.addDockWidget(sides.BottomDockWidgetArea, self.log)
        window.setCorner(Qt.Corner.BottomRightCorner, sides.RightDockWidgetArea)
        rail = window.ui.rail
        self.help_button = self._add(self.help, rail.add_foot(_("Help"), HELP_KEY, _("Help for this page")))
        self.log_button = self._add(self.log, rail.add_foot(_("Log"), LOG_KEY, _("What happened so far")))
        window.ui.notice.said.connect(self.log.note)
        window.jobs.failed.connect(self._note_failure)
        self.log.saved.connect(self._tell_saved)
        self.log.note(_("TissueID was started."))

    def paint_with(self, theme: Theme) -> None:
        """Take on the colours of a theme."""
        self.help.paint_with(theme)

    def _add(self, panel: QDockWidget, button: QToolButton) -> QToolButton:
        panel.hide()
        features = QDockWidget.DockWidgetFeature
        panel.setFeatures(features.DockWidgetClosable | features.DockWidgetMovable)
        toggle: Callable[..., None] = partial(self._toggle, panel, button)
        button.clicked.connect(toggle)
        panel.visibilityChanged.connect(partial(self._follow, panel, button))
        return button

    def _toggle(self, panel: QDockWidget, button: QToolButton, _checked: bool = False) -> None:
        """Show a panel and put the keyboard there, or take it away; beside a running test the keyboard stays."""
        show = panel.isHidden()
        focus = QApplication.focusWidget()
        if show:
            self._place(panel)
            if not self._window.testing:
                self._before = focus
                text = self.help.reader if panel is self.help else self.log.lines
                text.setFocus()
            return
        inside = focus is not None and panel.isAncestorOf(focus)
        panel.hide()
        if inside and self._before is not None and self._before.isVisible():
            self._before.setFocus()

    def _place(self, panel: QDockWidget) -> None:
        """Show a panel beside the page, which becomes smaller: nothing is covered."""
        panel.show()
        window = self._window
        if panel is self.help:
            width = _NARROW_HELP_WIDTH if window.width() < _NARROW else _HELP_WIDTH
            window.resizeDocks([panel], [width], Qt.Orientation.Horizontal)
        else:
            window.resizeDocks([panel], [min(_LOG_HEIGHT, window.height() // 3)], Qt.Orientation.Vertical)

    def _follow(self, panel: QDockWidget, button: QToolButton, _visible: bool) -> None:
        button.setChecked(not panel.isHidden())

    def _note_failure(self, words: str) -> None:
        self.log.note(words, problem=True)

    def _tell_saved(self, words: str, problem: bool) -> None:
        self._window.ui.notice.say(words, problem=problem)
