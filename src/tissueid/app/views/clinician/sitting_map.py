"""Sites of a sitting on a drawn body: the next one is a filled ring, the finished ones have a tick."""

from __future__ import annotations

from collections.abc import Collection

from PySide6.QtCore import QPointF, QRectF, QSize, Qt
from PySide6.QtGui import QColor, QFont, QPainter, QPaintEvent, QPalette, QPen
from PySide6.QtWidgets import QSizePolicy, QWidget

from tissueid.app.theme import appearance
from tissueid.app.views.clinician.body_map import HEIGHT, SPOTS, WIDTH, Side, Spot, outline
from tissueid.language import _

_SIDES: tuple[Side, ...] = ("front", "back")
_SIZE = QSize(122, 146)
_CAPTION = 16.0
"""Pixels for the captions."""


class SittingMap(QWidget):
    """Both sides of a body. Sites that are not standard ones are not drawn."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._outline = outline()
        self.next_site = ""
        self.sites: tuple[str, ...] = ()
        self.finished: frozenset[str] = frozenset()
        self.setSizePolicy(QSizePolicy.Policy.Fixed, QSizePolicy.Policy.Fixed)

    def sizeHint(self) -> QSize:  # noqa: N802
        """Return a fixed size, which fits next to a few words in a narrow window."""
        return _SIZE

    def show_sites(self, sites: Collection[str], next_site: str, finished: Collection[str]) -> None:
        """Show the sites of a sitting; ``next_site`` is "" when it is complete."""
        self.sites, self.next_site, self.finished = tuple(sites), next_site, frozenset(finished)
        self.setAccessibleName(
            _("Body map: next site {site}; finished: {finished}").format(
                site=next_site or _("none"), finished="; ".join(sorted(finished)) or _("none")
            )
        )
        self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:  # noqa: N802
        """Draw both sides next to each other, each with its sites."""
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        font = QFont(self.font())
        font.setPointSizeF(0.8 * font.pointSizeF())
        painter.setFont(font)
        width = self.width() / len(_SIDES)
        scale = min(width / WIDTH, (self.height() - _CAPTION) / HEIGHT)
        for place, (side, caption) in enumerate(zip(_SIDES, (_("Front"), _("Back")), strict=True)):
            left = place * width + (width - scale * WIDTH) / 2
            self._draw_side(painter, side, scale, left)
            painter.setPen(QColor(appearance.theme.muted))
            area = QRectF(place * width, self.height() - _CAPTION, width, _CAPTION)
            painter.drawText(area, Qt.AlignmentFlag.AlignCenter, caption)
        painter.end()

    def _draw_side(self, painter: QPainter, side: Side, scale: float, left: float) -> None:
        painter.save()
        painter.translate(left, 0.0)
        painter.scale(scale, scale)
        pen = QPen(QColor(appearance.theme.muted), 1.2)
        pen.setCosmetic(True)
        painter.setPen(pen)
        painter.setBrush(self.palette().color(QPalette.ColorRole.Base))
        painter.drawPath(self._outline)
        painter.restore()
        shown = [spot for spot in SPOTS if spot.side == side and spot.site in self.sites]
        for spot in sorted(shown, key=lambda spot: spot.site == self.next_site):
            self._draw_site(painter, spot, QPointF(left + scale * spot.x, scale * spot.y))

    def _draw_site(self, painter: QPainter, spot: Spot, at: QPointF) -> None:
        accent, good = QColor(appearance.theme.accent), QColor(appearance.theme.good)
        if spot.site == self.next_site:
            halo = QColor(accent)
            halo.setAlpha(70)
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(halo)
            painter.drawEllipse(at, 10.0, 10.0)
            painter.setBrush(accent)
            painter.drawEllipse(at, 5.5, 5.5)
        elif spot.site in self.finished:
            painter.setPen(QPen(good, 2.4, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap, Qt.PenJoinStyle.RoundJoin))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawPolyline([at + QPointF(-5.0, 0.0), at + QPointF(-1.5, 4.0), at + QPointF(5.5, -4.5)])
        else:
            painter.setPen(QPen(QColor(appearance.theme.muted), 1.5))
            painter.setBrush(self.palette().color(QPalette.ColorRole.Base))
            painter.drawEllipse(at, 4.0, 4.0)
