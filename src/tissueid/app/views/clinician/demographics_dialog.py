"""Dialog with the values of a subject for which the protocol of a study asks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QComboBox, QDialog, QDialogButtonBox, QFormLayout, QLineEdit, QWidget

from tissueid.app import build
from tissueid.app.number_field import OptionalNumberField
from tissueid.app.words import in_words
from tissueid.errors import UnusableInputError
from tissueid.language import _
from tissueid.messages import Message, Verbatim, translated
from tissueid.procedures.study_subjects import DEMOGRAPHIC_FIELDS, DemographicField, demographic_value

_FIELD_HEIGHT = 28
"""Pixels."""


class DemographicsDialog(QDialog):
    """``filled`` carries the values as they are stored, by name; empty ones are not known."""

    filled = Signal(dict)

    def __init__(
        self, subject: str, names: Sequence[str], known: Mapping[str, str], parent: QWidget | None = None
    ) -> None:
        super().__init__(parent)
        self.setWindowTitle(translated(Message("study.subject", "Subject {subject}", subject=Verbatim(subject))))
        about = build.label(
            "muted", text=_("For the statistics of the study. Leave empty what is not known. Never enter a name.")
        )
        self.problem = build.label("readout", level="poor", hidden=True)
        self.fields: dict[str, QWidget] = {}
        self._read: dict[str, Callable[[], str]] = {}
        form = QFormLayout()
        for name in names:
            kind = DEMOGRAPHIC_FIELDS[name]
            field, self._read[name] = _field(kind, known.get(name, ""))
            build.styled(field, name=_(kind.title), minimum_height=_FIELD_HEIGHT)
            self.fields[name] = field
            form.addRow(_(kind.title), field)
        buttons = QDialogButtonBox(QDialogButtonBox.StandardButton.Ok | QDialogButtonBox.StandardButton.Cancel)
        buttons.button(QDialogButtonBox.StandardButton.Ok).setText(_("Save"))
        buttons.button(QDialogButtonBox.StandardButton.Cancel).setText(_("Later"))
        buttons.accepted.connect(self.save)
        buttons.rejected.connect(self.reject)
        build.column(about, form, self.problem, buttons, margins=(11,), parent=self)
        self.setMinimumWidth(360)

    def save(self) -> None:
        """Check the values, send them and close; say what is wrong otherwise."""
        try:
            values = {name: demographic_value(name, read()) for name, read in self._read.items()}
        except UnusableInputError as error:
            self.problem.setText(in_words(error))
            self.problem.show()
            return
        self.filled.emit(values)
        self.accept()


def _field(kind: DemographicField, known: str) -> tuple[QWidget, Callable[[], str]]:
    """Return a control with a value, and a function that returns what it holds."""
    if kind.bounds is not None:
        number = OptionalNumberField(kind.bounds[1])
        build.styled(number, decimals=3, suffix=f" {_(kind.unit)}")
        try:
            number.give(float(known))
        except ValueError:
            number.give(None)
        return number, lambda: "" if number.given is None else f"{number.given:.10g}"
    if kind.choices:
        choice = QComboBox()
        choice.addItem(_("not known"), "")
        for value in kind.choices:
            choice.addItem(_(value), value)
        if known and choice.findData(known) < 0:
            choice.addItem(known, known)
        choice.setCurrentIndex(choice.findData(known))
        return choice, lambda: str(choice.currentData())
    text = build.styled(QLineEdit(known), max_length=200)
    return text, text.text
