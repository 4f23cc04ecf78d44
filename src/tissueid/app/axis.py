"""Axes with a grid that is drawn fast enough for thirty frames a second of several plots."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pyqtgraph as pg
from PySide6.QtCore import QPointF, QRectF
from PySide6.QtGui import QColor, QPainter, QPen
from PySide6.QtWidgets import QGraphicsItem, QGraphicsSceneWheelEvent, QStyleOptionGraphicsItem, QWidget

from tissueid.language import decimal

Line = tuple[QPen, QPointF, QPointF]
Text = tuple[QRectF, int, str]

_UNDER = -200.0
"""Depth of the axes: pyqtgraph puts what is plotted at -100."""
_APART = 3.0
"""Least distance between two numbers, pixels."""
_FINEST = 1
"""Ticks at whole steps and parts of them; tenths of a step are too faint to be seen, and cost as much as the rest."""


class QuickAxis(pg.AxisItem):  # type: ignore[misc]
    """An axis whose look is pyqtgraph's, at a fraction of the time.

    pyqtgraph records every axis before it plays it back, and blends each translucent line of the grid with what is
    under it, pixel by pixel. Here the grid lies under everything else, and each of its lines is an opaque rectangle
    in the colour that the blend with the ground comes to.
    """

    def __init__(self, side: str) -> None:
        super().__init__(side)
        self._ground = QColor("white")
        self.setCacheMode(QGraphicsItem.CacheMode.DeviceCoordinateCache)  # as long as neither range nor size changes
        self.enableAutoSIPrefix(False)  # or pyqtgraph sets the label again, in HTML, whenever the range changes
        self.setStyle(maxTickLevel=_FINEST)

    def wheelEvent(self, event: QGraphicsSceneWheelEvent) -> None:  # noqa: N802
        """Zoom by the wheel where the plot does; elsewhere leave it to the page, which scrolls."""
        view = self.linkedView()
        if view is None or not any(view.mouseEnabled()):
            event.ignore()
            return
        super().wheelEvent(event)

    def tickStrings(self, values: list[float], scale: float, spacing: float) -> list[str]:  # noqa: N802
        """Return the numbers with the decimal mark of the language."""
        return [decimal(text) for text in super().tickStrings(values, scale, spacing)]

    def set_ground(self, colour: str) -> None:
        """On which colour the grid lies."""
        self._ground = QColor(colour)
        self.setZValue(_UNDER)
        self.update()

    def paint(self, painter: QPainter, _option: QStyleOptionGraphicsItem, _widget: QWidget | None = None) -> None:
        """Draw line, grid and numbers; nothing while there is no room for them."""
        specification = self.generateDrawSpecs(painter)
        if specification is not None:
            self.drawPicture(painter, *specification)

    def drawPicture(self, painter: QPainter, line: Line, grid: Sequence[Line], texts: Sequence[Text]) -> None:  # noqa: N802
        """Draw these lines and texts, in the item's coordinates."""
        painter.setRenderHint(QPainter.RenderHint.Antialiasing, False)
        painter.setRenderHint(QPainter.RenderHint.TextAntialiasing, True)
        colours: dict[int, QColor] = {}
        for pen, start, end in grid:
            wanted = pen.color()
            seen = colours.get(wanted.alpha())
            if seen is None:
                seen = colours[wanted.alpha()] = _over(self._ground, wanted)
            left, top = math.floor(min(start.x(), end.x())), math.floor(min(start.y(), end.y()))
            width, height = math.ceil(abs(end.x() - start.x())), math.ceil(abs(end.y() - start.y()))
            painter.fillRect(left, top, max(1, width), max(1, height), seen)
        pen, start, end = line
        painter.setPen(pen)
        painter.drawLine(start, end)
        if self.style["tickFont"] is not None:
            painter.setFont(self.style["tickFont"])
        painter.setPen(self.textPen())
        painter.setClipRect(self.boundingRect().toAlignedRect())
        for place, flags, text in without_overlaps(texts):
            painter.drawText(place, int(flags), text)


def without_overlaps(texts: Sequence[Text]) -> list[Text]:
    """Return the texts that do not touch one before them; those of the coarser ticks come first, and stay."""
    kept: list[Text] = []
    for text in texts:
        room = text[0].adjusted(-_APART, 0.0, _APART, 0.0)
        if not any(room.intersects(other[0]) for other in kept):
            kept.append(text)
    return kept


def _over(ground: QColor, colour: QColor) -> QColor:
    """What a translucent colour comes to over an opaque one."""
    share, rest = colour.alphaF(), 1.0 - colour.alphaF()
    return QColor.fromRgbF(
        share * colour.redF() + rest * ground.redF(),
        share * colour.greenF() + rest * ground.greenF(),
        share * colour.blueF() + rest * ground.blueF(),
    )
