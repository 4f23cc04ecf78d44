"""The pages of the window: made, shown, told what happens, remembered from one start to the next."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PySide6.QtCore import QObject

from tissueid.app.layout import MEASURE
from tissueid.app.remembered import put_back, remember, remembered_page
from tissueid.app.views.gap.view import GapView
from tissueid.app.views.researcher.view import ResearchView
from tissueid.app.views.start.view import StartView
from tissueid.app.views.technician.view import InstrumentView
from tissueid.app.views.view import Desk, View
from tissueid.audit import Role
from tissueid.wording import clean

if TYPE_CHECKING:
    from tissueid.app.main_window import MainWindow

VIEWS: tuple[type[View], ...] = (StartView, ResearchView, GapView, InstrumentView)
ROLE_PAGES: dict[Role, str] = {
    "clinician": MEASURE,
    "researcher": ResearchView.name,
    "technician": InstrumentView.name,
}
"""Where each role works."""


class Pages(QObject):
    """Stands between the window and its pages; the guided test is one of them, the window's own."""

    def __init__(self, window: MainWindow) -> None:
        super().__init__(window)
        self._window = window
        self._settings = window.settings
        desk = Desk(
            window.around,
            window.jobs,
            self._settings,
            window.ui.notice.say,
            lambda: window.ui.role.role,
            self.show,
            self._open_session,
            self._prepare_test,
            window.show_report,
            lambda: window.ui.form.instrument.url,
        )
        self.views = [kind(desk) for kind in VIEWS]
        first, *others = self.views
        assert isinstance(first, StartView)
        self.start = first
        window.ui.add_page(first.name, first.title, first)
        window.ui.add_page(MEASURE, "Measure", window.ui.test_page())
        for view in others:
            window.ui.add_page(view.name, view.title, view)
        window.ui.order_tabs()
        window.ui.rail.chosen.connect(self.show)
        first.role_chosen.connect(self._work_as)
        first.instrument_chosen.connect(self._use_instrument)
        first.find_asked.connect(window.searching.find_instruments)
        first.recovery_asked.connect(window.searching.recover)
        window.ui.form.instrument.described.connect(self._show_instruments)

    def restore(self) -> None:
        """Put the window where it was last time."""
        put_back(self._window, self._settings)
        wanted = self._window.around.first_page or remembered_page(self._settings)
        self.show(wanted if wanted in self._window.ui.views else self.start.name)
        if self._window.ui.page == self.start.name:
            self.start.focus_first()

    def save(self) -> None:
        """Write what is to be found again."""
        remember(self._window, self._settings)
        for view in self.views:
            view.save_state()
        self._settings.sync()

    def show(self, name: str) -> None:
        """Show a page by its name."""
        for view in self.views:
            if view.name == name:
                view.enter()
        self._window.ui.show_page(name)
        self._window.panels.help.show_page(name)

    def settle(self, *, busy: bool, testing: bool) -> None:
        """Let every page do what now makes sense."""
        for view in self.views:
            view.settle(busy=busy, testing=testing)

    def take_role(self, role: Role) -> None:
        """Somebody else sits there."""
        for view in self.views:
            view.take_role(role)

    def heard_of(self, path: Path) -> None:
        """A session was recorded or recovered."""
        for view in self.views:
            view.heard_of(path)

    def cancel(self) -> None:
        """The window closes: whatever goes on ends soon."""
        for view in self.views:
            view.cancel()

    def paint(self, paint: Callable[[View], None]) -> None:
        """Colours for every page."""
        for view in self.views:
            paint(view)

    def _open_session(self, path: Path) -> None:
        self._window.open_session(path)

    def _work_as(self, role: Role) -> None:
        choice = self._window.ui.role.choice
        choice.setCurrentIndex(choice.findData(role))
        self.show(ROLE_PAGES[role])

    def _use_instrument(self, url: str) -> None:
        self._window.ui.form.instrument.choose(url)
        self._window.ui.notice.say(f"The next test is with {clean(url)}.")

    def _show_instruments(self) -> None:
        chooser = self._window.ui.form.instrument
        self.start.show_instruments(chooser.known, chooser.url)

    def _prepare_test(self, values: Mapping[str, Any], words: str) -> None:
        self.show(MEASURE)
        self._window.ui.form.fill(values)
        self._window.ui.notice.say(words)
