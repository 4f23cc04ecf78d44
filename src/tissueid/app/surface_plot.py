"""A surface in space that is turned by mouse or keyboard, drawn without a graphics card."""

from __future__ import annotations

import math

import numpy as np
from PySide6.QtCore import QPointF, QRectF, QSize, Qt
from PySide6.QtGui import (
    QBrush,
    QColor,
    QFontMetricsF,
    QKeyEvent,
    QLinearGradient,
    QMouseEvent,
    QPainter,
    QPaintEvent,
    QPen,
    QPolygonF,
    QWheelEvent,
)
from PySide6.QtWidgets import QFrame, QHBoxLayout, QLabel, QPushButton, QSizePolicy, QVBoxLayout, QWidget

from tissueid.app.surface_geometry import HALF_HEIGHT, Array, Mesh, Pose, drawing_order, mesh_of, ticks
from tissueid.app.theme import LIGHT, Theme
from tissueid.app.units import shown, shown_label
from tissueid.app.views.researcher.plot_data import Image
from tissueid.formatting import number
from tissueid.language import _, marked

_LEVELS, _SHADES = 64, 16
_DARKEST = 0.62
"""Of its colour, what is left of a cell on which no light falls."""
_RAD_PER_PX = math.radians(0.5)
_RAD_PER_KEY = math.radians(5.0)
_NOTCH = 120.0
_LARGER = 1.15
_ROOM_X, _ROOM_Y, _BAR = 84.0, 52.0, 112.0
_TICK, _TICKS = 0.05, 5
_HOW = marked("Drag or use the arrow keys to turn it, the wheel or + and − to come closer; Home turns it back.")


class SurfacePlot(QFrame):
    """A card with the surface, its heading, and a button that turns it back."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setProperty("role", "card")
        self.heading = QLabel()
        self.heading.setProperty("role", "heading")
        self.heading.setTextFormat(Qt.TextFormat.PlainText)
        self.back = QPushButton(_("Turn back"))
        self.back.setToolTip(_("Look at it as at first (Home)"))
        self.canvas = SurfaceCanvas()
        self.back.clicked.connect(self.canvas.turn_back)
        top = QHBoxLayout()
        top.addWidget(self.heading, 1)
        top.addWidget(self.back)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(10, 6, 10, 6)
        layout.setSpacing(2)
        layout.addLayout(top)
        layout.addWidget(self.canvas, 1)

    def show_image(self, image: Image) -> None:
        """Show the values of an image as heights."""
        self.canvas.show_image(image)
        self._head()

    def take_units(self) -> None:
        """Say everything in the units in force."""
        self.canvas.describe()
        self.canvas.update()
        self._head()

    def apply_theme(self, theme: Theme) -> None:
        """Take on the colours of a theme."""
        self.canvas.apply_theme(theme)

    def _head(self) -> None:
        image = self.canvas.image
        if image is not None:
            unit = shown(image.unit)[0]
            self.heading.setText(f"{image.title} ({unit})" if unit else image.title)


class SurfaceCanvas(QWidget):
    """The surface itself, with its axes and the bar of its colours."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.image: Image | None = None
        self.pose = Pose()
        self._mesh: Mesh | None = None
        self._theme = LIGHT
        self._brushes: list[QBrush] = []
        self._held: QPointF | None = None
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setCursor(Qt.CursorShape.OpenHandCursor)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self.setToolTip(_(_HOW))
        self.apply_theme(LIGHT)

    def show_image(self, image: Image) -> None:
        """Another surface; it is looked at from where the last one was."""
        if image is not self.image:
            self.image, self._mesh = image, mesh_of(image.values)
            self.describe()
            self.update()

    def describe(self) -> None:
        """Tell a screen reader what is shown, and how it is turned."""
        image = self.image
        if image is None or not np.isfinite(image.values).any():
            return
        unit, factor = shown(image.unit)
        self.setAccessibleName(_("Surface: {title}, {unit}").format(title=image.title, unit=unit))
        words = []
        for place, text in (
            (np.nanargmax(image.values), _("Greatest {value} at {x} and {y}.")),
            (np.nanargmin(image.values), _("Least {value} at {x} and {y}.")),
        ):
            column, row = np.unravel_index(place, image.values.shape)
            words.append(
                text.format(
                    value=number(factor * float(image.values[column, row]), 3),
                    x=_at(image.x_label, float(image.x[column])),
                    y=_at(image.y_label, float(image.y[row])),
                )
            )
        self.setAccessibleDescription(" ".join([*words, _(_HOW)]))

    def apply_theme(self, theme: Theme) -> None:
        """Take on the colours of a theme: one end below zero, the other above, and a tone of its own between."""
        self._theme = theme
        ends = QColor(theme.measured), QColor(theme.edge), QColor(theme.model)
        self._brushes = [
            QBrush(_mixed(ends, 2.0 * level / (_LEVELS - 1) - 1.0, _DARKEST + (1.0 - _DARKEST) * shade / (_SHADES - 1)))
            for level in range(_LEVELS)
            for shade in range(_SHADES)
        ]
        self.update()

    def turn_back(self) -> None:
        """Look at it as at first."""
        self._look(Pose())

    def sizeHint(self) -> QSize:  # noqa: N802
        """Room for the box and its labels."""
        return QSize(480, 320)

    def minimumSizeHint(self) -> QSize:  # noqa: N802
        """Below that the labels would lie over one another."""
        return QSize(260, 170)

    # -- turning --------------------------------------------------------------------------------------------

    def mousePressEvent(self, event: QMouseEvent) -> None:  # noqa: N802
        """Take hold of it."""
        if event.button() == Qt.MouseButton.LeftButton:
            self._held = event.position()
            self.setCursor(Qt.CursorShape.ClosedHandCursor)

    def mouseMoveEvent(self, event: QMouseEvent) -> None:  # noqa: N802
        """Turn it with the mouse."""
        if self._held is not None:
            way = event.position() - self._held
            self._held = event.position()
            self._look(self.pose.turned(-_RAD_PER_PX * way.x(), _RAD_PER_PX * way.y()))

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:  # noqa: N802
        """Let it go."""
        if event.button() == Qt.MouseButton.LeftButton:
            self._held = None
            self.setCursor(Qt.CursorShape.OpenHandCursor)

    def wheelEvent(self, event: QWheelEvent) -> None:  # noqa: N802
        """Come closer, or go away."""
        self._look(self.pose.zoomed(_LARGER ** (event.angleDelta().y() / _NOTCH)))
        event.accept()

    def keyPressEvent(self, event: QKeyEvent) -> None:  # noqa: N802
        """Arrows turn it, + and - change its size, Home turns it back."""
        keys, step, pose = Qt.Key, _RAD_PER_KEY, self.pose
        turns = {
            keys.Key_Left: pose.turned(step, 0.0),
            keys.Key_Right: pose.turned(-step, 0.0),
            keys.Key_Up: pose.turned(0.0, -step),
            keys.Key_Down: pose.turned(0.0, step),
            keys.Key_Plus: pose.zoomed(_LARGER),
            keys.Key_Minus: pose.zoomed(1.0 / _LARGER),
            keys.Key_Home: Pose(),
        }
        if (found := turns.get(Qt.Key(event.key()))) is None:
            super().keyPressEvent(event)
            return
        self._look(found)

    def _look(self, pose: Pose) -> None:
        if pose != self.pose:
            self.pose = pose
            self.update()

    # -- drawing --------------------------------------------------------------------------------------------

    def paintEvent(self, event: QPaintEvent) -> None:  # noqa: N802
        """Draw ground, surface, axes and bar."""
        painter = QPainter(self)
        painter.fillRect(self.rect(), QColor(self._theme.panel))
        image, mesh = self.image, self._mesh
        if image is not None and mesh is not None:
            painter.setRenderHint(QPainter.RenderHint.Antialiasing)
            self._draw_ground(painter)
            painter.setRenderHint(QPainter.RenderHint.Antialiasing, False)  # it would leave seams between cells
            self._draw_cells(painter, mesh)
            painter.setRenderHint(QPainter.RenderHint.Antialiasing)
            self._draw_axes(painter, image, mesh)
            self._draw_bar(painter, image, mesh)
        if self.hasFocus():
            painter.setPen(QPen(QColor(self._theme.accent), 1.0))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawRect(QRectF(self.rect()).adjusted(0.5, 0.5, -0.5, -0.5))
        painter.end()

    def _placed(self, x: Array, y: Array, z: Array) -> tuple[Array, Array]:
        """Pixels of points of the box. Turned in any way it keeps its size."""
        right, up = self.pose.seen(x, y, z)
        width, height = self.width() - _BAR, float(self.height())
        fits = min((width - _ROOM_X) / (2.0 * math.sqrt(2.0)), (height - _ROOM_Y) / (2.0 * math.sqrt(2.0) * 0.85))
        size = max(20.0, fits) * self.pose.zoom
        return 0.5 * width + size * right, 0.5 * height - 6.0 - size * up

    def _at(self, x: float, y: float, z: float) -> QPointF:
        right, down = self._placed(np.array(x), np.array(y), np.array(z))
        return QPointF(float(right), float(down))

    def _draw_ground(self, painter: QPainter) -> None:
        painter.setPen(QPen(QColor(self._theme.line), 1.0))
        painter.setBrush(Qt.BrushStyle.NoBrush)
        painter.drawPolygon(QPolygonF([self._at(x, y, -HALF_HEIGHT) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]))

    def _draw_cells(self, painter: QPainter, mesh: Mesh) -> None:
        cells, corners = drawing_order(mesh, self.pose)
        right, down = self._placed(mesh.x[:, None], mesh.y[None, :], mesh.z)
        hole = ~np.isfinite(down)
        # Half a pixel aside, an edge that stands upright on a pixel's border leaves no gap.
        right, down = np.where(hole, 0.0, right + 0.5), np.where(hole, 0.0, down + 0.5)
        points = list(map(QPointF, right.ravel().tolist(), down.ravel().tolist()))
        level = np.rint(0.5 * (mesh.level[cells] + 1.0) * (_LEVELS - 1)).astype(np.intp)
        shade = np.rint(mesh.slope[cells] * (_SHADES - 1)).astype(np.intp)
        brushes, last = self._brushes, -1
        painter.setPen(Qt.PenStyle.NoPen)
        draw = painter.drawConvexPolygon
        for (a, b, c, d), brush in zip(corners.tolist(), (level * _SHADES + shade).tolist(), strict=True):
            if brush != last:
                painter.setBrush(brushes[brush])
                last = brush
            draw((points[a], points[b], points[c], points[d]))

    def _draw_axes(self, painter: QPainter, image: Image, mesh: Mesh) -> None:
        # The ground's edges nearest to the eye, and the upright edge farthest to the left: nothing stands before them.
        near_x = -1.0 if math.sin(self.pose.azimuth) > 0.0 else 1.0
        near_y = -1.0 if math.cos(self.pose.azimuth) > 0.0 else 1.0
        ground = -HALF_HEIGHT
        corners = [(x, y) for x in (-1.0, 1.0) for y in (-1.0, 1.0)]
        left_x, left_y = min(corners, key=lambda corner: self._at(corner[0], corner[1], ground).x())
        text, factor = shown_label(image.x_label)
        self._draw_axis(
            painter,
            text,
            [(number(value * factor, 3), (place, near_y, ground)) for value, place in _placed_ticks(image.x)],
            ((-1.0, near_y, ground), (1.0, near_y, ground)),
            (0.0, near_y),
        )
        text, factor = shown_label(image.y_label)
        self._draw_axis(
            painter,
            text,
            [(number(value * factor, 3), (near_x, place, ground)) for value, place in _placed_ticks(image.y)],
            ((near_x, -1.0, ground), (near_x, 1.0, ground)),
            (near_x, 0.0),
        )
        factor = shown(image.unit)[1]
        self._draw_axis(
            painter,
            "",
            [
                (number(value, 3), (left_x, left_y, mesh.height(value / factor)))
                for value in ticks(factor * mesh.low, factor * mesh.high, _TICKS)
            ],
            ((left_x, left_y, -HALF_HEIGHT), (left_x, left_y, HALF_HEIGHT)),
            None,
        )

    def _draw_axis(
        self,
        painter: QPainter,
        label: str,
        marks: list[tuple[str, tuple[float, float, float]]],
        ends: tuple[tuple[float, float, float], tuple[float, float, float]],
        outward: tuple[float, float] | None,
    ) -> None:
        """A line between two corners with ticks; texts stand outward of it on the ground, None to the left."""
        theme = self._theme
        painter.setPen(QPen(QColor(theme.muted), 1.0))
        first, last = self._at(*ends[0]), self._at(*ends[1])
        painter.drawLine(first, last)
        if self.pose.elevation > math.radians(85.0) and outward is None:
            return  # seen from above an upright edge is a point
        # Edges that run straight away from the eye are too short on the page for numbers.
        metrics = QFontMetricsF(painter.font())
        tall = math.hypot(last.x() - first.x(), last.y() - first.y())
        widest = max((metrics.horizontalAdvance(text) for text, _place in marks), default=0.0)
        room = 1.4 * metrics.height() if outward is None else widest
        every = max(1, math.ceil(room * len(marks) / max(tall, 1.0)))
        reach = 0.0
        for text, place in marks[::every]:
            at = self._at(*place)
            away = self._outward(place, outward)
            painter.drawLine(at, at + away * 5.0)
            reach = max(reach, self._write(painter, text, at + away * 7.0, away, theme.muted))
        if label and outward is not None:
            away = self._outward((*outward, -HALF_HEIGHT), outward)
            at = self._at(*outward, -HALF_HEIGHT) + away * (10.0 + reach)
            width = metrics.horizontalAdvance(label)
            ends_at = at.x() + 0.5 * width * (away.x() + (1.0 if away.x() > 0.0 else -1.0))
            if not 0.0 < ends_at < self.width() - _BAR:  # no room next to the numbers: below the axis' lower end
                at = QPointF(at.x(), max(first.y(), last.y()) + 1.4 * metrics.height())
            self._write(painter, label, at, away, theme.text)

    def _outward(self, place: tuple[float, float, float], outward: tuple[float, float] | None) -> QPointF:
        """A pixel's way from an axis out of the box."""
        if outward is None:
            return QPointF(-1.0, 0.0)
        at, beyond = self._at(*place), self._at(place[0] + _TICK * outward[0], place[1] + _TICK * outward[1], place[2])
        way = beyond - at
        length = math.hypot(way.x(), way.y()) or 1.0
        return QPointF(way.x() / length, way.y() / length)

    def _write(self, painter: QPainter, text: str, at: QPointF, away: QPointF, colour: str) -> float:
        """Words whose nearest edge stands at a place; returns how far they reach along ``away``, pixels.

        What would lie over the bar or beyond an edge is moved inside.
        """
        metrics = QFontMetricsF(painter.font())
        width, height = metrics.horizontalAdvance(text), metrics.height()
        centre = at + QPointF(0.5 * width * away.x(), 0.5 * height * away.y())
        pen = painter.pen()
        painter.setPen(QColor(colour))
        left = min(max(2.0, centre.x() - 0.5 * width), self.width() - _BAR - width)
        top = min(max(2.0, centre.y() - 0.5 * height), self.height() - height - 2.0)
        box = QRectF(left - 1.0, top, width + 2.0, height)
        painter.drawText(box, Qt.AlignmentFlag.AlignCenter, text)
        painter.setPen(pen)
        return abs(width * away.x()) + abs(height * away.y())

    def _draw_bar(self, painter: QPainter, image: Image, mesh: Mesh) -> None:
        """The colours from the least to the greatest magnitude, as the image has them."""
        theme, limit = self._theme, mesh.limit
        bar = QRectF(self.width() - _BAR + 8.0, 14.0, 14.0, max(40.0, self.height() - 34.0))
        gradient = QLinearGradient(bar.bottomLeft(), bar.topLeft())
        for place, colour in ((0.0, theme.measured), (0.5, theme.edge), (1.0, theme.model)):
            gradient.setColorAt(place, QColor(colour))
        painter.setPen(QPen(QColor(theme.line), 1.0))
        painter.setBrush(gradient)
        painter.drawRect(bar)
        factor = shown(image.unit)[1]
        painter.setPen(QColor(theme.muted))
        for value in ticks(-factor * limit, factor * limit, _TICKS):
            height = bar.bottom() - bar.height() * 0.5 * (value / (factor * limit) + 1.0)
            painter.drawLine(QPointF(bar.right(), height), QPointF(bar.right() + 4.0, height))
            text = QRectF(bar.right() + 6.0, height - 10.0, _BAR - 28.0, 20.0)
            painter.drawText(text, Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter, number(value, 3))


def _mixed(ends: tuple[QColor, QColor, QColor], level: float, light: float) -> QColor:
    """A colour between three, at -1, 0 and 1, of which so much is left in the shade."""
    share, end, middle = abs(level), ends[0] if level < 0.0 else ends[2], ends[1]
    pairs = (middle.red(), end.red()), (middle.green(), end.green()), (middle.blue(), end.blue())
    return QColor(*(round(light * (low + share * (high - low))) for low, high in pairs))


def _placed_ticks(points: Array) -> list[tuple[float, float]]:
    """Round numbers along an axis, and where in the box they stand."""
    low, high = float(points[0]), float(points[-1])
    if high <= low:
        return [(low, 0.0)]
    return [(value, 2.0 * (value - low) / (high - low) - 1.0) for value in ticks(low, high, _TICKS)]


def _at(label: str, value: float) -> str:
    said, factor = shown_label(label)
    return f"{said} {number(factor * value, 3)}"


__all__ = ["SurfaceCanvas", "SurfacePlot"]
