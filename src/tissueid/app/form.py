"""The form of one test: instrument, subject, site, limits, stimulus, and where to save."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from datetime import datetime
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QKeyEvent
from PySide6.QtWidgets import (
    QAbstractButton,
    QCheckBox,
    QComboBox,
    QFileDialog,
    QGridLayout,
    QLabel,
    QLayout,
    QLineEdit,
    QToolButton,
    QVBoxLayout,
    QWidget,
)

from tissueid.app.build import button, column, fill, label, row, styled
from tissueid.app.chooser import InstrumentChooser
from tissueid.app.configuring import ConfigurationChooser
from tissueid.app.form_choices import (
    DISTRIBUTIONS,
    MULTISTEP,
    SITES,
    longest_stimulus_s,
)
from tissueid.app.number_field import NumberField, OptionalNumberField, WholeNumberField
from tissueid.app.presets import PresetChooser
from tissueid.app.stimulus_form import StimulusForm
from tissueid.app.user_files import dated_path
from tissueid.audit import Role
from tissueid.formatting import ANONYMOUS
from tissueid.instrument import PROFILES
from tissueid.language import _, marked
from tissueid.messages import Message, Verbatim, translated
from tissueid.procedures.pseudonyms import reads_like_name
from tissueid.procedures.test_plan import TestPlan
from tissueid.procedures.test_presets import PRESETS, Preset
from tissueid.stimuli.kinds.noise import Noise
from tissueid.test_settings import SECONDS, USUAL_FORCE_N, USUAL_SECONDS, USUAL_SEED

_CALLED = {
    "clinical": marked("Clinical"),
    "research": marked("Research"),
    "gaussian": marked("Gaussian"),
    "uniform": marked("Uniform"),
    "rayleigh": marked("Rayleigh"),
    "exponential": marked("Exponential"),
    "quantiles": marked("By a table"),
}
_LIKE_NAME = marked(
    "This looks like a person's name. Use a pseudonym, such as P-001: files and reports contain this text."
)
_UNDER_PROBE = {
    "": marked("Tissue or sample"),
    "spring": marked("Calibration spring"),
    "free_air": marked("Nothing: free air"),
}
_USUAL_DISTRIBUTION = Noise.model_fields["distribution"].default
_MOST_REPEATS = 20
_MOST_MINUTES = 1e6
_MINUTES_WIDTH = 96
"""Pixels."""
_MOST_SEED = 2**31 - 1


class PlanForm(QWidget):
    """The fields of a test plan; :meth:`plan` returns it. Return in one of them goes to the next one.

    ``changed`` is sent whenever one of them has another value.
    """

    changed = Signal()
    subject_chosen = Signal(str)
    """Another pseudonym was typed in full, or filled in."""

    def __init__(self, folder: Path, now: Callable[[], datetime], parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.folder = folder
        self._now = now
        self._own_path = False
        self._own_force = False
        self._applying = self._plain = False
        self._usual_force_n = USUAL_FORCE_N[1]
        self._forces_n: dict[str, float] = {}
        self.instrument = InstrumentChooser()
        self.subject = styled(
            QLineEdit(), placeholder_text=_("such as P-001; empty: anonymous"), tip=_("A pseudonym, never a name")
        )
        self.like_name = label("readout", level="check", text=_(_LIKE_NAME))
        self.is_pseudonym = QCheckBox(_("This is a pseudonym, not a name"))
        for part in (self.like_name, self.is_pseudonym):
            part.hide()
        self.product = styled(
            QLineEdit(),
            placeholder_text=_("such as lotion"),
            tip=_("The product on the skin, for studies that compare conditions"),
        )
        self.minutes = OptionalNumberField(_MOST_MINUTES)
        styled(
            self.minutes,
            suffix=" min",
            fixed_width=_MINUTES_WIDTH,
            name=_("Minutes since the application"),
            tip=_("Minutes since the application of the product; empty: not recorded"),
        )
        self.site = styled(QComboBox(), editable=True, insert_policy=QComboBox.InsertPolicy.NoInsert)
        # What is typed is meant: "left forearm" is not yet its posterior side.
        self.site.setCompleter(None)  # type: ignore[arg-type]
        self.site.addItems(list(SITES))
        self.site.setCurrentIndex(-1)
        if (line := self.site.lineEdit()) is not None:
            line.setPlaceholderText(_("such as left calf"))
        self.map = button(_("Body map…"), tip=_("Choose the site on a drawn body"))
        self.set_up = ConfigurationChooser()
        self.limits = QComboBox()
        for name in sorted(PROFILES):
            self.limits.addItem(
                _("{profile}: up to {force:g} N").format(
                    profile=_(_CALLED.get(name, name.capitalize())), force=PROFILES[name].max_force_n
                ),
                name,
            )
        self.path = QLineEdit()
        self.browse = button(_("C&hoose…"), self._choose_path, name=_("Choose where to save"))

        self.other_test = label(
            "muted", text=_("For the next test. The result that is shown is of another test."), hidden=True
        )
        layout = QVBoxLayout(self)
        fill(layout, self.other_test, spacing=10)
        _add(layout, _("&Instrument"), self.instrument, focus=self.instrument.choice)
        _add(layout, _("Si&te"), row((self.site, 1), self.map), focus=self.site)
        _add(layout, _("Su&bject (a pseudonym, never a name)"), self.subject, focus=self.subject)
        layout.addWidget(self.like_name)
        layout.addWidget(self.is_pseudonym)
        condition = row((self.product, 1), self.minutes)
        _add(layout, _("Condition (product on the skin)"), condition, focus=self.product)
        layout.addWidget(self.set_up)
        self._limits_label = _add(layout, _("&Limits"), self.limits, focus=self.limits)
        self._add_settings(layout)
        _add(layout, _("Sa&ve to"), row((self.path, 1), self.browse), focus=self.path)
        layout.addStretch(1)

        texts = (self.subject.textChanged, self.product.textChanged, self.path.textChanged)
        for edited in (self.site.editTextChanged, *texts):
            edited.connect(self.changed)
        self.product.textChanged.connect(self._look_at_product)
        self._look_at_product()
        for chosen in (self.instrument.choice.currentTextChanged, self.limits.currentIndexChanged):
            chosen.connect(self.changed)
        for field in (self.min_force, self.max_force, self.seconds, self.minutes):
            field.valueChanged.connect(self.changed)
        self.set_up.changed.connect(self.changed)
        self.subject.textChanged.connect(self._look_at_subject)
        self.subject.editingFinished.connect(self._choose_subject)
        self.set_up.changed.connect(self._show_set_up)
        self._chosen_subject = ""
        self.limits.currentIndexChanged.connect(self._apply_limits)
        self.instrument.choice.currentTextChanged.connect(self._apply_limits)
        self.max_force.valueChanged.connect(self._take_own_force)
        self.path.setPlaceholderText(_("empty: a name by date and time"))
        self.path.textEdited.connect(self.take_own_path)
        self.path.editingFinished.connect(self._name_by_date)
        _select(self.limits, "clinical")
        self._apply_limits()
        self.renew_path()

    def plan(self) -> TestPlan:
        """Return the plan of the fields. A dated file name gets the current time.

        Raises:
            UnusableInputError: a field does not hold a valid value.
        """
        if not self._own_path:
            self.renew_path()
        has = self.stimulus.has
        noise = self.stimulus.chosen == Noise.name
        return TestPlan(
            url=self.instrument.url,
            site=self.site.currentText().strip(),
            out=Path(self.path.text().strip()),
            subject=self.subject.text().strip() or ANONYMOUS,
            pseudonym_confirmed=self.is_pseudonym.isChecked(),
            condition=(product := self.product.text().strip()),
            minutes_since_application=self.minutes.given if product else None,
            limits=self.limits.currentData(),
            distribution=self.distribution.currentData() if noise else None,
            min_force_n=self.min_force.settled if "force_min_n" in has else None,
            max_force_n=self.max_force.settled if "force_max_n" in has else None,
            seconds=self.seconds.settled if "seconds" in has else None,
            seed=self.seed.value() if "seed" in has else None,
            lower_force=not self._own_force,
            repeats=1 if self.repeats.isHidden() else self.repeats.value(),
            rest_s=0.0 if self.rest.isHidden() else self.rest.settled,
            kind=None if self.under_probe.isHidden() else self.under_probe.currentData() or None,
            **self.set_up.values(),
            **self.stimulus.values(),
        )

    def tell_force(self, url: str, greatest_n: float) -> None:
        """Apply the maximum force of the instrument at ``url``, N."""
        if self._forces_n.get(url) != greatest_n:
            self._forces_n[url] = greatest_n
            self._apply_limits()

    def show_other_test(self, other: bool) -> None:
        """Show whether the displayed result belongs to another test than the form."""
        self.other_test.setVisible(other)

    def renew_path(self) -> None:
        """Change to an unused file name in the same folder."""
        if self._own_path:
            self.folder = Path(self.path.text().strip()).parent
        self._own_path = False
        self.path.setText(str(dated_path(self.folder, self._now())))
        self.path.setToolTip(self.path.text())
        self.path.setCursorPosition(len(self.path.text()))

    def save_in(self, folder: Path) -> None:
        """Save the next sessions in a folder, named by date and time."""
        self._own_path, self.folder = False, folder
        self.renew_path()

    def fill(self, values: Mapping[str, Any]) -> None:
        """Fill fields by their names; the others stay.

        Raises:
            KeyError: the form has no such field.
        """
        fields: dict[str, Callable[[Any], object]] = {
            "url": self.instrument.choose,
            "site": self.site.setEditText,
            "pseudonym": self.subject.setText,
            "condition": self.product.setText,
            "minutes_since_application": self.minutes.give,
            "preset": self._fill_preset,
            "limits": partial(_select, self.limits),
            "distribution": partial(_select, self.distribution),
            "min_force_n": self.min_force.setValue,
            "max_force_n": self.max_force.setValue,
            "seconds": self.seconds.setValue,
            "seed": self.seed.setValue,
            "stimulus_kind": self.stimulus.fill,
            "repeats": self.repeats.setValue,
            "under_probe": partial(_select, self.under_probe),
        }
        if settings := {name: value for name, value in values.items() if name not in fields}:
            self.set_up.choose(**settings)
        for name, value in values.items():
            if name in fields:
                fields[name](value)
        self._choose_subject()

    def keyPressEvent(self, event: QKeyEvent) -> None:  # noqa: N802
        """Go to the next field at Return, where a field does not use it."""
        if event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter):
            self.go_on()
            return
        super().keyPressEvent(event)

    def go_on(self) -> None:
        """Set the focus to the next field of the form; the last one keeps it. Buttons are passed over."""
        at = self.focusWidget()
        after = None if at is None else at.nextInFocusChain()
        while after is not None and after is not at:
            tabbed = bool(after.focusPolicy() & Qt.FocusPolicy.TabFocus) and after.focusProxy() is None
            if tabbed and after.isVisible() and after.isEnabled():
                if not self.isAncestorOf(after):
                    return
                if not isinstance(after, QAbstractButton):
                    after.setFocus(Qt.FocusReason.TabFocusReason)
                    return
            after = after.nextInFocusChain()

    def show_role(self, role: Role) -> None:
        """Fold more of the settings away for a clinician."""
        self._plain = role == "clinician"
        self._unfold(self.fold.isChecked())

    def order_options(self) -> None:
        """Put the options of the stimulus into the order of the tab key, where they stand."""
        around = (
            [self.preset.choice, *self.stimulus.option_fields(depths=True)],
            [self.stimulus.live_method, *self.stimulus.option_fields(depths=False)],
        )
        for order in around:
            for before, after in pairwise(order):
                QWidget.setTabOrder(before, after)

    # -- building -----------------------------------------------------------------------------------------

    def _add_settings(self, layout: QVBoxLayout) -> None:
        """The presets, and the stimulus, folded away under a line that says what it is."""
        self.preset = PresetChooser()
        _add(layout, _("Test"), self.preset, focus=self.preset.choice)
        self.fold = styled(
            QToolButton(),
            role="fold",
            name=_("Settings of the stimulus"),
            text=_("S&ettings"),
            checkable=True,
            tool_button_style=Qt.ToolButtonStyle.ToolButtonTextBesideIcon,
        )
        self.summary = styled(QLabel(), role="field", word_wrap=True)
        self.distribution = _choice({name: _CALLED.get(name, name.capitalize()) for name in DISTRIBUTIONS})
        _select(self.distribution, _USUAL_DISTRIBUTION)
        pulls = _("Below zero the coil pulls: tissue that is not attached to the probe is left")
        self.min_force = styled(_number(" N", -15.0, 14.5, 0.5, USUAL_FORCE_N[0]), tip=pulls)
        self.max_force = _number(" N", 0.5, 15.0, 0.5, USUAL_FORCE_N[1])
        self.seconds = _number(" s", *SECONDS, 1.0, USUAL_SECONDS)
        self.seed = styled(WholeNumberField(), range=(0, _MOST_SEED), value=USUAL_SEED)
        after = _("Tests one after another, in one session file")
        self.repeats = styled(WholeNumberField(), range=(1, _MOST_REPEATS), tip=after)
        pause = _("Pause between the tests, to cool the coil")
        self.rest = styled(_number(" s", 0.0, 600.0, 10.0, 0.0), tip=pause)
        self.under_probe = _choice(_UNDER_PROBE)
        self.stimulus = StimulusForm()
        self.settings = QWidget()
        grid = QGridLayout()
        grid.setVerticalSpacing(6)
        fill(QVBoxLayout(self.settings), self.stimulus, grid)
        self._rows: list[tuple[QLabel, QWidget]] = []
        rows = (
            (_("&Distribution"), self.distribution),
            (_("Lo&west force"), self.min_force),
            (_("Hi&ghest force"), self.max_force),
            (_("Dur&ation"), self.seconds),
            (_("Seed"), self.seed),
            (_("Repeats"), self.repeats),
            (_("Rest between repeats"), self.rest),
            (_("Under the probe"), self.under_probe),
        )
        for place, (name, field) in enumerate(rows):
            named = styled(QLabel(name), buddy=field)
            field.setAccessibleName(name.replace("&", ""))
            grid.addWidget(named, place, 0)
            grid.addWidget(field, place, 1)
            self._rows.append((named, field))
        grid.setColumnStretch(1, 1)
        layout.addLayout(column(self.stimulus.depths, self.fold, self.summary, self.settings, spacing=4))
        self.fold.toggled.connect(self._unfold)
        for choice in (self.distribution, self.under_probe):
            choice.currentIndexChanged.connect(self._summarise)
        self.distribution.currentIndexChanged.connect(self._decide_distribution)
        self._decide_distribution()
        self.preset.chosen.connect(self._take_preset)
        self.repeats.valueChanged.connect(self._show_options)
        for spin in (self.repeats, self.rest):
            spin.valueChanged.connect(self.changed)
        self.under_probe.currentIndexChanged.connect(self.changed)
        self.stimulus.changed.connect(self._summarise)
        self.stimulus.changed.connect(self.changed)
        self.stimulus.kind_changed.connect(self._show_options)
        self._show_options()
        for spin in (self.min_force, self.max_force, self.seconds, self.seed):
            spin.valueChanged.connect(self._summarise)
        self._unfold(False)

    # -- reacting -----------------------------------------------------------------------------------------

    def _unfold(self, opened: bool) -> None:
        self.fold.setArrowType(Qt.ArrowType.DownArrow if opened else Qt.ArrowType.RightArrow)
        self.settings.setVisible(opened)
        for part in (self._limits_label, self.limits):
            part.setVisible(opened or not self._plain)
        self._show_set_up()
        self._summarise()
        if opened:
            self.stimulus.offer_all()

    def _show_set_up(self) -> None:
        """Show how the instrument meets the tissue; a clinician sees it with the settings, or where it is unusual."""
        usual = self.set_up.chosen == "indentation"
        self.set_up.setVisible(not (self._plain and usual) or self.fold.isChecked())

    def _apply_limits(self) -> None:
        """Limit force and length to the profile of limits and the maximum force of the instrument."""
        name = self.limits.currentData()
        most = min(PROFILES[name].max_force_n, self._forces_n.get(self.instrument.url, math.inf))
        self._applying = True
        self.max_force.setMaximum(most)
        if not self._own_force:
            self.max_force.setValue(self._usual_force_n)
        self._applying = False
        self.min_force.setRange(-most, most - self.min_force.singleStep())
        self.preset.allow(most)
        self.seconds.setMaximum(longest_stimulus_s(name))

    def _show_options(self) -> None:
        """Show the fields of the chosen kind of stimulus."""
        has = self.stimulus.has
        wanted = {
            self.distribution: self.stimulus.chosen == Noise.name,
            self.min_force: "force_min_n" in has,
            self.max_force: "force_max_n" in has,
            self.seconds: "seconds" in has,
            self.seed: "seed" in has,
            self.repeats: self.stimulus.chosen != MULTISTEP,
            self.rest: self.stimulus.chosen != MULTISTEP and self.repeats.value() > 1,
            self.under_probe: self.stimulus.chosen != MULTISTEP,
        }
        for named, field in self._rows:
            for widget in (named, field):
                widget.setVisible(wanted[field])
        if self.window() is not self:  # before that, the fields belong to several windows
            self.order_options()

    def _decide_distribution(self) -> None:
        """Show the options of noise that go with its distribution."""
        self.stimulus.decide("distribution", self.distribution.currentData())

    def _take_preset(self, preset: Preset | None) -> None:
        """Fill the form with a preset; its highest force follows the instrument unless it is one that it needs."""
        if preset is None:
            self.fold.setChecked(True)
            return
        self.stimulus.fill(preset.kind, dict(preset.options))
        self.stimulus.stop_when.clear()
        _select(self.distribution, _USUAL_DISTRIBUTION)
        self.min_force.setValue(preset.force_n[0])
        self.seconds.setValue(preset.seconds)
        self._own_force, self._usual_force_n = not preset.lowered, preset.force_n[1]
        if not preset.lowered:
            self.max_force.setValue(preset.force_n[1])
        self._apply_limits()
        self._summarise()

    def _shown_preset(self) -> Preset | None:
        """Return the preset whose settings are in the form; seed, depths and repeats may be others."""
        for preset in PRESETS:
            most = min(preset.force_n[1], self.max_force.maximum()) if preset.lowered else preset.force_n[1]
            fields = (self.min_force.value(), self.max_force.value(), self.seconds.value())
            if self.stimulus.chosen == preset.kind and fields == (preset.force_n[0], most, preset.seconds):
                usual = self.distribution.currentData() == _USUAL_DISTRIBUTION
                if self.stimulus.changed_options() == dict(preset.options) and (usual or preset.kind != Noise.name):
                    return preset
        return None

    def _summarise(self) -> None:
        self.preset.show_preset(self._shown_preset())
        has = self.stimulus.has
        if self._plain and not self.fold.isChecked() and {"seconds", "force_max_n"} <= set(has):
            values = {"force": self.max_force.value(), "seconds": self.seconds.value()}
            self._show_summary(_("{seconds:g} s, up to {force:g} N").format(**values))
            return
        if self.stimulus.chosen != Noise.name:
            title = self.stimulus.kind.currentText()
            low, high, seconds = self.min_force.value(), self.max_force.value(), self.seconds.value()
            words = _("{title}, {low:g} to {high:g} N").format(title=title, low=low, high=high)
            words = words if "force_max_n" in has else title
            self._show_summary(f"{words}, {seconds:g} s" if "seconds" in has else words)
            return
        self._show_summary(
            translated(
                Message(
                    "form.noise",
                    "{distribution} noise, {low:g} to {high:g} N, {seconds:g} s, seed {seed}",
                    distribution=Verbatim(self.distribution.currentText()),
                    low=self.min_force.value(),
                    high=self.max_force.value(),
                    seconds=self.seconds.value(),
                    seed=self.seed.value(),
                )
            )
        )

    def _show_summary(self, words: str) -> None:
        under = "" if self.under_probe.isHidden() else self.under_probe.currentText()
        under = under if self.under_probe.currentData() else ""
        self.summary.setText(
            _("{words}; under the probe: {under}").format(words=words, under=under) if under else words
        )

    def _look_at_subject(self, text: str) -> None:
        """Warn of a pseudonym that looks like a real name, and ask whether it is one: a pseudonym may look so."""
        doubtful = reads_like_name(text)
        self.is_pseudonym.setChecked(False)
        for part in (self.like_name, self.is_pseudonym):
            part.setVisible(doubtful)
        self.subject.setAccessibleDescription(_(_LIKE_NAME) if doubtful else "")

    def _choose_subject(self) -> None:
        if self._chosen_subject != (subject := self.subject.text().strip()):
            self._chosen_subject = subject
            self.subject_chosen.emit(subject)

    def _look_at_product(self) -> None:
        """Offer the minutes where there is a product."""
        self.minutes.setEnabled(bool(self.product.text().strip()))

    def _fill_preset(self, name: str) -> None:
        """Fill in a test by its name, with its own force."""
        self._own_force = False
        self._take_preset(next(preset for preset in PRESETS if preset.name == name))

    def _take_own_force(self) -> None:
        self._own_force = self._own_force or not self._applying

    def take_own_path(self) -> None:
        """Keep a path that was typed or chosen, instead of the one from site and time."""
        self._own_path = bool(self.path.text().strip())

    def _name_by_date(self) -> None:
        if not self.path.text().strip():
            self.renew_path()

    def _choose_path(self) -> None:
        dialog = styled(
            QFileDialog(self, _("Save the session to"), str(self.folder), _("Sessions (*.h5)")),
            accept_mode=QFileDialog.AcceptMode.AcceptSave,
            default_suffix="h5",
        )
        dialog.setOption(QFileDialog.Option.DontConfirmOverwrite)  # an existing session is refused, not replaced
        dialog.selectFile(Path(self.path.text()).name)
        dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        dialog.fileSelected.connect(self.take_chosen_path)
        dialog.open()

    def take_chosen_path(self, path: str) -> None:
        """Use a path chosen in the dialog."""
        self._own_path = True
        self.path.setText(path)
        self.path.setToolTip(path)


def _add(layout: QVBoxLayout, name: str, field: QWidget | QLayout, *, focus: QWidget) -> QLabel:
    """Return the label above a field; the label's mnemonic goes to ``focus``."""
    named = styled(QLabel(name), role="field", buddy=focus)
    focus.setAccessibleName(name.replace("&", ""))
    layout.addLayout(column(named, field, spacing=3))
    return named


def _choice(titles: Mapping[str, str]) -> QComboBox:
    combo = QComboBox()
    for name, title in titles.items():
        combo.addItem(_(title), name)
    return combo


def _select(choice: QComboBox, name: str) -> None:
    choice.setCurrentIndex(choice.findData(name))


def _number(unit: str, low: float, high: float, step: float, value: float) -> NumberField:
    return styled(NumberField(), suffix=unit, decimals=2, range=(low, high), single_step=step, value=value)
