"""The third tab: faults and ends of tests, newest first, with what to do about each."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path

from PySide6.QtWidgets import QComboBox, QFrame, QLineEdit, QWidget

from tissueid.app import build
from tissueid.app.build import button, styled
from tissueid.app.context import AppContext
from tissueid.app.jobs import PageJob
from tissueid.app.views.technician.checkup import newest_first
from tissueid.app.views.technician.events import COMPLETED, KINDS, LEVELS, Event, Events, read_events
from tissueid.app.views.technician.log_reading import read_log
from tissueid.app.views.technician.tab import PiecesModel, Tab, table_of
from tissueid.app.widgets import show_level
from tissueid.formatting import clean, grouped
from tissueid.language import _, marked

_CONCERNS, _ALL = marked("Problems only"), marked("All ends of tests")
_FILTER, _SEARCH = "instrument/faults/filter", "instrument/faults/search"


def gather(folder: Path, log: Path, cancelled: Callable[[], object]) -> Events:
    """The events of a folder of sessions and of an audit log.

    Raises:
        UnusableInputError, OSError: the log cannot be read.
    """
    return read_events(newest_first(folder, ".h5"), read_log(log, cancelled), cancelled)


def _cell(event: Event, column: int) -> str:
    return (event.time, _(event.kind), event.subject, event.reason)[column]


class FaultsTab(Tab):
    """A list with a filter and a search; below it what the selected one says, and what to do."""

    def __init__(self, context: AppContext, page_job: PageJob, parent: QWidget | None = None) -> None:
        super().__init__(context, page_job, parent)
        self.events = Events(())
        self.kind = styled(QComboBox(), name=_("Which events are shown"))
        for name in (_CONCERNS, _ALL, *KINDS):
            self.kind.addItem(_(name), name)
        self.kind.setCurrentIndex(max(0, self.kind.findData(str(context.settings.value(_FILTER, _CONCERNS)))))
        self.search = styled(
            QLineEdit(str(context.settings.value(_SEARCH, ""))[:200]),
            placeholder_text=_("Search"),
            tip=_("Search (Ctrl+F)"),
            name=_("Search the events"),
            clear_button_enabled=True,
            max_length=200,
        )
        self.again = button(_("Read again"), self.load, name=_("Read the events again"))
        self.count = build.label("muted")
        self.model = PiecesModel(
            (_("Time (UTC)"), _("Kind"), _("About"), _("Why")), _cell, level=lambda event: event.level, marked=1
        )
        self.list = table_of(self.model, _("Faults and events"), (140, 120, 260))
        self.list.selectionModel().selectionChanged.connect(self._show_selected)
        self.open = button(
            _("Open session"), self._open, tip=_("Analyses the session of the selected event on the page Measure")
        )
        self.title = build.label("headline")
        self.reason = build.label()
        self.advice = build.label()
        self.where = build.label("muted")
        self.kind.currentIndexChanged.connect(self._show)
        self.search.textChanged.connect(self._show)
        build.column(
            build.row(
                *[(widget, 1 if widget is self.search else 0) for widget in (self.kind, self.search, self.again)],
                spacing=8,
            ),
            self.count,
            (self.list, 1),
            self._make_detail(),
            margins=(0, 8, 0, 0),
            parent=self,
        )
        self._busy = False
        self._show()

    def _make_detail(self) -> QFrame:
        self.detail = styled(QFrame(), role="verdict")
        build.row(
            (build.column(self.title, self.reason, self.advice, self.where, spacing=3), 1),
            self.open,
            margins=(12, 6, 10, 8),
            parent=self.detail,
        )
        self.detail.hide()
        return self.detail

    def load(self) -> None:
        """Read the log and the sessions."""
        services = self.context.services
        work = functools.partial(gather, services.folder, services.audit.path)
        if self.page_job.start(_("Reading faults and events…"), work, self._loaded, self.complain):
            self.stale = False

    def _loaded(self, events: Events) -> None:
        self.events, self.read = events, True
        self._show()

    def update_enabled(self, *, busy: bool) -> None:
        """Disable reading again and opening while a job is running, because both are slow."""
        self._busy = busy
        self.again.setEnabled(not busy)
        self._settle_open()
        if not self.read:
            self._show()

    def _settle_open(self) -> None:
        event = self.selected
        self.open.setEnabled(not self._busy and event is not None and event.path is not None)

    @property
    def selected(self) -> Event | None:
        """The event that is selected."""
        rows = [index.row() for index in self.list.selectionModel().selectedRows()]
        return self.model.rows[rows[0]] if rows and rows[0] < len(self.model.rows) else None

    def _show(self) -> None:
        wanted = str(self.kind.currentData())
        words = self.search.text().casefold().split()
        chosen = {_CONCERNS: tuple(LEVELS), _ALL: KINDS}.get(wanted, (wanted,))
        found = [
            event for event in self.events.found if event.kind in chosen and all(word in event.text for word in words)
        ]
        self.model.show_rows(found)
        total = sum(event.kind != COMPLETED for event in self.events.found)
        said = _("{shown} shown; {concerns} of {count} events are something other than a completed test.").format(
            shown=grouped(len(found)), concerns=grouped(total), count=grouped(len(self.events.found))
        )
        lines = [said, *(clean(line) for line in self.events.remarks)] if self.read else [self.context.unread]
        self.count.setText(" ".join(lines))
        self._show_selected()

    def _show_selected(self) -> None:
        event = self.selected
        self.detail.setVisible(event is not None)
        self._settle_open()
        if event is None:
            return
        show_level(self.detail, event.level)
        self.title.setText(f"{_(event.kind)}, {event.time} UTC")
        self.reason.setText(event.reason or _("No reason was recorded."))
        self.advice.setText(_("What to do: {advice}").format(advice=event.advice) if event.advice else "")
        self.advice.setVisible(bool(event.advice))
        self.where.setText(clean(str(event.path)) if event.path else event.subject)
        self.detail.setAccessibleName(" ".join([self.title.text(), event.reason, event.advice]))

    def _open(self) -> None:
        event = self.selected
        if event is not None and event.path is not None and not self.context.busy:
            self.context.open_session(event.path)

    def save_state(self) -> None:
        """Filter and search."""
        self.context.settings.setValue(_FILTER, self.kind.currentData())
        self.context.settings.setValue(_SEARCH, self.search.text())
