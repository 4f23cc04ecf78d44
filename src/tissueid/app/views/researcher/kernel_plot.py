"""Plot of a kernel as an image or as a surface that is turned, or of several kernels side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from PySide6.QtWidgets import QButtonGroup, QComboBox, QPushButton, QWidget

from tissueid.app import build
from tissueid.app.plot_canvas import PlotCanvas
from tissueid.app.views.researcher.engine_outcome import EngineOutcome
from tissueid.language import _, marked
from tissueid.messages import Verbatim

if TYPE_CHECKING:
    from tissueid.analysis.curves import Plot

_MOST_BESIDE = 4
"""Largest number of kernels side by side: more would be too small."""
_MISSING = marked("No result has a kernel to show: run Volterra, Depth or Direction.")


class KernelPlot(QWidget):
    """Plot of one kernel, selected by ``choice``: an image where ``flat`` is checked, a surface where ``raised`` is.

    With kernels of several results, ``choice`` also offers those of the same kind side by side (Chen 2010, Fig. 4.12).
    """

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.choice = build.styled(QComboBox(), name=_("Result whose kernel is shown"))
        # As wide as there is room: a long name must not widen the page.
        self.choice.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        self.choice.setMinimumContentsLength(10)
        self.choice.currentIndexChanged.connect(self._show)
        self.canvas = PlotCanvas()
        self._plots: list[Plot] = []
        self._groups: list[tuple[Plot, ...]] = []
        self.back = build.button(_("Reset view"), tip=_("Look at it as at first (Home)"))
        self.back.clicked.connect(self.canvas.show_everything)
        self.flat, self.raised = QPushButton(_("Image")), QPushButton(_("Surface"))
        self.flat.setToolTip(_("Seen from above, every value a colour"))
        self.raised.setToolTip(_("In space, every value a height; it can be turned"))
        self._ways = QButtonGroup(self)
        top = build.row((self.choice, 1), self.back, spacing=4)
        for button in (self.flat, self.raised):
            button.setCheckable(True)
            button.setProperty("role", "toggle")
            self._ways.addButton(button)
            top.addWidget(button)
        self.flat.setChecked(True)
        self.raised.toggled.connect(self._show)
        build.column(top, (self.canvas, 1), spacing=4, parent=self)
        self._show()

    @property
    def plot(self) -> Plot | None:
        """The shown kernel."""
        place = self.choice.currentIndex()
        return self._plots[place] if 0 <= place < len(self._plots) else None

    @property
    def side_by_side(self) -> tuple[Plot, ...]:
        """The kernels that are shown side by side; empty where one is shown."""
        place = self.choice.currentIndex() - len(self._plots)
        return self._groups[place] if 0 <= place < len(self._groups) else ()

    @property
    def turned(self) -> bool:
        """Whether the surface is shown."""
        return self.raised.isChecked() and not self.side_by_side

    def offer(self, outcomes: Sequence[EngineOutcome]) -> None:
        """Offer the kernels of results; the selection stays."""
        before = self.choice.currentText()
        pairs = [(f"{outcome.label}: {_(plot.title)}", plot) for outcome in outcomes for plot in outcome.plots.kernels]
        self.choice.blockSignals(True)
        self.choice.clear()
        self._plots = [plot for _name, plot in pairs]
        kinds: dict[str, list[Plot]] = {}
        for outcome in outcomes:
            for plot in outcome.plots.kernels:
                kinds.setdefault(str(plot.title), []).append(replace(plot, title=Verbatim(outcome.label)))
        several = {title: _on_one_scale(plots[:_MOST_BESIDE]) for title, plots in kinds.items() if len(plots) > 1}
        self._groups = list(several.values())
        together = [_("{kernel}: side by side").format(kernel=_(title)) for title in several]
        self.choice.addItems([text for text, _plot in pairs] + together)
        self.choice.setCurrentIndex(max(0, self.choice.findText(before)) if pairs else -1)
        self.choice.blockSignals(False)
        self._show()

    def _show(self) -> None:
        plot, together = self.plot, self.side_by_side
        self.choice.setVisible(plot is not None or bool(together))
        for widget in (self.flat, self.raised):
            widget.setVisible(plot is not None)
        self.back.setVisible(plot is not None and self.turned)
        if together:
            self.canvas.show_plots(together, side_by_side=True)
        elif plot is None:
            self.canvas.say_missing(_(_MISSING))
        else:
            self.canvas.show_plots([plot], relief=self.turned)


def _on_one_scale(plots: Sequence[Plot]) -> tuple[Plot, ...]:
    """Return plots of kernels with the same scale of colours."""
    surfaces = [plot.surface for plot in plots if plot.surface is not None]
    top = max((float(np.abs(surface.values).max()) for surface in surfaces), default=0.0)
    return tuple(
        plot if plot.surface is None else replace(plot, parts=(replace(plot.surface, limit=top or None),))
        for plot in plots
    )
