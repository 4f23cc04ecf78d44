"""The tab of calibrations: a button for a new one, the stored ones, and panels that compare the selected ones."""

from __future__ import annotations

import functools
import html
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QComboBox, QFrame, QLabel, QWidget

from tissueid.analysis.curves.calibration_plots import ALONG_STROKE, residual_plot, stroke_plot, trend_plot
from tissueid.app import build
from tissueid.app.build import button, label
from tissueid.app.context import AppContext
from tissueid.app.jobs import PageJob
from tissueid.app.plot_canvas import PlotCanvas
from tissueid.app.theme import appearance
from tissueid.app.views.technician.tab import PiecesModel, Tab, table_of
from tissueid.app.widgets import plain_tip, show_level
from tissueid.app.words import figure_of, sentence
from tissueid.calibration.active import apply_calibrations
from tissueid.calibration.comparison import (
    SIGNIFICANT_STD,
    CalibrationComparison,
    CalibrationDifference,
    Residuals,
    compare_sweeps,
    linear_region,
    residuals,
    trend,
)
from tissueid.calibration.file import CalibratedQuantity, Calibration
from tissueid.calibration.status import (
    Stored,
    calibration_folder,
    file_status,
    label_of,
    notes_of,
    problems_of,
    status_for_device,
    stored_calibrations,
    verdict_of,
)
from tissueid.device import DeviceDescription
from tissueid.formatting import clean, figure_text, fixed, local_minute, plus_minus
from tissueid.language import _, marked
from tissueid.messages import MISSING, Message, translated
from tissueid.records import Estimate
from tissueid.units import display_unit, shown_si, unit_of

_PREFERRED = "force_constant_n_per_a"
_MOST_LINES = 4


class StaticsPanel(QWidget):
    """The newest of the selected static calibrations; the trend is over all of its instrument that passed."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._all: tuple[Calibration, ...] = ()
        self._shown: Calibration | None = None
        self._residuals: tuple[Residuals, ...] = ()
        self.headline = build.label("headline")
        self.said = build.label("muted")
        self.model = PiecesModel(
            (_("Quantity"), _("Value"), _("Unit")),
            lambda row, column: figure_of(*row)[column],
            right=(1,),
        )
        self.figures = table_of(self.model, _("Figures of the static calibration"), (250, 175))
        residuals_of, trend_of = _("Which line's residuals are shown"), _("Figure whose trend over the dates is shown")
        self.line = build.choice({}, self._show_residuals, 16, name=_("Which line's residuals"), tip=residuals_of)
        self.figure = build.choice({}, self._show_trend, 16, name=_("Figure whose trend is shown"), tip=trend_of)
        self.off, self.over_dates = PlotCanvas(), PlotCanvas()
        self.drift = build.label("muted")
        halves = ((self.line, self.off), (self.figure, self.over_dates))
        below = build.row(*[(build.column(choice, (card, 1), spacing=4), 1) for choice, card in halves])
        build.column(self.headline, self.said, (self.figures, 3), (below, 3), self.drift, spacing=4, parent=self)

    def show_statics(self, chosen: Sequence[Calibration], stored: Sequence[Calibration]) -> None:
        """Show the newest of the chosen; ``stored`` are all there are, for the trend."""
        newest = max(chosen, key=lambda item: item.made)
        self._shown = newest
        self._all = tuple(
            item
            for item in stored
            if item.kind == "static"
            and item.verdict == "passed"
            and (item.serial_number, item.model) == (newest.serial_number, newest.model)
        )
        self.headline.setText(
            sentence(f"{newest.date[:10]}, {clean(newest.serial_number)[:40]} – {translated(verdict_of(newest))}")
        )
        show_level(self.headline, "good" if newest.verdict == "passed" else "poor")
        lines = [sentence(clean(translated(line))) for line in (*problems_of(newest), *notes_of(newest))]
        build.show_text(self.said, "\n".join(lines[:_MOST_LINES]))
        self.said.setToolTip(plain_tip("\n".join(lines)))
        self.model.show_rows(list(newest.quantities.items()))
        self._residuals = residuals(newest)
        lines_kept = [(translated(item.label), item.label) for item in self._residuals]
        self._fill(self.line, lines_kept, self.line.currentData())
        names = [name for name in newest.quantities if any(name in item.quantities for item in self._all)]
        kept = self.figure.currentData() or _PREFERRED
        self._fill(self.figure, [(translated(label_of(name)), name) for name in names], kept)
        self._show_residuals()
        self._show_trend()

    @staticmethod
    def _fill(choice: QComboBox, items: Sequence[tuple[str, str]], kept: object) -> None:
        build.offer(choice, {name: clean(text) for text, name in items}, kept)
        choice.setEnabled(bool(items))

    def _show_residuals(self) -> None:
        number = self.line.currentIndex()
        if not 0 <= number < len(self._residuals):
            self.off.say_missing(_("This calibration keeps no line with residuals."))
            return
        self.off.show_plots([residual_plot(self._residuals[number])])

    def _show_trend(self) -> None:
        name = self.figure.currentData()
        if not name:
            self.over_dates.say_missing(_("No calibration of this instrument that passed holds a figure."))
            self.drift.setText("")
            return
        figure_trend = trend(self._all, name)
        self.over_dates.show_plots([trend_plot(figure_trend, datetime.now(UTC))])
        self.drift.setText(translated(figure_trend.message))

    def take_units(self) -> None:
        """Show the figures in the units in force."""
        self.model.show_rows(self.model.rows)


MOST = 4
"""Maximum number of sweeps that can be distinguished by colour."""
ROLES = ("measured", "model", "good", "poor")
_PLOT_HEIGHT = 110
_SAID = {
    "noise": marked("within the noise"),
    "uncertainty": marked("within the uncertainty"),
    "beyond": marked("beyond the uncertainty"),
    "unknown": marked("no uncertainty known"),
}


class SweepsPanel(QWidget):
    """Shows one sweep, or several over each other; with two or more the newest is held against a chosen one."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._sweeps: tuple[Calibration, ...] = ()
        self.comparison: CalibrationComparison | None = None
        self.headline = build.label("headline")
        self.remarks = build.label("muted")
        comparing = _("Compare the newest of the selected sweeps with")
        self.against = build.choice({}, self._compare, name=_("Compare the newest sweep with"), tip=comparing)
        appearance.changed.connect(self._show_key)
        self.cards = {name: PlotCanvas(_(axis.label)) for name, (axis, _scale) in ALONG_STROKE.items()}
        for card in self.cards.values():
            card.setMinimumHeight(_PLOT_HEIGHT)
        self.model = PiecesModel(
            (_("Quantity"), _("Difference"), _("±2 std"), _("Which is"), _("Before"), _("Now"), _("Unit")),
            _cell,
            level=lambda row: "check" if isinstance(row, CalibrationDifference) and row.verdict == "beyond" else "",
            marked=3,
            right=(1, 2, 4, 5),
        )
        self.figures = table_of(
            self.model, _("Figures of the sweeps and their differences"), (178, 75, 60, 165, 130, 130)
        )
        pages = (self._make_plots(), _("Along the stroke")), (self.figures, _("Values"))
        self.tabs = build.tabs(_("Sweeps: along the stroke, or figures"), *pages)
        top = build.row((self.headline, 1), self.against)
        top.setAlignment(self.against, Qt.AlignmentFlag.AlignTop)
        build.column(top, self.remarks, (self.tabs, 1), spacing=4, parent=self)

    def _make_plots(self) -> QWidget:
        self.key = build.styled(
            QLabel(),
            text_format=Qt.TextFormat.RichText,
            word_wrap=True,
            minimum_width=1,
            alignment=Qt.AlignmentFlag.AlignTop,
        )
        card = build.styled(QFrame(), role="card")
        build.column(build.label("heading", _("Legend")), self.key, None, margins=(12, 8, 12, 8), parent=card)
        return build.holder(
            build.tiles(2, *self.cards.values(), card, stretch_rows=True, contents_margins=(0, 6, 0, 0))
        )

    def show_sweeps(self, sweeps: Sequence[Calibration]) -> None:
        """Show these; the newest is the one that is compared."""
        self._sweeps = tuple(sorted(sweeps, key=lambda item: item.made, reverse=True)[:MOST])
        said = _("against {date}, {serial}")
        texts = [
            said.format(date=sweep.date[:10], serial=clean(sweep.serial_number)[:30]) for sweep in self._sweeps[1:]
        ]
        build.offer(self.against, dict(enumerate(texts)), 0)
        self.against.setVisible(len(self._sweeps) > 2)
        for name, card in self.cards.items():
            card.show_plots([stroke_plot(name, self._sweeps, ROLES)])
        self._compare()
        self._show_key()

    def _compare(self) -> None:
        if not self._sweeps:
            return
        newest, *others = self._sweeps
        if not others:
            self.comparison = None
            self.headline.setText(
                _("Sweep of {date}: select another with Ctrl to compare the two.").format(date=newest.date[:10])
            )
            show_level(self.headline, "")
            self.remarks.setText(_region_words(newest))
            self.model.show_rows(list(newest.quantities.items()))
            return
        comparison = compare_sweeps(others[max(0, self.against.currentIndex())], newest)
        self.comparison = comparison
        self.headline.setText(translated(comparison.message))
        drift = next((item for item in comparison.differences if item.name == "force_constant_n_per_a"), None)
        show_level(self.headline, "check" if drift is not None and drift.verdict == "beyond" else "")
        self.remarks.setText(" ".join([_profile_words(comparison), *map(translated, comparison.remarks)]).strip())
        self.model.show_rows(comparison.differences)

    def _show_key(self) -> None:
        """Which colour is which sweep; the names are of people and are no markup."""
        theme = appearance.theme
        lines = [
            f'<span style="color:{getattr(theme, role)}">■</span> '
            f"{html.escape(sweep.made.strftime('%Y-%m-%d %H:%M'))}, {html.escape(clean(sweep.serial_number)[:30])}, "
            f"{html.escape(_(sweep.verdict))}"
            for role, sweep in zip(ROLES, self._sweeps, strict=False)
        ]
        note = _("Shaded upright: the linear region of each. Shaded along a curve: ± one standard deviation.")
        lines.append(f'<span style="color:{theme.muted}">{note}</span>')
        self.key.setText("<br>".join(lines))

    def take_units(self) -> None:
        """Show words and figures in the units in force."""
        self._compare()


def _region_words(sweep: Calibration) -> str:
    region = linear_region(sweep)
    if region is None:
        return _("It does not say where the coil is linear.")
    return _("Linear from {low} to {high} {unit}.").format(
        low=figure_text("position", region[0]), high=figure_text("position", region[1]), unit=unit_of("position").symbol
    )


def _profile_words(comparison: CalibrationComparison) -> str:
    if comparison.common_m is None:
        return _("Their linear regions do not overlap.")
    low, high = (figure_text("position", end) for end in comparison.common_m)
    unit = unit_of("position").symbol
    if not np.isfinite(comparison.profile):
        return _("Both are linear from {low} to {high} {unit}.").format(low=low, high=high, unit=unit)
    mean, largest = (f"{fixed(100.0 * share, 1)} %" for share in (comparison.profile, comparison.largest))
    where = figure_text("position", comparison.largest_at_m)
    return _(
        "Over {low} to {high} {unit}, where both are linear: mean {mean}, largest {largest}, at {where} {unit}."
    ).format(low=low, high=high, unit=unit, mean=mean, largest=largest, where=where)


def _cell(row: CalibrationDifference | tuple[str, CalibratedQuantity], column: int) -> str:
    if isinstance(row, tuple):
        label, value, unit = figure_of(*row)
        return (label, "", "", "", "", value, unit)[column]
    unit, scale = shown_si(row.before.unit)
    if column in (4, 5):
        held = row.before if column == 4 else row.now
        return plus_minus(Estimate(held.value, held.std), scale)
    return (translated(label_of(row.name)), *_sizes(row, scale), _(_SAID[row.verdict]), "", "", unit)[column]


def _sizes(row: CalibrationDifference, scale: float) -> tuple[str, str]:
    """A difference and what it is not known better than, as shares where the figure has a scale."""
    uncertainty = None if row.uncertainty is None else SIGNIFICANT_STD * row.uncertainty
    if np.isfinite(row.relative):
        share = None if uncertainty is None else 100.0 * uncertainty / abs(row.before.value)
        return f"{fixed(100.0 * row.relative, 1)} %", MISSING if share is None else f"{fixed(share, 1)} %"
    decimals = 2 if scale == display_unit(row.before.unit)[1] else 5
    return fixed(scale * row.absolute, decimals), MISSING if uncertainty is None else fixed(
        scale * uncertainty, decimals
    )


HEADERS = (marked("Date"), marked("Kind"), marked("Verdict"), marked("Age"), marked("Active"), marked("File"))
_LONGEST = 300
_IN_FILES = (marked("static"), marked("sweep"), marked("passed"), marked("failed"))
"""What calibrations say of themselves."""


@dataclass(frozen=True)
class CalibrationRow:
    """A calibration with what is said of it. ``level`` is that of a colour."""

    item: Stored
    date: str
    kind: str
    verdict: str
    age: str
    force: str
    level: str

    def cell(self, column: int) -> str:
        """What stands in a column."""
        name = clean(self.item.path.name)[:120]
        return (self.date, _(self.kind), _(self.verdict), self.age, self.force, name)[column]


def rows_of(stored: Sequence[Stored], nominal: DeviceDescription | None, now: datetime) -> tuple[CalibrationRow, ...]:
    """Rows in the order of ``stored``. ``nominal`` is what was asked; without it each is judged by its age alone."""
    if nominal is None:
        return tuple(_row(item, None, frozenset(), frozenset(), now) for item in stored)
    active = apply_calibrations(nominal, stored, now).calibration
    named = frozenset(str(active[name]) for name in ("static_file", "sweep_file") if name in active)
    sources = frozenset(_sources(stored, nominal, now))
    return tuple(_row(item, nominal, named, sources, now) for item in stored)


def _row(
    item: Stored, nominal: DeviceDescription | None, named: frozenset[str], sources: frozenset[Path], now: datetime
) -> CalibrationRow:
    calibration = item.calibration
    if calibration is None:
        return CalibrationRow(
            item,
            MISSING,
            MISSING,
            MISSING,
            MISSING,
            _said(_("no: {problem}").format(problem=translated(item.problem))),
            "poor",
        )
    days = calibration.age_days(now)
    age = _("in the future") if days < -1.0 else _("today") if days < 1.0 else _("{days:.0f} days").format(days=days)
    date = local_minute(calibration.date) or calibration.date[:10]
    if nominal is None:
        status = file_status(item, now)
        force, level = _said(translated(status.message)), "" if status.state == "valid" else "check"
    else:
        state, why = status_for_device(item, nominal, now)
        reason = translated(why)
        usable = state in ("valid", "stale")
        if usable and item.path.name in named:
            force, level = (
                (_("Yes"), "good")
                if state == "valid"
                else (_said(_("yes, but {reason}").format(reason=reason)), "check")
            )
        elif usable and item.path in sources:
            force, level = _("In part, together with another one"), "good"
        elif usable:
            force, level = translated(Message("calibrations.superseded", "No: a newer one is")), ""
        else:
            force, level = _said(_("no: {reason}").format(reason=reason)), "" if state == "foreign" else "poor"
    if calibration.verdict == "failed":
        level = "poor"
    return CalibrationRow(item, date, calibration.kind, calibration.verdict, age, force, level)


def _sources(stored: Sequence[Stored], nominal: DeviceDescription, now: datetime) -> set[Path]:
    """The static calibrations of which a figure is in force: the newest good one that holds it, else a stale one."""
    usable = [(status_for_device(item, nominal, now)[0], item) for item in stored]
    statics = [
        (state == "stale", item, item.calibration)
        for state, item in usable
        if state in ("valid", "stale") and item.calibration is not None and item.calibration.kind == "static"
    ]
    statics.sort(key=lambda entry: (not entry[0], entry[2].made, entry[1].path.name), reverse=True)
    source: dict[str, Path] = {}
    for _stale, item, calibration in statics:
        for name in calibration.quantities:
            source.setdefault(name, item.path)
    active = apply_calibrations(nominal, stored, now).calibration
    return {path for name, path in source.items() if name in active}


def _said(text: str) -> str:
    return sentence(clean(text)[:_LONGEST])


_HINT = marked(
    "Select a calibration to see its figures. Select two or more sweeps, with Ctrl or Shift, to lay them over each "
    "other and see what has drifted."
)
_TO_MEASURE = marked(
    "Press “Begin static calibration” or “Begin dynamic sweep” on the tab Calibration; the coil will move."
)
_ROLE = marked("Only a technician can calibrate: choose the role Technician at the top, then press this button again.")
_MOST_WHY = 4
_SPLIT = "instrument/calibrations/split"


def read_stored(folder: Path | None, cancelled: Callable[[], object]) -> tuple[Stored, ...]:
    """The calibrations of the folder in force, or of a given one.

    Raises:
        UnusableInputError: it is not there, or cannot be read.
    """
    cancelled()
    return stored_calibrations(calibration_folder(folder))


class CalibrationsTab(Tab):
    """A list on the left; what is selected on the right."""

    def __init__(self, context: AppContext, page_job: PageJob, parent: QWidget | None = None) -> None:
        super().__init__(context, page_job, parent)
        self._stored: tuple[Stored, ...] = ()
        self._nominal: DeviceDescription | None = None
        self.calibrate = button(_("Calibrate…"), self._go, tip=_("Shows the page Measure, where calibrations are made"))
        self.again = button(_("Read again"), self.load, name=_("Read the folder of calibrations again"))
        self.about = build.label("muted")
        self.model = PiecesModel(
            tuple(_(head) for head in HEADERS), CalibrationRow.cell, level=lambda row: row.level, marked=4
        )
        self.list = table_of(self.model, _("Calibrations"), (82, 66, 74, 70, 180))
        self.list.selectionModel().selectionChanged.connect(self._show_selected)
        self.why = build.label("muted")
        self.hint = label("muted", _(_HINT), alignment=Qt.AlignmentFlag.AlignCenter)
        self.sweeps = SweepsPanel()
        self.statics = StaticsPanel()
        self.detail = build.stack(self.hint, self.sweeps, self.statics)
        listing = build.holder(build.column((self.list, 1), self.why, margins=(0, 0, 6, 0)))
        self.split = build.splitter((listing, 2), (self.detail, 3), sizes=(450, 600))
        if (state := context.settings.value(_SPLIT)) is not None:
            self.split.restoreState(state)
        build.column(
            build.row(self.calibrate, self.again, (self.about, 1), spacing=8),
            (self.split, 1),
            margins=(0, 8, 0, 0),
            parent=self,
        )
        self._show()

    # -- work ---------------------------------------------------------------------------------------------

    def load(self) -> None:
        """Read the folder."""
        work = functools.partial(read_stored, self.context.services.calibrations)
        self.read_files(_("Reading the calibrations…"), work)

    def _loaded(self, stored: tuple[Stored, ...]) -> None:
        self._stored, self.read = stored, True
        self._show()

    def tell_instrument(self, nominal: DeviceDescription | None) -> None:
        """Set the instrument for which the active calibrations are shown."""
        if nominal is not self._nominal or not self.read:
            self._nominal = nominal
            self._show()

    def _go(self) -> None:
        """Show the page of calibrations; start nothing."""
        if self.context.state.role == "technician":
            self.context.calibrate(_(_TO_MEASURE))
        else:
            self.context.say(_(_ROLE))

    # -- showing ------------------------------------------------------------------------------------------

    def update_enabled(self, *, busy: bool) -> None:
        """Disable reading and calibrating while a job runs."""
        self.again.setEnabled(not busy)
        self.calibrate.setEnabled(not busy)
        if not self.read:
            self._show()

    @property
    def selected(self) -> list[Calibration]:
        """The selected readable calibrations, newest first."""
        return [row.item.calibration for row in self._rows if row.item.calibration is not None]

    @property
    def _rows(self) -> list[CalibrationRow]:
        numbers = sorted(index.row() for index in self.list.selectionModel().selectedRows())
        return [self.model.rows[number] for number in numbers if number < len(self.model.rows)]

    def _show(self) -> None:
        kept = {row.item.path for row in self._rows}
        rows = rows_of(self._stored, self._nominal, datetime.now(UTC))
        self.model.show_rows(rows)
        selection = self.list.selectionModel()
        for number, row in enumerate(rows[: self.model.rowCount()]):
            if row.item.path in kept:
                selection.select(
                    self.model.index(number, 0), selection.SelectionFlag.Select | selection.SelectionFlag.Rows
                )
        if not self.read:
            self.about.setText(self.context.unread)
        elif not rows:
            self.about.setText(_("There is no calibration yet: the nominal figures are used."))
        elif self._nominal is None:
            self.about.setText(_("Check the instrument under Health to see which of them it uses."))
        else:
            self.about.setText(
                _("Column “Active”: whether the instrument {serial} uses it.").format(
                    serial=clean(self._nominal.serial_number)[:60]
                )
            )
        self._show_selected()

    def _show_selected(self) -> None:
        rows = self._rows
        build.show_text(self.why, "\n".join(f"{row.cell(5)}: {row.force}" for row in rows[:_MOST_WHY]))
        chosen = self.selected
        sweeps = [item for item in chosen if item.kind == "sweep"]
        if sweeps and len(sweeps) >= len(chosen) - len(sweeps):
            self.sweeps.show_sweeps(sweeps)
            self.detail.setCurrentWidget(self.sweeps)
        elif chosen:
            statics = [item for item in chosen if item.kind == "static"]
            readable = [item.calibration for item in self._stored if item.calibration is not None]
            self.statics.show_statics(statics, readable)
            self.detail.setCurrentWidget(self.statics)
        else:
            self.hint.setText("\n".join(row.force for row in rows[:_MOST_WHY]) or _(_HINT))
            self.detail.setCurrentWidget(self.hint)

    def save_state(self) -> None:
        """Where the two halves part."""
        self.context.settings.setValue(_SPLIT, self.split.saveState())
