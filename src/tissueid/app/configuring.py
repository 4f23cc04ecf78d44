"""Choosing what is set for a test: configuration, probe, and the settings that go with the configuration."""

from __future__ import annotations

from typing import Any

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QComboBox, QGridLayout, QLabel, QWidget

from tissueid.app import build
from tissueid.app.option_field import OptionField
from tissueid.configuration import PROBES
from tissueid.language import _, marked
from tissueid.messages import translated
from tissueid.test_settings import Circumstances, SetUp, label_of, setting_of

_USUAL_SPRING_N_PER_M = 200.0
CONFIGURATION_NAMES: dict[str, str] = dict(setting_of("configuration").choices)
_WHAT = {
    "indentation": marked("The probe pushes into the tissue"),
    "extension": marked("The probe is stuck on and moves along the skin, which it stretches"),
    "surface": marked("The probe slides on the surface against an external spring, which is subtracted"),
}
_DECLARED = {**SetUp.model_fields, **Circumstances.model_fields}
_ELSEWHERE = ("probe", "minutes_since_application")
"""Settings with a control of their own."""


class ConfigurationChooser(QWidget):
    """Only what goes together can be chosen: each configuration has its own probes and settings.

    ``changed`` is sent whenever one of them has another value.
    """

    changed = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.settings = {name: OptionField(name, info) for name, info in _DECLARED.items() if name not in _ELSEWHERE}
        self.probe = build.styled(QComboBox(), name=_("Probe"))
        grid = QGridLayout(self)
        grid.setContentsMargins(0, 0, 0, 0)
        build.styled(grid, horizontal_spacing=8, vertical_spacing=5)
        grid.setColumnStretch(1, 1)
        self._labels: dict[str, QLabel] = {}
        rows: dict[str, QWidget] = {"configuration": self.settings["configuration"], "probe": self.probe}
        for row, (name, control) in enumerate((rows | self.settings).items()):
            label = build.styled(
                QLabel(_(label_of(name))),
                role="field",
                buddy=control.controls[0] if isinstance(control, OptionField) else control,
            )
            grid.addWidget(label, row, 0)
            grid.addWidget(control, row, 1)
            self._labels[name] = label
        for name, field in self.settings.items():
            field.set_value(_DECLARED[name].get_default())
            field.edited.connect(self._go_together if name == "configuration" else self.changed)
        self.probe.currentIndexChanged.connect(self._describe)
        self._go_together()

    @property
    def fields(self) -> list[QWidget]:
        """The controls from top to bottom."""
        first, *others = self.settings.values()
        return [*first.controls, self.probe, *(control for field in others for control in field.controls)]

    @property
    def chosen(self) -> str:
        """The name of the configuration."""
        return str(self.settings["configuration"].value())

    @property
    def probe_name(self) -> str:
        """The name of the probe."""
        return str(self.probe.currentData())

    def values(self) -> dict[str, Any]:
        """Return the fields of a plan that are chosen here."""
        values: dict[str, Any] = {"probe": self.probe_name}
        for name, field in self.settings.items():
            values[name] = field.value() if self._has(name) else _DECLARED[name].get_default()
        return values

    def choose(self, probe: str | None = None, **values: Any) -> None:
        """Choose settings by their names, the default for others; the first probe of the configuration for None.

        Raises:
            KeyError: there is no such setting.
        """
        if unknown := values.keys() - self.settings.keys():
            raise KeyError(*unknown)
        for name, field in self.settings.items():
            field.set_value(values.get(name, _DECLARED[name].get_default()))
        self._go_together()
        self.probe.setCurrentIndex(0 if probe is None else self.probe.findData(probe))

    def _has(self, name: str) -> bool:
        """Return whether the chosen configuration has a setting."""
        only = setting_of(name).only
        return not only or self.chosen in only

    def _go_together(self) -> None:
        """Offer the probes and the settings of the configuration."""
        self.probe.clear()
        for probe in PROBES.values():
            if probe.configuration == self.chosen:
                self.probe.addItem(probe.name, probe.name)
        for name, field in self.settings.items():
            for widget in (self._labels[name], field):
                widget.setVisible(self._has(name))
        spring = self.settings["external_spring_n_per_m"]
        if self._has("external_spring_n_per_m") and not spring.value():
            spring.set_value(_USUAL_SPRING_N_PER_M)
        self.settings["configuration"].setToolTip(_(_WHAT.get(self.chosen, "")))
        self._describe()
        self.changed.emit()

    def _describe(self) -> None:
        if (probe := PROBES.get(self.probe_name)) is not None:
            self.probe.setToolTip(translated(probe.words))
