"""The outline of a body, from the front and from behind, and where on it the standard sites lie. Nothing here draws."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from PySide6.QtCore import QPointF
from PySide6.QtGui import QPainterPath

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
    found: list[Spot] = []
    paired: tuple[tuple[str, Side, float, float], ...] = (
        ("upper arm", "front", 23.5, 58.0),
        ("forearm, anterior", "front", 30.8, 86.0),
        ("thigh", "front", 11.0, 122.0),
        ("forearm, posterior", "back", 30.8, 86.0),
        ("calf", "back", 10.5, 163.0),
    )
    for name, side, off, height in paired:
        left = off if side == "front" else -off
        found.append(Spot(f"left {name}", side, middle + left, height))
        found.append(Spot(f"right {name}", side, middle - left, height))
    found.append(Spot("abdomen", "front", middle, 80.0))
    return tuple(found)


SPOTS = _spots()


def outline() -> QPainterPath:
    """Head and body as one path, a smooth line through the points of both halves."""
    middle = WIDTH / 2
    right = [QPointF(middle + x, y) for x, y in _HALF]
    left = [QPointF(middle - x, y) for x, y in reversed(_HALF[:-1])]
    body = _smooth([*right, *left])
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
