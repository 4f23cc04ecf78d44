"""The tabs of faults and events, and of the audit log with its verification and its export as CSV."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QComboBox, QFrame, QLineEdit

from tissueid.app import build
from tissueid.app.build import button, label, row, styled
from tissueid.app.context import AppContext
from tissueid.app.jobs import PageJob
from tissueid.app.views.technician.checkup import newest_first
from tissueid.app.views.technician.events import (
    COMPLETED,
    KINDS,
    LEVELS,
    Event,
    Events,
    LogPage,
    about,
    haystack,
    moment,
    people_and_sites,
    read_events,
    read_log,
    shown,
    write_csv,
)
from tissueid.app.views.technician.tab import PiecesModel, Tab, table_of
from tissueid.app.widgets import show_level
from tissueid.app.words import sentence
from tissueid.audit import ROLES, LogLine, Verification, verify
from tissueid.errors import UnusableInputError
from tissueid.formatting import clean, grouped
from tissueid.language import _, marked
from tissueid.messages import Message, translated

_ALL_ROLES, _ALL_ACTS = marked("All roles"), marked("All acts")
_MOST_ACTS = 60
_BLIND = marked(
    "A log that was cut at its end, together with the note next to it, can be recognised only by comparing it with a "
    "session or a calibration that was made later."
)


@dataclass(frozen=True)
class Read:
    """The log, with what of each line is searched, the acts that occur, and the names of sessions and tests."""

    page: LogPage
    texts: tuple[str, ...]
    acts: tuple[str, ...]
    names: dict[str, str] = field(default_factory=dict)


def read(path: Path, cancelled: Callable[[], object]) -> Read:
    """Read the log for the table.

    Raises:
        UnusableInputError, OSError: it cannot be read.
    """
    page = read_log(path, cancelled)
    names = people_and_sites(page.lines)
    texts = tuple(f"{haystack(line)} {about(line, names).casefold()}" for line in page.lines)
    acts = sorted({line.what for line in page.lines if isinstance(line.what, str)})
    return Read(page, texts, tuple(acts[:_MOST_ACTS]), names)


def check(path: Path, cancelled: Callable[[], object]) -> Verification:
    """Verify the log.

    Raises:
        UnusableInputError: there is none.
        OSError: it cannot be read.
    """
    if not path.is_file():
        raise UnusableInputError(
            "audit.missing",
            "there is no audit log {path}: nothing has been logged yet, or it was moved",
            path=str(path),
        )
    return verify(path, cancelled=cancelled)


def _cell(line: LogLine, column: int, names: Mapping[str, str]) -> str:
    if column == 1:
        return moment(line.time)
    if column == 5:
        return about(line, names)
    return shown((line.number, line.time, line.role, line.who, line.what, line.subject, line.old, line.new)[column])


class SearchedTab(Tab):
    """A table whose rows a choice and a search select; both are kept in the settings below ``key``."""

    key = ""

    def __init__(
        self, context: AppContext, page_job: PageJob, chosen: QComboBox, model: PiecesModel, widths: Sequence[int]
    ) -> None:
        super().__init__(context, page_job)
        kept = context.settings
        self.chosen, self.model = chosen, model
        chosen.setCurrentIndex(max(0, chosen.findData(str(kept.value(self._chosen_key, chosen.itemData(0))))))
        chosen.currentIndexChanged.connect(self._show)
        self.search = styled(
            QLineEdit(str(kept.value(f"{self.key}/search", ""))[:200]),
            placeholder_text=_("Search"),
            tip=_("Search (Ctrl+F)"),
            clear_button_enabled=True,
            max_length=200,
        )
        self.search.textChanged.connect(self._show)
        self.again = button(_("Read again"), self.load)
        self.count = build.label("muted")
        self.list = table_of(model, "", widths)
        self.list.selectionModel().selectionChanged.connect(self._show_selected)

    @property
    def _chosen_key(self) -> str:
        return f"{self.key}/filter"

    @property
    def selected(self) -> Any:
        """The row that is selected; None without one."""
        rows = [index.row() for index in self.list.selectionModel().selectedRows()]
        return self.model.rows[rows[-1]] if rows and rows[-1] < len(self.model.rows) else None

    def update_enabled(self, *, busy: bool) -> None:
        """Disable reading again while a job runs."""
        self.again.setEnabled(not busy)
        if not self.read:
            self._show()

    def save_state(self) -> None:
        """Save filter and search."""
        self.context.settings.setValue(self._chosen_key, self.chosen.currentData())
        self.context.settings.setValue(f"{self.key}/search", self.search.text())

    def _show(self) -> None:
        """Show the rows that were read, as far as they are chosen."""

    def _show_selected(self) -> None:
        """Show all of the selected row."""


class AuditTab(SearchedTab):
    """The audit log, newest first. The rows are filtered in memory and handed to the view in pieces."""

    key = "instrument/audit"

    def __init__(self, context: AppContext, page_job: PageJob) -> None:
        self._read = Read(LogPage(), (), ())
        self._csv: Path | None = None
        roles = {"": _(_ALL_ROLES)} | {role: role for role in ROLES}
        self.role = build.choice(roles, name=_("Role whose lines are shown"))
        model = PiecesModel(
            (_("Line"), _("Time (UTC)"), _("Role"), _("Who"), _("What"), _("About"), _("Old"), _("New")),
            lambda line, column: _cell(line, column, self._read.names),
            right=(0,),
        )
        super().__init__(context, page_job, self.role, model, (60, 138, 82, 80, 150, 190, 100))
        self.search.setAccessibleName(_("Search the audit log"))
        self.again.setAccessibleName(_("Read the audit log again"))
        self.list.setAccessibleName(_("Audit log"))
        self.act = build.choice(
            {"": _(_ALL_ACTS)}, self._show, name=_("Which acts are shown"), minimum_contents_length=20
        )
        verifying = _("Checks every line of the log for changes, from the first to the last")
        self.verify = button(_("Verify"), self.begin_verifying, tip=verifying)
        exporting = _("Writes the lines that are shown, for a spreadsheet")
        self.export = button(_("Export CSV…"), self._choose_csv, tip=exporting)
        self.verdict = styled(QFrame(), role="verdict")
        self.verdict_text = build.label(
            text=_("Not verified yet: press Verify to see whether every line is as it was written.")
        )
        row(self.verdict_text, margins=(12, 6, 10, 6), parent=self.verdict)
        self.full = label(text_interaction_flags=Qt.TextInteractionFlag.TextSelectableByMouse)
        build.column(
            row(self.role, self.act, (self.search, 1), self.again, self.verify, self.export, spacing=8),
            self.verdict,
            (self.list, 1),
            self.full,
            self.count,
            margins=(0, 8, 0, 0),
            parent=self,
        )
        self._show()

    @property
    def _chosen_key(self) -> str:
        return f"{self.key}/role"

    # -- work ---------------------------------------------------------------------------------------------

    def load(self) -> None:
        """Read the log."""
        self.read_files(_("Reading the audit log…"), functools.partial(read, self.context.services.audit.path))

    def _loaded(self, content: Read) -> None:
        self._read, self.read = content, True
        build.offer(self.act, {"": _(_ALL_ACTS)} | {act: clean(act)[:60] for act in content.acts})
        self._show()

    def begin_verifying(self) -> None:
        """Verify the log, in a job."""
        work = functools.partial(check, self.context.services.audit.path)
        if self.page_job.start(_("Verifying the audit log…"), work, self._verified, self.complain):
            self._tell("", _("Verifying…"))

    def complain(self, message: str) -> None:
        """Show the error and empty the table."""
        if self.verdict_text.text() == _("Verifying…"):
            self._tell("", _("Not verified."))
        super().complain(message)

    def _verified(self, verification: Verification) -> None:
        remarks = " ".join(sentence(translated(line)) for line in verification.remarks[:3])
        if verification.broken is not None:
            broken = Message(
                "audit.table.broken",
                "The log is not as it was written. Line {place} of the file: {words} ({damage}).",
                place=grouped(verification.broken.line),
                words=verification.broken.message,
                damage=verification.broken.damage.value,
            )
            self._tell("poor", f"{translated(broken)} {remarks}".strip())
        elif not verification.lines:
            self._tell(
                "check", f"{_('The log contains no complete line: nothing has been logged yet.')} {remarks}".strip()
            )
        else:
            summary = _("Intact: {lines} lines, all unchanged. Head {head}…").format(
                lines=grouped(verification.lines), head=verification.head[:22]
            )
            self._tell(
                "check" if verification.remarks else "good", " ".join(filter(None, [summary, remarks, _(_BLIND)]))
            )

    def _tell(self, level: str, text: str) -> None:
        show_level(self.verdict, level)
        self.verdict_text.setText(clean(text))
        self.verdict.setAccessibleName(clean(text))

    def _choose_csv(self) -> None:
        if self.context.busy:
            return
        title, kinds = _("Export the audit log"), _("Spreadsheets (*.csv)")
        build.ask_path(self, title, Path.home(), self.export_to, kinds, save="audit.csv", default_suffix="csv")

    def export_to(self, path: Path) -> None:
        """Write the lines that are shown to a file, in a job."""
        self._csv = path
        work = functools.partial(write_csv, self._csv, self.context.services.audit.path, tuple(self.model.rows))
        self.page_job.start(_("Writing the audit log…"), work, self._exported, self.complain)

    def _exported(self, lines: int) -> None:
        self.context.say(
            _("{lines} lines of the audit log are saved in {path}.").format(
                lines=grouped(lines), path=clean(str(self._csv))
            )
        )

    # -- showing ------------------------------------------------------------------------------------------

    def update_enabled(self, *, busy: bool) -> None:
        """Disable all of it while a job runs, because it is slow."""
        super().update_enabled(busy=busy)
        self.verify.setEnabled(not busy)
        self.export.setEnabled(not busy and bool(self.model.rows))

    def _show(self) -> None:
        role, act = self.role.currentData(), self.act.currentData()
        terms = self.search.text().casefold().split()
        lines = self._read.page.lines
        matches = [
            line
            for line, text in zip(lines, self._read.texts, strict=True)
            if role in ("", line.role) and act in ("", line.what) and all(word in text for word in terms)
        ]
        self.model.show_rows(matches)
        said = _("{shown} of {count} lines, newest first, in {path}.").format(
            shown=grouped(len(matches)), count=grouped(len(lines)), path=self.context.services.audit.path
        )
        remarks = (clean(line) for line in self._read.page.remarks)
        self.count.setText(" ".join([clean(said), *remarks]) if self.read else self.context.unread)
        self.export.setEnabled(bool(matches) and not self.context.busy)
        self._show_selected()

    def _show_selected(self) -> None:
        """Show the complete selected line, which the columns elide."""
        line = self.selected
        self.full.setVisible(line is not None)
        if line is None:
            return
        parts = [
            _("Line {number}, {time} UTC, {role} {who}").format(
                number=shown(line.number), time=moment(line.time), role=shown(line.role), who=shown(line.who)
            )
        ]
        parts += [f"{shown(line.what)} {shown(line.subject)}".strip()]
        parts += [
            f"{name}: {shown(value)}"
            for name, value in ((_("old"), line.old), (_("new"), line.new))
            if value is not None
        ]
        self.full.setText(" · ".join(parts))


_CONCERNS, _ALL = marked("Problems only"), marked("All ends of tests")


def gather(folder: Path, log: Path, cancelled: Callable[[], object]) -> Events:
    """The events of a folder of sessions and of an audit log.

    Raises:
        UnusableInputError, OSError: the log cannot be read.
    """
    return read_events(newest_first(folder, ".h5"), read_log(log, cancelled), cancelled)


def _event_cell(event: Event, column: int) -> str:
    return (event.time, _(event.kind), event.subject, event.reason)[column]


class FaultsTab(SearchedTab):
    """Faults and events; below the list what the selected one says, and what to do."""

    key = "instrument/faults"

    def __init__(self, context: AppContext, page_job: PageJob) -> None:
        self.events = Events(())
        kinds = {name: _(name) for name in (_CONCERNS, _ALL, *KINDS)}
        self.kind = build.choice(kinds, name=_("Which events are shown"))
        heads = _("Time (UTC)"), _("Kind"), _("About"), _("Why")
        model = PiecesModel(heads, _event_cell, level=lambda event: event.level, marked=1)
        super().__init__(context, page_job, self.kind, model, (140, 120, 260))
        self.search.setAccessibleName(_("Search the events"))
        self.again.setAccessibleName(_("Read the events again"))
        self.list.setAccessibleName(_("Faults and events"))
        opening = _("Analyses the session of the selected event on the page Measure")
        self.open = button(_("Open session"), self._open, tip=opening)
        self.title = build.label("headline")
        self.reason, self.advice = build.label(), build.label()
        self.where = build.label("muted")
        self.detail = styled(QFrame(), role="verdict", hidden=True)
        said = build.column(self.title, self.reason, self.advice, self.where, spacing=3)
        row((said, 1), self.open, margins=(12, 6, 10, 8), parent=self.detail)
        build.column(
            row(self.kind, (self.search, 1), self.again, spacing=8),
            self.count,
            (self.list, 1),
            self.detail,
            margins=(0, 8, 0, 0),
            parent=self,
        )
        self._busy = False
        self._show()

    def load(self) -> None:
        """Read the log and the sessions."""
        services = self.context.services
        work = functools.partial(gather, services.folder, services.audit.path)
        self.read_files(_("Reading faults and events…"), work)

    def _loaded(self, events: Events) -> None:
        self.events, self.read = events, True
        self._show()

    def update_enabled(self, *, busy: bool) -> None:
        """Disable reading again and opening while a job is running, because both are slow."""
        self._busy = busy
        super().update_enabled(busy=busy)
        self._show_selected()

    def _show(self) -> None:
        wanted = str(self.kind.currentData())
        terms = self.search.text().casefold().split()
        chosen = {_CONCERNS: tuple(LEVELS), _ALL: KINDS}.get(wanted, (wanted,))
        matches = [
            event for event in self.events.entries if event.kind in chosen and all(word in event.text for word in terms)
        ]
        self.model.show_rows(matches)
        total = sum(event.kind != COMPLETED for event in self.events.entries)
        said = _("{shown} shown; {concerns} of {count} events are something other than a completed test.").format(
            shown=grouped(len(matches)), concerns=grouped(total), count=grouped(len(self.events.entries))
        )
        lines = [said, *(clean(line) for line in self.events.remarks)] if self.read else [self.context.unread]
        self.count.setText(" ".join(lines))
        self._show_selected()

    def _show_selected(self) -> None:
        event = self.selected
        self.detail.setVisible(event is not None)
        self.open.setEnabled(not self._busy and event is not None and event.path is not None)
        if event is None:
            return
        show_level(self.detail, event.level)
        self.title.setText(f"{_(event.kind)}, {event.time} UTC")
        self.reason.setText(event.reason or _("No reason was recorded."))
        advised = _("What to do: {advice}").format(advice=event.advice)
        build.show_text(self.advice, advised if event.advice else "")
        self.where.setText(clean(str(event.path)) if event.path else event.subject)
        self.detail.setAccessibleName(" ".join([self.title.text(), event.reason, event.advice]))

    def _open(self) -> None:
        event = self.selected
        if event is not None and event.path is not None and not self.context.busy:
            self.context.open_session(event.path)
