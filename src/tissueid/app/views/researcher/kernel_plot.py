"""Plot of a kernel as an image with a colour bar, or as a surface."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import QRectF
from PySide6.QtGui import QColor
from PySide6.QtWidgets import QButtonGroup, QComboBox, QHBoxLayout, QPushButton, QStackedWidget, QVBoxLayout, QWidget

from tissueid.app.plotting import PlotCard
from tissueid.app.surface_plot import SurfacePlot
from tissueid.app.theme import Theme
from tissueid.app.units import shown, shown_label
from tissueid.app.views.researcher.engine_outcome import EngineOutcome
from tissueid.app.views.researcher.plot_data import Image
from tissueid.language import _, marked

_MISSING = marked("No result has a kernel to show: run Volterra, Depth or Direction.")


class KernelPlot(QWidget):
    """Plot of one kernel, selected by ``choice``; ``flat`` is the image, ``raised`` the surface.

    ``surface`` is None until it is asked for.
    """

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.choice = QComboBox()
        self.choice.setAccessibleName(_("Result whose kernel is shown"))
        # As wide as there is room: a long name must not widen the page.
        self.choice.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        self.choice.setMinimumContentsLength(10)
        self.choice.currentIndexChanged.connect(self._show)
        self.card = PlotCard(_("Kernel"), " ", "", unit_of="colours")
        self.card.plot.getAxis("left").setWidth(66)
        self._item = pg.ImageItem()
        self.card.plot.addItem(self._item)
        self._bar = pg.ColorBarItem(interactive=False, width=14)
        self._bar.setImageItem(self._item, insert_in=self.card.plot.getPlotItem())
        self._images: list[Image] = []
        self._theme: Theme | None = None
        self.surface: SurfacePlot | None = None
        self.flat, self.raised = QPushButton(_("Image")), QPushButton(_("Surface"))
        self.flat.setToolTip(_("Seen from above, every value a colour"))
        self.raised.setToolTip(_("In space, every value a height; it can be turned"))
        self._ways = QButtonGroup(self)
        top = QHBoxLayout()
        top.setSpacing(4)
        top.addWidget(self.choice, 1)
        for button in (self.flat, self.raised):
            button.setCheckable(True)
            button.setProperty("role", "toggle")
            self._ways.addButton(button)
            top.addWidget(button)
        self.flat.setChecked(True)
        self._ways.buttonToggled.connect(self._turn)
        self._pages = QStackedWidget()
        self._pages.addWidget(self.card)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(4)
        layout.addLayout(top)
        layout.addWidget(self._pages, 1)
        self._show()

    @property
    def image(self) -> Image | None:
        """The shown image."""
        place = self.choice.currentIndex()
        return self._images[place] if 0 <= place < len(self._images) else None

    @property
    def turned(self) -> bool:
        """Whether the surface is shown."""
        return self.raised.isChecked()

    def offer(self, outcomes: Sequence[EngineOutcome]) -> None:
        """Offer the images of results; the selection stays."""
        before = self.choice.currentText()
        pairs = [(f"{outcome.label}: {image.title}", image) for outcome in outcomes for image in outcome.plots.images]
        self.choice.blockSignals(True)
        self.choice.clear()
        self.choice.addItems([text for text, _ in pairs])
        self._images = [image for _, image in pairs]
        self.choice.setCurrentIndex(max(0, self.choice.findText(before)) if pairs else -1)
        self.choice.blockSignals(False)
        self._show()

    def apply_theme(self, theme: Theme) -> None:
        """Take on the colours of a theme: nothing is the colour of the card, so that only what there is stands out."""
        self._theme = theme
        self.card.apply_theme(theme)
        ends = QColor(theme.measured), QColor(theme.panel), QColor(theme.model)
        self._bar.setColorMap(pg.ColorMap([0.0, 0.5, 1.0], list(ends)))
        self._bar.axis.setPen(theme.line)
        self._bar.axis.setTextPen(theme.muted)
        if self.surface is not None:
            self.surface.apply_theme(theme)
        self._label()

    def take_units(self) -> None:
        """Show all values in the active unit system."""
        self._label()

    def _show(self) -> None:
        image = self.image
        self.card.say_missing("" if image else _(_MISSING))
        for widget in (self.choice, self.flat, self.raised):
            widget.setVisible(image is not None)
        if image is None:
            self._pages.setCurrentIndex(0)
            return
        if self.surface is not None:
            self.surface.show_image(image)
            self._pages.setCurrentIndex(int(self.raised.isChecked()))
        # Cells are drawn about the points that they stand for.
        (left, width), (low, height) = _reach(image.x), _reach(image.y)
        limit = float(np.nanmax(np.abs(image.values))) or 1.0
        self._item.setImage(image.values, levels=(-limit, limit))
        self._item.setRect(QRectF(left, low, width, height))
        self._bar.setLevels((-limit, limit))
        self.card.plot.setXRange(left, left + width, padding=0.0)
        self.card.plot.setYRange(low, low + height, padding=0.0)
        self.card.retitle(image.title, image.unit)
        self._label()

    def _label(self) -> None:
        image, theme = self.image, self._theme
        if image is not None and theme is not None:
            self.card.relabel(image.x_label)
            text, factor = shown_label(image.y_label)
            axis = self.card.plot.getAxis("left")
            axis.setScale(factor)
            axis.setLabel(text, siPrefixEnableRanges=(), color=theme.muted)
            self._bar.axis.setScale(shown(image.unit)[1])

    def _turn(self) -> None:
        """Switch between image and surface; the surface is created on first use."""
        if self.raised.isChecked() and self.surface is None:
            self.surface = SurfacePlot()
            if self._theme is not None:
                self.surface.apply_theme(self._theme)
            self._pages.addWidget(self.surface)
        self._show()


def _reach(points: np.ndarray) -> tuple[float, float]:
    """Return the start of the first of evenly spaced cells, and the total width."""
    step = float(points[1] - points[0]) if points.size > 1 else 1.0
    return float(points[0]) - 0.5 * step, step * points.size
