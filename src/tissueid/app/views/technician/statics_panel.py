"""A static calibration: its figures with their deviations, what lies off its lines, and each figure over the dates."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime

from PySide6.QtWidgets import QComboBox, QHBoxLayout, QWidget

from tissueid.analysis.curves.calibration_plots import residual_plot, trend_plot
from tissueid.app import build
from tissueid.app.calibration_state import figure_of
from tissueid.app.plot_canvas import PlotCanvas
from tissueid.app.views.technician.tab import PiecesModel, table_of
from tissueid.app.widgets import plain_tip, show_level
from tissueid.app.words import sentence
from tissueid.calibration.comparison import Residuals, residuals, trend
from tissueid.calibration.file import Calibration
from tissueid.calibration.labels import label_of, notes_of, problems_of, verdict_of
from tissueid.formatting import clean
from tissueid.language import _
from tissueid.messages import translated

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
        self.line = build.styled(
            QComboBox(), name=_("Which line's residuals"), tip=_("Which line's residuals are shown")
        )
        self.line.currentIndexChanged.connect(self._show_residuals)
        self.figure = build.styled(
            QComboBox(), name=_("Figure whose trend is shown"), tip=_("Figure whose trend over the dates is shown")
        )
        self.figure.currentIndexChanged.connect(self._show_trend)
        for choice in (self.line, self.figure):
            choice.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
            choice.setMinimumContentsLength(16)
        self.off, self.over_dates = PlotCanvas(), PlotCanvas()
        self.drift = build.label("muted")
        below = QHBoxLayout()
        below.setSpacing(6)
        for choice, card in ((self.line, self.off), (self.figure, self.over_dates)):
            column = build.column(choice, (card, 1), spacing=4)
            below.addLayout(column, 1)
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
        choice.blockSignals(True)
        choice.clear()
        for text, name in items:
            choice.addItem(clean(text), name)
        choice.setCurrentIndex(max(0, choice.findData(kept)) if items else -1)
        choice.blockSignals(False)
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
