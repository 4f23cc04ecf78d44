"""Figures of the report of a study, drawn by the renderer of reports."""

from __future__ import annotations

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QComboBox, QWidget

from tissueid.app import build
from tissueid.app.build import button, column, row
from tissueid.app.plot_canvas import PlotCanvas
from tissueid.app.views.studies.study_figures import StudyFigures
from tissueid.language import _

_MOST_REMARKS = 6


class FiguresTab(QWidget):
    """One figure at a time, chosen by kind and parameter. ``wanted`` asks for the figures."""

    wanted = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.figures = StudyFigures()
        self.compute = button(_("Compute figures"), self.wanted, tip=_("Statistics and figures of the table as it is"))
        self.save = button(_("Save figure…"), tip=_("Save the figure as PNG, SVG or PDF, or its numbers as CSV"))
        self.kind, self.parameter = QComboBox(), QComboBox()
        self.kind.setAccessibleName(_("Kind of the figure"))
        self.parameter.setAccessibleName(_("Parameter of the figure"))
        self.canvas = PlotCanvas(_("Figure of the study"))
        self.remarks = build.label("muted")
        for choice in (self.kind, self.parameter):
            build.styled(
                choice,
                size_adjust_policy=QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon,
                minimum_contents_length=10,
            )
        top = row((self.kind, 1), (self.parameter, 1), self.save, self.compute)
        self.setLayout(column(top, (self.canvas, 1), self.remarks, margins=(0, 8, 0, 0)))
        self.save.clicked.connect(self.canvas.ask_where_to_save)
        self.kind.currentIndexChanged.connect(self._choose_kind)
        self.parameter.currentIndexChanged.connect(self._draw)
        self.show_figures(None, analysed=False)

    @property
    def fields(self) -> list[QWidget]:
        """Widgets in tab order."""
        return [self.kind, self.parameter, self.save, self.compute]

    def show_figures(self, found: StudyFigures | None, *, analysed: bool) -> None:
        """Offer the figures of a study; the chosen kind and parameter stay if they are there."""
        self.figures = found or StudyFigures()
        _fill(self.kind, [heading for heading, _figures in self.figures.groups])
        count, more = _MOST_REMARKS, len(self.figures.remarks) - _MOST_REMARKS
        shown = [
            *self.figures.remarks[:count],
            *([_("and {count} more: see the report").format(count=more)] * (more > 0)),
        ]
        self.remarks.setText("\n".join(shown))
        self.remarks.setVisible(bool(shown))
        self._choose_kind()
        if found is None:
            self.canvas.say_missing(
                _("Press “Compute figures” to draw the figures of this table.")
                if analysed
                else _("Press “Analyse” first: the figures are drawn from its table.")
            )

    def update_enabled(self, *, busy: bool, has_table: bool) -> None:
        """Enable what makes sense now."""
        self.compute.setEnabled(has_table and not busy)

    def _choose_kind(self) -> None:
        place = self.kind.currentIndex()
        figures = self.figures.groups[place][1] if place >= 0 else ()
        _fill(self.parameter, [label for label, _plot in figures])
        self.save.setEnabled(bool(figures))
        self._draw()

    def _draw(self) -> None:
        place = self.kind.currentIndex()
        if place < 0:
            self.canvas.say_missing(_("The table has no parameter that can be drawn."))
        else:
            self.canvas.show_plots([self.figures.groups[place][1][self.parameter.currentIndex()][1]])


def _fill(choice: QComboBox, texts: list[str]) -> None:
    """Offer texts; the chosen one stays if it is there."""
    kept = choice.currentText()
    choice.blockSignals(True)
    choice.clear()
    choice.addItems(texts)
    choice.setCurrentIndex(max(0, choice.findText(kept)) if texts else -1)
    choice.blockSignals(False)
    choice.setEnabled(len(texts) > 1)
