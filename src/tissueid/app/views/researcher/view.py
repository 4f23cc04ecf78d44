"""The page ``research``: a year of sessions on the left; signals and analyses of the selected tests on the right."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtCore import QByteArray, QTimer
from PySide6.QtWidgets import QAbstractButton, QSplitter, QTabWidget, QVBoxLayout, QWidget

from tissueid.app.theme import Theme
from tissueid.app.views.researcher.analysis import AnalysisPanel
from tissueid.app.views.researcher.browser import Browser
from tissueid.app.views.researcher.errand import ErrandStrip
from tissueid.app.views.researcher.export_button import ExportButton
from tissueid.app.views.researcher.signals import SignalsPanel
from tissueid.app.views.view import Desk, View
from tissueid.language import _

_SPLIT, _TAB = "research/split", "research/tab"
_WIDTHS = (300, 700)


class ResearchView(View):
    """Browser and panels. Work that waits for other work is begun here, one piece at a time."""

    name = "research"

    def __init__(self, desk: Desk, parent: QWidget | None = None) -> None:
        super().__init__(desk, parent)
        self._to_open: Path | None = None
        self._testing = False
        self._over = False
        self.strip = ErrandStrip()
        self.browser = Browser(desk, self.strip)
        self.export = ExportButton(desk, self.strip, self.browser.chosen)
        self.browser.foot.addWidget(self.export)
        self.signals = SignalsPanel(desk, self.strip)
        self.analysis = AnalysisPanel(desk)
        self.tabs = QTabWidget()
        self.tabs.setDocumentMode(True)
        self.tabs.tabBar().setDrawBase(False)
        self.tabs.tabBar().setAccessibleName(_("Signals and analysis"))
        self.tabs.setCornerWidget(self.strip)
        self.tabs.addTab(self.signals, _("Signals"))
        self.tabs.addTab(self.analysis, _("Analysis"))
        self.split = QSplitter()
        self.split.addWidget(self.browser)
        self.split.addWidget(self.tabs)
        self.split.setChildrenCollapsible(False)
        self.split.setHandleWidth(8)
        self.split.setStretchFactor(0, 3)
        self.split.setStretchFactor(1, 7)
        self.split.setSizes(list(_WIDTHS))
        rows = QVBoxLayout(self)
        rows.setContentsMargins(12, 10, 12, 6)
        rows.setSpacing(4)
        rows.addWidget(self.split, 1)
        # Not from within a job's end: the other pages must have settled first.
        self._soon = QTimer(self)
        self._soon.setSingleShot(True)
        self._soon.setInterval(0)
        self._soon.timeout.connect(self._go_on)
        self.browser.work_waits.connect(self._soon.start)
        self.signals.work_waits.connect(self._soon.start)
        self.browser.selected.connect(self._show_selected)
        self.browser.opened.connect(self._open)
        self._restore()

    def enter(self) -> None:
        """Look for sessions, the first time that somebody looks here."""
        self._soon.start()

    def settle(self, *, busy: bool, testing: bool) -> None:
        """Enable what makes sense now, and begin what waited."""
        self._testing = testing
        self.browser.settle(testing=testing)
        self.signals.settle(busy=busy, testing=testing)
        self.analysis.settle(busy=busy, testing=testing)
        self.export.settle(busy=busy)
        if not busy:
            self._soon.start()

    def list_sessions(self, paths: list[Path]) -> None:
        """Add folders and sessions to the list of sessions."""
        self.browser.list_sessions(paths)

    def buttons(self) -> tuple[QAbstractButton, ...]:
        """Return the buttons that the command palette offers."""
        return self.browser.again, self.analysis.run, self.analysis.compare, self.analysis.save_table, self.strip.stop

    def heard_of(self, path: Path) -> None:
        """List a new session."""
        self.browser.heard_of(path)

    def paint_with(self, theme: Theme) -> None:
        """Take on the colours of a theme."""
        self.browser.paint_with(theme)
        self.signals.paint_with(theme)
        self.analysis.paint_with(theme)

    def cancel(self) -> None:
        """The window closes: end what goes on, begin nothing more."""
        self._over = True
        self.strip.cancel()
        self.analysis.cancel()

    def save_state(self) -> None:
        """Keep folders, filters, columns, signals and sizes."""
        self.browser.save_state()
        self.signals.save_state()
        self.analysis.save_state()
        self.desk.settings.setValue(_SPLIT, self.split.saveState())
        self.desk.settings.setValue(_TAB, self.tabs.currentIndex())

    def _go_on(self) -> None:
        if self._over or self._testing or self.desk.busy or not self.isVisible():
            return
        if self._to_open is not None:
            path, self._to_open = self._to_open, None
            self.desk.open_session(path)
        elif not self.analysis.go_on() and not self.signals.go_on():
            self.browser.go_on()

    def _open(self, path: Path) -> None:
        self._to_open = path
        self.strip.cancel()
        self._soon.start()

    def _show_selected(self) -> None:
        chosen = self.browser.chosen()
        self._to_open = None
        self.export.selection_changed()
        self.signals.show_tests(chosen)
        self.analysis.show_tests(chosen)

    def _restore(self) -> None:
        split = self.desk.settings.value(_SPLIT)
        if isinstance(split, QByteArray):
            self.split.restoreState(split)
        if str(self.desk.settings.value(_TAB, "0")) == "1":
            self.tabs.setCurrentWidget(self.analysis)


__all__ = ["ResearchView"]
