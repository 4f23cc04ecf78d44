"""A field for a number with a unit that never makes another number of what was typed."""

from __future__ import annotations

import re

from PySide6.QtGui import QValidator
from PySide6.QtWidgets import QDoubleSpinBox, QWidget

_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)")


class NumberField(QDoubleSpinBox):
    """Takes a decimal comma as well as a point.

    A bare spin box drops the letters that it does not like: "0,5" would become 5, "5 kN" 5 N and "-3" 3. Here what is
    typed stays as it is typed; where that is no number in the range and the unit of the field, the value before stands
    again once the field is left. Until then the field has the value before; :attr:`settled` does not wait for it.
    """

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setKeyboardTracking(False)

    @property
    def settled(self) -> float:
        """The value, with what is being typed taken or left."""
        self.interpretText()
        return self.value()

    def validate(self, text: str, position: int) -> tuple[QValidator.State, str, int]:
        """Anything may be typed; only a number in the range is taken."""
        number = self._number(text)
        good = number is not None and self.minimum() <= number <= self.maximum()
        return QValidator.State.Acceptable if good else QValidator.State.Intermediate, text, position

    def fixup(self, text: str) -> str:
        """Nothing is made of what is no number: Qt would take commas out, and read "0,1" as 1."""
        return text

    def valueFromText(self, text: str) -> float:  # noqa: N802
        """The number that is typed; the value before where it is none."""
        number = self._number(text)
        return self.value() if number is None else number

    def _number(self, text: str) -> float | None:
        body, unit = text.strip(), self.suffix().strip()
        for _ in range(2):  # the field's own, and one that is typed before it
            body = body.removesuffix(unit).strip()
        return float(body.replace(",", ".")) if _NUMBER.fullmatch(body) else None
