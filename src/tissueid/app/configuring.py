"""Choosing how the instrument meets the tissue: configuration, probe, and the external spring where there is one."""

from __future__ import annotations

from PySide6.QtWidgets import QComboBox, QGridLayout, QLabel, QWidget

from tissueid.app.number_field import NumberField
from tissueid.configuration import CONFIGURATIONS, PROBES, STIFFEST_SPRING_N_PER_M
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
        probe_label = QLabel(_("&Probe"))
        probe_label.setBuddy(self.probe)
        grid = QGridLayout(self)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setHorizontalSpacing(8)
        grid.setVerticalSpacing(5)
        rows = ((QLabel(_("Configuration")), self.name), (probe_label, self.probe), (self._spring_label, self.spring))
        for row, (label, field) in enumerate(rows):
            label.setProperty("role", "field")
            grid.addWidget(label, row, 0)
            grid.addWidget(field, row, 1)
        grid.setColumnStretch(1, 1)
        self.name.currentIndexChanged.connect(self._go_together)
        self.probe.currentIndexChanged.connect(self._describe)
        self._go_together()

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

    def _go_together(self) -> None:
        """Offer the probes that are made for the configuration."""
        self.probe.clear()
        for probe in PROBES.values():
            if probe.configuration == self.chosen:
                self.probe.addItem(probe.name, probe.name)
        for widget in (self.spring, self._spring_label):
            widget.setVisible(self.chosen == "surface")
        self.name.setToolTip(_(_WHAT.get(self.chosen, "")))
        self._describe()

    def _describe(self) -> None:
        if (probe := PROBES.get(str(self.probe.currentData()))) is not None:
            self.probe.setToolTip(translated(probe.words))
