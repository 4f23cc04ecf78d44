"""Panels of the selected calibrations: a static calibration, and sweeps laid over each other."""

from __future__ import annotations

import html
from collections.abc import Sequence
from datetime import UTC, datetime

import numpy as np
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QComboBox, QFrame, QLabel, QWidget

from tissueid.analysis.curves.calibration_plots import ALONG_STROKE, residual_plot, stroke_plot, trend_plot
from tissueid.app import build
from tissueid.app.plot_canvas import PlotCanvas
from tissueid.app.theme import appearance
from tissueid.app.views.technician.tab import PiecesModel, table_of
from tissueid.app.widgets import plain_tip, show_level
from tissueid.app.words import figure_of, sentence
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
from tissueid.calibration.status import label_of, notes_of, problems_of, verdict_of
from tissueid.formatting import clean, figure_text, fixed, plus_minus
from tissueid.language import _, marked
from tissueid.messages import MISSING, translated
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
        self.said.setText("\n".join(lines[:_MOST_LINES]))
        self.said.setToolTip(plain_tip("\n".join(lines)))
        self.said.setVisible(bool(lines))
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
        found = trend(self._all, name)
        self.over_dates.show_plots([trend_plot(found, datetime.now(UTC))])
        self.drift.setText(translated(found.words))

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
        self.words = build.label("headline")
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
        top = build.row((self.words, 1), self.against)
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
        texts = [said.format(date=one.date[:10], serial=clean(one.serial_number)[:30]) for one in self._sweeps[1:]]
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
            self.words.setText(
                _("Sweep of {date}: select another with Ctrl to compare the two.").format(date=newest.date[:10])
            )
            show_level(self.words, "")
            self.remarks.setText(_region_words(newest))
            self.model.show_rows(list(newest.quantities.items()))
            return
        found = compare_sweeps(others[max(0, self.against.currentIndex())], newest)
        self.comparison = found
        self.words.setText(translated(found.words))
        drift = next((item for item in found.differences if item.name == "force_constant_n_per_a"), None)
        show_level(self.words, "check" if drift is not None and drift.verdict == "beyond" else "")
        self.remarks.setText(" ".join([_profile_words(found), *map(translated, found.remarks)]).strip())
        self.model.show_rows(found.differences)

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


def _profile_words(found: CalibrationComparison) -> str:
    if found.common_m is None:
        return _("Their linear regions do not overlap.")
    low, high = (figure_text("position", end) for end in found.common_m)
    unit = unit_of("position").symbol
    if not np.isfinite(found.profile):
        return _("Both are linear from {low} to {high} {unit}.").format(low=low, high=high, unit=unit)
    mean, largest = (f"{fixed(100.0 * share, 1)} %" for share in (found.profile, found.largest))
    where = figure_text("position", found.largest_at_m)
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
    known = None if row.uncertainty is None else SIGNIFICANT_STD * row.uncertainty
    if np.isfinite(row.relative):
        share = None if known is None else 100.0 * known / abs(row.before.value)
        return f"{fixed(100.0 * row.relative, 1)} %", MISSING if share is None else f"{fixed(share, 1)} %"
    decimals = 2 if scale == display_unit(row.before.unit)[1] else 5
    return fixed(scale * row.absolute, decimals), MISSING if known is None else fixed(scale * known, decimals)
