"""Control of one option, made from its declaration: bounds, choices, unit and description."""

from __future__ import annotations

import html
import json
import math
import types
from collections.abc import Mapping
from typing import Any, Literal, Union, get_args, get_origin

from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined
from PySide6.QtCore import SIGNAL, QEvent, QObject, Signal
from PySide6.QtGui import QKeyEvent, QKeySequence
from PySide6.QtWidgets import (
    QCheckBox,
    QComboBox,
    QDoubleSpinBox,
    QGridLayout,
    QLabel,
    QLineEdit,
    QSpinBox,
    QWidget,
)

from tissueid.app import build
from tissueid.app.number_field import NumberField, WholeNumberField
from tissueid.errors import UnusableInputError
from tissueid.formatting import label_and_unit
from tissueid.language import _, decimal, marked
from tissueid.plan_options import OptionBounds, bounds_of, option_of
from tissueid.test_settings import Setting
from tissueid.units import display_unit

_DECIMALS = 15
_DIGITS = 10
_LARGEST = 2**31 - 1
_UNBOUND = 1e12
_LONGEST = 2000
_SHORT_S, _START = 0.1, 10.0
_NARROW = 60
"""Controls may shrink so far: the form scrolls up and down alone."""

CHOICES = {
    "autocorrelation": marked("by its autocorrelation"),
    "band": marked("flat up to the cutoff"),
    "blackman": "Blackman",
    "boxcar": marked("none (rectangular)"),
    "burger": "Burgers",
    "butterworth": marked("low-pass (Butterworth)"),
    "exponential": marked("exponential"),
    "full": marked("all lines"),
    "gaussian": marked("Gaussian"),
    "hamming": "Hamming",
    "hammerstein": marked("nonlinearity, then dynamics (Hammerstein)"),
    "hann": "Hann",
    "in": marked("inward"),
    "kelvin-voigt": "Kelvin-Voigt",
    "laguerre": "Laguerre",
    "lnl": marked("dynamics, nonlinearity, dynamics"),
    "low_crest": marked("low crest factor"),
    "maxwell": "Maxwell",
    "nln": marked("nonlinearity, dynamics, nonlinearity"),
    "odd": marked("odd lines"),
    "odd_random": marked("odd lines, some left out"),
    "out": marked("outward"),
    "power": marked("power of the frequency"),
    "power_law": marked("power of the frequency"),
    "quantiles": marked("by its quantiles"),
    "rayleigh": "Rayleigh",
    "schroeder": "Schroeder",
    "second_order": marked("second order"),
    "standard-linear-solid": marked("standard linear solid"),
    "svd": marked("robust (singular values)"),
    "table": marked("from a table"),
    "toeplitz": marked("fast (Toeplitz)"),
    "uniform": marked("uniform"),
    "white": marked("flat (white)"),
    "wiener": marked("dynamics, then nonlinearity (Wiener)"),
}
"""Labels of choices whose name, as it is typed in the shell, does not say enough."""


class OptionField(QWidget):
    """The control of one option; ``edited`` is emitted when the user changes its value.

    A choice has no entries for the values ``without``. ``undone`` and ``redone`` are sent for the keys of undo and
    redo, which a control would otherwise keep for itself.
    """

    edited = Signal()
    undone = Signal()
    redone = Signal()

    def __init__(
        self, name: str, info: FieldInfo, parent: QWidget | None = None, *, without: tuple[str, ...] = ()
    ) -> None:
        super().__init__(parent)
        self.name = name
        self._heading: QLabel | None = None
        kind, self._optional = _without_none(info.annotation)
        option = option_of(info)
        declared = option if isinstance(option, Setting) else Setting()
        choices = dict(declared.choices)
        unknown = choices.pop(None, None) if not self._optional or len(choices) == 1 else None
        self._optional = self._optional and not choices and declared.usual is None
        label, si_unit = label_and_unit(name)
        unit, self._scale = display_unit(si_unit)
        self._title = _(info.title or label)
        self.label = label = self._title.replace("&", "")
        self._kind = kind
        if not choices and get_origin(kind) is Literal:
            choices = {name: CHOICES.get(str(name), str(name)) for name in get_args(kind) if name not in without}
        self._control = self._choice(choices) if choices else self._make(kind, info, declared, unit)
        if isinstance(self._control, QLineEdit) and unit:
            self.label = f"{_(label)} ({unit})"
        self._automatic: QCheckBox | None = None
        row = build.row((self._control, 1), parent=self)
        if self._optional:
            caption = _(unknown or marked("automatic"))
            self._automatic = build.styled(QCheckBox(caption), name=f"{label}, {caption}")
            self._automatic.toggled.connect(self._switch)
            row.addWidget(self._automatic)
        description = _(info.description or "")
        for widget in self.controls:
            widget.setToolTip(f"<qt>{html.escape(description)}</qt>" if description else "")
            widget.installEventFilter(self)
        build.styled(self._control, name=self.label, accessible_description=description, minimum_width=_NARROW)
        usual = declared.usual if declared.usual is not None else info.get_default()
        if usual is not PydanticUndefined:
            self.set_value(usual)

    def place(self, grid: QGridLayout, row: int, **style: Any) -> None:
        """Put the option into a row of a grid, after a label in a style; both are shown and hidden together."""
        self._heading = build.styled(QLabel(self._title), **({"word_wrap": True, "buddy": self._control} | style))
        grid.addWidget(self._heading, row, 0)
        grid.addWidget(self, row, 1)

    def setVisible(self, visible: bool) -> None:  # noqa: N802
        """Show or hide the option and its label."""
        super().setVisible(visible)
        if self._heading is not None:
            self._heading.setVisible(visible)

    def limit(self, low: float, high: float) -> None:
        """Change the bounds of a number, in its displayed unit; ``edited`` is emitted where that changes its value."""
        assert isinstance(self._control, QDoubleSpinBox)
        self._control.setRange(low, high)

    @property
    def controls(self) -> list[QWidget]:
        """Widgets in tab order."""
        return [self._control] if self._automatic is None else [self._control, self._automatic]

    @property
    def text(self) -> str:
        """The label of the value that is chosen."""
        assert isinstance(self._control, QComboBox)
        return self._control.currentText()

    def value(self) -> Any:
        """Return the value of the option in SI units.

        Raises:
            UnusableInputError: what was typed does not read as one.
        """
        if self._automatic is not None and self._automatic.isChecked():
            return None
        control = self._control
        if isinstance(control, QCheckBox):
            return control.isChecked()
        if isinstance(control, QComboBox):
            return control.currentData()
        if isinstance(control, QSpinBox):
            control.interpretText()
            return control.value()
        if isinstance(control, QDoubleSpinBox):
            control.interpretText()
            return float(f"{control.value() / self._scale:.12g}")
        assert isinstance(control, QLineEdit)
        return self._typed(control.text().strip())

    def set_value(self, value: Any) -> None:
        """Show a value without a signal; values out of range are clipped."""
        blocked = [(widget, widget.blockSignals(True)) for widget in self.controls]
        try:
            if self._automatic is not None:
                self._automatic.setChecked(value is None)
                self._control.setEnabled(value is not None)
            if value is not None or isinstance(self._control, QComboBox):
                self._show(value)
        finally:
            for widget, before in blocked:
                widget.blockSignals(before)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:  # noqa: N802
        """Forward undo and redo keys to the form, and ignore the wheel without focus."""
        if isinstance(event, QKeyEvent) and event.type() in (QEvent.Type.ShortcutOverride, QEvent.Type.KeyPress):
            for keys, signal, name in (
                (QKeySequence.StandardKey.Undo, self.undone, "undone()"),
                (QKeySequence.StandardKey.Redo, self.redone, "redone()"),
            ):
                if event.matches(keys) and self.receivers(SIGNAL(name)):
                    event.accept()
                    if event.type() == QEvent.Type.KeyPress:
                        signal.emit()
                    return True
        # A wheel that rolls the form must not change what it happens to roll over.
        if event.type() == QEvent.Type.Wheel and isinstance(watched, QWidget) and not watched.hasFocus():
            event.ignore()
            return True
        return super().eventFilter(watched, event)

    # -- making -------------------------------------------------------------------------------------------

    def _make(self, kind: Any, info: FieldInfo, declared: Setting, unit: str) -> QWidget:
        if kind is bool:
            box = QCheckBox()
            box.toggled.connect(self._tell)
            return box
        if kind is int or kind is float:
            bounds = bounds_of(info)
            if declared.offered:
                bounds = bounds._replace(least=declared.offered[0], most=declared.offered[1])
            return self._make_number(kind, bounds, unit, declared.step)
        line = build.styled(
            QLineEdit(), max_length=_LONGEST, placeholder_text="1, 2, 3" if get_origin(kind) is tuple else ""
        )
        line.editingFinished.connect(self._tell)
        return line

    def _choice(self, choices: Mapping[Any, str]) -> QComboBox:
        return build.choice({choice: _(label) for choice, label in choices.items()}, self._tell, 6)

    def _make_number(self, kind: type, bounds: OptionBounds, unit: str, step: float) -> QSpinBox | QDoubleSpinBox:
        spin: QSpinBox | QDoubleSpinBox
        opened = bounds.least_open, bounds.most_open
        limits = (
            -_UNBOUND if bounds.least is None else float(bounds.least),
            _UNBOUND if bounds.most is None else float(bounds.most),
        )
        if kind is int:
            whole = WholeNumberField()
            low = math.ceil(max(limits[0], -_LARGEST)) + (opened[0] and limits[0].is_integer())
            high = math.floor(min(limits[1], _LARGEST)) - (opened[1] and limits[1].is_integer())
            whole.setRange(low, high)
            whole.setValue(1)  # where "automatic" is taken away
            whole.valueChanged.connect(self._tell)
            spin = whole
        else:
            number = build.styled(NumberField(), decimals=2, single_step=step) if step else _GeneralSpin()
            low_f, high_f = (limit * self._scale for limit in limits)
            number.setRange(_inside(low_f, 1.0) if opened[0] else low_f, _inside(high_f, -1.0) if opened[1] else high_f)
            number.setValue(_SHORT_S if unit == "s" else _START)
            number.valueChanged.connect(self._tell)
            spin = number
        spin.setKeyboardTracking(False)
        if unit:
            spin.setSuffix(f" {unit}")
        return spin

    # -- values -------------------------------------------------------------------------------------------

    def _show(self, value: Any) -> None:
        control = self._control
        if isinstance(control, QCheckBox):
            control.setChecked(bool(value))
        elif isinstance(control, QComboBox):
            if isinstance(value, float) and control.findData(value) < 0:
                control.addItem(f"{value:g}", value)
            control.setCurrentIndex(max(0, control.findData(value)))
        elif isinstance(control, QSpinBox):
            control.setValue(int(max(control.minimum(), min(control.maximum(), value))))
        elif isinstance(control, QDoubleSpinBox):
            control.setValue(float(value) * self._scale)
        elif isinstance(control, QLineEdit):
            listed = isinstance(value, list | tuple)
            numbers = ", ".join(f"{float(item) * self._scale:.10g}" for item in value) if listed else json.dumps(value)
            control.setText(numbers)

    def _typed(self, text: str) -> Any:
        if get_origin(self._kind) is tuple:
            try:
                # A comma between digits is no decimal mark here: it parts numbers.
                return [float(f"{float(part) / self._scale:.12g}") for part in text.split(",") if part.strip()]
            except ValueError:
                raise UnusableInputError(
                    "form.numbers", "{label}: give numbers, separated by commas, such as 1, 2.5, 4", label=self.label
                ) from None
        try:
            return json.loads(text)
        except (ValueError, RecursionError):
            return text

    def _switch(self, automatic: bool) -> None:
        self._control.setEnabled(not automatic)
        self._tell()

    def _tell(self) -> None:
        self.edited.emit()


class _GeneralSpin(NumberField):
    """Number field with as few digits as the number needs, e.g. 1e-12 or 200."""

    def __init__(self) -> None:
        super().__init__()
        build.styled(self, decimals=_DECIMALS, step_type=QDoubleSpinBox.StepType.AdaptiveDecimalStepType)

    def textFromValue(self, value: float) -> str:  # noqa: N802
        """Return the number with up to ten digits."""
        return decimal(f"{value:.{_DIGITS}g}")

    def stepBy(self, steps: int) -> None:  # noqa: N802
        """Step by the second digit: 0.125 s to 0.135 s, 1e-12 to 1.1e-12."""
        value = self.value()
        size = 10.0 ** (math.floor(math.log10(abs(value))) - 1) if value else 0.01
        self.setValue(round(value + steps * size, _DECIMALS))


def _without_none(annotation: Any) -> tuple[Any, bool]:
    """Return the type of an option, and whether it may be None."""
    if get_origin(annotation) in (Union, types.UnionType):
        others = [kind for kind in get_args(annotation) if kind is not type(None)]
        return (others[0] if len(others) == 1 else object), len(others) < len(get_args(annotation))
    return annotation, False


def _inside(limit: float, way: float) -> float:
    """Return the nearest number inside an exclusive bound."""
    return limit + way * max(10.0**-_DECIMALS, 1e-9 * abs(limit))
