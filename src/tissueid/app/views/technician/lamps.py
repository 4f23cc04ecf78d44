"""The traffic light: three lamps, one of them lit, with the level as text for colour-blind users."""

from __future__ import annotations

from PySide6.QtCore import QPointF, Qt
from PySide6.QtGui import QColor, QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import QWidget

from tissueid.app.theme import Theme, faint
from tissueid.language import _, marked

_LEVELS = ("poor", "check", "good")
_WORDS = {"poor": marked("red"), "check": marked("yellow"), "good": marked("green"), "": marked("dark")}
_RADIUS = 12.0
_STEP = 32.0


class Lamps(QWidget):
    """Red above yellow above green; the lit one is full and has a ring, the others are outlines."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._level = ""
        self._theme: Theme | None = None
        self.setFixedSize(36, round(3 * _STEP + 4))
        self.show_level("")

    @property
    def level(self) -> str:
        """Level of the lit lamp."""
        return self._level

    def show_level(self, level: str) -> None:
        """Light a lamp, or none."""
        self._level = level
        self.setAccessibleName(_("Traffic light: {colour}").format(colour=_(_WORDS[level])))
        self.setToolTip(_("Traffic light: {colour}").format(colour=_(_WORDS[level])))
        self.update()

    def apply_theme(self, theme: Theme) -> None:
        """Take on the colours of a theme."""
        self._theme = theme
        self.update()

    def paintEvent(self, event: QPaintEvent) -> None:  # noqa: N802
        """Draw the lamps."""
        super().paintEvent(event)
        if self._theme is None:
            return
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        for row, level in enumerate(_LEVELS):
            centre = QPointF(0.5 * self.width(), (row + 0.5) * _STEP + 2.0)
            lit = level == self._level
            colour = QColor(getattr(self._theme, level))
            painter.setBrush(colour if lit else faint(self._theme.line, 120))
            painter.setPen(QPen(colour if lit else QColor(self._theme.edge), 1.0))
            painter.drawEllipse(centre, _RADIUS, _RADIUS)
            if lit:
                painter.setBrush(Qt.BrushStyle.NoBrush)
                painter.setPen(QPen(colour, 1.5))
                painter.drawEllipse(centre, _RADIUS + 3.0, _RADIUS + 3.0)
        painter.end()
