"""The fourth tab: the audit log as a table, its verification, and its export as CSV."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QComboBox, QFileDialog, QFrame, QLineEdit, QWidget

from tissueid.app import build
from tissueid.app.build import button, label, row, styled
from tissueid.app.context import AppContext
from tissueid.app.jobs import PageJob
from tissueid.app.views.technician.events import moment
from tissueid.app.views.technician.log_reading import (
    LogPage,
    about,
    haystack,
    people_and_sites,
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
_ROLE, _SEARCH = "instrument/audit/role", "instrument/audit/search"
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


class AuditTab(Tab):
    """Newest first. The rows are filtered in memory and handed to the view in pieces."""

    def __init__(self, context: AppContext, page_job: PageJob, parent: QWidget | None = None) -> None:
        super().__init__(context, page_job, parent)
        self._read = Read(LogPage(), (), ())
        self._csv: Path | None = None
        self.role = styled(QComboBox(), name=_("Role whose lines are shown"))
        self.role.addItem(_(_ALL_ROLES), "")
        for role in ROLES:
            self.role.addItem(role, role)
        self.role.setCurrentIndex(max(0, self.role.findData(str(context.settings.value(_ROLE, "")))))
        self.act = styled(QComboBox(), name=_("Which acts are shown"))
        self.act.addItem(_(_ALL_ACTS))
        self.act.setMinimumContentsLength(20)
        self.search = styled(
            QLineEdit(str(context.settings.value(_SEARCH, ""))[:200]),
            placeholder_text=_("Search"),
            tip=_("Search (Ctrl+F)"),
            name=_("Search the audit log"),
            clear_button_enabled=True,
            max_length=200,
        )
        self.again = button(_("Read again"), self.load, name=_("Read the audit log again"))
        self.verify = button(
            _("Verify"),
            self.begin_verifying,
            tip=_("Checks every line of the log for changes, from the first to the last"),
        )
        self.export = button(
            _("Export CSV…"), self._choose_csv, tip=_("Writes the lines that are shown, for a spreadsheet")
        )
        self.verdict = styled(QFrame(), role="verdict")
        self.words = build.label(
            text=_("Not verified yet: press Verify to see whether every line is as it was written.")
        )
        row(self.words, margins=(12, 6, 10, 6), parent=self.verdict)
        self.count = build.label("muted")
        self.model = PiecesModel(
            (_("Line"), _("Time (UTC)"), _("Role"), _("Who"), _("What"), _("About"), _("Old"), _("New")),
            lambda line, column: _cell(line, column, self._read.names),
            right=(0,),
        )
        self.list = table_of(self.model, _("Audit log"), (60, 138, 82, 80, 150, 190, 100))
        self.full = label(text_interaction_flags=Qt.TextInteractionFlag.TextSelectableByMouse)
        self.list.selectionModel().selectionChanged.connect(self._show_full)
        self.role.currentIndexChanged.connect(self._show)
        self.act.currentIndexChanged.connect(self._show)
        self.search.textChanged.connect(self._show)
        build.column(
            row(
                *[
                    (widget, 1 if widget is self.search else 0)
                    for widget in (self.role, self.act, self.search, self.again, self.verify, self.export)
                ],
                spacing=8,
            ),
            self.verdict,
            (self.list, 1),
            self.full,
            self.count,
            margins=(0, 8, 0, 0),
            parent=self,
        )
        self._show()

    # -- work ---------------------------------------------------------------------------------------------

    def load(self) -> None:
        """Read the log."""
        work = functools.partial(read, self.context.services.audit.path)
        if self.page_job.start(_("Reading the audit log…"), work, self._loaded, self.complain):
            self.stale = False

    def _loaded(self, found: Read) -> None:
        self._read, self.read = found, True
        kept = self.act.currentText()
        self.act.blockSignals(True)
        self.act.clear()
        self.act.addItem(_(_ALL_ACTS))
        self.act.addItems([clean(act)[:60] for act in found.acts])
        self.act.setCurrentIndex(max(0, self.act.findText(kept)))
        self.act.blockSignals(False)
        self._show()

    def begin_verifying(self) -> None:
        """Verify the log, in a job."""
        work = functools.partial(check, self.context.services.audit.path)
        if self.page_job.start(_("Verifying the audit log…"), work, self._verified, self.complain):
            self._tell("", _("Verifying…"))

    def complain(self, words: str) -> None:
        """Show the error and empty the table."""
        if self.words.text() == _("Verifying…"):
            self._tell("", _("Not verified."))
        super().complain(words)

    def _verified(self, found: Verification) -> None:
        remarks = " ".join(sentence(translated(line)) for line in found.remarks[:3])
        if found.broken is not None:
            broken = Message(
                "audit.table.broken",
                "The log is not as it was written. Line {place} of the file: {words} ({damage}).",
                place=grouped(found.broken.place),
                words=found.broken.words,
                damage=found.broken.damage.value,
            )
            self._tell("poor", f"{translated(broken)} {remarks}".strip())
        elif not found.lines:
            self._tell(
                "check", f"{_('The log contains no complete line: nothing has been logged yet.')} {remarks}".strip()
            )
        else:
            words = _("Intact: {lines} lines, all unchanged. Head {head}…").format(
                lines=grouped(found.lines), head=found.head[:22]
            )
            self._tell("check" if found.remarks else "good", " ".join(filter(None, [words, remarks, _(_BLIND)])))

    def _tell(self, level: str, words: str) -> None:
        show_level(self.verdict, level)
        self.words.setText(clean(words))
        self.verdict.setAccessibleName(clean(words))

    def _choose_csv(self) -> None:
        if self.context.busy:
            return
        dialog = styled(
            QFileDialog(self, _("Export the audit log"), str(Path.home() / "audit.csv"), _("Spreadsheets (*.csv)")),
            accept_mode=QFileDialog.AcceptMode.AcceptSave,
            default_suffix="csv",
            attribute=Qt.WidgetAttribute.WA_DeleteOnClose,
        )
        dialog.fileSelected.connect(self.export_to)
        dialog.open()

    def export_to(self, path: str) -> None:
        """Write the lines that are shown to a file, in a job."""
        self._csv = Path(path)
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
        """All of it is slow."""
        self.again.setEnabled(not busy)
        self.verify.setEnabled(not busy)
        self.export.setEnabled(not busy and bool(self.model.rows))
        if not self.read:
            self._show()

    def _show(self) -> None:
        role = self.role.currentData()
        act = "" if self.act.currentIndex() <= 0 else self._read.acts[self.act.currentIndex() - 1]
        words = self.search.text().casefold().split()
        lines, texts = self._read.page.lines, self._read.texts
        if role or act or words:
            found = [
                line
                for line, text in zip(lines, texts, strict=True)
                if (not role or line.role == role)
                and (not act or line.what == act)
                and all(word in text for word in words)
            ]
        else:
            found = list(lines)
        self.model.show_rows(found)
        said = _("{shown} of {count} lines, newest first, in {path}.").format(
            shown=grouped(len(found)), count=grouped(len(lines)), path=self.context.services.audit.path
        )
        remarks = (clean(line) for line in self._read.page.remarks)
        self.count.setText(" ".join([clean(said), *remarks]) if self.read else self.context.unread)
        self.export.setEnabled(bool(found) and not self.context.busy)
        self._show_full()

    def _show_full(self) -> None:
        """Show the complete selected line, which the columns elide."""
        rows = [index.row() for index in self.list.selectionModel().selectedRows()]
        if not rows or rows[-1] >= len(self.model.rows):
            self.full.hide()
            return
        line = self.model.rows[rows[-1]]
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
        self.full.show()

    def save_state(self) -> None:
        """Filter and search."""
        self.context.settings.setValue(_ROLE, self.role.currentData())
        self.context.settings.setValue(_SEARCH, self.search.text())
