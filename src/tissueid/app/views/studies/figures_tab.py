"""Figures of the report of a study, drawn by the renderer of reports."""

from __future__ import annotations

from typing import TYPE_CHECKING

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QComboBox, QHBoxLayout, QPushButton, QVBoxLayout, QWidget

from tissueid.app.plot_canvas import PlotCanvas
from tissueid.app.theme import Theme
from tissueid.app.widgets import plain_label
from tissueid.formatting import label_and_unit
from tissueid.language import _
from tissueid.messages import Verbatim, translated

if TYPE_CHECKING:
    from tissueid.reports.study_curves import Plots
    from tissueid.studies.study_statistics import StudyStatistics

_MOST_REMARKS = 6


class FiguresTab(QWidget):
    """One figure at a time, chosen by kind and parameter. ``wanted`` asks for the statistics."""

    wanted = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.figures: list[tuple[str, Plots]] = []
        self.compute = QPushButton(_("Compute figures"))
        self.compute.setToolTip(_("Statistics and figures of the table as it is"))
        self.kind, self.parameter = QComboBox(), QComboBox()
        self.kind.setAccessibleName(_("Figure"))
        self.parameter.setAccessibleName(_("Parameter of the figure"))
        self.canvas = PlotCanvas(_("Figure of the study"))
        self.remarks = plain_label("muted")
        row = QHBoxLayout()
        row.setSpacing(6)
        for choice in (self.kind, self.parameter):
            choice.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
            choice.setMinimumContentsLength(10)
            row.addWidget(choice, 1)
        row.addWidget(self.compute)
        rows = QVBoxLayout(self)
        rows.setContentsMargins(0, 8, 0, 0)
        rows.setSpacing(6)
        rows.addLayout(row)
        rows.addWidget(self.canvas, 1)
        rows.addWidget(self.remarks)
        self.compute.clicked.connect(self.wanted)
        self.kind.currentIndexChanged.connect(self._choose_kind)
        self.parameter.currentIndexChanged.connect(self._draw)
        self.clear()

    @property
    def fields(self) -> list[QWidget]:
        """Widgets in tab order."""
        return [self.kind, self.parameter, self.compute]

    def clear(self) -> None:
        """Show that there are no figures yet."""
        self.figures = []
        for choice in (self.kind, self.parameter):
            choice.blockSignals(True)
            choice.clear()
            choice.blockSignals(False)
            choice.setEnabled(False)
        self.remarks.hide()
        self.canvas.say_missing(_("Analyse the study, then compute its figures."))

    def show_statistics(self, found: StudyStatistics) -> None:
        """Offer the figures of the statistics; the chosen kind and parameter stay if they are there."""
        from tissueid.reports.study import simulated_line, study_plots

        title = self.kind.currentText()
        self.figures = [(heading, plots) for _key, heading, plots in study_plots(found)]
        self.kind.blockSignals(True)
        self.kind.clear()
        for heading, _plots in self.figures:
            self.kind.addItem(heading)
        self.kind.setCurrentIndex(max(0, self.kind.findText(title)))
        self.kind.blockSignals(False)
        self.kind.setEnabled(bool(self.figures))
        simulated = simulated_line(found)
        remarks = [*([simulated] if simulated else []), *(translated(remark) for remark in found.remarks)]
        more = [_("and {count} more: see the report").format(count=len(remarks) - _MOST_REMARKS)]
        shown = remarks[:_MOST_REMARKS] + (more if len(remarks) > _MOST_REMARKS else [])
        self.remarks.setText("\n".join(shown))
        self.remarks.setVisible(bool(shown))
        self._choose_kind()

    def apply_theme(self, theme: Theme) -> None:
        """Apply the colours of a theme."""
        self.canvas.apply_theme(theme)

    def update_enabled(self, *, busy: bool, has_table: bool) -> None:
        """Enable what makes sense now."""
        self.compute.setEnabled(has_table and not busy)

    def _choose_kind(self) -> None:
        if not 0 <= self.kind.currentIndex() < len(self.figures):
            self.canvas.say_missing(_("The table has no parameter that can be drawn."))
            return
        from tissueid.reports.study import OF_SEVERAL  # it imports matplotlib

        asked = self.parameter.currentData()
        self.parameter.blockSignals(True)
        self.parameter.clear()
        for name in self.figures[self.kind.currentIndex()][1]:
            label = str(name) if isinstance(name, Verbatim) else _(label_and_unit(name)[0])
            self.parameter.addItem(_("all parameters") if name in OF_SEVERAL else label, str(name))
        self.parameter.setCurrentIndex(max(0, self.parameter.findData(asked)))
        self.parameter.blockSignals(False)
        self.parameter.setEnabled(self.parameter.count() > 1)
        self._draw()

    def _draw(self) -> None:
        plots = self.figures[self.kind.currentIndex()][1]
        if (make := plots.get(self.parameter.currentData())) is not None:
            self.canvas.show_plots([make()])
