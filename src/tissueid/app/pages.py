"""The pages of the window: made, shown, told what happens, remembered from one start to the next."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PySide6.QtCore import QObject

from tissueid.app.layout import MEASURE
from tissueid.app.views.gap.view import GapView
from tissueid.app.views.researcher.view import ResearchView
from tissueid.app.views.start.view import StartView
from tissueid.app.views.technician.view import InstrumentView
from tissueid.app.views.view import Desk, View
from tissueid.audit import Role

if TYPE_CHECKING:
    from tissueid.app.main_window import MainWindow

VIEWS: tuple[type[View], ...] = (StartView, ResearchView, GapView, InstrumentView)
_GEOMETRY = "window/geometry"
_PAGE = "window/page"


class Pages(QObject):
    """Stands between the window and its pages; the guided test is one of them, the window's own."""

    def __init__(self, window: MainWindow) -> None:
        super().__init__(window)
        self._window = window
        self._settings = window.around.settings()
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
        )
        self.views = [kind(desk) for kind in VIEWS]
        first, *others = self.views
        window.ui.add_page(first.name, first.title, first)
        window.ui.add_page(MEASURE, "Measure", window.ui.test_page())
        for view in others:
            window.ui.add_page(view.name, view.title, view)
        window.ui.order_tabs()
        window.ui.rail.chosen.connect(self.show)

    def restore(self) -> None:
        """Put the window where it was last time."""
        geometry = self._settings.value(_GEOMETRY)
        if geometry is not None:
            self._window.restoreGeometry(geometry)
        wanted = self._window.around.first_page or str(self._settings.value(_PAGE, ""))
        self.show(wanted if wanted in self._window.ui.views else self.views[0].name)

    def save(self) -> None:
        """Write what is to be found again."""
        self._settings.setValue(_GEOMETRY, self._window.saveGeometry())
        self._settings.setValue(_PAGE, self._window.ui.page)
        for view in self.views:
            view.save_state()
        self._settings.sync()

    def show(self, name: str) -> None:
        """Show a page by its name."""
        for view in self.views:
            if view.name == name:
                view.enter()
        self._window.ui.show_page(name)

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
        self.show(MEASURE)
        self._window.open_session(path)

    def _prepare_test(self, values: Mapping[str, Any], words: str) -> None:
        self.show(MEASURE)
        self._window.ui.form.fill(values)
        self._window.ui.notice.say(words)
