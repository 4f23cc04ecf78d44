"""Choosing how the instrument meets the tissue: configuration, probe, coupling, direction, and external spring."""

from __future__ import annotations

from typing import Any

from PySide6.QtWidgets import QComboBox, QGridLayout, QLabel, QWidget

from tissueid.app.number_field import NumberField
from tissueid.configuration import (
    CONFIGURATIONS,
    COUPLINGS,
    DIRECTIONS,
    INITIAL_LENGTHS_M,
    MOST_NORMAL_PRELOAD_N,
    PROBES,
    STIFFEST_SPRING_N_PER_M,
)
from tissueid.language import _, marked
from tissueid.messages import translated

_USUAL_SPRING_N_PER_M = 200.0
CONFIGURATION_NAMES = {
    "indentation": marked("Indentation"),
    "extension": marked("Extension"),
    "surface": marked("Surface (sliding)"),
}
_WHAT = {
    "indentation": marked("The probe pushes into the tissue"),
    "extension": marked("The probe is stuck on and moves along the skin, which it stretches"),
    "surface": marked("The probe slides on the surface against an external spring, which is subtracted"),
}
_COUPLED = {
    "none": marked("not attached"),
    "tape": marked("Double-sided tape"),
    "adhesive": marked("Glue or liquid bandage"),
}
_NAMED_DIRECTIONS = {
    DIRECTIONS["vertical"]: marked("vertical, along the limb"),
    DIRECTIONS["horizontal"]: marked("horizontal, across the limb"),
}
_ANGLES_DEG = (0, 15, 30, 45, 60, 75, 90, -75, -60, -45, -30, -15)
_NOT_RECORDED = marked("not recorded")


class ConfigurationChooser(QWidget):
    """Only what goes together can be chosen: each configuration has its own probes, and one of them a spring."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.name = QComboBox()
        self.name.setAccessibleName(_("Configuration"))
        for name in CONFIGURATIONS:
            self.name.addItem(_(CONFIGURATION_NAMES.get(name, name.capitalize())), name)
        self.probe = QComboBox()
        self.probe.setAccessibleName(_("Probe"))
        self.spring = NumberField()
        self.spring.setAccessibleName(_("External spring"))
        self.spring.setSuffix(" N/m")
        self.spring.setDecimals(0)
        self.spring.setRange(1.0, STIFFEST_SPRING_N_PER_M)
        self.spring.setSingleStep(50.0)
        self.spring.setValue(_USUAL_SPRING_N_PER_M)
        self._spring_label = QLabel(_("E&xternal spring"))
        self._spring_label.setBuddy(self.spring)
        self.coupling = QComboBox()
        self.coupling.setAccessibleName(_("Coupling"))
        self.coupling.setToolTip(_("What attaches the probe to the skin: only an attached probe can pull"))
        for coupling in COUPLINGS:
            self.coupling.addItem(_(_COUPLED[coupling]), coupling)
        self.orientation = QComboBox()
        self.orientation.setAccessibleName(_("Orientation"))
        self.orientation.setToolTip(_("Direction of the extension against the axis of the limb"))
        self.orientation.addItem(_(_NOT_RECORDED), None)
        for angle in _ANGLES_DEG:
            words = _(_NAMED_DIRECTIONS[angle]) if angle in _NAMED_DIRECTIONS else ""
            self.orientation.addItem(f"{angle}° {words}".rstrip(), float(angle))
        self.initial_length = _zero_unknown(" mm", 1e3 * INITIAL_LENGTHS_M[1], _("Initial length"))
        self.normal_preload = _zero_unknown(" N", MOST_NORMAL_PRELOAD_N, _("Normal preload"))
        probe_label = QLabel(_("&Probe"))
        probe_label.setBuddy(self.probe)
        grid = QGridLayout(self)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setHorizontalSpacing(8)
        grid.setVerticalSpacing(5)
        self._only: dict[QWidget, tuple[str, ...]] = {
            self.coupling: ("indentation", "extension"),
            self.orientation: ("extension",),
            self.initial_length: ("extension",),
            self.spring: ("surface",),
            self.normal_preload: ("surface",),
        }
        self._rows = (
            (QLabel(_("Configuration")), self.name),
            (probe_label, self.probe),
            (QLabel(_("Coupling")), self.coupling),
            (QLabel(_("Orientation")), self.orientation),
            (QLabel(_("Initial length")), self.initial_length),
            (self._spring_label, self.spring),
            (QLabel(_("Normal preload")), self.normal_preload),
        )
        for row, (label, field) in enumerate(self._rows):
            label.setProperty("role", "field")
            grid.addWidget(label, row, 0)
            grid.addWidget(field, row, 1)
        grid.setColumnStretch(1, 1)
        self.name.currentIndexChanged.connect(self._go_together)
        self.probe.currentIndexChanged.connect(self._describe)
        self._go_together()

    @property
    def fields(self) -> list[QWidget]:
        """The fields from top to bottom."""
        return [field for _label, field in self._rows]

    @property
    def chosen(self) -> str:
        """The name of the configuration."""
        return str(self.name.currentData())

    @property
    def probe_name(self) -> str:
        """The name of the probe."""
        return str(self.probe.currentData())

    @property
    def spring_n_per_m(self) -> float:
        """The external spring; zero where the configuration has none."""
        return self.spring.settled if self.chosen == "surface" else 0.0

    def values(self) -> dict[str, Any]:
        """Return the fields of a plan that say how the instrument meets the tissue."""
        length_mm = self._value(self.initial_length, self.initial_length.settled, 0.0)
        return {
            "configuration": self.chosen,
            "probe": self.probe_name,
            "external_spring_n_per_m": self.spring_n_per_m,
            "coupling": self._value(self.coupling, self.coupling.currentData(), "none"),
            "orientation_deg": self._value(self.orientation, self.orientation.currentData(), None),
            "initial_length_m": 1e-3 * length_mm if length_mm else None,
            "normal_preload_n": self._value(self.normal_preload, self.normal_preload.settled, 0.0) or None,
        }

    def choose(
        self,
        configuration: str,
        probe: str | None = None,
        coupling: str = "none",
        external_spring_n_per_m: float = 0.0,
        orientation_deg: float | None = None,
        initial_length_m: float | None = None,
        normal_preload_n: float | None = None,
    ) -> None:
        """Choose a configuration and what goes with it: the fields of :meth:`values`; its first probe for None."""
        self.name.setCurrentIndex(self.name.findData(configuration))
        self.probe.setCurrentIndex(0 if probe is None else self.probe.findData(probe))
        self.coupling.setCurrentIndex(self.coupling.findData(coupling))
        if self.orientation.findData(orientation_deg) < 0:
            self.orientation.addItem(f"{orientation_deg:g}°", orientation_deg)
        self.orientation.setCurrentIndex(self.orientation.findData(orientation_deg))
        if external_spring_n_per_m > 0.0:
            self.spring.setValue(external_spring_n_per_m)
        self.initial_length.setValue(1e3 * (initial_length_m or 0.0))
        self.normal_preload.setValue(normal_preload_n or 0.0)

    def _value(self, field: QWidget, value: Any, otherwise: Any) -> Any:
        return value if self.chosen in self._only[field] else otherwise

    def _go_together(self) -> None:
        """Offer the probes that are made for the configuration."""
        self.probe.clear()
        for probe in PROBES.values():
            if probe.configuration == self.chosen:
                self.probe.addItem(probe.name, probe.name)
        for label, field in self._rows:
            for widget in (label, field):
                widget.setVisible(self.chosen in self._only.get(field, CONFIGURATIONS))
        self.name.setToolTip(_(_WHAT.get(self.chosen, "")))
        self._describe()

    def _describe(self) -> None:
        if (probe := PROBES.get(str(self.probe.currentData()))) is not None:
            self.probe.setToolTip(translated(probe.words))


def _zero_unknown(unit: str, most: float, called: str) -> NumberField:
    field = NumberField()
    field.setAccessibleName(called)
    field.setToolTip(_("0: not recorded"))
    field.setSuffix(unit)
    field.setDecimals(1)
    field.setRange(0.0, most)
    return field
