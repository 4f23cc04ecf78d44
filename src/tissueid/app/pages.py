"""The pages of the window: made, shown, told what happens, remembered from one start to the next.

All but the first are made when they are first shown, and only then are their modules imported: the window is there
sooner, and who never leaves the guided test pays for nothing else.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PySide6.QtCore import QObject

from tissueid.app.file_drops import pass_drops_on
from tissueid.app.layout import MEASURE
from tissueid.app.remembered import put_back, remember, remembered_page
from tissueid.app.theme import Theme, palette_of
from tissueid.app.views.start.view import StartView
from tissueid.app.views.view import Desk, View
from tissueid.app.waiting import tell_why
from tissueid.audit import Role
from tissueid.language import _, marked
from tissueid.wording import clean

if TYPE_CHECKING:
    from tissueid.app.main_window import MainWindow


def _research(desk: Desk) -> View:
    from tissueid.app.views.researcher.view import ResearchView

    return ResearchView(desk)


def _gap(desk: Desk) -> View:
    from tissueid.app.views.gap.view import GapView

    return GapView(desk)


def _instrument(desk: Desk) -> View:
    from tissueid.app.views.technician.view import InstrumentView

    return InstrumentView(desk)


LATER: dict[str, tuple[str, Callable[[Desk], View]]] = {
    "research": (marked("Research"), _research),
    "gap": (marked("Gap"), _gap),
    "instrument": (marked("Instrument"), _instrument),
}
"""What the rail calls the pages that are made when they are first shown, and what makes them."""
ROLE_PAGES: dict[Role, str] = {"clinician": MEASURE, "researcher": "research", "technician": "instrument"}
"""Where each role works."""


class Pages(QObject):
    """Stands between the window and its pages; the guided test is one of them, the window's own."""

    def __init__(self, window: MainWindow) -> None:
        super().__init__(window)
        self._window = window
        self._settings = window.settings
        self._theme: Theme | None = None
        self._desk = Desk(
            window.around,
            window.jobs,
            self._settings,
            window.ui.notice.say,
            lambda: window.ui.role.role,
            self.show,
            self._open_session,
            self._prepare_test,
            window.reports.show,
            lambda: window.ui.form.instrument.url,
            self._go_calibrate,
        )
        self.start = StartView(self._desk_of(StartView.name))
        self.views: list[View] = [self.start]
        window.ui.rail.add(self.start.name, _("Start"))
        window.ui.add_page(self.start.name, self.start)
        window.ui.rail.add(MEASURE, _("Measure"))
        window.ui.add_page(MEASURE, window.ui.test_page())
        for name, (title, _make) in LATER.items():
            window.ui.rail.add(name, _(title))
        window.ui.order_tabs()
        pass_drops_on(window)
        window.ui.rail.chosen.connect(self.show)
        self.start.role_chosen.connect(self._work_as)
        self.start.instrument_chosen.connect(self._use_instrument)
        self.start.find_asked.connect(window.searching.find_instruments)
        self.start.recovery_asked.connect(window.searching.recover)
        window.ui.form.instrument.described.connect(self._show_instruments)

    def restore(self) -> None:
        """Put the window where it was last time."""
        put_back(self._window, self._settings)
        wanted = self._window.around.first_page or remembered_page(self._settings)
        self.show(wanted if wanted in self._window.ui.rail.buttons else self.start.name)
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
        if name in LATER and name not in self._window.ui.views:
            self._make(name)
        for view in self.views:
            if view.name == name:
                view.enter()
        if name == MEASURE:
            self._window.searching.list_twins()
        self._window.ui.show_page(name)
        self._window.panels.help.show_page(name)

    def settle(self, *, busy: bool, testing: bool) -> None:
        """Let every page do what now makes sense."""
        for view in self.views:
            view.settle(busy=busy, testing=testing)
            tell_why(view.waiting(), self._window.jobs.why)

    def take_role(self, role: Role) -> None:
        """Somebody else sits there."""
        for view in self.views:
            view.take_role(role)

    def heard_of(self, path: Path) -> None:
        """A session was recorded or recovered."""
        for view in self.views:
            view.heard_of(path)

    def offer_files(self, paths: list[Path]) -> bool:
        """Return whether the page that is shown takes these files."""
        return any(view.offer_files(paths) for view in self.views if view.name == self._window.ui.page)

    def list_sessions(self, paths: list[Path]) -> None:
        """Show folders and sessions in the list of the page Research."""
        from tissueid.app.views.researcher.view import ResearchView

        self.show("research")
        for view in self.views:
            if isinstance(view, ResearchView):
                view.list_sessions(paths)

    def cancel(self) -> None:
        """The window closes: whatever goes on ends soon."""
        for view in self.views:
            view.cancel()

    def paint_with(self, theme: Theme) -> None:
        """Colours for every page, and for those that come later."""
        self._theme = theme
        for view in self.views:
            _paint(view, theme)

    def _make(self, name: str) -> None:
        """Make a page as it would stand if it had been there from the beginning."""
        view = LATER[name][1](self._desk_of(name))
        self.views.append(view)
        self._window.ui.add_page(name, view)
        pass_drops_on(view)
        view.take_role(self._window.ui.role.role)
        view.settle(busy=self._window.busy, testing=self._window.testing)
        tell_why(view.waiting(), self._window.jobs.why)
        if self._theme is not None:
            _paint(view, self._theme)

    def _desk_of(self, name: str) -> Desk:
        """What a page says stays with it, wherever somebody is when it is said."""
        return dataclasses.replace(self._desk, say=functools.partial(self._window.ui.notice.say, page=name))

    def _open_session(self, path: Path) -> None:
        self._window.open_session(path)

    def _work_as(self, role: Role) -> None:
        choice = self._window.ui.role.choice
        choice.setCurrentIndex(choice.findData(role))
        self.show(ROLE_PAGES[role])

    def _use_instrument(self, url: str) -> None:
        self._window.ui.form.instrument.choose(url)
        self._window.ui.notice.say(_("The next test is with {url}.").format(url=clean(url)))

    def _show_instruments(self) -> None:
        chooser = self._window.ui.form.instrument
        self.start.show_instruments(chooser.known, chooser.url)

    def _go_calibrate(self, words: str) -> None:
        self.show(MEASURE)
        ui = self._window.ui
        ui.pages.setCurrentWidget(ui.calibration)
        ui.notice.say(words)
        ui.calibration.begin["static"].setFocus()

    def _prepare_test(self, values: Mapping[str, Any], words: str) -> None:
        self.show(MEASURE)
        self._window.ui.form.fill(values)
        self._window.ui.notice.say(words)


def _paint(view: View, theme: Theme) -> None:
    """Colours for a page; one that is made late does not get the window's palette by itself."""
    view.setPalette(palette_of(theme))
    view.paint_with(theme)
