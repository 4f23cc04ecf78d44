"""Form of an analysis: engine, options made from its declaration, and signals; changes can be undone."""

from __future__ import annotations

import html
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

from PySide6.QtCore import QEvent, QSignalBlocker, Qt, Signal
from PySide6.QtGui import QKeySequence, QUndoCommand, QUndoStack
from PySide6.QtWidgets import (
    QBoxLayout,
    QCheckBox,
    QComboBox,
    QFrame,
    QLabel,
    QScrollArea,
    QWidget,
)

from tissueid.app import build
from tissueid.app.number_field import NumberField
from tissueid.app.option_field import OptionField
from tissueid.app.views.researcher.engine_outcome import Preparation
from tissueid.app.views.researcher.selected_test import signal_title
from tissueid.app.words import in_words
from tissueid.errors import UnusableInputError
from tissueid.identification import engine_label, engine_names, get_engine, report_engines
from tissueid.language import _

_HIGHEST_HZ = 1e5
_NARROW = 60
"""Width to which a field may shrink, pixels: the form scrolls up and down alone."""


class PreparationForm(QWidget):
    """Drift, band and actuator, as the options of ``tissueid identify``; ``changed`` is emitted on each change."""

    changed = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.detrend = self._box(
            _("Subtract the linear drift"), _("The straight line through the output is subtracted before the fit")
        )
        self.tissue_alone = self._box(
            _("Also report the tissue alone"),
            _("Mass and damping without the moving part of the instrument, next to those of both together"),
        )
        self.low = self._edge(_("Band from"), _("Lower frequencies are removed from both signals before the fit"))
        self.high = self._edge(_("Band to"), _("Higher frequencies are removed from both signals before the fit"))
        edges = [(_field(edge.accessibleName(), edge), 1) for edge in (self.low, self.high)]
        build.column(build.row(*edges), self.detrend, self.tissue_alone, spacing=2, parent=self)

    @property
    def controls(self) -> tuple[QWidget, ...]:
        """The controls in tab order."""
        return self.low, self.high, self.detrend, self.tissue_alone

    def value(self) -> Preparation:
        """Return what is chosen; an edge of 0 Hz is none."""
        return Preparation(
            detrend=self.detrend.isChecked(),
            low_hz=self.low.value() or None,
            high_hz=self.high.value() or None,
            tissue_alone=self.tissue_alone.isChecked(),
        )

    def set_value(self, value: Preparation) -> None:
        """Show a preparation."""
        self.detrend.setChecked(value.detrend)
        self.low.setValue(value.low_hz or 0.0)
        self.high.setValue(value.high_hz or 0.0)
        self.tissue_alone.setChecked(value.tissue_alone)

    def _box(self, label: str, what: str) -> QCheckBox:
        box = build.styled(QCheckBox(label), tip=what)
        box.toggled.connect(self.changed)
        return box

    def _edge(self, label: str, what: str) -> NumberField:
        edge = NumberField()
        build.styled(
            edge,
            range=(0.0, _HIGHEST_HZ),
            decimals=2,
            suffix=" Hz",
            special_value_text=_("no limit"),
            minimum_width=_NARROW,
            name=label,
            tip=what,
        )
        edge.valueChanged.connect(self.changed)
        return edge


INPUTS = ("force", "current", "voltage", "command")
OUTPUTS = ("position", "force", "current", "acceleration_x")
_UNDOABLE = 200


class EngineForm(QWidget):
    """Engine, options and signals; ``changed`` is emitted on each change."""

    changed = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._values: dict[str, dict[str, Any]] = {}
        self._fields: dict[str, OptionField] = {}
        self._stack = QUndoStack(self)
        self._stack.setUndoLimit(_UNDOABLE)
        engines = {name: engine_label(name) for name in engine_names()}
        self.engine = build.choice(engines, self._choose_engine, name=_("Identification engine"))
        for index, name in enumerate(engines):
            self.engine.setItemData(index, _about(name), Qt.ItemDataRole.ToolTipRole)
        self.about = build.label("field")
        self.input, self.output = _signals(_("Input"), INPUTS), _signals(_("Output"), OUTPUTS)
        self.together = build.styled(
            QCheckBox(_("Fit tests of a file together")),
            tip=_("One model for all chosen tests of a session; otherwise one for each test"),
        )
        self.preparation = PreparationForm()
        self.defaults = build.button(
            _("&Defaults"), self._take_defaults, tip=_("All options of this engine as they are when nothing is chosen")
        )
        undoing, redoing = _("Take the last change back (Ctrl+Z)"), _("Make it again (Ctrl+Shift+Z)")
        self.undo = build.button(_("Undo"), self._stack.undo, tip=undoing, enabled=False)
        self.redo = build.button(_("Redo"), self._stack.redo, tip=redoing, enabled=False)
        self.problem = build.label("readout", level="poor", hidden=True)
        self._arrange()
        for signal in (self.input.currentIndexChanged, self.output.currentIndexChanged, self.together.toggled):
            signal.connect(self.changed)
        self.preparation.changed.connect(self.changed)
        self._stack.canUndoChanged.connect(self.undo.setEnabled)
        self._stack.canRedoChanged.connect(self.redo.setEnabled)
        build.shortcut(self, QKeySequence.StandardKey.Undo, self._stack.undo)
        build.shortcut(self, QKeySequence.StandardKey.Redo, self._stack.redo)
        self._shown = str(self.engine.currentData())
        self.choose(report_engines()[0])
        self._stack.clear()

    @property
    def name(self) -> str:
        """Name of the shown engine."""
        return str(self.engine.currentData())

    @property
    def signals(self) -> tuple[str, str]:
        """Input and output of the model."""
        return str(self.input.currentData()), str(self.output.currentData())

    def options(self) -> dict[str, Any]:
        """Return the options of the shown engine.

        Raises:
            UnusableInputError: one cannot be read, or they do not go together.
        """
        options = {name: field.value() for name, field in self._fields.items()}
        get_engine(self.name).from_options(options)
        return options

    def field(self, name: str) -> OptionField:
        """Return the control of an option of the shown engine.

        Raises:
            KeyError: it has none of that name.
        """
        return self._fields[name]

    def choose(self, engine: str, options: Mapping[str, Any] | None = None) -> None:
        """Show an engine, with options if given; unknown options are ignored.

        Raises:
            UnusableInputError: there is no such engine, or it takes no such value.
        """
        kind = get_engine(engine)
        if options is not None:
            accepted = {name: value for name, value in options.items() if name in kind.model_fields}
            values = kind.from_options(accepted).options()
            self._stack.push(_Change(self, engine, self._of(engine), values, "options"))
            return
        index = self.engine.findData(engine)
        if index != self.engine.currentIndex():
            self.engine.setCurrentIndex(index)
        else:
            self._show_engine(engine)

    def take_signals(self, input_name: str, output_name: str, together: bool) -> None:
        """Select the signals; add those that are not listed."""
        for combo, name in ((self.input, input_name), (self.output, output_name)):
            if combo.findData(name) < 0:
                combo.addItem(signal_title(name), name)
            combo.setCurrentIndex(combo.findData(name))
        self.together.setChecked(together)

    def restore(self, values: Mapping[str, Mapping[str, Any]]) -> None:
        """Restore the options of several engines; invalid ones are ignored."""
        for engine in engine_names():
            try:
                given = {n: v for n, v in values.get(engine, {}).items() if n in get_engine(engine).model_fields}
                self._values[engine] = get_engine(engine).from_options(given).options()
            except (UnusableInputError, TypeError, AttributeError):
                self._values.pop(engine, None)
        self._show_engine(self.name)
        self._stack.clear()

    def all_options(self) -> dict[str, dict[str, Any]]:
        """Return the options of every changed engine."""
        return {engine: dict(values) for engine, values in self._values.items()}

    def apply(self, engine: str, values: Mapping[str, Any]) -> None:
        """Show the options of an engine after a change, undo or redo."""
        self._values[engine] = dict(values)
        if self.name != engine:
            with QSignalBlocker(self.engine):
                self.engine.setCurrentIndex(self.engine.findData(engine))
        self._show_engine(engine)

    # -- reacting -----------------------------------------------------------------------------------------

    def _of(self, engine: str) -> dict[str, Any]:
        if engine not in self._values:
            self._values[engine] = get_engine(engine)().options()
        return self._values[engine]

    def _choose_engine(self) -> None:
        self._show_engine(self.name)

    def _show_engine(self, engine: str) -> None:
        values = self._of(engine)
        if engine != self._shown or not self._fields:
            self._shown = engine
            self._make_fields(engine)
        for name, field in self._fields.items():
            field.set_value(values[name])
        self._judge()
        self.changed.emit()

    def _edited(self) -> None:
        """Record a change by the user as one undoable step."""
        try:
            values = {name: field.value() for name, field in self._fields.items()}
        except UnusableInputError:
            self._judge()
            return
        before = self._of(self.name)
        changed = [name for name, value in values.items() if value != before.get(name)]
        if changed:
            self._stack.push(_Change(self, self.name, before, values, changed[0]))

    def _take_defaults(self) -> None:
        values = get_engine(self.name)().options()
        if values != self._of(self.name):
            self._stack.push(_Change(self, self.name, self._of(self.name), values, "defaults"))

    def _judge(self) -> None:
        try:
            self.options()
        except UnusableInputError as error:
            self.problem.setText(in_words(error))
        else:
            self.problem.clear()
        self.problem.setVisible(bool(self.problem.text()))

    # -- building -----------------------------------------------------------------------------------------

    def changeEvent(self, event: QEvent) -> None:  # noqa: N802
        """Apply a new palette to every field."""
        super().changeEvent(event)
        if event.type() == QEvent.Type.PaletteChange:
            for field in self._fields.values():
                field.setPalette(self.palette())

    def _make_fields(self, engine: str) -> None:
        while (item := self._fields_box.takeAt(0)) is not None:
            if (widget := item.widget()) is not None:
                widget.hide()
                widget.deleteLater()
        kind = get_engine(engine)
        self._fields = {}
        self.about.setText(_about(engine))
        for name, info in kind.model_fields.items():
            field = OptionField(name, info, self)
            field.setPalette(self.palette())  # a field that comes late does not get the page's colours by itself
            tip = f"<qt>{html.escape(_(info.description))}</qt>" if info.description else ""
            label = build.styled(QLabel(field.label), role="field", text_format=Qt.TextFormat.PlainText, tip=tip)
            for part in (label, field):
                self._fields_box.addWidget(part)
            field.edited.connect(self._edited)
            field.undone.connect(self._stack.undo)
            field.redone.connect(self._stack.redo)
            self._fields[name] = field
        buttons = self.defaults, self.undo, self.redo
        controls = [control for field in self._fields.values() for control in field.controls]
        order = self.engine, *controls, *buttons, self.input, self.output, self.together, *self.preparation.controls
        for before, after in pairwise(order):
            QWidget.setTabOrder(before, after)

    def _arrange(self) -> None:
        self._fields_box = build.column(spacing=2)
        signals = build.row((_field(_("Input"), self.input), 1), (_field(_("Output"), self.output), 1))
        content = build.column(
            self.about,
            self._fields_box,
            self.problem,
            build.row(self.defaults, self.undo, self.redo, spacing=4),
            signals,
            self.together,
            self.preparation,
            None,
            margins=(0, 0, 8, 0),
        )
        scroll = build.styled(
            QScrollArea(),
            widget=build.holder(content),
            widget_resizable=True,
            frame_shape=QFrame.Shape.NoFrame,
            horizontal_scroll_bar_policy=Qt.ScrollBarPolicy.ScrollBarAlwaysOff,
            focus_policy=Qt.FocusPolicy.NoFocus,
        )
        build.column(self.engine, (scroll, 1), spacing=4, parent=self)


class _Change(QUndoCommand):
    """Undoable change of options."""

    def __init__(
        self, form: EngineForm, engine: str, before: Mapping[str, Any], after: Mapping[str, Any], what: str
    ) -> None:
        super().__init__(f"{engine}: {what}")
        self._form, self._engine = form, engine
        self._before, self._after = dict(before), dict(after)

    def undo(self) -> None:
        """Restore the options before the change."""
        self._form.apply(self._engine, self._before)

    def redo(self) -> None:
        """Apply the change."""
        self._form.apply(self._engine, self._after)


def _about(engine: str) -> str:
    return _(get_engine(engine).title)


def _signals(name: str, offered: tuple[str, ...]) -> QComboBox:
    titles = {signal: signal_title(signal) for signal in offered}
    return build.choice(titles, characters=5, name=_("{name} of the model").format(name=name))


def _field(text: str, field: QWidget) -> QBoxLayout:
    """Return a field below its label."""
    return build.column(build.styled(QLabel(text), role="field"), field, spacing=2)
