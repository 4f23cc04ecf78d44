"""Sweeps over each other: force constant, mass, damping, stiffness and VAF along the stroke, and what differs."""

from __future__ import annotations

import html
from collections.abc import Sequence

import numpy as np
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QComboBox, QFrame, QGridLayout, QHBoxLayout, QLabel, QTabWidget, QWidget

from tissueid.analysis.curves.calibration_plots import ALONG_STROKE, stroke_plot
from tissueid.app import build
from tissueid.app.calibration_state import figure_of
from tissueid.app.plot_canvas import PlotCanvas
from tissueid.app.theme import appearance
from tissueid.app.views.technician.tab import PiecesModel, table_of
from tissueid.app.widgets import show_level
from tissueid.calibration.comparison import (
    SIGNIFICANT_STD,
    Comparison,
    Difference,
    compare_sweeps,
    linear_region,
)
from tissueid.calibration.file import Calibration, Quantity
from tissueid.calibration.labels import label_of
from tissueid.formatting import clean, figure_text, fixed, plus_minus
from tissueid.language import _, marked
from tissueid.messages import MISSING, translated
from tissueid.records import Estimate
from tissueid.units import display_unit, shown_si, unit_of

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
        self.comparison: Comparison | None = None
        self.words = build.label("headline")
        self.remarks = build.label("muted")
        self.against = build.styled(
            QComboBox(),
            name=_("Compare the newest sweep with"),
            tip=_("Compare the newest of the selected sweeps with"),
        )
        self.against.currentIndexChanged.connect(self._compare)
        appearance.changed.connect(self._show_key)
        self.cards = {name: PlotCanvas(_(axis.label)) for name, (axis, _scale) in ALONG_STROKE.items()}
        for card in self.cards.values():
            card.setMinimumHeight(_PLOT_HEIGHT)
        self.model = PiecesModel(
            (_("Quantity"), _("Difference"), _("±2 std"), _("Which is"), _("Before"), _("Now"), _("Unit")),
            _cell,
            level=lambda row: "check" if isinstance(row, Difference) and row.verdict == "beyond" else "",
            marked=3,
            right=(1, 2, 4, 5),
        )
        self.figures = table_of(
            self.model, _("Figures of the sweeps and their differences"), (178, 75, 60, 165, 130, 130)
        )
        self.tabs = build.styled(QTabWidget(), document_mode=True)
        self.tabs.tabBar().setDrawBase(False)
        self.tabs.tabBar().setAccessibleName(_("Sweeps: along the stroke, or figures"))
        self.tabs.addTab(self._make_plots(), _("Along the stroke"))
        self.tabs.addTab(self.figures, _("Values"))
        top = QHBoxLayout()
        top.addWidget(self.words, 1)
        top.addWidget(self.against, 0, Qt.AlignmentFlag.AlignTop)
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
        page = QWidget()
        grid = QGridLayout(page)
        grid.setContentsMargins(0, 6, 0, 0)
        grid.setSpacing(6)
        for number, widget in enumerate((*self.cards.values(), card)):
            grid.addWidget(widget, number // 2, number % 2)
        for line in range(3):
            grid.setRowStretch(line, 1)
        for column in range(2):
            grid.setColumnStretch(column, 1)
        return page

    def show_sweeps(self, sweeps: Sequence[Calibration]) -> None:
        """Show these; the newest is the one that is compared."""
        self._sweeps = tuple(sorted(sweeps, key=lambda item: item.made, reverse=True)[:MOST])
        self.against.blockSignals(True)
        self.against.clear()
        for sweep in self._sweeps[1:]:
            self.against.addItem(
                _("against {date}, {serial}").format(date=sweep.date[:10], serial=clean(sweep.serial_number)[:30])
            )
        self.against.blockSignals(False)
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


def _profile_words(found: Comparison) -> str:
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


def _cell(row: Difference | tuple[str, Quantity], column: int) -> str:
    if isinstance(row, tuple):
        label, value, unit = figure_of(*row)
        return (label, "", "", "", "", value, unit)[column]
    unit, scale = shown_si(row.before.unit)
    if column in (4, 5):
        held = row.before if column == 4 else row.now
        return plus_minus(Estimate(held.value, held.std), scale)
    return (translated(label_of(row.name)), *_sizes(row, scale), _(_SAID[row.verdict]), "", "", unit)[column]


def _sizes(row: Difference, scale: float) -> tuple[str, str]:
    """A difference and what it is not known better than, as shares where the figure has a scale."""
    known = None if row.uncertainty is None else SIGNIFICANT_STD * row.uncertainty
    if np.isfinite(row.relative):
        share = None if known is None else 100.0 * known / abs(row.before.value)
        return f"{fixed(100.0 * row.relative, 1)} %", MISSING if share is None else f"{fixed(share, 1)} %"
    decimals = 2 if scale == display_unit(row.before.unit)[1] else 5
    return fixed(scale * row.absolute, decimals), MISSING if known is None else fixed(scale * known, decimals)
