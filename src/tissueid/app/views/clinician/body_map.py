"""The body map: standard sites as points on a drawn body, chosen by mouse, arrow keys and Return."""

from __future__ import annotations

from PySide6.QtCore import QPointF, QRectF, QSize, Qt, Signal
from PySide6.QtGui import QColor, QKeyEvent, QMouseEvent, QPainter, QPaintEvent, QPalette, QPen, QResizeEvent
from PySide6.QtWidgets import (
    QButtonGroup,
    QDialog,
    QDialogButtonBox,
    QGridLayout,
    QLabel,
    QRadioButton,
    QVBoxLayout,
    QWidget,
)

from tissueid.app.views.clinician.body import HEIGHT, SPOTS, WIDTH, Side, Spot, outline
from tissueid.language import _, marked

_POINT = 24
"""Pixels that a point takes: large enough for a finger."""
_HINT = marked("Click a point, or use the arrow keys and Return. Esc leaves the site as it is.")


class BodyMap(QDialog):
    """Both sides of a body. ``chosen`` carries the name of a site; the dialog closes with it."""

    chosen = Signal(str)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle(_("Site on the body"))
        self.setAccessibleName(_("Body map"))
        self.setAccessibleDescription(_(_HINT))
        self._group = QButtonGroup(self)
        self.spots: dict[str, QRadioButton] = {}
        grid = QGridLayout()
        grid.setHorizontalSpacing(16)
        sides: tuple[Side, ...] = ("front", "back")
        for column, side in enumerate(sides):
            heading = QLabel({"front": _("Front"), "back": _("Back")}[side])
            heading.setProperty("role", "heading")
            heading.setAlignment(Qt.AlignmentFlag.AlignCenter)
            figure = _Figure(side)
            grid.addWidget(heading, 0, column)
            grid.addWidget(figure, 1, column)
            for spot in figure.spots:
                self._group.addButton(spot)
                self.spots[spot.spot.site] = spot
                spot.picked.connect(self._pick)
                spot.toggled.connect(self._name)
        grid.setRowStretch(1, 1)
        self.name = QLabel()
        self.name.setProperty("role", "headline")
        self.name.setAlignment(Qt.AlignmentFlag.AlignCenter)
        hint = QLabel(_(_HINT))
        hint.setProperty("role", "muted")
        hint.setAlignment(Qt.AlignmentFlag.AlignCenter)
        buttons = QDialogButtonBox(QDialogButtonBox.StandardButton.Ok | QDialogButtonBox.StandardButton.Cancel)
        self.use = buttons.button(QDialogButtonBox.StandardButton.Ok)
        self.use.setText(_("Use this site"))
        buttons.accepted.connect(self._use)
        buttons.rejected.connect(self.reject)
        layout = QVBoxLayout(self)
        layout.addLayout(grid, 1)
        layout.addWidget(self.name)
        layout.addWidget(hint)
        layout.addWidget(buttons)
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

    def _pick(self, site: str) -> None:
        self.spots[site].setChecked(True)
        self._use()

    def _use(self) -> None:
        if self.site:
            self.chosen.emit(self.site)
            self.accept()

    def _name(self) -> None:
        self.name.setText(self.site or _("No point is chosen"))
        self.use.setEnabled(bool(self.site))


class _Point(QRadioButton):
    """One site. ``picked`` is sent where it is clicked with the mouse; keys only choose it."""

    picked = Signal(str)

    def __init__(self, spot: Spot, parent: QWidget) -> None:
        super().__init__(parent)
        self.spot = spot
        self.setAccessibleName(spot.site)
        self.setToolTip(spot.site)
        self.setFixedSize(_POINT, _POINT)
        self.setCursor(Qt.CursorShape.PointingHandCursor)

    def sizeHint(self) -> QSize:  # noqa: N802
        """A square."""
        return QSize(_POINT, _POINT)

    def hitButton(self, _place: object) -> bool:  # noqa: N802
        """Return whether ``position`` is inside: the whole square can be clicked."""
        return True

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:  # noqa: N802
        """Send ``picked``."""
        inside = self.rect().contains(event.position().toPoint())
        super().mouseReleaseEvent(event)
        if inside and event.button() is Qt.MouseButton.LeftButton:
            self.picked.emit(self.spot.site)

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
        scale, left, top = self._fit()
        for point in self.spots:
            middle = QPointF(left + scale * point.spot.x, top + scale * point.spot.y).toPoint()
            point.move(middle.x() - _POINT // 2, middle.y() - _POINT // 2)

    def paintEvent(self, _event: QPaintEvent) -> None:  # noqa: N802
        """The outline, with the subject's sides named."""
        colours = self.palette()
        scale, left, top = self._fit()
        line = QColor(colours.color(QPalette.ColorRole.PlaceholderText))
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        names = (_("right"), _("left")) if self._side == "front" else (_("left"), _("right"))
        painter.setPen(line)
        width = scale * WIDTH / 2
        for place, name in enumerate(names):
            painter.drawText(
                QRectF(left + place * width, top + scale * 2.0, width, 18.0),
                (Qt.AlignmentFlag.AlignLeft, Qt.AlignmentFlag.AlignRight)[place],
                name,
            )
        painter.translate(left, top)
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
