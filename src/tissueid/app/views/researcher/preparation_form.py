"""Controls for what is done to the signals before a fit, and for the parameters of the tissue alone."""

from __future__ import annotations

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QCheckBox, QGridLayout, QLabel, QWidget

from tissueid.app import build
from tissueid.app.number_field import NumberField
from tissueid.app.views.researcher.analysis_task import Preparation
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
        layout = QGridLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setVerticalSpacing(2)
        for column, edge in enumerate((self.low, self.high)):
            label = build.styled(QLabel(edge.accessibleName()), role="field")
            layout.addWidget(label, 0, column)
            layout.addWidget(edge, 1, column)
            layout.setColumnStretch(column, 1)
        layout.addWidget(self.detrend, 2, 0, 1, 2)
        layout.addWidget(self.tissue_alone, 3, 0, 1, 2)

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
        edge.setRange(0.0, _HIGHEST_HZ)
        edge.setDecimals(2)
        edge.setSuffix(" Hz")
        edge.setSpecialValueText(_("no limit"))
        edge.setMinimumWidth(_NARROW)
        edge.setAccessibleName(label)
        edge.setToolTip(what)
        edge.valueChanged.connect(self.changed)
        return edge
