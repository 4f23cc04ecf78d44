"""The dialog that imports records: which column is which signal, in which unit, with a preview of the numbers."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PySide6.QtCore import QSize, Qt, Signal
from PySide6.QtWidgets import (
    QComboBox,
    QDialog,
    QDialogButtonBox,
    QFileDialog,
    QFormLayout,
    QHeaderView,
    QLabel,
    QLineEdit,
    QTableWidget,
    QTableWidgetItem,
    QWidget,
)

from tissueid.app import build
from tissueid.app.build import label, styled
from tissueid.app.words import in_words
from tissueid.configuration import CONFIGURATIONS
from tissueid.errors import TissueIDError, UnusableInputError
from tissueid.formatting import clean, number
from tissueid.language import _, marked
from tissueid.procedures.import_export import ImportPlan
from tissueid.sessions import KINDS
from tissueid.sessions.file_policy import located
from tissueid.sessions.imports import (
    OFFERED,
    ROLES,
    guessed_role,
    open_foreign,
    parse_map,
)
from tissueid.sessions.imports.export_attributes import attributes_beside
from tissueid.sessions.imports.imported_table import Column, RowRange
from tissueid.sessions.imports.stated_units import unit_of
from tissueid.sessions.model import SIGNAL_UNITS
from tissueid.test_settings import setting_of

_SHOWN_ROWS = 4
_TITLE_BAR = 40
_FURTHER_UNITS = ("Pa", "kPa", "MPa", "psi", "N m", "rad", "deg", "%", "1")
"""Units that are offered for input and output of another system, besides those of the signals."""
_DECIMALS = {"point": marked("a point"), "comma": marked("a comma")}
_LEAST_UNIT = 8
"""Characters of a unit that are shown at least: "minutes"."""
_MOST_COLUMNS = 60
"""Columns that the table offers; the command line takes any."""
_ROLE_NAMES = {
    "": marked("not imported"),
    "time": marked("Time"),
    "command": marked("Command"),
    "voltage": marked("Voltage"),
    "current": marked("Current"),
    "force": marked("Force"),
    "position": marked("Position"),
    "temperature": marked("Temperature"),
    "acceleration_x": marked("Acceleration, first axis"),
    "acceleration_y": marked("Acceleration, second axis"),
    "input": marked("Input of another system"),
    "output": marked("Output of another system"),
}
_KIND_NAMES = {
    "stochastic": marked("Stochastic test"),
    "quiet": marked("Quiet: no command"),
    "slow_ramp": marked("Slow ramp"),
    "step_hold": marked("Step and hold"),
    "spring": marked("Calibration spring"),
    "free_air": marked("Free air"),
}


@dataclass(frozen=True)
class ColumnPreview:
    """One column of a record, the role it seems to have, and its first numbers."""

    column: Column
    role: str
    first: tuple[float, ...]


@dataclass(frozen=True)
class Preview:
    """What a record looks like before it is imported. ``described`` is true where an export's attributes say it all."""

    paths: tuple[Path, ...]
    format: str
    columns: tuple[ColumnPreview, ...]
    described: bool


def preview_of(paths: Sequence[Path]) -> Preview:
    """Look into the first of some records of equal layout.

    Raises:
        UnusableInputError: it cannot be read; OSError: neither can its disk.
    """
    try:
        return _preview_of(paths, None)
    except UnusableInputError as error:
        if error.code != "import.thousands":  # that is asked for
            raise UnusableInputError(located(str(paths[0]), error.message)) from error
    return _preview_of(paths, ".")


def _preview_of(paths: Sequence[Path], decimal: str | None) -> Preview:
    unit_of("N")  # loads the units here and not while the user types
    file = open_foreign(paths[0], decimal)
    places = range(min(len(file.columns), _MOST_COLUMNS))
    try:
        values = file.load(list(places), RowRange(0, _SHOWN_ROWS))[0]
    except UnusableInputError as error:  # a short record, or variables of different lengths
        if error.code == "import.thousands":
            raise
        values = [file.load([index], RowRange())[0][0] for index in places]
    columns = []
    taken: set[str] = set()
    for index, numbers in zip(places, values, strict=True):
        role = guessed_role(file, index)
        role = "" if role in taken else role
        taken.add(role)
        first = tuple(float(value) for value in np.asarray(numbers[:_SHOWN_ROWS], np.float64))
        columns.append(ColumnPreview(file.columns[index], role, first))
    return Preview(tuple(paths), file.format, tuple(columns), attributes_beside(paths[0]) is not None)


class ImportDialog(QDialog):
    """Asks for what an import needs; ``wanted`` carries an :class:`ImportPlan`. It stays open until that succeeds."""

    wanted = Signal(object)

    def __init__(self, preview: Preview, out: Path, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._preview = preview
        build.styled(self, window_title=_("Import records"), attribute=Qt.WidgetAttribute.WA_DeleteOnClose)
        names = ", ".join(clean(path.name) for path in preview.paths[:5])
        more = len(preview.paths) - 5
        self.files = label(text=f"{names}{f' + {more}' if more > 0 else ''}  ({preview.format})")
        self.table = self._make_table()
        self.rate = build.styled(QLineEdit(), placeholder_text=_("only where no column is time"))
        self.decimal = _choice(_DECIMALS, tuple(_DECIMALS), _("as the numbers show"))
        self.first, self.last = QLineEdit(), QLineEdit()
        for field, name in ((self.first, _("First row")), (self.last, _("Row after the last"))):
            build.styled(field, placeholder_text=name, name=name)
        self.site, self.subject = QLineEdit(), QLineEdit()
        self.subject.setPlaceholderText(_("a pseudonym, never a name"))
        self.kind = _choice(_KIND_NAMES, KINDS, _("as the record shows: stochastic, or a ramp and hold"))
        self.configuration = _choice(dict(setting_of("configuration").choices), tuple(CONFIGURATIONS))
        self.out = QLineEdit(str(out))
        self.browse = build.button(_("Browse…"), self._choose_out)
        self.said = label("readout", level="poor", hidden=True)
        self.buttons = QDialogButtonBox()
        self.go = self.buttons.addButton(_("Import"), QDialogButtonBox.ButtonRole.ActionRole)
        self.cancel = self.buttons.addButton(_("Cancel"), QDialogButtonBox.ButtonRole.RejectRole)
        self.buttons.rejected.connect(self.reject)
        self.go.clicked.connect(self._ask)
        self._arrange()
        for button in (self.browse, self.cancel):
            button.setAutoDefault(False)
        self.go.setDefault(True)
        if parent is not None:
            self.setPalette(parent.palette())  # a window of its own would have the system's colours
        self.resize(QSize(760, 560).boundedTo(self.screen().availableSize() - QSize(0, _TITLE_BAR)))

    def plan(self) -> ImportPlan:
        """Return what is asked for.

        Raises:
            UnusableInputError: the columns, units or numbers do not make an import.
        """
        mapping = []
        if not self._preview.described:
            for row in range(self.table.rowCount()):
                role, unit = self.role_of(row).currentData(), self.unit_of(row).currentText().strip()
                if role:
                    mapping.append(f"{role}={row + 1}:{unit}" if unit else f"{role}={row + 1}")
            parse_map(mapping)
        rows = RowRange(_whole(self.first), _whole(self.last))
        suffix = "" if rows == RowRange() else f"@{rows}"
        kind, site, configuration = self.kind.currentData(), self.site.text().strip(), self.configuration.currentData()
        return ImportPlan(
            files=tuple(Path(f"{path}{suffix}") for path in self._preview.paths),
            out=Path(self.out.text().strip()),
            mapping=tuple(mapping),
            rate_hz=_rate(self.rate),
            decimal=self.decimal.currentData(),
            kinds=(kind,) if kind else (),
            sites=(site,) if site else (),
            configurations=(configuration,) if configuration else (),
            subject=self.subject.text().strip() or None,
        )

    def say(self, message: str) -> None:
        """Show what is wrong, and let it be put right."""
        self.said.setText(message)
        self.said.show()
        self.update_enabled(busy=False)

    def update_enabled(self, *, busy: bool) -> None:
        """Nothing can be changed while the files are read."""
        self.go.setEnabled(not busy)
        self.table.setEnabled(not busy and not self._preview.described)

    def _ask(self) -> None:
        try:
            plan = self.plan()
        except TissueIDError as error:
            self.say(in_words(error))
            return
        self.said.hide()
        self.update_enabled(busy=True)
        self.wanted.emit(plan)

    def _choose_out(self) -> None:
        keep = QFileDialog.Option.DontConfirmOverwrite  # an import never overwrites
        title, at, kinds = _("Save the session"), self.out.text(), _("Sessions (*.h5)")
        build.ask_path(self, title, at, self._take_out, kinds, save="", default_suffix="h5", option=keep)

    def _take_out(self, path: Path) -> None:
        self.out.setText(str(path))

    # -- the table ------------------------------------------------------------------------------------------

    def _make_table(self) -> QTableWidget:
        heads = [_("Column"), _("Signal"), _("Unit"), _("First values")]
        named = _("Columns of the record and the signals they become")
        table = styled(QTableWidget(len(self._preview.columns), len(heads)), name=named, horizontal_header_labels=heads)
        table.verticalHeader().hide()
        build.styled(
            table,
            edit_triggers=QTableWidget.EditTrigger.NoEditTriggers,
            selection_mode=QTableWidget.SelectionMode.NoSelection,
        )
        header = table.horizontalHeader()
        header.setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        header.setStretchLastSection(True)
        for row, column in enumerate(self._preview.columns):
            name = clean(column.column.header)[:60]
            table.setItem(row, 0, QTableWidgetItem(name or str(row + 1)))
            role_names = {role: _(_ROLE_NAMES[role]) for role in ("", *ROLES)}
            roles = build.choice(role_names, name=_("What column {name} is").format(name=name))
            units = styled(
                QComboBox(),
                name=_("Unit of column {name}").format(name=name),
                editable=True,
                size_adjust_policy=QComboBox.SizeAdjustPolicy.AdjustToContents,
                minimum_contents_length=_LEAST_UNIT,
            )
            roles.currentIndexChanged.connect(lambda _index, row=row: self._offer_units(row))
            units.editTextChanged.connect(lambda _text, row=row: self._mark(row))
            table.setCellWidget(row, 1, roles)
            table.setCellWidget(row, 2, units)
            numbers = "  ".join(number(value, 6) for value in column.first)
            table.setItem(row, 3, QTableWidgetItem(numbers))
        self.table = table
        for row, column in enumerate(self._preview.columns):
            self.role_of(row).setCurrentIndex(max(0, self.role_of(row).findData(column.role)))
            self._offer_units(row)
        return table

    def _offer_units(self, row: int) -> None:
        """Offer the units of a role's quantity, with the one that the file states chosen.

        A text that is no unit of the quantity is marked: it has to be replaced.
        """
        role, units, column = self.role_of(row).currentData(), self.unit_of(row), self._preview.columns[row].column
        quantity = SIGNAL_UNITS.get(role, "")
        stated = "s" if column.dated else column.unit_for(role, quantity) if role else column.unit
        units.clear()
        units.addItems(OFFERED[quantity] if quantity else (*itertools.chain(*OFFERED.values()), *_FURTHER_UNITS))
        units.setEnabled(bool(role) and not column.dated)
        units.setEditText(stated)
        self._mark(row)

    def _mark(self, row: int) -> None:
        """Mark the unit of a column that cannot be read, and say why."""
        role, units = self.role_of(row).currentData(), self.unit_of(row)
        text, quantity = units.currentText().strip(), SIGNAL_UNITS.get(role, "")
        unit = unit_of(text.removesuffix("!"), quantity) if role and text else None
        fits = not role or not text or (unit is not None and quantity in ("", unit.si))
        problem = "" if fits else _("“{unit}” is not a known unit of this signal: choose one.").format(unit=clean(text))
        build.styled(units, tip=problem, accessible_description=problem, level=None if fits else "poor")
        units.style().polish(units)

    def role_of(self, row: int) -> QComboBox:
        """Return the choice of what a column is."""
        widget = self.table.cellWidget(row, 1)
        assert isinstance(widget, QComboBox)
        return widget

    def unit_of(self, row: int) -> QComboBox:
        """Return the field of the unit of a column."""
        widget = self.table.cellWidget(row, 2)
        assert isinstance(widget, QComboBox)
        return widget

    def _arrange(self) -> None:
        form = QFormLayout()
        form.addRow(_("Sample rate (Hz)"), self.rate)
        if self._preview.format == "csv" and not self._preview.described:
            form.addRow(_("Decimal sign"), self.decimal)
        form.addRow(_("Rows"), build.row(self.first, self.last))
        fields = (_("Site"), self.site), (_("Subject"), self.subject), (_("Kind of test"), self.kind)
        for name, field in (*fields, (_("Configuration"), self.configuration)):
            form.addRow(name, field)
        form.addRow(_("Save to"), build.row((self.out, 1), self.browse))
        layout = build.column(self.files, (self.table, 1), margins=(11,), parent=self)
        if self._preview.described:
            layout.addWidget(QLabel(_("Its attributes file (.json) says what its columns are.")))
            for widget in (self.rate, self.table):
                widget.setEnabled(False)
        layout.addLayout(form)
        layout.addWidget(self.said)
        layout.addWidget(self.buttons)


def _choice(names: dict[str, str], keys: Sequence[str], usual: str = "") -> QComboBox:
    entries: dict[str | None, str] = {None: usual or _("as the file says, else the usual one")}
    return build.choice(entries | {name: _(names[name]) for name in keys})


def _whole(field: QLineEdit) -> int | None:
    """Return the row that is typed, None for an empty field.

    Raises:
        UnusableInputError: it is not a whole number.
    """
    text = field.text().strip()
    if not text:
        return None
    if not text.removeprefix("-").isdecimal() or len(text) > 12:
        raise UnusableInputError("import.row", "a row is a whole number, not {text}", text=clean(text)[:20])
    return int(text)


def _rate(field: QLineEdit) -> float | None:
    text = field.text().strip().replace(",", ".")
    if not text:
        return None
    try:
        return float(text)
    except ValueError:
        raise UnusableInputError(
            "import.rate", "the sample rate is a number above 0, not {text}", text=clean(text)[:20]
        ) from None
