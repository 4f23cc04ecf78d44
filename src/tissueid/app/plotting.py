"""One plot on a card: a title with its key, axes with units, curves that follow the palette."""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Collection, Sequence

import numpy as np
import pyqtgraph as pg
from numpy.typing import NDArray
from PySide6.QtCore import QPointF, QRectF, Qt
from PySide6.QtGui import QColor, QFont, QPainter, QPen
from PySide6.QtWidgets import (
    QFrame,
    QGraphicsItem,
    QGraphicsSceneWheelEvent,
    QLabel,
    QSizePolicy,
    QStyleOptionGraphicsItem,
    QWidget,
)

from tissueid.app import build
from tissueid.app.theme import Theme, appearance, faint
from tissueid.app.widgets import ElidedLabel
from tissueid.language import _, decimal
from tissueid.units import shown, shown_label

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
            x, y = math.floor(min(start.x(), end.x())), math.floor(min(start.y(), end.y()))
            width, height = math.ceil(abs(end.x() - start.x())), math.ceil(abs(end.y() - start.y()))
            painter.fillRect(x, y, max(1, width), max(1, height), seen)
        pen, start, end = line
        painter.setPen(pen)
        painter.drawLine(start, end)
        if self.style["tickFont"] is not None:
            painter.setFont(self.style["tickFont"])
        painter.setPen(self.textPen())
        painter.setClipRect(self.boundingRect().toAlignedRect())
        for area, flags, text in without_overlaps(texts):
            painter.drawText(area, int(flags), text)


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


Array = NDArray[np.float64]

_AXIS_WIDTH = 40
_GRID = 70
"""Opacity of the grid, of 255."""
_LOG_STEPS = (1.0, 2.0, 5.0)
_LEAST_DECADE = 20.0
"""Distance of two labelled decades, pixels, below which some are left out."""
_NOTHING = np.zeros(0)


class LogAxis(QuickAxis):
    """An axis whose data are decimal logarithms, labelled with plain numbers at 1, 2 and 5."""

    def tickValues(self, low: float, high: float, size: float) -> list[tuple[float, list[float]]]:  # noqa: N802
        """Ticks from ``low`` to ``high``; fewer when they would crowd ``size`` pixels."""
        every = max(1, math.ceil(_LEAST_DECADE * (high - low) / max(size, 1.0)))
        decades = range(every * math.floor(low / every), math.ceil(high) + 1, every)
        steps = _LOG_STEPS if size / max(high - low, 1e-9) > 90.0 else _LOG_STEPS[:1]
        values = [decade + math.log10(step) for decade in decades for step in steps]
        return [(1.0, [value for value in values if low <= value <= high])]

    def tickStrings(self, values: list[float], scale: float, spacing: float) -> list[str]:  # noqa: N802
        """The numbers themselves, in the unit that is shown."""
        return [decimal(f"{10.0**value * scale:.4g}") for value in values]


class PlotCard(QFrame):
    """A plot under a heading that carries its unit, if it has one.

    What is drawn is in clinical units; ticks, heading and label below say it in those in force. ``unit`` is that of
    the ordinate; that of the abscissa is the one in brackets in ``x_label``.
    ``key`` maps what curves are called to the role of their colour.
    ``log_axes`` names the sides, "bottom" and "left", whose data are decimal logarithms.
    """

    def __init__(
        self,
        title: str,
        x_label: str,
        unit: str,
        *,
        key: dict[str, str] | None = None,
        log_axes: Collection[str] = (),
        parent: QWidget | None = None,
    ) -> None:
        super().__init__(parent)
        self.setProperty("role", "card")
        self._title, self._unit = title, unit
        self._key = key or {}
        self._painters: list[Callable[[Theme], object]] = []
        # Without a menu from the beginning: making one only to take it away is a third of what a plot costs.
        axes = {side: LogAxis(side) if side in log_axes else QuickAxis(side) for side in ("left", "bottom")}
        self.plot = pg.PlotWidget(axisItems=axes, enableMenu=False)
        for side in ("right", "top"):  # hidden, but they follow
            self.plot.getAxis(side).enableAutoSIPrefix(False)
        for side, axis in axes.items():
            axis.setGrid(_GRID)
            axis.setStyle(tickLength=0, showValues=side == "left" or bool(x_label))
        self.plot.setMenuEnabled(False)
        self.plot.setMouseEnabled(x=False, y=False)
        self.plot.hideButtons()
        build.styled(
            self.plot,
            focus_policy=Qt.FocusPolicy.NoFocus,
            minimum_height=60,
            size_policy=(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Ignored),
        )
        self._remark: tuple[str, str] | None = None
        self._x_label = x_label
        self.plot.getAxis("left").setWidth(_AXIS_WIDTH)
        self.heading = build.styled(ElidedLabel(), role="heading")
        self.legend = build.styled(
            QLabel(textFormat=Qt.TextFormat.RichText, wordWrap=True),
            role="muted",
            alignment=Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter,
        )
        self.missing = build.styled(
            QLabel(),
            role="muted",
            word_wrap=True,
            minimum_width=1,
            text_format=Qt.TextFormat.PlainText,
            hidden=True,
            alignment=Qt.AlignmentFlag.AlignCenter,
        )
        build.column(
            build.row(self.heading, (self.legend, 1), spacing=2),
            (self.plot, 1),
            (self.missing, 1),
            spacing=2,
            margins=(10, 6, 10, 6),
            parent=self,
        )
        self._head()
        self.plot.getAxis("bottom").setScale(shown_label(x_label)[1])
        appearance.follow(self._paint)

    def line(self, role: str, *, width: int = 1, alpha: int = 255) -> pg.PlotDataItem:
        """Add an empty line in the colour of a role. Long ones must be one pixel wide to be drawn fast."""
        item = self.plot.plot(_NOTHING, _NOTHING, connect="finite")
        self._colour(lambda theme: item.setPen(pg.mkPen(faint(getattr(theme, role), alpha), width=width)))
        return item

    def dots(self, role: str, size: int = 3) -> pg.PlotDataItem:
        """Add empty dots in the colour of a role."""
        item = self.plot.plot(_NOTHING, _NOTHING, pen=None, symbol="o", symbolSize=size, symbolPen=None)
        self._colour(lambda theme: item.setSymbolBrush(faint(getattr(theme, role), 150)))
        return item

    def band(self, role: str, *, alpha: int = 60) -> tuple[pg.PlotCurveItem, pg.PlotCurveItem]:
        """Add an empty band; returns its lower and upper edge. The axes do not stretch to hold it."""
        edges = pg.PlotCurveItem(_NOTHING, _NOTHING, pen=None), pg.PlotCurveItem(_NOTHING, _NOTHING, pen=None)
        band = pg.FillBetweenItem(*edges)
        for item in (*edges, band):
            self.plot.addItem(item, ignoreBounds=True)
        self._colour(lambda theme: band.setBrush(faint(getattr(theme, role), alpha)))
        return edges

    def mark(self, *, upright: bool = True, text: str = "") -> pg.InfiniteLine:
        """Add a hidden thin line across the plot, with a text at its end if there is one."""
        where = {"position": 0.99, "anchors": [(1.0, 1.0), (1.0, 1.0)]}
        item = pg.InfiniteLine(angle=90 if upright else 0, label=text or None, labelOpts=where if text else None)
        item.hide()
        self.plot.addItem(item, ignoreBounds=True)
        self._colour(lambda theme: item.setPen(pg.mkPen(theme.muted, width=1, style=Qt.PenStyle.DotLine)))
        if text:
            self._colour(lambda theme: item.label.setColor(theme.muted))
        return item

    def _colour(self, paint: Callable[[Theme], object]) -> None:
        """Apply the active theme to an item, now and whenever the theme changes."""
        self._painters.append(paint)
        paint(appearance.theme)

    def retitle(self, title: str, unit: str) -> None:
        """Change the heading."""
        if (title, unit) != (self._title, self._unit):
            self._title, self._unit = title, unit
            self._head()

    def relabel(self, x_label: str) -> None:
        """Change the label of the bottom axis."""
        if x_label != self._x_label:
            self._x_label = x_label
            self.plot.getAxis("bottom").setStyle(showValues=bool(x_label))
            self.take_units()

    def take_units(self) -> None:
        """Show labels and ticks in the active units; the curves stay."""
        self._head()
        self.plot.getAxis("bottom").setScale(shown_label(self._x_label)[1])
        self._label_below()

    def _head(self) -> None:
        title, (unit, factor) = self._title, shown(self._unit)
        self.heading.setText(f"{title} ({unit})" if unit else title)
        self.plot.setAccessibleName(
            _("Plot: {title}, {unit}").format(title=title, unit=unit)
            if unit
            else _("Plot: {title}").format(title=title)
        )
        self.plot.getAxis("left").setScale(factor)

    def _label_below(self) -> None:
        if self._x_label:
            look = {"color": appearance.theme.muted, "font-size": f"{_small().pointSizeF():.1f}pt"}
            # Without ranges in which it may, pyqtgraph does not turn 0.4 s into 400 of a unit that no label names.
            self.plot.getAxis("bottom").setLabel(shown_label(self._x_label)[0], siPrefixEnableRanges=(), **look)

    def remark(self, text: str, role: str = "muted") -> None:
        """Show a text next to the key in the colour of a role; empty removes it."""
        remark = (text, role) if text else None
        if remark != self._remark:
            self._remark = remark
            self._show_key()

    def say_missing(self, text: str) -> None:
        """Show a text in place of the plot; empty shows the plot."""
        self.missing.setText(text)
        self.missing.setVisible(bool(text))
        self.plot.setVisible(not text)
        self.legend.setVisible(not text)

    def _paint(self) -> None:
        theme = appearance.theme
        self.plot.setBackground(theme.panel)
        small = _small()
        for side in ("left", "bottom"):
            axis = self.plot.getAxis(side)
            axis.setPen(theme.line)
            axis.setTextPen(theme.muted)
            axis.setTickFont(small)
            axis.set_ground(theme.panel)
        for paint in self._painters:
            paint(theme)
        self._label_below()
        self._show_key()

    def _show_key(self) -> None:
        theme = appearance.theme
        entries = [f'<span style="color:{getattr(theme, role)}">■</span> {name}' for name, role in self._key.items()]
        if self._remark is not None:
            text, role = self._remark
            entries.append(f'<span style="color:{getattr(theme, role)}">{html.escape(text)}</span>')
        self.legend.setText("&nbsp;&nbsp; ".join(entries))


def _small() -> QFont:
    """Return the font of ticks and labels."""
    small = appearance.font(0.85)
    small.setPointSizeF(max(7.0, small.pointSizeF()))
    return small
