"""Help and log next to the page, opened and closed by keys or by buttons at the foot of the navigation bar."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from PySide6.QtCore import QObject, Qt
from PySide6.QtWidgets import QApplication, QDockWidget, QMainWindow, QToolButton, QWidget

from tissueid.app.context import AppContext
from tissueid.app.help_panel import HelpPanel
from tissueid.app.log_panel import LogPanel
from tissueid.app.navigation_bar import NavigationBar
from tissueid.app.notice import Notice
from tissueid.app.theme import Theme
from tissueid.language import _

HELP_KEY = "F1"
LOG_KEY = "F9"
_LOG_HEIGHT = 150


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
        self.help_button = self._add(self.help, rail.add_foot(_("Help"), HELP_KEY, _("Help for this page")))
        self.log_button = self._add(self.log, rail.add_foot(_("Log"), LOG_KEY, _("What happened so far")))
        self.help.turned.connect(partial(self._follow, self.help, self.help_button))
        self.log.visibilityChanged.connect(partial(self._follow, self.log, self.log_button))
        notice.said.connect(self.log.note)
        context.jobs.failed.connect(self._note_failure)
        self.log.saved.connect(self._tell_saved)
        self.log.note(_("TissueID was started."))

    def apply_theme(self, theme: Theme) -> None:
        """Take on the colours of a theme."""
        self.help.apply_theme(theme)

    def _add(self, panel: QWidget, button: QToolButton) -> QToolButton:
        toggle: Callable[..., None] = partial(self._toggle, panel)
        button.clicked.connect(toggle)
        return button

    def _toggle(self, panel: QWidget, _checked: bool = False) -> None:
        """Open a panel and give it the keyboard focus, or close it. During a test the focus does not move."""
        show = panel.isHidden()
        focus = QApplication.focusWidget()
        if show:
            panel.show()
            if panel is self.log:
                height = min(_LOG_HEIGHT, self._window.height() // 3)
                self._window.resizeDocks([self.log], [height], Qt.Orientation.Vertical)
            if not self._context.testing():
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

    def _note_failure(self, words: str) -> None:
        self.log.note(words, problem=True)

    def _tell_saved(self, words: str, problem: bool) -> None:
        self._notice.say(words, problem=problem)
