"""The page ``instrument`` for technicians: health, calibrations, faults and the audit log."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtCore import Qt
from PySide6.QtGui import QShowEvent
from PySide6.QtWidgets import QAbstractButton, QLabel, QWidget

from tissueid.app import build
from tissueid.app.build import button, column, styled, timer
from tissueid.app.context import AppContext, View
from tissueid.app.jobs import PageJob
from tissueid.app.views.technician.calibrations import CalibrationsTab
from tissueid.app.views.technician.health import HealthTab
from tissueid.app.views.technician.log_tabs import AuditTab, FaultsTab, SearchedTab
from tissueid.app.views.technician.tab import Tab
from tissueid.device import DeviceDescription
from tissueid.language import _, marked

_TAB = "instrument/tab"
_TITLES = (marked("Health"), marked("Calibrations"), marked("Faults and events"), marked("Audit log"))


class InstrumentView(View):
    """The page ``instrument``. Each tab reads its files when it is first seen, and nothing else goes on."""

    name = "instrument"

    def __init__(self, context: AppContext, parent: QWidget | None = None) -> None:
        super().__init__(context, parent)
        self.page_job = PageJob(context.jobs, self)
        self._closing = self._busy = False
        self._answered: tuple[str, DeviceDescription] | None = None
        self.health = HealthTab(context, self.page_job)
        self.calibrations = CalibrationsTab(context, self.page_job)
        self.faults = FaultsTab(context, self.page_job)
        self.audit = AuditTab(context, self.page_job)
        self.all: tuple[Tab, ...] = (self.health, self.calibrations, self.faults, self.audit)
        self.doing = styled(QLabel(), role="muted", text_format=Qt.TextFormat.PlainText)
        ending = _("Ends what is being read or asked")
        self.give_up = button(_("Cancel"), self.page_job.cancel, role="small", tip=ending)
        self.tabs = build.tabs(_("Parts of the page Instrument"), *zip(self.all, map(_, _TITLES), strict=True))
        corner = build.row(self.doing, self.give_up, spacing=8, margins=(0, 0, 0, 2))
        self.tabs.setCornerWidget(build.holder(corner), Qt.Corner.TopRightCorner)
        column(self.tabs, margins=(12, 8, 12, 10), parent=self)
        self.refresh_timer = timer(self, 0, self._bring_up_to_date)
        build.restore_tab(self.tabs, context.settings.value(_TAB))
        self.tabs.currentChanged.connect(self._tab_changed)
        self.page_job.changed.connect(self._show_job)
        build.shortcut(self, "F5", self._again)
        build.shortcut(self, "Ctrl+F", self._search)
        self._show_job()

    def _again(self) -> None:
        """Handle F5: ask the instrument, or read the files of the tab again."""
        if self._busy:
            return
        if self.tabs.currentWidget() is self.health:
            self.health.begin_asking()
        else:
            self.current.load()

    def _search(self) -> None:
        tab = self.current
        if isinstance(tab, SearchedTab):
            tab.search.setFocus()
            tab.search.selectAll()

    @property
    def current(self) -> Tab:
        """The tab that is shown."""
        return self.all[self.tabs.currentIndex()]

    # -- what happens -------------------------------------------------------------------------------------

    def enter(self) -> None:
        """Mark the tabs as stale: files may have changed."""
        self._mark_stale()
        self.health.show_chosen()
        self._judge_chosen()
        self.refresh_timer.start()

    def showEvent(self, event: QShowEvent) -> None:  # noqa: N802
        """Read what is shown, once it is."""
        super().showEvent(event)
        self.refresh_timer.start()

    def _tab_changed(self) -> None:
        self.refresh_timer.start()

    def _bring_up_to_date(self) -> None:
        if self._closing or self._busy or self.context.busy or not self.isVisible():
            return
        if self.current.stale:
            self.current.load()

    def _show_job(self) -> None:
        """The words and the button of what goes on; the calibrations know of the instrument that has answered."""
        self.doing.setText(self.page_job.words)
        self.give_up.setVisible(self.page_job.running)
        checkup = self.health.checkup
        if not self.page_job.running and checkup is not None:
            self._answered = checkup.url, checkup.nominal
            self.context.answered(checkup.url, checkup.device)
        self._judge_chosen()

    def _judge_chosen(self) -> None:
        """Judge the calibrations for the chosen instrument; for none, where another one answered last."""
        url, nominal = self._answered or ("", None)
        self.calibrations.tell_instrument(nominal if url == self.context.instrument() else None)

    def on_instrument_answered(self, url: str, nominal: DeviceDescription) -> None:
        """Take a calibration that was just made for an answer of its instrument."""
        self._answered = url, nominal
        self._mark_stale()
        self._judge_chosen()
        self.refresh_timer.start()

    def update_enabled(self, *, busy: bool, testing: bool) -> None:
        """Disable what starts a job while another one runs."""
        self._busy = busy or testing
        for tab in self.all:
            tab.update_enabled(busy=self._busy)
        if not self._busy:
            self.refresh_timer.start()

    def buttons(self) -> tuple[QAbstractButton, ...]:
        """Return the buttons that the command palette offers."""
        return self.health.ask, self.calibrations.calibrate, self.audit.verify, self.audit.export, self.give_up

    def on_session_saved(self, path: Path) -> None:
        """Mark the tabs as stale: a test was measured."""
        self._mark_stale()

    def _mark_stale(self) -> None:
        for tab in self.all:
            tab.stale = True

    def cancel(self) -> None:
        """The window closes."""
        self._closing = True
        self.page_job.cancel()

    def save_state(self) -> None:
        """Which tab is shown, and what each of them keeps."""
        self.context.settings.setValue(_TAB, self.tabs.currentIndex())
        for tab in self.all:
            tab.save_state()
