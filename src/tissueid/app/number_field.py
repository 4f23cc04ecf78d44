"""A field for a number with a unit that never makes another number of what was typed."""

from __future__ import annotations

import re

from PySide6.QtCore import QPoint, Qt, Signal
from PySide6.QtGui import QValidator
from PySide6.QtWidgets import QDoubleSpinBox, QLabel, QSpinBox, QWidget

from tissueid.app import build
from tissueid.app.widgets import show_level
from tissueid.language import _, decimal

_SHOWN_MS = 6000
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?")


class FieldHint(QLabel):
    """Words right below a field, drawn over what is there, so that nothing moves for them."""

    def __init__(self, field: QWidget) -> None:
        super().__init__(field)
        self._field = field
        build.styled(
            self,
            role="hint",
            text_format=Qt.TextFormat.PlainText,
            attribute=Qt.WidgetAttribute.WA_TransparentForMouseEvents,
        )
        self._over = build.timer(self, _SHOWN_MS, self.hide)
        self.hide()

    def say(self, text: str, *, fading: bool = False) -> None:
        """Show words, for some seconds where they are ``fading``; none of them hides it."""
        self._over.stop()
        self.setText(text)
        self._field.setAccessibleDescription(text)
        if not text:
            self.hide()
            return
        window = self._field.window()
        self.setParent(window)
        self.adjustSize()
        corner = self._field.mapTo(window, QPoint(0, self._field.height() + 1))
        self.move(max(0, min(corner.x(), window.width() - self.width())), corner.y())
        self.show()
        self.raise_()
        if fading:
            self._over.start()


class NumberField(QDoubleSpinBox):
    """Takes a decimal comma as well as a point.

    A bare spin box drops the letters that it does not like: "0,5" would become 5, "5 kN" 5 N and "-3" 3. Here what is
    typed stays as it is typed; where that is no number in the range and the unit of the field, the value before stands
    again once the field is left. Until then the field has the value before; :attr:`settled` does not wait for it.
    """

    refused = Signal(str)
    """What was typed and is not taken."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setKeyboardTracking(False)
        self.hint = FieldHint(self)
        self.editingFinished.connect(self._look_back)
        self._typed = self._tip = ""
        self.valueChanged.connect(self._take_back)
        if (line := self.lineEdit()) is not None:
            line.textEdited.connect(self._look_at)

    @property
    def range_words(self) -> str:
        """What may be typed, in words: "0.5 to 12 N"."""
        return _("{low:g} to {high:g}{unit}").format(low=self.minimum(), high=self.maximum(), unit=self.suffix())

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
        self._typed = text
        return text

    def _look_at(self, text: str) -> None:
        """Say what may be typed as soon as what is typed cannot become it."""
        self._take_back()
        number = self._number(text)
        wrong = bool(text.strip()) and (number is None or number > self.maximum())
        self.hint.say(self.range_words if wrong else "")

    def _look_back(self) -> None:
        """Say what may be typed, and which value stands again."""
        typed, self._typed = self._typed.removeprefix(self.prefix()).removesuffix(self.suffix()).strip(), ""
        if not typed:
            self.hint.say("")
            return
        kept = self.textFromValue(self.value())
        said = _("{range}; {kept} is kept").format(range=self.range_words, kept=kept + self.suffix())
        said = said if kept else _("{range}; left empty").format(range=self.range_words)
        self.hint.say(said, fading=True)
        self._tip = self._tip or self.toolTip()
        self.setToolTip(said)
        show_level(self, "check")
        self.refused.emit(typed)

    def _take_back(self) -> None:
        """The field is edited again: it is no longer marked as one that did not take what was typed."""
        if self.property("level"):
            self.setToolTip(self._tip)
            show_level(self, "")
            self._tip = ""

    def valueFromText(self, text: str) -> float:  # noqa: N802
        """The number that is typed; the value before where it is none."""
        number = self._number(text)
        return self.value() if number is None else number

    def _number(self, text: str) -> float | None:
        body, unit = text.strip(), self.suffix().strip()
        if body and body == self.specialValueText():
            return self.minimum()
        body = body.removeprefix(self.prefix().strip()).strip()
        for _time in range(2):  # the field's own, and one that is typed before it
            body = body.removesuffix(unit).strip()
        return float(body.replace(",", ".")) if _NUMBER.fullmatch(body) else None


class WholeNumberField(QSpinBox):
    """A field for a whole number that, as ``NumberField``, never makes another number of what was typed.

    A bare spin box drops the comma of "1,5", which would become 15. Here the value before stands again.
    """

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setKeyboardTracking(False)

    def validate(self, text: str, position: int) -> tuple[QValidator.State, str, int]:
        """Anything may be typed; only a whole number in the range is taken."""
        number = self._number(text)
        good = number is not None and self.minimum() <= number <= self.maximum()
        return QValidator.State.Acceptable if good else QValidator.State.Intermediate, text, position

    def fixup(self, text: str) -> str:
        """Return the text as it is."""
        return text

    def valueFromText(self, text: str) -> int:  # noqa: N802
        """Return the number that is typed; the value before where it is none."""
        number = self._number(text)
        return self.value() if number is None else number

    def _number(self, text: str) -> int | None:
        body = text.strip()
        if body and body == self.specialValueText():
            return self.minimum()
        body = body.removesuffix(self.suffix().strip()).strip()
        return int(body) if re.fullmatch(r"[+-]?\d{1,12}", body) else None


class OptionalNumberField(NumberField):
    """A number field that may be empty; ``given`` is None then. The least value of its range stands for that."""

    def __init__(self, most: float, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setRange(-1.0, most)
        self.setValue(-1.0)

    @property
    def given(self) -> float | None:
        """The value that is typed, or None for an empty field."""
        value = self.settled
        return None if value < 0.0 else value

    def give(self, value: float | None) -> None:
        """Show a value, or an empty field for None."""
        self.setValue(-1.0 if value is None else value)

    @property
    def range_words(self) -> str:
        """What may be typed, in words."""
        return _("{low:g} to {high:g}{unit}").format(low=0.0, high=self.maximum(), unit=self.suffix())

    def validate(self, text: str, position: int) -> tuple[QValidator.State, str, int]:
        """Nothing, or a number from 0, may be typed."""
        if self._is_empty(text):
            return QValidator.State.Acceptable, text, position
        state, text, position = super().validate(text, position)
        negative = (self._number(text) or 0.0) < 0.0
        return QValidator.State.Intermediate if negative else state, text, position

    def valueFromText(self, text: str) -> float:  # noqa: N802
        """The number that is typed; the least value where nothing is."""
        return -1.0 if self._is_empty(text) else super().valueFromText(text)

    def textFromValue(self, value: float) -> str:  # noqa: N802
        """Nothing for the least value; no more decimals than needed."""
        return "" if value < 0.0 else decimal(f"{value:.10g}")

    def _is_empty(self, text: str) -> bool:
        return not text.strip().removesuffix(self.suffix().strip()).strip()
