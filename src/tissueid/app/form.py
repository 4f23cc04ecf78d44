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
from PySide6.QtGui import QKeyEvent, QStandardItemModel
from PySide6.QtWidgets import (
    QAbstractButton,
    QCheckBox,
    QComboBox,
    QFileDialog,
    QLabel,
    QLayout,
    QLineEdit,
    QToolButton,
    QVBoxLayout,
    QWidget,
)

from tissueid.acquisition.stimulus_choice import PRELOAD_S
from tissueid.app.build import ask_path, button, choice, column, fill, grid, label, row, styled
from tissueid.app.chooser import InstrumentChooser
from tissueid.app.number_field import OptionalNumberField
from tissueid.app.option_field import OptionField
from tissueid.app.stimulus_form import MULTISTEP, ConfigurationChooser, StimulusForm
from tissueid.app.user_files import dated_path
from tissueid.audit import Role
from tissueid.formatting import ANONYMOUS
from tissueid.instrument import PROFILES
from tissueid.language import _, marked
from tissueid.messages import Message, Verbatim, translated
from tissueid.procedures.test_plan import PRESETS, SPECIFIED, TestPlan, reads_like_name
from tissueid.stimuli.kinds.noise import Noise
from tissueid.test_settings import SECONDS, USUAL_FORCE_N

SITES = (
    "left forearm, posterior",
    "left forearm, anterior",
    "right forearm, posterior",
    "right forearm, anterior",
    "left upper arm",
    "right upper arm",
    "left thigh",
    "right thigh",
    "left calf",
    "right calf",
    "abdomen",
    "material sample",
)
"""Suggested sites; any text is allowed."""
_LIMITS = {"clinical": marked("Clinical"), "research": marked("Research")}
_LIKE_NAME = marked(
    "This looks like a person's name. Use a pseudonym, such as P-001: files and reports contain this text."
)
OWN = ""
"""Choice of settings that are those of no preset."""
_OPTIONS = (*SPECIFIED.values(), "repeats", "rest_s", "kind")
"""Fields of the plan that are made from their declaration, from top to bottom."""
_MOST_MINUTES = 1e6
_LEAST_FORCE_N = 0.5
_MINUTES_WIDTH = 96
"""Pixels."""


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
        limits = {name: _(_LIMITS.get(name, name.capitalize())) for name in sorted(PROFILES)}
        self.limits = choice(
            {
                name: _("{profile}: up to {force:g} N").format(profile=title, force=PROFILES[name].max_force_n)
                for name, title in limits.items()
            }
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
        self.minutes.valueChanged.connect(self.changed)
        self.set_up.changed.connect(self.changed)
        self.subject.textChanged.connect(self._look_at_subject)
        self.subject.editingFinished.connect(self._choose_subject)
        self.set_up.changed.connect(self._show_set_up)
        self._chosen_subject = ""
        self.limits.currentIndexChanged.connect(self._apply_limits)
        self.instrument.choice.currentTextChanged.connect(self._apply_limits)
        self.options["max_force_n"].edited.connect(self._take_own_force)
        self.path.setPlaceholderText(_("empty: a name by date and time"))
        self.path.textEdited.connect(self.take_own_path)
        self.path.editingFinished.connect(self._name_by_date)
        _select(self.limits, "clinical")
        self._apply_limits()
        self.renew_path()

    @property
    def fields(self) -> list[QWidget]:
        """The controls in the order of the tab key, without the options of the stimulus."""
        return [
            *(self.instrument.choice, self.instrument.refresh, self.site, self.map, self.subject, self.is_pseudonym),
            *(self.product, self.minutes, *self.set_up.fields, self.limits, self.preset, self.fold),
            *self.stimulus.fields,
            *(control for field in self.options.values() for control in field.controls),
            *(self.path, self.browse),
        ]

    def plan(self) -> TestPlan:
        """Return the plan of the fields. A dated file name gets the current time.

        Raises:
            UnusableInputError: a field does not hold a valid value.
        """
        if not self._own_path:
            self.renew_path()
        return TestPlan(
            url=self.instrument.url,
            site=self.site.currentText().strip(),
            out=Path(self.path.text().strip()),
            subject=self.subject.text().strip() or ANONYMOUS,
            pseudonym_confirmed=self.is_pseudonym.isChecked(),
            condition=(product := self.product.text().strip()),
            minutes_since_application=self.minutes.given if product else None,
            limits=self.limits.currentData(),
            lower_force=not self._own_force,
            **{name: field.value() for name, field in self.options.items() if not field.isHidden()},
            **self.set_up.values(),
            **self.stimulus.values(),
        )

    def tell_force(self, url: str, greatest_n: float) -> None:
        """Apply the maximum force of the instrument at ``url``, N."""
        if self._forces_n.get(url) != greatest_n:
            self._forces_n[url] = greatest_n
            self._apply_limits()

    @property
    def another_name(self) -> Callable[[], Path] | None:
        """Return an unused path in the same folder when called, from any thread; None for a path of the user's own."""
        return None if self._own_path else partial(dated_path, self.folder, self._now())

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
            "preset": self._take_preset,
            "limits": partial(_select, self.limits),
            "stimulus_kind": self.stimulus.fill,
            "distribution": self._fill_distribution,
            "under_probe": lambda kind: self.options["kind"].set_value(kind or None),
        }
        fields |= {name: field.set_value for name, field in self.options.items()}
        max_force_n = self.options["max_force_n"].value()
        if settings := {name: value for name, value in values.items() if name not in fields}:
            self.set_up.choose(**settings)
        for name, value in values.items():
            if name in fields:
                fields[name](value)
        if values.get("max_force_n", max_force_n) != max_force_n:
            self._own_force = True
        self._choose_subject()
        self._show_options()
        self._summarise()
        self.changed.emit()

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
            [self.preset, *self.stimulus.option_fields(depths=True)],
            [self.stimulus.live_method, *self.stimulus.option_fields(depths=False)],
        )
        for order in around:
            for before, after in pairwise(order):
                QWidget.setTabOrder(before, after)

    # -- building -----------------------------------------------------------------------------------------

    def _add_settings(self, layout: QVBoxLayout) -> None:
        """The presets, and the stimulus, folded away under a line that says what it is."""
        self.preset = choice({preset.name: _(preset.title) for preset in PRESETS} | {OWN: _("Own settings")})
        self.not_offered = label("muted", hidden=True)
        _add(layout, _("Test"), column(self.preset, self.not_offered, spacing=3), focus=self.preset)
        self.fold = styled(
            QToolButton(),
            role="fold",
            name=_("Settings of the stimulus"),
            text=_("S&ettings"),
            checkable=True,
            tool_button_style=Qt.ToolButtonStyle.ToolButtonTextBesideIcon,
        )
        self.summary = styled(QLabel(), role="field", word_wrap=True)
        self.stimulus = StimulusForm()
        self.options = {name: OptionField(name, TestPlan.model_fields[name]) for name in _OPTIONS}
        self.settings = QWidget()
        rows = grid()
        fill(QVBoxLayout(self.settings), self.stimulus, rows)
        for index, field in enumerate(self.options.values()):
            field.place(rows, index, word_wrap=False)
            field.edited.connect(self._summarise)
            field.edited.connect(self.changed)
        layout.addLayout(column(self.stimulus.depths, self.fold, self.summary, self.settings, spacing=4))
        self.fold.toggled.connect(self._unfold)
        self.preset.activated.connect(self._choose_preset)
        self.options["repeats"].edited.connect(self._show_options)
        self.stimulus.changed.connect(self._summarise)
        self.stimulus.changed.connect(self.changed)
        self.stimulus.kind_changed.connect(self._show_options)
        self._show_options()
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
        most_n = self.most_n
        self._applying = True
        self.options["max_force_n"].limit(_LEAST_FORCE_N, most_n)
        if not self._own_force:
            self.options["max_force_n"].set_value(self._usual_force_n)
        self._applying = False
        self.options["min_force_n"].limit(-most_n, most_n - _LEAST_FORCE_N)
        self.options["seconds"].limit(SECONDS[0], longest_stimulus_s(self.limits.currentData()))
        self._allow_presets(most_n)
        self._summarise()

    @property
    def most_n(self) -> float:
        """Greatest force that limits and instrument allow, N."""
        allowed = PROFILES[self.limits.currentData()].max_force_n
        return min(allowed, self._forces_n.get(self.instrument.url, math.inf))

    def _allow_presets(self, most_n: float) -> None:
        """Offer the presets whose force is within ``most_n``, N, and say why the others are not."""
        model = self.preset.model()
        assert isinstance(model, QStandardItemModel)
        reasons = [translated(why) if (why := preset.why_not(most_n)) else "" for preset in PRESETS]
        for index, reason in enumerate(reasons):
            model.item(index).setEnabled(not reason)
            self.preset.setItemData(index, reason, Qt.ItemDataRole.ToolTipRole)
        self.not_offered.setText("\n".join(filter(None, reasons)))
        self.not_offered.setVisible(any(reasons))

    def _show_options(self) -> None:
        """Show the fields of the chosen kind of stimulus."""
        shown = dict.fromkeys(_OPTIONS, self.stimulus.chosen != MULTISTEP)
        shown |= {name: option in self.stimulus.has for option, name in SPECIFIED.items()}
        shown["rest_s"] = shown["rest_s"] and self.options["repeats"].value() > 1
        for name, field in self.options.items():
            field.setVisible(shown[name])
        if self.window() is not self:  # before that, the fields belong to several windows
            self.order_options()

    def _fill_distribution(self, name: str) -> None:
        if "distribution" in self.stimulus.controls:
            self.stimulus.controls["distribution"].set_value(name)
            self.stimulus.update_shown()

    def _choose_preset(self) -> None:
        if self.preset.currentData() == OWN:
            self.fold.setChecked(True)
        else:
            self._take_preset(self.preset.currentData())

    def _take_preset(self, name: str) -> None:
        """Fill the form with a preset; its highest force follows the instrument unless it is one that it needs."""
        preset = next(preset for preset in PRESETS if preset.name == name)
        self.stimulus.fill(preset.stimulus, dict(preset.options))
        self.stimulus.stop_when.clear()
        for field in ("min_force_n", "seconds", *(() if preset.lower_force else ("max_force_n",))):
            self.options[field].set_value(getattr(preset, field))
        self._own_force, self._usual_force_n = not preset.lower_force, preset.max_force_n
        self._apply_limits()
        self.changed.emit()

    def _shown_preset(self) -> str:
        """Return the name of the preset whose settings are in the form; seed, depths and repeats may be others."""
        for preset in PRESETS:
            most_n = min(preset.max_force_n, self.most_n) if preset.lower_force else preset.max_force_n
            fields = [self.options[name].value() for name in ("min_force_n", "max_force_n", "seconds")]
            wanted = [preset.stimulus, preset.min_force_n, most_n, preset.seconds]
            if [self.stimulus.chosen, *fields] == wanted and self.stimulus.changed_options() == dict(preset.options):
                return preset.name
        return OWN

    def _summarise(self) -> None:
        _select(self.preset, self._shown_preset())
        has = self.stimulus.has
        low, high, seconds = (self.options[name].value() for name in ("min_force_n", "max_force_n", "seconds"))
        if self._plain and not self.fold.isChecked() and {"seconds", "force_max_n"} <= set(has):
            self._show_summary(_("{seconds:g} s, up to {force:g} N").format(seconds=seconds, force=high))
            return
        if self.stimulus.chosen != Noise.name:
            title = self.stimulus.kind.currentText()
            summary = _("{title}, {low:g} to {high:g} N").format(title=title, low=low, high=high)
            summary = summary if "force_max_n" in has else title
            self._show_summary(f"{summary}, {seconds:g} s" if "seconds" in has else summary)
            return
        distribution = self.stimulus.controls["distribution"].text
        self._show_summary(
            translated(
                Message(
                    "form.noise",
                    "{distribution} noise, {low:g} to {high:g} N, {seconds:g} s, seed {seed}",
                    distribution=Verbatim(distribution[:1].upper() + distribution[1:]),
                    low=low,
                    high=high,
                    seconds=seconds,
                    seed=self.options["seed"].value(),
                )
            )
        )

    def _show_summary(self, summary: str) -> None:
        kind = self.options["kind"]
        under = "" if kind.isHidden() or kind.value() is None else kind.text
        self.summary.setText(
            _("{words}; under the probe: {under}").format(words=summary, under=under) if under else summary
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

    def _take_own_force(self) -> None:
        self._own_force = self._own_force or not self._applying

    def take_own_path(self) -> None:
        """Keep a path that was typed or chosen, instead of the one from site and time."""
        self._own_path = bool(self.path.text().strip())

    def _name_by_date(self) -> None:
        if not self.path.text().strip():
            self.renew_path()

    def _choose_path(self) -> None:
        name, kinds = Path(self.path.text()).name, _("Sessions (*.h5)")
        # An existing session is refused, not replaced.
        keep = QFileDialog.Option.DontConfirmOverwrite
        taken = self.take_chosen_path
        ask_path(self, _("Save the session to"), self.folder, taken, kinds, save=name, default_suffix="h5", option=keep)

    def take_chosen_path(self, path: Path) -> None:
        """Use a path chosen in the dialog."""
        self._own_path = True
        styled(self.path, text=str(path), tip=str(path))


def _add(layout: QVBoxLayout, name: str, field: QWidget | QLayout, *, focus: QWidget) -> QLabel:
    """Return the label above a field; the label's mnemonic goes to ``focus``."""
    named = styled(QLabel(name), role="field", buddy=focus)
    focus.setAccessibleName(name.replace("&", ""))
    layout.addLayout(column(named, field, spacing=3))
    return named


def _select(choice: QComboBox, name: str) -> None:
    choice.setCurrentIndex(choice.findData(name))


def longest_stimulus_s(limits: str) -> float:
    """Return the longest stimulus that a profile of limits allows after the preload, s."""
    return PROFILES[limits].max_seconds - PRELOAD_S
