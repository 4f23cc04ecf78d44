"""The page of calibrations: requirements, progress, verdict and figures."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import (
    QCheckBox,
    QFrame,
    QLabel,
    QProgressBar,
    QPushButton,
    QSizePolicy,
    QTableWidget,
    QTableWidgetItem,
    QWidget,
)

from tissueid.app import build
from tissueid.app.live_signals import Array
from tissueid.app.number_field import NumberField
from tissueid.app.plotting import PlotCard
from tissueid.app.small_window import FoldingBox, PageScroll
from tissueid.app.widgets import BigButton
from tissueid.app.words import CalibrationState, figure_of, sentence
from tissueid.calibration.file import CalibratedQuantity, Calibration
from tissueid.calibration.status import headline_of, problems_of
from tissueid.device import DeviceDescription
from tissueid.language import _, marked
from tissueid.messages import translated
from tissueid.procedures.calibration_plans import Kind


@dataclass(frozen=True)
class CalibrationOutcome:
    """The result. ``remarks`` are further messages, ``state`` is the new state of the instrument's calibration.

    ``nominal`` is the instrument as it answered, without a calibration.

    ``report`` is None if it could not be written; the calibration is valid without it.
    """

    calibration: Calibration
    path: Path
    report: Path | None
    remarks: tuple[str, ...]
    state: CalibrationState = field(default_factory=CalibrationState)
    nominal: DeviceDescription | None = None


@dataclass(frozen=True)
class PromptState:
    """State of a running calibration: its step, the fraction done, and the instruction to the person.

    With ``answer`` the person has to confirm that it is done; otherwise the instrument detects it.
    """

    step: str = ""
    fraction: float = 0.0
    instruction: str = ""
    answer: bool = False


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
        self.step = build.styled(QLabel(), role="muted", word_wrap=True, minimum_width=1)
        self.bar = build.styled(
            QProgressBar(), range=(0, _STEPS), text_visible=False, name=_("Progress of the calibration")
        )
        self.done = build.styled(BigButton(_("Done, go on")), role="start", clicked=self.answered)
        # Its height is its minimum: a layout without room for more would take the rest from wrapped labels.
        self.done.setSizePolicy(QSizePolicy.Policy.Minimum, QSizePolicy.Policy.Fixed)
        self.done.setToolTip(_("Return does the same; Space and Escape stop"))
        self.done.hide()
        self.headline = build.styled(QLabel(), role="headline", word_wrap=True)
        self.said = build.label()
        self._has_report = False
        self.report = build.button(_("Open its report"), self.report_wanted)
        self._figures: dict[str, CalibratedQuantity] = {}
        self.figures = build.table([_("Quantity"), _("Value"), _("Unit")], _("Figures of the calibration"), _ROW)
        build.styled(
            self.figures,
            word_wrap=True,
            selection_mode=QTableWidget.SelectionMode.NoSelection,
            focus_policy=Qt.FocusPolicy.NoFocus,
            minimum_height=_LEAST_TABLE,
        )
        # No preferred height above the minimum: a layout without room for that takes the rest from wrapped labels.
        self.figures.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Ignored)
        self.figures.horizontalHeader().setStretchLastSection(True)
        self.fixed = build.styled(
            QCheckBox(_("Spring fixed to the probe")),
            checked=True,
            tip=_("Without it the probe only leans on the spring, and is pushed and never pulled"),
        )
        self.room_known = QCheckBox(_("Room at"))
        self.room = NumberField()
        build.styled(self.room, name=_("Temperature of the room"), suffix=" °C", decimals=1, range=(-10.0, 50.0))
        self.room.setValue(22.0)
        self.room.setEnabled(False)
        self.room_known.toggled.connect(self.room.setEnabled)
        self.curve = build.styled(PlotCard("", "", "mm"), minimum_height=_LEAST_CURVE)
        self._shown = -1
        self._points = self.curve.dots("measured", 6)
        self._kind: Kind = "static"
        self._result = self._make_result()
        content = QWidget()
        self._choices = QWidget()
        build.fill(
            FoldingBox(_TWO_COLUMNS, self._choices), *[(self._make_choice(kind), 1) for kind in _KINDS], spacing=8
        )
        layout = build.column(
            (self._result, 1), self._choices, self._make_progress(), (self.curve, 1), spacing=8, parent=content
        )
        self._layout = layout
        layout.addStretch()
        self._scroll = PageScroll(content)
        build.column(self._scroll, parent=self)
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
            build.restyle(widget, level=level)
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
        title, description, begin = (_(text) for text in _KINDS[kind])
        card = build.styled(QFrame(), role="card")
        heading = build.styled(QLabel(title), role="headline")
        about = build.styled(
            QLabel(description), role="muted", word_wrap=True, minimum_width=1, alignment=Qt.AlignmentFlag.AlignTop
        )
        button = QPushButton(begin)
        button.clicked.connect(lambda: self.begun.emit(kind))
        self.begin[kind] = button
        options = FoldingBox(_OPTIONS_IN_A_ROW)
        if kind == "static":
            room = build.row(self.room_known, self.room, None, spacing=None)
            options.addWidget(self.fixed)
            options.addLayout(room, 1)
        build.column(heading, (about, 1), options, build.row(button, None), margins=(12, 8, 12, 10), parent=card)
        return card

    def _make_progress(self) -> QFrame:
        card = build.styled(
            QFrame(), role="card", size_policy=(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Maximum)
        )
        build.fill(
            FoldingBox(_OPTIONS_IN_A_ROW, card),
            (build.column(self.step, self.bar), 1),
            self.done,
            margins=(12, 8, 12, 10),
        )
        return card

    def _make_result(self) -> QFrame:
        frame = build.styled(QFrame(), role="verdict")
        build.column(
            build.row((self.headline, 1), self.report),
            self.said,
            (self.figures, 1),
            margins=(12, 6, 10, 8),
            parent=frame,
        )
        return frame
