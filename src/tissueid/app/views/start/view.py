"""The first page with its tables: role, instrument, recent sessions, and unfinished tests."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QColor, QKeyEvent, QResizeEvent, QShowEvent
from PySide6.QtWidgets import (
    QAbstractButton,
    QAbstractItemView,
    QBoxLayout,
    QFrame,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QLineEdit,
    QScrollArea,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
    QWidget,
)

from tissueid.app import build
from tissueid.app.build import button, fill, for_reading, label, row, styled, timer
from tissueid.app.context import AppContext, View
from tissueid.app.small_window import FoldingBox
from tissueid.app.theme import appearance
from tissueid.app.views.start.recent import FolderLook, KnownFiles, Recent, look_into, storage_locations
from tissueid.app.widgets import ElidedLabel
from tissueid.app.window_state import RoleCard, choosers, visited_studies
from tissueid.app.words import RESEARCH_USE, CalibrationState
from tissueid.audit import Role
from tissueid.formatting import clean
from tissueid.language import _, marked, plural
from tissueid.messages import Message, code_of, translated

Cell = tuple[str, str]
"""What a cell says, and the level of its colour: good, check, poor, or none."""
_LEVEL = Qt.ItemDataRole.UserRole
_LONGEST_ADDRESS = 36
"""Characters of an address in the list of instruments; the tooltip shows all of it."""
_LOWEST = 4
"""Rows that are seen at least."""


class Rows(QTableWidget):
    """Shows lines of words. ``taken`` carries the number of a row that was double-clicked, or on which Return fell."""

    taken = Signal(int)

    def __init__(
        self, name: str, headings: Sequence[str], stretched: Sequence[int], parent: QWidget | None = None
    ) -> None:
        super().__init__(0, len(headings), parent)
        for_reading(self, name, self.fontMetrics().height() + 8, horizontal_header_labels=list(headings))
        styled(
            self,
            selection_mode=QAbstractItemView.SelectionMode.SingleSelection,
            word_wrap=True,
            vertical_scroll_mode=QAbstractItemView.ScrollMode.ScrollPerPixel,
            horizontal_scroll_bar_policy=Qt.ScrollBarPolicy.ScrollBarAlwaysOff,
        )
        header = self.horizontalHeader()
        header.setSectionsClickable(False)
        self._stretched = tuple(stretched)
        for column in range(len(headings)):
            kind = QHeaderView.ResizeMode.Fixed if column in stretched else QHeaderView.ResizeMode.ResizeToContents
            header.setSectionResizeMode(column, kind)
        header.setMinimumSectionSize(40)
        self.verticalHeader().setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        self.verticalHeader().setMinimumSectionSize(self.verticalHeader().defaultSectionSize())
        self.setMinimumHeight(header.sizeHint().height() + _LOWEST * self.verticalHeader().defaultSectionSize())
        self.cellDoubleClicked.connect(self._take)
        appearance.follow(self._colour)

    @property
    def chosen(self) -> int:
        """The number of the row that is selected; -1 where none is."""
        rows = self.selectionModel().selectedRows()
        return rows[0].row() if rows else -1

    def fill(self, rows: Sequence[Sequence[Cell]]) -> None:
        """Show other lines; the row that is selected stays so."""
        kept = min(self.chosen, len(rows) - 1)
        self.setRowCount(len(rows))
        for index, line in enumerate(rows):
            for column, (text, level) in enumerate(line):
                item = QTableWidgetItem(text)
                item.setToolTip(text)
                item.setData(_LEVEL, level)
                self.setItem(index, column, item)
        self._colour()
        self._share_room()
        if kept >= 0:
            self.selectRow(kept)

    def explain(self, row: int, text: str) -> None:
        """Return the complete text of a row for tooltip and screen reader."""
        for column in range(self.columnCount()):
            if (item := self.item(row, column)) is not None:
                item.setToolTip(text)
                item.setData(Qt.ItemDataRole.AccessibleDescriptionRole, text)

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        """Distribute the width over the columns again."""
        super().resizeEvent(event)
        self._share_room()

    def _share_room(self) -> None:
        """Columns that are stretched get what the others leave, by what each has to say; too long a text is wrapped."""
        header = self.horizontalHeader()
        header.resizeSections(QHeaderView.ResizeMode.ResizeToContents)
        wanted = [max(self.sizeHintForColumn(c), header.sectionSizeHint(c)) for c in self._stretched]
        others = sum(self.columnWidth(c) for c in range(self.columnCount()) if c not in self._stretched)
        remaining = max(0, self.viewport().width() - others)
        # Narrowest first: a column that needs less than an equal share gets its need, the longest texts share the rest.
        places = sorted(range(len(wanted)), key=wanted.__getitem__)
        for number, index in enumerate(places):
            share = remaining // (len(places) - number)
            spare = max(0, remaining - sum(wanted[other] for other in places[number:])) // (len(places) - number)
            width = share if number == len(places) - 1 else min(wanted[index] + spare, share)
            self.setColumnWidth(self._stretched[index], width)
            remaining -= width
        self.resizeRowsToContents()

    def keyPressEvent(self, event: QKeyEvent) -> None:  # noqa: N802
        """Return takes the row that is selected, once for each time that the key goes down."""
        if event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter):
            if self.chosen >= 0 and not event.isAutoRepeat():
                self.taken.emit(self.chosen)
            return
        super().keyPressEvent(event)

    def _take(self, row: int, _column: int) -> None:
        self.taken.emit(row)

    def _colour(self) -> None:
        theme = appearance.theme
        colours = {"good": theme.good, "check": theme.check, "poor": theme.poor}
        for index in range(self.rowCount()):
            for column in range(self.columnCount()):
                if (item := self.item(index, column)) is not None:
                    item.setForeground(QColor(colours.get(item.data(_LEVEL), theme.text)))


def cells(item: Recent) -> tuple[tuple[str, str], ...]:
    """Return the cells of a row for a session."""
    subject = "  ·  ".join(filter(None, [item.subject, item.study]))
    return (item.date, ""), (item.site, ""), (subject, ""), (item.verdict, item.level), (item.accepted, "")


def short_address(url: str) -> str:
    """Return an address without its middle where it is long: the end names a port or a file."""
    if len(url) <= _LONGEST_ADDRESS:
        return url
    kept = _LONGEST_ADDRESS // 3
    return f"{url[:kept]}…{url[-2 * kept :]}"


def brief(health: str) -> str:
    """Return a problem without its advice, which is in the tooltip of the row."""
    return health.partition(";")[0]


def under_heading(title: str, about: QLabel, table: Rows, *buttons: QWidget) -> QBoxLayout:
    """A table under a heading with buttons next to the heading."""
    about.setProperty("role", "muted")
    return build.column(
        row(styled(QLabel(title), role="heading"), (about, 1), *buttons, spacing=8), (table, 1), spacing=4
    )


WHAT_ROLES_DO: dict[Role, str] = {
    "clinician": marked(
        "Run a guided test: where to hold the probe, a green light if the test is good, and the tissue's "
        "mass, damping and stiffness."
    ),
    "researcher": marked(
        "Reopen sessions, fit and compare every model of the tissue, and see where a simulation of the "
        "same test would have been wrong."
    ),
    "technician": marked("Maintain the instrument: identity, health, calibration of coil and sensors."),
}
HINT = marked("No instrument? Try simulated://forearm.")
_LEVELS = {"instruments.ready": "good", "instruments.no_answer": "poor"}
"""Levels of a colour by the code of the state of an instrument."""
_MOST_NAMES = 3
_TYPING_MS = 250
_SEARCH_WIDTH = 220
_TWO_COLUMNS = 960
"""Width below which the instruments stand below the sessions, pixels."""
_ONE_ROW = 640
"""Width below which the choosers stand in two rows, pixels; wider where they need more."""


class StartView(View):
    """The page ``start``. What it asks for the window does: its signals say what.

    ``role_chosen`` carries a role, ``instrument_chosen`` an address.
    """

    name = "start"
    role_chosen = Signal(str)
    instrument_chosen = Signal(str)
    find_asked = Signal()
    recovery_asked = Signal()

    def __init__(self, context: AppContext, parent: QWidget | None = None) -> None:
        super().__init__(context, parent)
        self._look = FolderLook()
        self._known = KnownFiles()
        self._urls: list[str] = []
        self._stale, self._reading = True, False
        self._cancelled = threading.Event()
        self._then: Callable[[], None] | None = None
        # Not at once: the window first tells every page that nothing goes on any more.
        self.refresh_timer = timer(self, 0, self._go_on)
        self.cards = {role: RoleCard(role, _(sentence)) for role, sentence in WHAT_ROLES_DO.items()}
        columns = _("Date"), _("Site"), _("Subject"), _("Quality"), _("Accepted result")
        self.recent = Rows(_("Recent sessions"), columns, (1, 2, 3, 4))
        self.instruments = Rows(_("Instruments"), (_("Instrument"), _("Health"), _("Calibration")), (0, 1, 2))
        self.search = styled(
            QLineEdit(),
            placeholder_text=_("Search: subject, site, date"),
            name=_("Search sessions by subject, site, study or date"),
            tip=_("Such as P01 forearm, or 2026-01-15"),
            clear_button_enabled=True,
            minimum_width=_SEARCH_WIDTH,
        )
        self._typed = timer(self, _TYPING_MS, self._search)
        self.about_recent, self.about_instruments = label(), ElidedLabel()
        self.open = button(_("Open"), self._open_chosen, name=_("Open the selected session"))
        self.stop_reading = button(_("Cancel"), self.cancel, name=_("Stop reading the folder of sessions"))
        self.use = button(_("Use"), self._use_chosen, name=_("Use the selected instrument for the next test"))
        self.seek = button(_("Fin&d"), self._find, name=_("Find instruments: ask every port"))
        self.unfinished = label()
        self.recover = button(_("Recover"), self._recover, name=_("Recover all unfinished tests"))
        self.choosers = choosers(context.settings)
        self.language, self.units, self.appearance, self.text_size = self.choosers
        self.folder = button(_("Show folder"), self._show_folder, name=_("Show the folder of sessions"))
        self._arrange()
        self._connect()
        self.set_role(context.state.role)

    # -- what the window tells ------------------------------------------------------------------------------

    def update_enabled(self, *, busy: bool, testing: bool) -> None:
        """Disable everything during a test, and what starts a job during another job."""
        self.setEnabled(not testing)
        others = busy and not self._reading
        for part in (self.recent, self.seek, self.recover, *self.cards.values()):
            part.setEnabled(not others)
        self.stop_reading.setVisible(self._reading)
        self._enable_choices()
        if not busy and (self._stale or self._then is not None):
            self.refresh_timer.start()

    def buttons(self) -> tuple[QAbstractButton, ...]:
        """Return the buttons that the command palette offers."""
        return self.recover, self.folder, self.stop_reading

    def set_role(self, role: Role) -> None:
        """Mark the card of the role."""
        for name, card in self.cards.items():
            card.show_taken(name == role)

    def on_session_saved(self, path: Path) -> None:
        """Read the folder again: a session was added."""
        self._stale = True
        self.refresh_timer.start()

    def show_instruments(self, instruments: Mapping[str, tuple[str, CalibrationState]], chosen: str) -> None:
        """Show what was found, its state, a message, and calibration; ``chosen`` is what the next test is with."""
        self._urls = list(instruments)
        self.instruments.fill(
            [
                (
                    (f"{'✓ ' if url == chosen else ''}{short_address(clean(url))}", ""),
                    (brief(clean(translated(health))), _LEVELS.get(code_of(health), "")),
                    (clean(_calibration(state)), state.level),
                )
                for url, (health, state) in instruments.items()
            ]
        )
        for index, (url, (health, state)) in enumerate(instruments.items()):
            lines_of_tip = clean(url), translated(health), _(state.summary), *state.warnings
            self.instruments.explain(index, "\n".join(lines_of_tip))
        self.about_instruments.setText(
            _("The next test is with {url}.").format(url=clean(chosen)) if chosen else _("None is chosen.")
        )
        self._enable_choices()

    def cancel(self) -> None:
        """Stop reading the folder."""
        self._cancelled.set()

    def save_state(self) -> None:
        """Start no more jobs: the window closes."""
        self.refresh_timer.stop()
        self._stale = False

    def focus_first(self) -> None:
        """Set the focus to the card of the current role."""
        self.cards[self.context.state.role].setFocus()

    def showEvent(self, event: QShowEvent) -> None:  # noqa: N802
        """Read the folder again when the page is shown."""
        super().showEvent(event)
        self._stale = True
        self.refresh_timer.start()

    # -- the folder of sessions ------------------------------------------------------------------------------

    def _go_on(self) -> None:
        """Nothing goes on: do what was asked for meanwhile, or else look into the folder if that is due."""
        if self.context.busy or not self.isVisible():
            return
        if self._then is not None:
            then, self._then = self._then, None
            then()
        elif self._stale:
            self._stale, self._reading = False, True
            self._cancelled = threading.Event()
            folder, settings = self.context.services.folder, self.context.settings
            work = functools.partial(
                look_into,
                folder,
                self._cancelled,
                self._known,
                studies=visited_studies(settings),
                search=self.search.text(),
            )
            self.context.jobs.do(work, self._looked, self._looking_failed)

    def _looked(self, look: FolderLook) -> None:
        self._reading = False
        if self._cancelled.is_set() and (self._then is not None or self._stale):
            return  # it was cut short for something else
        self._look = look
        self.recent.fill([cells(item) for item in look.sessions])
        self.about_recent.setText(self._words_of(look))
        count = len(look.unfinished)
        names = ", ".join(clean(path.name.removesuffix(".journal")) for path in look.unfinished[:_MOST_NAMES])
        names += " …" if count > _MOST_NAMES else ""
        what = plural("One test was not finished", "{count} tests were not finished", count).format(count=count)
        self.unfinished.setText(_("{what}: {names}. What was recorded is kept.").format(what=what, names=names))
        self._strip.setVisible(count > 0)
        self._enable_choices()

    def _words_of(self, look: FolderLook) -> str:
        if look.problem:
            return look.problem
        read = sum(item.tests for item in look.sessions)
        if self._cancelled.is_set():
            return translated(
                Message(
                    "start.cancelled", "Cancelled: {read} of {count} sessions were read.", read=read, count=look.count
                )
            )
        if self.search.text().strip() and not look.sessions:
            return _("No session matches.")
        if self.search.text().strip():
            return ""
        if not look.count:
            return translated(Message("start.no_session", "No session is here yet: the first test makes one."))
        return _("The newest {shown} of {count}.").format(shown=read, count=look.count) if look.count > read else ""

    def _search(self) -> None:
        """List what matches, now or as soon as nothing else goes on."""
        self._stale = True
        if self._reading:
            self._cancelled.set()
        self.refresh_timer.start()

    def _looking_failed(self, message: str) -> None:
        self._reading = False
        self.about_recent.setText(message)

    def _when_idle(self, action: Callable[[], None]) -> None:
        """Run at once, or as soon as the folder is read, but not while another job runs."""
        if not self.context.busy:
            action()
        elif self._reading:
            self._then = action
            self._cancelled.set()

    # -- what a person does -----------------------------------------------------------------------------------

    def _choose_role(self, role: Role) -> None:
        self._when_idle(functools.partial(self.role_chosen.emit, role))

    def _open_row(self, row: int) -> None:
        if 0 <= row < len(self._look.sessions):
            self._when_idle(functools.partial(self.context.open_session, self._look.sessions[row].path))

    def _open_chosen(self) -> None:
        self._open_row(self.recent.chosen)

    def _use_row(self, row: int) -> None:
        if 0 <= row < len(self._urls):
            self.instrument_chosen.emit(self._urls[row])

    def _use_chosen(self) -> None:
        self._use_row(self.instruments.chosen)

    def _find(self) -> None:
        self._when_idle(self.find_asked.emit)

    def _recover(self) -> None:
        self._when_idle(self.recovery_asked.emit)

    def _show_folder(self) -> None:
        folder = self.context.services.folder
        if not folder.is_dir():
            self.context.say(_("{folder} is made with the first test.").format(folder=folder))
        elif not self.context.services.show_file(folder):
            self.context.say(_("Sessions are kept in {folder}.").format(folder=folder))

    def _enable_choices(self) -> None:
        self.open.setEnabled(self.recent.isEnabled() and self.recent.chosen >= 0)
        self.use.setEnabled(self.instruments.chosen >= 0)

    # -- building ---------------------------------------------------------------------------------------------

    def _connect(self) -> None:
        for role, card in self.cards.items():
            card.clicked.connect(functools.partial(self._choose_role, role))
        self.search.textChanged.connect(self._typed.start)
        self.recent.taken.connect(self._open_row)
        self.recent.itemSelectionChanged.connect(self._enable_choices)
        self.instruments.taken.connect(self._use_row)
        self.instruments.itemSelectionChanged.connect(self._enable_choices)

    def _arrange(self) -> None:
        page = QWidget()
        beside = self.search, self.stop_reading, self.open
        sessions = under_heading(_("Recent sessions"), self.about_recent, self.recent, *beside)
        instruments = self.about_instruments, self.instruments, self.use, self.seek
        columns = fill(
            FoldingBox(_TWO_COLUMNS), (sessions, 1), (under_heading(_("Instruments"), *instruments), 1), spacing=16
        )
        cards = row(*((card, 1) for card in self.cards.values()), spacing=10)
        parts = (
            styled(QLabel(_("Who is working?")), role="heading"),
            cards,
            self._make_strip(),
            (columns, 1),
            self._make_foot(),
        )
        fill(QVBoxLayout(page), *parts, spacing=8, margins=(16, 10, 16, 10))
        scroll = QScrollArea()
        scroll.setWidget(page)
        styled(
            scroll,
            widget_resizable=True,
            frame_shape=QFrame.Shape.NoFrame,
            horizontal_scroll_bar_policy=Qt.ScrollBarPolicy.ScrollBarAlwaysOff,
            focus_policy=Qt.FocusPolicy.NoFocus,
        )
        fill(QVBoxLayout(self), scroll)
        order = [*self.cards.values(), self.recover, self.search, self.stop_reading, self.open, self.recent]
        order += [self.seek, self.instruments, self.use, self.folder]
        order += [chooser.choice for chooser in self.choosers]
        for before, after in pairwise(order):
            QWidget.setTabOrder(before, after)

    def _make_strip(self) -> QWidget:
        self._strip = styled(QFrame(), role="notice")
        fill(QHBoxLayout(self._strip), (self.unfinished, 1), self.recover, margins=(12, 6, 8, 6))
        self._strip.hide()
        return self._strip

    def _make_foot(self) -> QWidget:
        foot = styled(QFrame(), role="card")
        grid = build.grid(foot, stretched=(1, 3), margins=(14, 8, 10, 8), horizontal_spacing=14, vertical_spacing=2)
        said = label(text=f"{_(RESEARCH_USE)} {_('Nothing leaves this computer.')} {_(HINT)}")
        grid.addWidget(said, 0, 0, 1, 4)
        grid.addWidget(self.folder, 0, 4)
        for index, (what, where) in enumerate(storage_locations(self.context.services, self.context.settings)):
            named, path = styled(QLabel(what), role="field"), label("readout", clean(where), tip=clean(where))
            grid.addWidget(named, 1 + index // 2, 2 * (index % 2), Qt.AlignmentFlag.AlignTop)
            grid.addWidget(path, 1 + index // 2, 2 * (index % 2) + 1, 1, 1 + index % 2)
        pairs = [row(*pair, None, spacing=24, margins=(0, 0, 16, 0)) for pair in (self.choosers[:2], self.choosers[2:])]
        grid.addLayout(fill(FoldingBox(_ONE_ROW), pairs[0], (pairs[1], 1), spacing=8), 4, 0, 1, 5)
        return foot


def _calibration(state: CalibrationState) -> str:
    """Return the state without the word of the column header."""
    said = _(state.summary)
    for word in ("Calibration", _("Calibration")):
        said = said.removeprefix(f"{word}: ")
    said = said[:1].upper() + said[1:]
    return _("{calibration}; next by {date}").format(calibration=said, date=state.until) if state.until else said
