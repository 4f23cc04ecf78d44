"""The body map: standard sites as points on a drawn body, chosen by mouse, arrow keys and Return."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from PySide6.QtCore import QPointF, QRectF, QSize, Qt, Signal
from PySide6.QtGui import (
    QColor,
    QKeyEvent,
    QMouseEvent,
    QPainter,
    QPainterPath,
    QPaintEvent,
    QPalette,
    QPen,
    QResizeEvent,
)
from PySide6.QtWidgets import (
    QButtonGroup,
    QDialog,
    QDialogButtonBox,
    QGridLayout,
    QLabel,
    QRadioButton,
    QWidget,
)

from tissueid.app import build
from tissueid.language import _, marked

Side = Literal["front", "back"]

WIDTH, HEIGHT = 100.0, 210.0
"""The drawing of one side, in units of its own; the middle of the body lies at half the width."""

_HALF = (
    (5.0, 24.0),
    (6.0, 32.0),
    (19.0, 36.0),
    (25.0, 43.0),
    (28.0, 58.0),
    (31.0, 73.0),
    (36.0, 97.0),
    (40.0, 110.0),
    (35.0, 114.0),
    (31.0, 99.0),
    (25.0, 75.0),
    (18.5, 52.0),
    (16.0, 74.0),
    (19.0, 96.0),
    (19.5, 116.0),
    (15.5, 146.0),
    (16.0, 162.0),
    (10.5, 190.0),
    (15.0, 201.0),
    (5.0, 202.0),
    (5.0, 188.0),
    (5.0, 165.0),
    (4.5, 146.0),
    (0.0, 106.0),
)
"""One half of the outline below the head, from the neck round the arm and the leg: distance from the middle, height."""
_HEAD = (9.0, 12.5, 14.0)
"""Half width, half height, and height of the middle."""


@dataclass(frozen=True)
class Spot:
    """A standard site: on which side it is seen, and where, in the units of the drawing."""

    site: str
    side: Side
    x: float
    y: float


def _spots() -> tuple[Spot, ...]:
    """From the front the subject's left is on the right of the drawing; from behind it is on the left."""
    middle = WIDTH / 2
    spots: list[Spot] = []
    paired: tuple[tuple[str, Side, float, float], ...] = (
        ("upper arm", "front", 23.5, 58.0),
        ("forearm, anterior", "front", 30.8, 86.0),
        ("thigh", "front", 11.0, 122.0),
        ("forearm, posterior", "back", 30.8, 86.0),
        ("calf", "back", 10.5, 163.0),
    )
    for name, side, off, height in paired:
        offset = off if side == "front" else -off
        spots.append(Spot(f"left {name}", side, middle + offset, height))
        spots.append(Spot(f"right {name}", side, middle - offset, height))
    spots.append(Spot("abdomen", "front", middle, 80.0))
    return tuple(spots)


SPOTS = _spots()


def outline() -> QPainterPath:
    """Head and body as one path, a smooth line through the points of both halves."""
    middle = WIDTH / 2
    right_half = [QPointF(middle + x, y) for x, y in _HALF]
    left_half = [QPointF(middle - x, y) for x, y in reversed(_HALF[:-1])]
    body = _smooth([*right_half, *left_half])
    head = QPainterPath()
    head.addEllipse(QPointF(middle, _HEAD[2]), _HEAD[0], _HEAD[1])
    return body.united(head)


def _smooth(points: list[QPointF]) -> QPainterPath:
    """A closed line through the points, without corners (Catmull and Rom)."""
    path = QPainterPath(points[0])
    count = len(points)
    for k in range(count):
        before, start, end, after = (points[(k + step) % count] for step in (-1, 0, 1, 2))
        path.cubicTo(
            start.x() + (end.x() - before.x()) / 6.0,
            start.y() + (end.y() - before.y()) / 6.0,
            end.x() - (after.x() - start.x()) / 6.0,
            end.y() - (after.y() - start.y()) / 6.0,
            end.x(),
            end.y(),
        )
    path.closeSubpath()
    return path


_POINT = 24
"""Pixels that a point takes: large enough for a finger."""
_HINT = marked(
    "Click a point or go to it by the arrow keys, then press Return or “Use this site”. Esc leaves the site as it is."
)


class BodyMap(QDialog):
    """Both sides of a body. ``chosen`` carries the name of a site; the dialog closes with it."""

    chosen = Signal(str)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        build.styled(self, window_title=_("Site on the body"), name=_("Body map"), accessible_description=_(_HINT))
        self._group = QButtonGroup(self)
        self.spots: dict[str, QRadioButton] = {}
        grid = QGridLayout()
        grid.setHorizontalSpacing(16)
        sides: tuple[Side, ...] = ("front", "back")
        for column, side in enumerate(sides):
            heading = build.styled(
                QLabel({"front": _("Front"), "back": _("Back")}[side]),
                role="heading",
                alignment=Qt.AlignmentFlag.AlignCenter,
            )
            figure = _Figure(side)
            grid.addWidget(heading, 0, column)
            grid.addWidget(figure, 1, column)
            for spot in figure.spots:
                self._group.addButton(spot)
                self.spots[spot.spot.site] = spot
                spot.picked.connect(self._use)
                spot.toggled.connect(self._name)
        grid.setRowStretch(1, 1)
        self.name = build.styled(QLabel(), role="headline", alignment=Qt.AlignmentFlag.AlignCenter)
        hint = build.styled(QLabel(_(_HINT)), role="muted", alignment=Qt.AlignmentFlag.AlignCenter)
        buttons = QDialogButtonBox(QDialogButtonBox.StandardButton.Ok | QDialogButtonBox.StandardButton.Cancel)
        self.use = buttons.button(QDialogButtonBox.StandardButton.Ok)
        self.use.setText(_("Use this site"))
        buttons.accepted.connect(self._use)
        buttons.rejected.connect(self.reject)
        build.column((grid, 1), self.name, hint, buttons, margins=(11,), parent=self)
        self._name()

    def show_site(self, site: str) -> None:
        """Open with a site chosen; a text that is none of the standard ones leaves no point chosen."""
        self._group.setExclusive(False)
        for name, spot in self.spots.items():
            spot.setChecked(name == site.strip())
        self._group.setExclusive(True)
        self._name()
        self.open()
        self.spots.get(site.strip(), next(iter(self.spots.values()))).setFocus(Qt.FocusReason.OtherFocusReason)

    @property
    def site(self) -> str:
        """The chosen site; empty if there is none."""
        return next((name for name, spot in self.spots.items() if spot.isChecked()), "")

    def keyPressEvent(self, event: QKeyEvent) -> None:  # noqa: N802
        """Choose the point with the focus at the Return key; leave other keys to the dialog."""
        if event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter):
            focus = self.focusWidget()
            if isinstance(focus, _Point):
                focus.setChecked(True)
            self._use()
            return
        super().keyPressEvent(event)

    def _use(self) -> None:
        if self.site:
            self.chosen.emit(self.site)
            self.accept()

    def _name(self) -> None:
        self.name.setText(self.site or _("No point is chosen"))
        self.use.setEnabled(bool(self.site))


class _Point(QRadioButton):
    """One site. ``picked`` is sent by a double click; a click and keys only choose it."""

    picked = Signal()

    def __init__(self, spot: Spot, parent: QWidget) -> None:
        super().__init__(parent)
        self.spot = spot
        build.styled(
            self, name=spot.site, tip=spot.site, fixed_size=(_POINT, _POINT), cursor=Qt.CursorShape.PointingHandCursor
        )

    def sizeHint(self) -> QSize:  # noqa: N802
        """A square."""
        return QSize(_POINT, _POINT)

    def hitButton(self, _place: object) -> bool:  # noqa: N802
        """Return whether ``position`` is inside: the whole square can be clicked."""
        return True

    def mouseDoubleClickEvent(self, event: QMouseEvent) -> None:  # noqa: N802
        """Send ``picked``."""
        if event.button() is Qt.MouseButton.LeftButton:
            self.setChecked(True)
            self.picked.emit()

    def paintEvent(self, _event: QPaintEvent) -> None:  # noqa: N802
        """A ring; filled where it is chosen, with another round it where it has the focus."""
        colours = self.palette()
        accent = colours.color(QPalette.ColorRole.Highlight)
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        middle = QPointF(self.width() / 2, self.height() / 2)
        painter.setPen(QPen(accent, 2.0))
        filled = accent if self.isChecked() or self.underMouse() else colours.color(QPalette.ColorRole.Base)
        painter.setBrush(filled)
        painter.drawEllipse(middle, 6.0, 6.0)
        if self.hasFocus():
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.setPen(QPen(colours.color(QPalette.ColorRole.WindowText), 1.5))
            painter.drawEllipse(middle, 10.0, 10.0)
        painter.end()


class _Figure(QWidget):
    """One side of the body with its points."""

    def __init__(self, side: Side) -> None:
        super().__init__()
        self._side = side
        self._outline = outline()
        self.setMinimumSize(230, 390)
        self.spots = [_Point(spot, self) for spot in SPOTS if spot.side == side]

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        """Put the points where the body now has them."""
        super().resizeEvent(event)
        scale, x0, y0 = self._fit()
        for point in self.spots:
            middle = QPointF(x0 + scale * point.spot.x, y0 + scale * point.spot.y).toPoint()
            point.move(middle.x() - _POINT // 2, middle.y() - _POINT // 2)

    def paintEvent(self, _event: QPaintEvent) -> None:  # noqa: N802
        """The outline, with the subject's sides named."""
        colours = self.palette()
        scale, x0, y0 = self._fit()
        line = QColor(colours.color(QPalette.ColorRole.PlaceholderText))
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        names = (_("right"), _("left")) if self._side == "front" else (_("left"), _("right"))
        painter.setPen(line)
        width = scale * WIDTH / 2
        for index, name in enumerate(names):
            painter.drawText(
                QRectF(x0 + index * width, y0 + scale * 2.0, width, 18.0),
                (Qt.AlignmentFlag.AlignLeft, Qt.AlignmentFlag.AlignRight)[index],
                name,
            )
        painter.translate(x0, y0)
        painter.scale(scale, scale)
        pen = QPen(line, 1.5)
        pen.setCosmetic(True)
        painter.setPen(pen)
        painter.setBrush(colours.color(QPalette.ColorRole.Base))
        painter.drawPath(self._outline)
        painter.end()

    def _fit(self) -> tuple[float, float, float]:
        """Pixels a unit, and where the drawing begins."""
        scale = min(self.width() / WIDTH, self.height() / HEIGHT)
        return scale, (self.width() - scale * WIDTH) / 2, (self.height() - scale * HEIGHT) / 2
