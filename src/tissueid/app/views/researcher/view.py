"""The page ``research``: sessions on the left; signals and analyses of the selected tests on the right."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtCore import QByteArray, Qt, QTimer
from PySide6.QtWidgets import QAbstractButton, QSplitter, QTabWidget, QToolButton, QVBoxLayout, QWidget

from tissueid.app.context import AppContext, View
from tissueid.app.views.researcher.analysis import AnalysisPanel
from tissueid.app.views.researcher.background_work import ProgressStrip
from tissueid.app.views.researcher.browser import Browser
from tissueid.app.views.researcher.export_button import ExportButton
from tissueid.app.views.researcher.signals import SignalsPanel
from tissueid.language import _

_SPLIT, _TAB, _FOLDED = "research/split", "research/tab", "research/list-folded"
_WIDTHS = (300, 700)


class ResearchView(View):
    """Browser and panels. Starts waiting work, one job at a time."""

    name = "research"

    def __init__(self, context: AppContext, parent: QWidget | None = None) -> None:
        super().__init__(context, parent)
        self._to_open: Path | None = None
        self._testing = False
        self._over = False
        self.strip = ProgressStrip()
        self.browser = Browser(context, self.strip)
        self.export = ExportButton(context, self.strip, self.browser.chosen)
        self.browser.foot.addWidget(self.export)
        self.signals = SignalsPanel(context, self.strip)
        self.analysis = AnalysisPanel(context)
        self.tabs = QTabWidget()
        self.tabs.setDocumentMode(True)
        self.tabs.tabBar().setDrawBase(False)
        self.tabs.tabBar().setAccessibleName(_("Signals and analysis"))
        self.tabs.setCornerWidget(self.strip)
        self.fold_list = QToolButton()
        self.fold_list.setProperty("role", "fold")
        self.fold_list.setCheckable(True)
        self.fold_list.setAccessibleName(_("Hide the list of sessions"))
        self.fold_list.setToolTip(_("Hide the list of sessions, for more room; the selection stays"))
        self.fold_list.toggled.connect(self._fold_list)
        self.tabs.setCornerWidget(self.fold_list, Qt.Corner.TopLeftCorner)
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
        QWidget.setTabOrder(self.export, self.fold_list)
        QWidget.setTabOrder(self.fold_list, self.tabs.tabBar())
        rows = QVBoxLayout(self)
        rows.setContentsMargins(12, 10, 12, 6)
        rows.setSpacing(4)
        rows.addWidget(self.split, 1)
        # Not from within a job's end: the other pages must have settled first.
        self.refresh_timer = QTimer(self)
        self.refresh_timer.setSingleShot(True)
        self.refresh_timer.setInterval(0)
        self.refresh_timer.timeout.connect(self._go_on)
        self.browser.work_waits.connect(self.refresh_timer.start)
        self.signals.work_waits.connect(self.refresh_timer.start)
        self.browser.selected.connect(self._show_selected)
        self.browser.opened.connect(self._open)
        self._restore()

    def enter(self) -> None:
        """Start the search for sessions on the first visit."""
        self.refresh_timer.start()

    def update_enabled(self, *, busy: bool, testing: bool) -> None:
        """Enable or disable the controls, and start waiting work."""
        self._testing = testing
        self.browser.update_enabled(testing=testing)
        self.signals.update_enabled(busy=busy, testing=testing)
        self.analysis.update_enabled(busy=busy, testing=testing)
        self.export.update_enabled(busy=busy)
        if not busy:
            self.refresh_timer.start()

    def list_sessions(self, paths: list[Path]) -> None:
        """Add folders and sessions to the list."""
        self.browser.list_sessions(paths)

    def show_new(self, path: Path) -> bool:
        """List a session that was made on this page, and show its signals."""
        self.browser.choose(path)
        self.tabs.setCurrentWidget(self.signals)
        return True

    def buttons(self) -> tuple[QAbstractButton, ...]:
        """Return the buttons that the command palette offers."""
        of_analysis = self.analysis.run, self.analysis.compare, self.analysis.save_table, self.analysis.save_figure
        return self.browser.again, self.export, *of_analysis, self.strip.stop

    def on_session_saved(self, path: Path) -> None:
        """List a new session."""
        self.browser.on_session_saved(path)

    def cancel(self) -> None:
        """Cancel the running work and start no more; the window closes."""
        self._over = True
        self.strip.cancel()
        self.analysis.cancel()

    def save_state(self) -> None:
        """Save folders, filters, columns, signals and sizes."""
        self.browser.save_state()
        self.signals.save_state()
        self.analysis.save_state()
        self.context.settings.setValue(_SPLIT, self.split.saveState())
        self.context.settings.setValue(_TAB, self.tabs.currentIndex())
        self.context.settings.setValue(_FOLDED, "yes" if self.fold_list.isChecked() else "no")

    def _go_on(self) -> None:
        if self._over or self._testing or self.context.busy or not self.isVisible():
            return
        if self._to_open is not None:
            path, self._to_open = self._to_open, None
            self.context.open_session(path)
        elif not self.analysis.go_on() and not self.signals.go_on():
            self.browser.go_on()

    def _open(self, path: Path) -> None:
        self._to_open = path
        self.strip.cancel()
        self.refresh_timer.start()

    def _show_selected(self) -> None:
        chosen = self.browser.chosen()
        self._to_open = None
        self.export.selection_changed()
        self.signals.show_tests(chosen)
        self.analysis.show_tests(chosen)

    def _fold_list(self, folded: bool) -> None:
        self.browser.setVisible(not folded)
        self.fold_list.setArrowType(Qt.ArrowType.RightArrow if folded else Qt.ArrowType.LeftArrow)

    def _restore(self) -> None:
        self.fold_list.setChecked(str(self.context.settings.value(_FOLDED, "no")) == "yes")
        self._fold_list(self.fold_list.isChecked())
        split = self.context.settings.value(_SPLIT)
        if isinstance(split, QByteArray):
            self.split.restoreState(split)
        if str(self.context.settings.value(_TAB, "0")) == "1":
            self.tabs.setCurrentWidget(self.analysis)
