"""Dialogs of the page: the protocol of a study, and the options of its engine."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from typing import Any, get_args

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import (
    QBoxLayout,
    QCheckBox,
    QComboBox,
    QDialog,
    QDialogButtonBox,
    QFormLayout,
    QLineEdit,
    QTableWidget,
    QTableWidgetItem,
    QWidget,
)

from tissueid.app.build import button, column, label, row, styled, table
from tissueid.app.number_field import WholeNumberField
from tissueid.app.option_field import OptionField
from tissueid.app.small_window import PageScroll
from tissueid.app.widgets import show_level
from tissueid.app.words import in_words
from tissueid.errors import UnusableInputError
from tissueid.identification import engine_label, get_engine
from tissueid.language import _
from tissueid.messages import Message, translated
from tissueid.procedures.study_protocol import (
    PROTOCOL_FILE,
    Demographic,
    Protocol,
    check_tests,
    parse_protocol,
    sitting_steps,
)
from tissueid.procedures.study_subjects import DEMOGRAPHIC_FIELDS
from tissueid.procedures.test_presets import PRESETS
from tissueid.test_settings import Circumstances


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
        for spin, most, value in ((self.repeats, 100, protocol.repeats), (self.attempts, 20, protocol.attempts)):
            spin.setRange(1, most)
            spin.setValue(value)
        self.attempts.setToolTip(_("After so many tests that are of no use, the visit goes on to the next test"))
        columns = _("Product"), *(_(info.title or name) for name, info in Circumstances.model_fields.items())
        self.conditions = _Rows(columns, _("Conditions"))
        self.conditions.setToolTip(_("One line for each; an empty product means none"))
        given = ((one.product, *one.model_dump(exclude={"product"}).values()) for one in protocol.conditions)
        self.conditions.fill(list(given))
        self.order, self.stimulus = QComboBox(), QComboBox()
        for name, words in _orders():
            self.order.addItem(words, name)
        for preset in PRESETS:
            self.stimulus.addItem(_(preset.title), preset.name)
        for choice, known in ((self.order, protocol.order), (self.stimulus, protocol.stimulus)):
            choice.setCurrentIndex(choice.findData(known))
        self.asked = {name: QCheckBox(_(DEMOGRAPHIC_FIELDS[name].title)) for name in get_args(Demographic)}
        for name, box in self.asked.items():
            box.setChecked(name in protocol.demographics)
        self.photograph = styled(QCheckBox(_("Offer to add a photograph of each site")), checked=protocol.photograph)
        self.problem = label()
        self.buttons, self.save = _buttons(self, self._save)
        form = QFormLayout()
        form.addRow(_("Name of the study"), self.name)
        form.addRow(_("Sites, in order"), self.sites)
        form.addRow(_("Tests at each site"), self.repeats)
        form.addRow(_("Conditions, in order"), self.conditions)
        form.addRow(_("Order of the sites"), self.order)
        form.addRow(_("Test"), self.stimulus)
        form.addRow(_("Attempts at each test"), self.attempts)
        form.addRow(_("Ask the subject for"), _holder(_two_columns(tuple(self.asked.values()))))
        form.addRow("", self.photograph)
        inside = _holder(form)
        self.setLayout(column((PageScroll(inside), 1), self.problem, self.buttons, spacing=8, margins=(12,)))
        self.resize(620, 640)
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
        found = parse_protocol(values, PROTOCOL_FILE)
        check_tests(found, PROTOCOL_FILE)
        return found

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
        form = QFormLayout()
        for name, field in self.fields.items():
            field.set_value(given.get(name, self._defaults[name]))
            form.addRow(field.label, field)
        self.problem = label(level="poor")
        self.buttons, _save = _buttons(self, self._save)
        defaults = button(_("&Defaults"), tip=_("All options of this engine as they are when nothing is chosen"))
        defaults.clicked.connect(self._take_defaults)
        self.buttons.addButton(defaults, QDialogButtonBox.ButtonRole.ResetRole)
        self.setLayout(column((PageScroll(_holder(form)), 1), self.problem, self.buttons, spacing=8, margins=(12,)))
        self.resize(420, 480)

    def _take_defaults(self) -> None:
        for name, field in self.fields.items():
            field.set_value(self._defaults[name])

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
        self.table.setEditTriggers(QTableWidget.EditTrigger.AllEditTriggers)
        self.table.horizontalHeader().setSectionResizeMode(self.table.horizontalHeader().ResizeMode.Stretch)
        self.table.setMinimumHeight(92)
        add, remove = button(_("Add"), name=f"{_('Add')}: {name}"), button(_("Remove"), name=f"{_('Remove')}: {name}")
        add.clicked.connect(lambda: self.fill([*self.rows, ()]))
        remove.clicked.connect(self._remove)
        self.table.itemChanged.connect(self.changed)
        self.setLayout(column(self.table, row(add, remove, None), spacing=4))

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """The texts of each row."""
        places = range(self.table.columnCount())
        items = ([self.table.item(line, place) for place in places] for line in range(self.table.rowCount()))
        return [tuple("" if item is None else item.text().strip() for item in line) for line in items]

    def fill(self, rows: Sequence[Sequence[Any]]) -> None:
        """Show these rows; None is an empty cell."""
        self.table.blockSignals(True)
        self.table.setRowCount(len(rows))
        for line, values in enumerate(rows):
            for place in range(self.table.columnCount()):
                value = values[place] if place < len(values) else None
                text = f"{value:g}" if isinstance(value, int | float) else value or ""
                self.table.setItem(line, place, QTableWidgetItem(text))
        self.table.blockSignals(False)
        self.table.setCurrentCell(len(rows) - 1, 0)
        self.changed.emit()

    def _remove(self) -> None:
        self.table.removeRow(self.table.currentRow())
        self.changed.emit()


def _orders() -> list[tuple[str, str]]:
    return [("fixed", _("As listed")), ("randomised", _("Shuffled for each subject"))]


def _number(text: str) -> Any:
    """Return a number of a cell, None for an empty one; a text that is none is refused by the protocol."""
    try:
        return float(text.replace(",", ".")) if text else None
    except ValueError:
        return text


def _two_columns(parts: Sequence[QWidget]) -> QBoxLayout:
    half = (len(parts) + 1) // 2
    return row(column(*parts[:half], spacing=2), column(*parts[half:], None, spacing=2), None, spacing=24)


def _holder(box: Any) -> QWidget:
    holder = QWidget()
    holder.setLayout(box)
    return holder


def _buttons(dialog: QDialog, save: Callable[[], None]) -> tuple[QDialogButtonBox, Any]:
    buttons = QDialogButtonBox(Qt.Orientation.Horizontal)
    accept = buttons.addButton(_("Save"), QDialogButtonBox.ButtonRole.AcceptRole)
    buttons.addButton(_("Cancel"), QDialogButtonBox.ButtonRole.RejectRole)
    buttons.accepted.connect(save)
    buttons.rejected.connect(dialog.reject)
    return buttons, accept
