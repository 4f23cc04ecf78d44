"""Parts of the form of a test: the stimulus with its live estimates, and the configuration with its probe."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from pydantic import BaseModel, Field
from PySide6.QtCore import Signal
from PySide6.QtWidgets import QComboBox, QLabel, QLineEdit, QWidget

from tissueid.acquisition.waveform_file import SUFFIXES, is_waveform
from tissueid.app import build
from tissueid.app.option_field import OptionField
from tissueid.configuration import PROBES
from tissueid.errors import UnusableInputError
from tissueid.language import _, marked
from tissueid.messages import translated
from tissueid.procedures.test_plan import LIVE_METHODS, SPECIFIED
from tissueid.stimuli import StimulusKind, get_stimulus, stimulus_names
from tissueid.stimuli.kinds.noise import Noise
from tissueid.test_settings import Circumstances, FilePlayback, SetUp, label_of, setting_of

FROM_FILE = "file"
MULTISTEP = "multistep"
TITLES = {MULTISTEP: marked("Equal depths, in steps"), FROM_FILE: marked("From a file")}
"""Titles of the choices that are no kinds of stimulus; a kind has its own title."""
DEPTHS = ("depth_min_m", "depth_max_m")
"""Options that are shown with the presets, above the settings."""
IN_FORM = (*SPECIFIED, "sample_rate")
"""Options that are fields of the plan, or that the instrument decides."""
_HURTING = ("binary",)
"""Distributions of noise that are not offered: its edges hurt (thesis 3.1.1)."""


class _Steps(BaseModel):
    """Options of a test in steps, as the command line has them."""

    steps: int = Field(3, ge=1, le=20, description=marked("Most tests; fewer where the depth is even before"))
    depth_min_m: float = Field(0.001, ge=-0.05, le=0.05, description=marked("Least desired depth from the surface, m"))
    depth_max_m: float = Field(0.004, ge=-0.05, le=0.05, description=marked("Greatest desired depth, m"))
    target: float = Field(0.05, gt=0.0, le=1.0, description=marked("Distance from evenness at which it is enough"))


_BETWEEN = re.compile(r"[;,]\s*(?=[^\d\s])")
_TARGET = re.compile(r"(\w+)[\s=:]+(\d+(?:[.,]\d+)?)\s*(%?)")


class StimulusForm(QWidget):
    """``changed`` is sent when the kind or one of its options is another; ``kind_changed`` for the kind alone.

    ``depths`` holds the fields of the range of depth, for a place of its own; hidden for kinds without one.
    """

    changed = Signal()
    kind_changed = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.kind = build.styled(QComboBox(), name=_("Stimulus"))
        self.kind.addItem(_(Noise.title), Noise.name)
        self.file = build.styled(
            QLineEdit(),
            placeholder_text=_("no file"),
            tip=_(
                "A saved stimulus, or a waveform in N: .csv, .txt or .npy with one column of "
                "values, or two of time and value"
            ),
            name=_("File of the stimulus"),
        )
        self.depths = QWidget()
        self._depths = build.grid(self.depths)
        self.browse = build.button(_("Browse…"), self._choose_file)
        self.stop_when = build.styled(
            QLineEdit(),
            placeholder_text=_("stiffness 2 %"),
            name=_("Stop at uncertainty"),
            tip=_("Standard deviation that is enough, as a share of the value: mass, damping, stiffness")
            + "\n"
            + _("such as stiffness 2 %; empty: to its end"),
        )
        self.live_method = build.choice(
            {name: _(title) for name, title in LIVE_METHODS.items()},
            name=_("Live response"),
            tip=_("Impulse response while the test runs. Sliding: least squares of the last 10 s, with a band.")
            + "\n"
            + _("Recursive: least squares of all samples. Adaptive: follows a response that changes with depth."),
        )
        self.controls: dict[str, OptionField] = {}
        self._grid = build.grid(self)
        self._saved = QWidget()
        build.row((self.file, 1), self.browse, parent=self._saved)
        self._stop_label = build.styled(QLabel(_("Stop at uncertainty")), word_wrap=True)
        self._grid.addWidget(QLabel(_("Stimulus")), 0, 0)
        self._grid.addWidget(self.kind, 0, 1)
        self._grid.addWidget(self._saved, 1, 0, 1, 2)
        self._grid.addWidget(self._stop_label, 2, 0)
        self._grid.addWidget(self.stop_when, 2, 1)
        self._live_label = build.styled(QLabel(_("Live response")), word_wrap=True)
        self._grid.addWidget(self._live_label, 3, 0)
        self._grid.addWidget(self.live_method, 3, 1)
        self._rows, self._fixed = self._grid.rowCount(), self._grid.count()
        self.kind.currentIndexChanged.connect(self._show_kind)
        self.file.textChanged.connect(self.update_shown)
        for line in (self.file, self.stop_when):
            line.textChanged.connect(self.changed)
        self.live_method.currentIndexChanged.connect(self.changed)
        self._show_kind()

    def offer_all(self) -> None:
        """Offer every kind. Finding them takes long, so it waits until one is to be chosen."""
        if self.kind.count() > 1:
            return
        names = [*(name for name in stimulus_names() if name != Noise.name), MULTISTEP, FROM_FILE]
        for name in names:
            self.kind.addItem(_(TITLES.get(name) or get_stimulus(name).title or name), name)

    @property
    def chosen(self) -> str:
        """The kind of stimulus, ``MULTISTEP`` or ``FROM_FILE``."""
        return str(self.kind.currentData())

    @property
    def has(self) -> frozenset[str]:
        """The names of the options that the kind takes."""
        if self.chosen == FROM_FILE:
            return frozenset()
        if self.chosen == MULTISTEP:
            return frozenset((*_Steps.model_fields, *IN_FORM))
        return frozenset(_model(self.chosen).model_fields)

    def options(self) -> tuple[tuple[str, Any], ...]:
        """The options of the kind that the form has no field for and that apply, SI; of noise, the unusual ones.

        Raises:
            UnusableInputError: what was typed does not read as one.
        """
        values = tuple((name, field.value()) for name, field in self.controls.items() if self._is_used(name))
        if self.chosen != Noise.name:
            return values
        unusual = self.changed_options()
        return tuple((name, value) for name, value in values if name in unusual)

    def changed_options(self) -> dict[str, Any]:
        """Return the options that apply and have not their usual value, without the depths; those that read as one."""
        changed = {}
        fields = _model(self.chosen).model_fields
        for name, field in self.controls.items():
            if name not in DEPTHS and self._is_used(name):
                try:
                    value = field.value()
                except UnusableInputError:
                    value = ...
                if value != fields[name].get_default() and not (value == [] and not fields[name].get_default()):
                    changed[name] = value
        return changed

    def values(self) -> dict[str, Any]:
        """The fields of ``TestPlan`` that stand here.

        Raises:
            UnusableInputError: what was typed does not read as an option, or no file is chosen.
        """
        if self.chosen == MULTISTEP:
            chosen = dict(self.options())
            depths_m = chosen["depth_min_m"], chosen["depth_max_m"]
            return {"multistep": chosen["steps"], "target": chosen["target"], "depth_range_m": depths_m}
        values: dict[str, Any] = {"live": True, "live_method": self.live_method.currentData()}
        values["stop_when"] = _targets(self.stop_when.text())
        if self.chosen == FROM_FILE:
            saved = self.file.text().strip()
            if not saved:
                raise UnusableInputError("plan.no_stimulus_file", "choose the file of the stimulus")
            return values | {"stimulus_file": Path(saved)} | dict(self.options())
        return values | {"stimulus": self.chosen, "options": self.options()}

    def fill(self, kind: str, options: dict[str, Any] | None = None) -> None:
        """Choose a kind, with options other than its usual ones."""
        self.offer_all()
        self.kind.setCurrentIndex(max(0, self.kind.findData(kind)))
        self._show_kind()
        for name, value in (options or {}).items():
            self.controls[name].set_value(value)
        self.update_shown()
        self.changed.emit()

    @property
    def fields(self) -> list[QWidget]:
        """What the tab key visits in the settings, in order, before the options of the kind."""
        return [self.kind, self.file, self.browse, self.stop_when, self.live_method]

    def option_fields(self, *, depths: bool) -> list[QWidget]:
        """Return the controls of the options of the kind, in order: those of the depths, or the others."""
        fields = (field for name, field in self.controls.items() if (name in DEPTHS) == depths)
        return [control for field in fields for control in field.controls]

    @property
    def _stops(self) -> bool:
        return self.chosen != MULTISTEP

    def _show_kind(self) -> None:
        for grid, kept in ((self._grid, self._fixed), (self._depths, 0)):
            while grid.count() > kept:
                item = grid.takeAt(grid.count() - 1)
                if item is not None and (widget := item.widget()) is not None:
                    widget.hide()
                    widget.deleteLater()
        self.controls = {}
        chosen = self.chosen
        self._saved.setVisible(chosen == FROM_FILE)
        for widget in (self._stop_label, self.stop_when, self._live_label, self.live_method):
            widget.setVisible(self._stops)
        for name, info in _model(chosen).model_fields.items():
            if name in IN_FORM:
                continue
            field = OptionField(name, info, without=_HURTING if chosen == Noise.name else ())
            field.edited.connect(self.update_shown)
            field.edited.connect(self.changed)
            grid, row = (self._depths, 0) if name in DEPTHS else (self._grid, self._rows)
            field.place(grid, row + len(self.controls))
            self.controls[name] = field
        self.depths.setVisible(any(name in DEPTHS for name in self.controls))
        self.update_shown()
        self.kind_changed.emit()
        self.changed.emit()

    def _is_used(self, name: str) -> bool:
        """Return whether an option applies with the other ones as they are."""
        if self.chosen == FROM_FILE:
            return name != "file_rate_hz" or is_waveform(Path(self.file.text().strip()))
        kind = _model(self.chosen)
        rule = kind.applies.get(name) if issubclass(kind, StimulusKind) else None
        return rule is None or self.controls[rule[0]].value() in rule[1]

    def update_shown(self) -> None:
        """Show the options that apply."""
        for name, field in self.controls.items():
            field.setVisible(self._is_used(name))

    def _choose_file(self) -> None:
        kinds = " ".join(f"*{suffix}" for suffix in (".json", *SUFFIXES))
        offered = f"{_('Stimuli and waveforms')} ({kinds});;{_('All files')} (*)"
        title, at = _("Choose the file of a stimulus"), self.file.text()
        build.ask_path(self, title, at, lambda path: self.file.setText(str(path)), offered)


def _model(kind: str) -> type[BaseModel]:
    """Return the model of the options of a choice, without looking for other kinds where it is noise."""
    if kind in (MULTISTEP, FROM_FILE):
        return _Steps if kind == MULTISTEP else FilePlayback
    return Noise if kind == Noise.name else get_stimulus(kind)


def _targets(text: str) -> tuple[str, ...]:
    """Return targets as they are typed, such as "stiffness 2 %, mass 3 %", as NAME=SHARE; the rule judges them."""
    parts = list(filter(None, map(str.strip, _BETWEEN.split(text))))
    if not parts:
        return ()
    from tissueid.identification.live.stopping import PARAMETERS  # takes long to import

    names = {_(name).casefold(): name for name in PARAMETERS}
    targets = []
    for part in parts:
        match = _TARGET.fullmatch(part)
        if match is None:
            targets.append(part)
            continue
        name, share, percent = match[1].casefold(), match[2].replace(",", "."), match[3]
        targets.append(
            f"{names.get(name, name)}={float(share) / 100.0:g}" if percent else f"{names.get(name, name)}={share}"
        )
    return tuple(targets)


_USUAL_SPRING_N_PER_M = 200.0
_WHAT = {
    "indentation": marked("The probe pushes into the tissue"),
    "extension": marked("The probe is stuck on and moves along the skin, which it stretches"),
    "surface": marked("The probe slides on the surface against an external spring, which is subtracted"),
}
_SET_UP = {**SetUp.model_fields, **Circumstances.model_fields}
_ELSEWHERE = ("probe", "minutes_since_application")
"""Settings with a control of their own."""


class ConfigurationChooser(QWidget):
    """Configuration, probe, and the settings of the configuration: only what goes together can be chosen.

    ``changed`` is sent whenever one of them has another value.
    """

    changed = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.settings = {name: OptionField(name, info) for name, info in _SET_UP.items() if name not in _ELSEWHERE}
        self.probe = build.styled(QComboBox(), name=_("Probe"))
        grid = build.grid(self, vertical_spacing=5, horizontal_spacing=8)
        grid.addWidget(build.styled(QLabel(_(label_of("probe"))), role="field", buddy=self.probe), 1, 0)
        grid.addWidget(self.probe, 1, 1)
        for index, (name, field) in enumerate(self.settings.items()):
            field.place(grid, index + bool(index), role="field", word_wrap=False)
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

    def values(self) -> dict[str, Any]:
        """Return the fields of a plan that are chosen here."""
        values = {
            name: field.value() if self._has(name) else _SET_UP[name].get_default()
            for name, field in self.settings.items()
        }
        return values | {"probe": self.probe.currentData()}

    def choose(self, probe: str | None = None, **values: Any) -> None:
        """Choose settings by their names, the default for others; the first probe of the configuration for None.

        Raises:
            KeyError: there is no such setting.
        """
        if unknown := values.keys() - self.settings.keys():
            raise KeyError(*unknown)
        for name, field in self.settings.items():
            field.set_value(values.get(name, _SET_UP[name].get_default()))
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
            field.setVisible(self._has(name))
        spring = self.settings["external_spring_n_per_m"]
        if self._has(spring.name) and not spring.value():
            spring.set_value(_USUAL_SPRING_N_PER_M)
        self.settings["configuration"].setToolTip(_(_WHAT.get(self.chosen, "")))
        self._describe()
        self.changed.emit()

    def _describe(self) -> None:
        if (probe := PROBES.get(self.probe.currentData())) is not None:
            self.probe.setToolTip(translated(probe.words))
