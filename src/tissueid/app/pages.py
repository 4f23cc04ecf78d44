"""The pages of the window: create and show them, pass events and files on, save and restore their state.

All pages except the first are created, and their modules imported, when they are first shown. This shortens the start.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PySide6.QtCore import QObject, Qt, Signal
from PySide6.QtGui import QDropEvent
from PySide6.QtWidgets import QLineEdit, QPlainTextEdit, QTextEdit, QWidget

from tissueid.app.context import AppContext, View
from tissueid.app.jobs import JobControl
from tissueid.app.layout import Layout
from tissueid.app.navigation_bar import MEASURE
from tissueid.app.theme import appearance, palette_of
from tissueid.app.views.start.view import StartView
from tissueid.app.window_state import saved_page
from tissueid.app.words import sentence
from tissueid.atomic_write import private_folder, unused_path
from tissueid.audit import Role
from tissueid.formatting import clean
from tissueid.language import _, marked, plural
from tissueid.messages import translated

if TYPE_CHECKING:
    from tissueid.app.import_dialog import ImportDialog, Preview
    from tissueid.procedures.import_export import ImportPlan
    from tissueid.sessions.imports import ImportedSession


def _research(context: AppContext) -> View:
    from tissueid.app.views.researcher.view import ResearchView

    return ResearchView(context)


def _gap(context: AppContext) -> View:
    from tissueid.app.views.gap.view import GapView

    return GapView(context)


def _instrument(context: AppContext) -> View:
    from tissueid.app.views.technician.view import InstrumentView

    return InstrumentView(context)


def _studies(context: AppContext) -> View:
    from tissueid.app.views.studies.view import StudiesView

    return StudiesView(context)


LATER: dict[str, tuple[str, Callable[[AppContext], View]]] = {
    "research": (marked("Research"), _research),
    "gap": (marked("Gap"), _gap),
    "instrument": (marked("Instrument"), _instrument),
    "studies": (marked("Studies"), _studies),
}
"""Title and factory of each page that is created when it is first shown."""
ROLE_PAGES: dict[Role, str] = {"clinician": MEASURE, "researcher": "research", "technician": "instrument"}
"""Page that opens for each role."""


class Pages(QObject):
    """Creates, shows and notifies the pages. The page of the guided test belongs to the window itself."""

    shown = Signal(str)
    """A page is shown; carries its name."""

    def __init__(self, context: AppContext, ui: Layout, window: QWidget) -> None:
        super().__init__(window)
        self._context, self._ui = context, ui
        self.start = StartView(self._context_of(StartView.name))
        self.views: list[View] = [self.start]
        ui.rail.add(self.start.name, _("Start"))
        ui.add_page(self.start.name, self.start)
        ui.rail.add(MEASURE, _("Measure"))
        ui.add_page(MEASURE, ui.test_page())
        for name, (title, _make) in LATER.items():
            ui.rail.add(name, _(title))
        ui.order_tabs()
        _pass_drops_on(window)
        ui.notice.watch(window)
        context.jobs.ready.connect(ui.notice.action_succeeded)
        ui.rail.chosen.connect(self.show)
        self.start.role_chosen.connect(self._work_as)
        self.start.instrument_chosen.connect(self._use_instrument)
        ui.form.instrument.described.connect(self._show_instruments)

    def restore(self) -> None:
        """Show the page of the last start."""
        wanted = self._context.services.first_page or saved_page(self._context.settings)
        self.show(wanted if wanted in self._ui.rail.buttons else self.start.name)
        if self._ui.page == self.start.name:
            self.start.focus_first()

    def save(self) -> None:
        """Save the state of the pages."""
        self._context.state.leaving.emit()
        self._context.settings.sync()

    def show(self, name: str) -> None:
        """Show a page by its name."""
        if name in LATER and name not in self._ui.views:
            self._make(name)
        for view in self.views:
            if view.name == name:
                view.enter()
        self._ui.make_way()
        self._ui.show_page(name)
        self.shown.emit(name)

    def go(self, name: str) -> None:
        """Show a page and put the focus into it, as users of the keyboard expect."""
        self.show(name)
        self._ui.focus_page()

    def title(self, name: str) -> str:
        """Return the title of a page."""
        return self._ui.rail.buttons[name].text()

    def offer_files(self, paths: list[Path]) -> bool:
        """Return whether the page that is shown takes these files."""
        return any(view.offer_files(paths) for view in self.views if view.name == self._ui.page)

    def show_new(self, path: Path) -> bool:
        """Return whether the page that is shown shows a session that was imported there."""
        return any(view.show_new(path) for view in self.views if view.name == self._ui.page)

    def list_sessions(self, paths: list[Path]) -> None:
        """Show folders and sessions in the list of the page Research."""
        from tissueid.app.views.researcher.view import ResearchView

        self.show("research")
        for view in self.views:
            if isinstance(view, ResearchView):
                view.list_sessions(paths)

    def _make(self, name: str) -> None:
        """Create a page and bring it to the current state: role, enabled controls, theme."""
        view = LATER[name][1](self._context_of(name))
        self.views.append(view)
        self._ui.add_page(name, view)
        _pass_drops_on(view)
        self._ui.notice.watch(view)
        state = self._context.state
        view.set_role(state.role)
        if state.answered is not None:
            view.on_instrument_answered(*state.answered)
        view.apply_state()
        view.setPalette(palette_of(appearance.theme))

    def _context_of(self, name: str) -> AppContext:
        """Return the context of a page, whose notices are shown with that page."""
        return dataclasses.replace(self._context, say=functools.partial(self._ui.notice.say, page=name))

    def _work_as(self, role: Role) -> None:
        choice = self._ui.role.choice
        choice.setCurrentIndex(choice.findData(role))
        self.show(ROLE_PAGES[role])

    def _use_instrument(self, url: str) -> None:
        self._ui.form.instrument.choose(url)
        self._ui.notice.say(_("The next test is with {url}.").format(url=clean(url)))

    def _show_instruments(self) -> None:
        chooser = self._ui.form.instrument
        self.start.show_instruments(chooser.states, chooser.url)

    def go_calibrate(self, message: str) -> None:
        """Show the page of calibrations with a notice; nothing starts."""
        self.show(MEASURE)
        ui = self._ui
        ui.pages.setCurrentWidget(ui.calibration)
        ui.notice.say(message)
        ui.calibration.begin["static"].setFocus(Qt.FocusReason.ShortcutFocusReason)

    def prepare_test(self, values: Mapping[str, Any], message: str) -> None:
        """Fill the form of a test and show it with a notice; nothing starts."""
        self.show(MEASURE)
        self._ui.form.fill(values)
        self._ui.notice.say(message)


def _pass_drops_on(page: QWidget) -> None:
    """Make the text fields of a page pass dropped files to the window; otherwise they insert them as text."""
    for kind in (QLineEdit, QPlainTextEdit, QTextEdit):
        for field in page.findChildren(kind):
            field.setAcceptDrops(False)


def dropped_paths(event: QDropEvent) -> list[Path]:
    """Return the local files and folders that are dragged."""
    return [Path(url.toLocalFile()) for url in event.mimeData().urls() if url.isLocalFile()]


class FileDrops(QObject):
    """Opens what a person drops or chooses: each kind of file where it belongs."""

    def __init__(self, context: AppContext, pages: Pages, folder: Callable[[], Path], window: QWidget) -> None:
        super().__init__(window)
        self._context, self._pages, self._folder, self._window = context, pages, folder, window
        self.dialog: ImportDialog | None = None
        self._out = Path()
        self._control = JobControl()

    def can_take(self, paths: list[Path]) -> bool:
        """Return whether these may be opened now: not while a coil may be energised or work goes on."""
        return bool(paths) and not self._context.busy

    def take(self, paths: list[Path]) -> None:
        """Open what was dropped on the page that is shown, which may have a use of its own for it."""
        if self.can_take(paths) and not self._pages.offer_files(paths):
            self.open(paths)

    def open(self, paths: list[Path]) -> None:
        """Open each kind of file where it belongs."""
        from tissueid.sessions.imports import is_record

        records = [path for path in paths if path.is_file() and is_record(path)]
        others = [path for path in paths if path not in records]
        if records:
            self.import_records(records)
        elif len(others) == 1 and not others[0].is_dir():
            self._context.open_session(others[0])
        else:
            self._pages.list_sessions(others)

    def import_records(self, paths: list[Path]) -> None:
        """Look into records, then ask what their columns are."""
        from tissueid.app.import_dialog import preview_of

        work, context = functools.partial(preview_of, paths), self._context
        context.jobs.do(work, self._ask, context.say_failed, why=_("A record is being read: wait a few seconds."))

    def _ask(self, preview: Preview) -> None:
        from tissueid.app.import_dialog import ImportDialog

        out = unused_path(self._folder() / f"{preview.paths[0].stem}.h5")
        self.dialog = dialog = ImportDialog(preview, out, self._window)
        dialog.wanted.connect(self._import)
        dialog.finished.connect(self._closed)
        dialog.open()

    def _closed(self) -> None:
        self.dialog = None

    def _import(self, plan: ImportPlan) -> None:
        from tissueid.procedures.import_export import run_import

        self._out, self._control = plan.out, JobControl()
        if plan.out.parent == self._context.services.folder:
            private_folder(plan.out.parent)
        why = _("Records are being imported: wait a moment.")
        work = functools.partial(run_import, plan, self._control, self._context.trail)
        self._context.jobs.do(work, self._imported, self._not_imported, why=why)

    def _imported(self, made: ImportedSession) -> None:
        problems = self._control.notices
        if self.dialog is not None:
            self.dialog.accept()
        count = len(made.session.tests)
        said = plural("Imported {count} test into {path}.", "Imported {count} tests into {path}.", count)
        doubts = [*(notice for test in made.tests for notice in test.notices), *made.notices, *problems]
        messages = [
            said.format(count=count, path=clean(str(self._out))),
            *(sentence(translated(doubt)) for doubt in doubts),
        ]
        self._context.state.session_saved.emit(self._out)
        if not self._pages.show_new(self._out):
            self._context.open_session(self._out)
        self._context.say(" ".join(messages), problem=bool(problems))

    def _not_imported(self, message: str) -> None:
        if self.dialog is not None:
            self.dialog.say(message)
        else:
            self._context.say(message, problem=True)
