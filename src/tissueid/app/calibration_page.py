"""The page of calibrations: requirements, progress, verdict and figures."""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import (
    QCheckBox,
    QFrame,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QProgressBar,
    QPushButton,
    QSizePolicy,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
    QWidget,
)

from tissueid.app.calibration_state import figure_of
from tissueid.app.live_signals import Array
from tissueid.app.number_field import NumberField
from tissueid.app.operator_prompts import CalibrationOutcome, PromptState
from tissueid.app.plotting import PlotCard
from tissueid.app.small_window import FoldingBox, PageScroll
from tissueid.app.widgets import BigButton
from tissueid.app.words import sentence
from tissueid.calibration.file import Quantity
from tissueid.calibration.labels import headline_of, problems_of
from tissueid.language import _, marked
from tissueid.messages import translated
from tissueid.procedures.calibration_plans import Kind

_KINDS: dict[Kind, tuple[str, str, str]] = {
    "static": (
        marked("Static calibration"),
        marked(
            "Coil, force, position, range of motion, thermometer, accelerometer and supplies. Needs the "
            "calibration spring; without a motorised stage, instructions say what to put under the probe."
        ),
        marked("Begin static calibration"),
    ),
    "sweep": (
        marked("Dynamic sweep"),
        marked(
            "The calibration spring, identified along the stroke: the force constant by position, and where the coil "
            "is linear. Best after a static calibration."
        ),
        marked("Begin dynamic sweep"),
    ),
}
_CURVES: dict[Kind, tuple[str, str, str]] = {
    "static": (marked("Position on the spring"), marked("Current (A)"), "mm"),
    "sweep": (marked("Probe displacement per ampere"), marked("Position (mm)"), "mm/A"),
}
_MM = 1e3
_STEPS = 1000
_ROW = 22
_LEAST_CURVE = 140
_LEAST_TABLE = 120
_NO_POINTS: Array = np.zeros(0)
_TWO_COLUMNS = 650
_OPTIONS_IN_A_ROW = 380


class CalibrationPage(QWidget):
    """``begun`` carries the kind of calibration to start; ``answered`` confirms that an instruction was carried out."""

    begun = Signal(str)
    answered = Signal()
    report_wanted = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.begin: dict[Kind, QPushButton] = {}
        self.step = QLabel()
        self.step.setProperty("role", "muted")
        self.step.setWordWrap(True)
        self.step.setMinimumWidth(1)
        self.bar = QProgressBar()
        self.bar.setRange(0, _STEPS)
        self.bar.setTextVisible(False)
        self.bar.setAccessibleName(_("Progress of the calibration"))
        self.done = BigButton(_("Done, go on"))
        self.done.setProperty("role", "start")
        # Its height is its minimum: a layout without room for more would take the rest from wrapped labels.
        self.done.setSizePolicy(QSizePolicy.Policy.Minimum, QSizePolicy.Policy.Fixed)
        self.done.setToolTip(_("Return does the same; Space and Escape stop"))
        self.done.clicked.connect(self.answered)
        self.done.hide()
        self.headline = QLabel()
        self.headline.setProperty("role", "headline")
        self.headline.setWordWrap(True)
        self.said = QLabel()
        self.said.setWordWrap(True)
        self.said.setMinimumWidth(1)
        self.said.setTextFormat(Qt.TextFormat.PlainText)
        self.said.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self._has_report = False
        self.report = QPushButton(_("Open its report"))
        self.report.clicked.connect(self.report_wanted)
        self._figures: dict[str, Quantity] = {}
        self.figures = QTableWidget(0, 3)
        self.figures.setHorizontalHeaderLabels([_("Quantity"), _("Value"), _("Unit")])
        self.figures.setAccessibleName(_("Figures of the calibration"))
        self.figures.verticalHeader().hide()
        self.figures.setEditTriggers(QTableWidget.EditTrigger.NoEditTriggers)
        self.figures.setSelectionMode(QTableWidget.SelectionMode.NoSelection)
        self.figures.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.figures.setShowGrid(False)
        # No preferred height above the minimum: a layout without room for that takes the rest from wrapped labels.
        self.figures.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Ignored)
        self.figures.setMinimumHeight(_LEAST_TABLE)
        header = self.figures.horizontalHeader()
        header.setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        header.setStretchLastSection(True)
        header.setDefaultAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter)
        self.figures.verticalHeader().setDefaultSectionSize(_ROW)
        self.fixed = QCheckBox(_("Spring fixed to the probe"))
        self.fixed.setChecked(True)
        self.fixed.setToolTip(_("Without it the probe only leans on the spring, and is pushed and never pulled"))
        self.room_known = QCheckBox(_("Room at"))
        self.room = NumberField()
        self.room.setAccessibleName(_("Temperature of the room"))
        self.room.setSuffix(" °C")
        self.room.setDecimals(1)
        self.room.setRange(-10.0, 50.0)
        self.room.setValue(22.0)
        self.room.setEnabled(False)
        self.room_known.toggled.connect(self.room.setEnabled)
        self.curve = PlotCard("", "", "mm")
        self.curve.setMinimumHeight(_LEAST_CURVE)
        self._shown = -1
        self._points = self.curve.dots("measured", 6)
        self._kind: Kind = "static"
        self._result = self._make_result()
        content = QWidget()
        layout = QVBoxLayout(content)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(8)
        self._choices = QWidget()
        choices = FoldingBox(_TWO_COLUMNS, self._choices)
        choices.setContentsMargins(0, 0, 0, 0)
        choices.setSpacing(8)
        for kind in _KINDS:
            choices.addWidget(self._make_choice(kind), 1)
        layout.addWidget(self._result, 1)
        layout.addWidget(self._choices)
        layout.addWidget(self._make_progress())
        layout.addWidget(self.curve, 1)
        self._layout = layout
        layout.addStretch()
        whole = QVBoxLayout(self)
        whole.setContentsMargins(0, 0, 0, 0)
        self._scroll = PageScroll(content)
        whole.addWidget(self._scroll)
        self.clear()
        self._show_result(False)

    @property
    def fields(self) -> list[QWidget]:
        """Controls in the order of the tab key."""
        first = [self.fixed, self.room_known, self.room, self.begin["static"]]
        return [*first, self.begin["sweep"], self.done, self.report]

    @property
    def ambient_c(self) -> float | None:
        """Temperature of the room, °C; None if it is not known."""
        return self.room.settled if self.room_known.isChecked() else None

    def expect(self, kind: Kind) -> None:
        """Show progress and curve of a starting calibration in place of the choices."""
        self._show_result(False)
        self._choices.hide()
        self.step.setText(_("{kind}: connecting to the instrument.").format(kind=_(_KINDS[kind][0])))
        self.bar.setValue(0)
        title, below, unit = _CURVES[kind]
        self._kind = kind
        self.curve.retitle(_(title), unit)
        self.curve.relabel(_(below))
        self.show_curve(_NO_POINTS, _NO_POINTS)
        self.curve.show()

    def show_curve(self, x: Array, y: Array) -> None:
        """Draw the curve so far: ``x`` and ``y`` in SI units, shape (n,)."""
        if x.size != self._shown:
            self._shown = x.size
            self._points.setData(x * (1.0 if self._kind == "static" else _MM), y * _MM)

    def clear(self) -> None:
        """Show that no calibration is running."""
        self._choices.show()
        self.bar.setValue(0)
        self.step.setText(_("No calibration is running."))
        self.done.hide()

    def update_enabled(self, *, busy: bool) -> None:
        """Enable what makes sense."""
        for button in self.begin.values():
            button.setEnabled(not busy)
        self.fixed.setEnabled(not busy)
        self.room_known.setEnabled(not busy)
        self.room.setEnabled(not busy and self.room_known.isChecked())
        self.report.setEnabled(not busy and self._has_report)

    def show_prompts(self, state: PromptState) -> None:
        """Show the state of a running calibration, and a button where the person has to confirm."""
        if state.step:
            self.step.setText(sentence(translated(state.step)))
        self.bar.setValue(round(_STEPS * state.fraction))
        asked = state.answer
        if asked and self.done.isHidden():
            self.done.show()
            self.done.setFocus(Qt.FocusReason.ShortcutFocusReason)
        elif not asked:
            self.done.hide()

    def show_outcome(self, outcome: CalibrationOutcome) -> None:
        """Show verdict, figures and remarks."""
        self.clear()
        calibration = outcome.calibration
        self.headline.setText(sentence(translated(headline_of(calibration))))
        level = "good" if calibration.verdict == "passed" else "poor"
        for widget in (self._result, self.headline):
            widget.setProperty("level", level)
            widget.style().unpolish(widget)
            widget.style().polish(widget)
        lines = [sentence(translated(line)) for line in (*problems_of(calibration), *outcome.remarks)]
        self.said.setText("\n".join([*lines, _("Saved in {path}.").format(path=outcome.path)]))
        self._has_report = outcome.report is not None
        self._figures = calibration.quantities
        self.take_units()
        self._show_result(True)
        self._scroll.verticalScrollBar().setValue(0)

    def take_units(self) -> None:
        """Show the figures in the active units."""
        self.figures.setRowCount(len(self._figures))
        for row, (name, quantity) in enumerate(self._figures.items()):
            for column, text in enumerate(figure_of(name, quantity)):
                item = QTableWidgetItem(text)
                if column == 1:
                    item.setTextAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
                self.figures.setItem(row, column, item)

    def _show_result(self, there: bool) -> None:
        """Show or hide the result, which takes all available height."""
        self._result.setVisible(there)
        self.curve.setVisible(False)
        self._layout.setStretch(self._layout.count() - 1, 0 if there else 1)

    # -- building -----------------------------------------------------------------------------------------

    def _make_choice(self, kind: Kind) -> QFrame:
        title, words, begin = (_(text) for text in _KINDS[kind])
        card = QFrame()
        card.setProperty("role", "card")
        heading = QLabel(title)
        heading.setProperty("role", "headline")
        about = QLabel(words)
        about.setProperty("role", "muted")
        about.setWordWrap(True)
        about.setMinimumWidth(1)
        about.setAlignment(Qt.AlignmentFlag.AlignTop)
        button = QPushButton(begin)
        button.clicked.connect(lambda: self.begun.emit(kind))
        self.begin[kind] = button
        options = FoldingBox(_OPTIONS_IN_A_ROW)
        if kind == "static":
            room = QHBoxLayout()
            for widget in (self.room_known, self.room):
                room.addWidget(widget)
            room.addStretch(1)
            options.addWidget(self.fixed)
            options.addLayout(room, 1)
        below = QHBoxLayout()
        below.addWidget(button)
        below.addStretch(1)
        layout = QVBoxLayout(card)
        layout.setContentsMargins(12, 8, 12, 10)
        layout.addWidget(heading)
        layout.addWidget(about, 1)
        layout.addLayout(options)
        layout.addLayout(below)
        return card

    def _make_progress(self) -> QFrame:
        card = QFrame()
        card.setProperty("role", "card")
        card.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Maximum)
        words = QVBoxLayout()
        words.addWidget(self.step)
        words.addWidget(self.bar)
        layout = FoldingBox(_OPTIONS_IN_A_ROW, card)
        layout.setContentsMargins(12, 8, 12, 10)
        layout.addLayout(words, 1)
        layout.addWidget(self.done)
        return card

    def _make_result(self) -> QFrame:
        frame = QFrame()
        frame.setProperty("role", "verdict")
        top = QHBoxLayout()
        top.addWidget(self.headline, 1)
        top.addWidget(self.report)
        layout = QVBoxLayout(frame)
        layout.setContentsMargins(12, 6, 10, 8)
        layout.addLayout(top)
        layout.addWidget(self.said)
        layout.addWidget(self.figures, 1)
        return frame
