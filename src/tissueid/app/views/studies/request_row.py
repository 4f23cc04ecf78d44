"""Choices of the page, with the dialogs of the protocol and of the options of an engine."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, get_args

from PySide6.QtCore import QSettings, Qt, Signal
from PySide6.QtWidgets import (
    QBoxLayout,
    QCheckBox,
    QDialog,
    QDialogButtonBox,
    QFileDialog,
    QFormLayout,
    QFrame,
    QLineEdit,
    QMenu,
    QPushButton,
    QSizePolicy,
    QTableWidget,
    QVBoxLayout,
    QWidget,
)

from tissueid.app.build import (
    ProgressRow,
    ask_path,
    button,
    choice,
    column,
    fill,
    holder,
    label,
    row,
    styled,
    table,
)
from tissueid.app.number_field import WholeNumberField
from tissueid.app.option_field import OptionField
from tissueid.app.small_window import FoldingBox, PageScroll
from tissueid.app.views.studies.study_data import StudyData
from tissueid.app.widgets import ElidedLabel, fill_table, plain_tip, show_level
from tissueid.app.window_state import load_texts, save_texts
from tissueid.app.words import in_words
from tissueid.errors import UnusableInputError
from tissueid.formatting import clean
from tissueid.identification import engine_label, engine_names, get_engine
from tissueid.language import _
from tissueid.messages import Message, Verbatim, translated
from tissueid.plan_options import parse_options
from tissueid.procedures.study_plans import StudyPlan
from tissueid.procedures.study_protocol import (
    PROTOCOL_FILE,
    Demographic,
    Protocol,
    check_tests,
    parse_protocol,
    sitting_steps,
)
from tissueid.procedures.study_subjects import DEMOGRAPHIC_FIELDS
from tissueid.procedures.test_plan import PRESETS
from tissueid.test_settings import Circumstances

_ONE_ROW = 620
_FOLDER, _ENGINE, _OPTIONS, _HELD_OUT = "study/folder", "study/engine", "study/options", "study/held-out"
_RECENT = "study/recent"
_MOST_RECENT = 10


class RequestRow(QFrame):
    """Signals: ``chosen`` and ``made`` carry a folder; the others are sent by the buttons."""

    chosen = Signal(object)
    made = Signal(object)
    """The folder of a new study, which is to be made."""
    wanted = Signal()
    report_wanted = Signal()
    protocol_wanted = Signal()
    sitting_wanted = Signal(str)
    unwanted = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        styled(self, role="card")
        self.path: Path | None = None
        opening = _("A folder of sessions, with a protocol.json if sittings follow a protocol")
        self.open = button(_("Open study…"), self._choose, tip=opening)
        self.new = button(_("New study…"), self._name_new, tip=_("Name a folder for a new study; it is made"))
        self.folder = ElidedLabel()
        engines = {name: engine_label(name) for name in engine_names()}
        self.engine = choice(engines, characters=12, name=_("Engine of the study"))
        self.recent = button(_("Recent"), name=_("Recent studies"), menu=QMenu(self))
        self.options = button("", self._edit_options, name=_("Options of the engine"))
        self._options: tuple[str, ...] = ()
        self._studies: list[str] = []
        held_out = _("Fit three quarters of each test and score the rest; otherwise fit whole tests")
        self.held_out = styled(QCheckBox(_("Score on held-out data")), tip=held_out)
        analysing = _("Sessions that are new or changed; after a cancellation it continues")
        self.analyse = button(_("Analyse"), self.wanted, tip=analysing)
        reporting = _("Analyse what has changed, compute all statistics, and open the page")
        self.report = button(_("Write report"), self.report_wanted, tip=reporting)
        self.protocol = label("muted")
        self.template = button(
            "", self.protocol_wanted, tip=_("Sites, repeats, conditions, and what a subject is asked for")
        )
        pseudonym = _("Pseudonym of the subject, never a name")
        self.subject = styled(QLineEdit(), name=pseudonym, tip=pseudonym, placeholder_text=_("Subject, such as P-001"))
        leading = _("Lead through the sitting of this subject on the page Measure; nothing starts yet")
        self.measure = button(_("Measure subject"), self._ask_sitting, tip=leading)
        names = _("Progress of the study"), _("Cancel the work on the study")
        self.progress = ProgressRow(ElidedLabel(), *names, self.unwanted)
        self.doing, self.bar, self.stop = self.progress.parts
        self._of_analysis = self.engine, self.options, self.held_out, self.analyse, self.report
        self._of_visit = self.protocol, self.template, self.subject, self.measure
        self._arrange()
        self.subject.returnPressed.connect(self._ask_sitting)
        self.engine.currentIndexChanged.connect(lambda: self._take_options(()))
        self.engine.setCurrentIndex(self.engine.findData(StudyPlan.model_fields["engine"].default))
        self.show_study(None)

    @property
    def fields(self) -> list[QWidget]:
        """Widgets in tab order."""
        first = [self.open, self.new, self.recent, self.engine, self.options, self.held_out, self.analyse, self.report]
        return [*first, self.template, self.subject, self.measure, self.stop]

    @property
    def waiting(self) -> tuple[QPushButton, ...]:
        """The buttons that are disabled while other work runs."""
        return self.open, self.new, self.analyse, self.report, self.template, self.measure

    def plan(self, folder: Path, *, workers: int | None) -> StudyPlan:
        """Return the plan of an analysis.

        Raises:
            UnusableInputError: a value is not possible.
        """
        return StudyPlan(
            folder=folder,
            engine=str(self.engine.currentData()),
            options=self._options,
            held_out=self.held_out.isChecked(),
            workers=workers,
        )

    def show_study(self, data: StudyData | None) -> None:
        """Show the folder and the protocol of a study."""
        self.path = None if data is None else data.folder
        self.folder.setText(_("No study is open.") if data is None else clean(str(data.folder)))
        if data is not None:
            self._studies = list(dict.fromkeys([str(data.folder), *self._studies]))[:_MOST_RECENT]
        self._offer_recent()
        for part in (*self._of_analysis, *self._of_visit):
            part.setVisible(data is not None)
        if data is None:
            return
        show_level(self.protocol, "check" if data.protocol_problem else "")
        if data.protocol is not None:
            said = Message(
                "study.protocol",
                "Protocol: {name}, {count} tests for each subject",
                name=Verbatim(clean(data.protocol.name)),
                count=data.steps,
            )
            self.protocol.setText(translated(said))
        else:
            self.protocol.setText(
                translated(data.protocol_problem)
                or _("This study has no protocol: its tests can be analysed; a visit needs a protocol.")
            )
        self.template.setVisible(not data.protocol_problem)
        self.template.setText(_("New protocol…") if data.protocol is None else _("Edit protocol…"))
        for part in (self.subject, self.measure):
            part.setVisible(data.protocol is not None)

    def update_enabled(self, *, busy: bool, working: bool) -> None:
        """Enable what makes sense now; Cancel is always possible. ``working`` is whether other long work runs."""
        for part in (self.open, self.new):
            part.setEnabled(not busy and self.bar.isHidden())
        for part in (self.analyse, self.report, self.template):
            part.setEnabled(not working and self.path is not None)
        self.measure.setEnabled(not busy and self.path is not None)

    def save(self, settings: QSettings) -> None:
        """Save the choices."""
        settings.setValue(_FOLDER, "" if self.path is None else str(self.path))
        settings.setValue(_ENGINE, self.engine.currentData())
        save_texts(settings, _OPTIONS, self._options)
        save_texts(settings, _RECENT, self._studies)
        settings.setValue(_HELD_OUT, "yes" if self.held_out.isChecked() else "no")

    def restore(self, settings: QSettings) -> Path | None:
        """Restore the choices; return the folder of the last study, if it is still there."""
        index = self.engine.findData(str(settings.value(_ENGINE, "")))
        self.engine.setCurrentIndex(index if index >= 0 else self.engine.currentIndex())
        self._take_options(tuple(load_texts(settings, _OPTIONS)))
        self._studies = load_texts(settings, _RECENT)[:_MOST_RECENT]
        self._offer_recent()
        self.held_out.setChecked(str(settings.value(_HELD_OUT, "no")) == "yes")
        kept = str(settings.value(_FOLDER, ""))
        return Path(kept) if kept and Path(kept).is_dir() else None

    def _arrange(self) -> None:
        chosen, led = QWidget(), QWidget()
        fill(FoldingBox(_ONE_ROW, chosen), *self._of_analysis, spacing=8)
        fill(FoldingBox(_ONE_ROW, led), *self._of_visit, spacing=8)
        self.subject.setMaximumWidth(200)
        for part in (self.measure, self.template):
            part.setSizePolicy(QSizePolicy.Policy.Maximum, QSizePolicy.Policy.Fixed)
        fill(
            QVBoxLayout(self),
            row(self.open, self.new, self.recent, (self.folder, 1), spacing=8),
            chosen,
            led,
            row((self.doing, 2), (self.bar, 1), self.stop, spacing=8),
            margins=(12, 8, 12, 8),
        )

    def _take_options(self, options: tuple[str, ...]) -> None:
        """Take options, as NAME=VALUE, of the engine."""
        self._options = options
        changed = _("Options… ({count} changed)").format(count=len(options))
        self.options.setText(changed if options else _("Options…"))
        self.options.setToolTip(plain_tip("\n".join(options) or _("All options have their defaults")))

    def _edit_options(self) -> None:
        dialog = OptionsDialog(str(self.engine.currentData()), parse_options(self._options), self)
        dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        dialog.chosen.connect(self._take_options)
        dialog.open()

    def _offer_recent(self) -> None:
        menu = self.recent.menu()
        menu.clear()
        for folder in self._studies:
            menu.addAction(clean(folder).replace("&", "&&"), functools.partial(self.chosen.emit, Path(folder)))
        self.recent.setVisible(bool(self._studies))

    def _choose(self) -> None:
        ask_path(self.window(), _("Open a study"), self.path, self.chosen.emit)

    def _name_new(self) -> None:
        near = None if self.path is None else self.path.parent
        ask_path(
            self.window(),
            _("New study: name its folder"),
            near,
            self.made.emit,
            save="",
            option=QFileDialog.Option.DontConfirmOverwrite,  # a folder that is there is opened
            label_text=(QFileDialog.DialogLabel.Accept, _("Create")),
        )

    def _ask_sitting(self) -> None:
        if self.measure.isEnabled() and self.measure.isVisible():
            self.sitting_wanted.emit(self.subject.text())


class ProtocolDialog(QDialog):
    """Edits a protocol; ``saved`` carries the new one. What has no field here, such as the probe, stays as it is."""

    saved = Signal(object)

    def __init__(self, protocol: Protocol, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle(_("Protocol of the study"))
        self._before = protocol
        self.name = QLineEdit(protocol.name)
        self.sites = _Rows((_("Site"), _("Tests, if not as usual")), _("Sites"))
        self.sites.fill([(site.site, site.repeats) for site in protocol.sites])
        self.repeats, self.attempts = WholeNumberField(), WholeNumberField()
        attempting = _("After so many tests that are of no use, the visit goes on to the next test")
        styled(self.repeats, range=(1, 100), value=protocol.repeats)
        styled(self.attempts, range=(1, 20), value=protocol.attempts, tip=attempting)
        columns = _("Product"), *(_(info.title or name) for name, info in Circumstances.model_fields.items())
        self.conditions = _Rows(columns, _("Conditions"))
        self.conditions.setToolTip(_("One line for each; an empty product means none"))
        given = (
            (condition.product, *condition.model_dump(exclude={"product"}).values())
            for condition in protocol.conditions
        )
        self.conditions.fill(list(given))
        self.order = choice({"fixed": _("As listed"), "randomised": _("Shuffled for each subject")})
        self.order.setCurrentIndex(self.order.findData(protocol.order))
        self.stimulus = choice({preset.name: _(preset.title) for preset in PRESETS})
        self.stimulus.setCurrentIndex(self.stimulus.findData(protocol.stimulus))
        self.asked = {
            name: styled(QCheckBox(_(DEMOGRAPHIC_FIELDS[name].title)), checked=name in protocol.demographics)
            for name in get_args(Demographic)
        }
        self.photograph = styled(QCheckBox(_("Offer to add a photograph of each site")), checked=protocol.photograph)
        self.problem = label()
        self.buttons, self.save = _buttons(self, self._save)
        rows = {
            _("Name of the study"): self.name,
            _("Sites, in order"): self.sites,
            _("Tests at each site"): self.repeats,
            _("Conditions, in order"): self.conditions,
            _("Order of the sites"): self.order,
            _("Test"): self.stimulus,
            _("Attempts at each test"): self.attempts,
            _("Ask the subject for"): holder(_two_columns(tuple(self.asked.values()))),
            "": self.photograph,
        }
        _arrange_dialog(self, rows, 620, 640)
        for part in (self.name.textChanged, self.repeats.valueChanged, self.attempts.valueChanged, self.sites.changed):
            part.connect(self._judge)
        self.conditions.changed.connect(self._judge)
        self._judge()

    def protocol(self) -> Protocol:
        """Return the protocol as it is shown.

        Raises:
            UnusableInputError: a value is missing or not possible.
        """
        sites = [{"site": site, "repeats": _number(repeats)} for site, repeats in self.sites.rows if site or repeats]
        conditions = [
            {"product": product} | dict(zip(Circumstances.model_fields, map(_number, values), strict=True))
            for product, *values in self.conditions.rows
        ]
        values = self._before.model_dump(mode="json") | {
            "name": self.name.text(),
            "sites": sites,
            "repeats": self.repeats.value(),
            "conditions": conditions,
            "demographics": [name for name, box in self.asked.items() if box.isChecked()],
            "order": self.order.currentData(),
            "stimulus": self.stimulus.currentData(),
            "attempts": self.attempts.value(),
            "photograph": self.photograph.isChecked(),
        }
        protocol = parse_protocol(values, PROTOCOL_FILE)
        check_tests(protocol, PROTOCOL_FILE)
        return protocol

    def _judge(self) -> None:
        """Say how long a visit is, or what is wrong."""
        try:
            count = len(sitting_steps(self.protocol(), ""))
            said = translated(Message("study.visit", "{count} tests for each subject", count=count))
        except UnusableInputError as error:
            count, said = 0, in_words(error)
        self.problem.setText(said)
        show_level(self.problem, "" if count else "poor")
        self.save.setEnabled(bool(count))

    def _save(self) -> None:
        self._judge()
        if self.save.isEnabled():
            self.saved.emit(self.protocol())
            self.accept()


class OptionsDialog(QDialog):
    """Edits the options of an engine; ``chosen`` carries those that differ from the defaults, as NAME=VALUE."""

    chosen = Signal(tuple)

    def __init__(self, engine: str, given: dict[str, Any], parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle(_("Options: {engine}").format(engine=engine_label(engine)))
        kind = get_engine(engine)
        self._kind, self._defaults = kind, kind().options()
        self.fields = {name: OptionField(name, info) for name, info in kind.model_fields.items()}
        self._show(self._defaults | given)
        self.problem = label(level="poor")
        self.buttons, _save = _buttons(self, self._save)
        of_engine = _("All options of this engine as they are when nothing is chosen")
        defaults = button(_("&Defaults"), lambda: self._show(self._defaults), tip=of_engine)
        self.buttons.addButton(defaults, QDialogButtonBox.ButtonRole.ResetRole)
        _arrange_dialog(self, {field.label: field for field in self.fields.values()}, 420, 480)

    def _show(self, values: dict[str, Any]) -> None:
        for name, field in self.fields.items():
            field.set_value(values[name])

    def _save(self) -> None:
        try:
            values = self._kind.from_options({name: field.value() for name, field in self.fields.items()}).options()
        except UnusableInputError as error:
            self.problem.setText(in_words(error))
            return
        changed = {name: value for name, value in values.items() if value != self._defaults[name]}
        self.chosen.emit(tuple(f"{name}={json.dumps(value)}" for name, value in changed.items()))
        self.accept()


class _Rows(QWidget):
    """A table that is edited, with buttons that add and remove a row."""

    changed = Signal()

    def __init__(self, columns: Sequence[str], name: str) -> None:
        super().__init__()
        self.table = table(columns, name)
        styled(self.table, edit_triggers=QTableWidget.EditTrigger.AllEditTriggers, minimum_height=92)
        self.table.horizontalHeader().setSectionResizeMode(self.table.horizontalHeader().ResizeMode.Stretch)
        add = button(_("Add"), lambda: self.fill([*self.rows, ()]), name=f"{_('Add')}: {name}")
        remove = button(_("Remove"), self._remove, name=f"{_('Remove')}: {name}")
        self.table.itemChanged.connect(self.changed)
        column(self.table, row(add, remove, None), spacing=4, parent=self)

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """The texts of each row."""
        places = range(self.table.columnCount())
        items = ([self.table.item(line, column) for column in places] for line in range(self.table.rowCount()))
        return [tuple("" if item is None else item.text().strip() for item in line) for line in items]

    def fill(self, rows: Sequence[Sequence[Any]]) -> None:
        """Show these rows; None is an empty cell."""
        cells = [[*values, *[None] * (self.table.columnCount() - len(values))] for values in rows]
        fill_table(
            self.table,
            [[f"{cell:g}" if isinstance(cell, int | float) else cell or "" for cell in line] for line in cells],
        )
        self.table.setCurrentCell(len(rows) - 1, 0)
        self.changed.emit()

    def _remove(self) -> None:
        self.table.removeRow(self.table.currentRow())
        self.changed.emit()


def _number(text: str) -> Any:
    """Return a number of a cell, None for an empty one; a text that is none is refused by the protocol."""
    try:
        return float(text.replace(",", ".")) if text else None
    except ValueError:
        return text


def _two_columns(parts: Sequence[QWidget]) -> QBoxLayout:
    half = (len(parts) + 1) // 2
    return row(column(*parts[:half], spacing=2), column(*parts[half:], None, spacing=2), None, spacing=24)


def _arrange_dialog(dialog: ProtocolDialog | OptionsDialog, rows: dict[str, QWidget], width: int, height: int) -> None:
    """Lay out a form that scrolls, with what is wrong and the buttons below."""
    form = QFormLayout()
    for text, field in rows.items():
        form.addRow(text, field)
    column((PageScroll(holder(form)), 1), dialog.problem, dialog.buttons, spacing=8, margins=(12,), parent=dialog)
    dialog.resize(width, height)


def _buttons(dialog: QDialog, save: Callable[[], None]) -> tuple[QDialogButtonBox, Any]:
    buttons = QDialogButtonBox(Qt.Orientation.Horizontal)
    accept = buttons.addButton(_("Save"), QDialogButtonBox.ButtonRole.AcceptRole)
    buttons.addButton(_("Cancel"), QDialogButtonBox.ButtonRole.RejectRole)
    buttons.accepted.connect(save)
    buttons.rejected.connect(dialog.reject)
    return buttons, accept
