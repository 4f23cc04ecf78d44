"""Tab "How far": the gap before and after, the noise floor, and recorded against simulated signals."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from PySide6.QtCore import QRectF, QSize, Qt
from PySide6.QtGui import QColor, QPainter, QPaintEvent, QResizeEvent
from PySide6.QtWidgets import QComboBox, QFrame, QLabel, QSizePolicy, QWidget

from tissueid.app import build
from tissueid.app.plot_canvas import PlotCanvas
from tissueid.app.small_window import FoldingBox
from tissueid.app.theme import appearance
from tissueid.formatting import number
from tissueid.language import _
from tissueid.messages import translated

if TYPE_CHECKING:
    from tissueid.app.views.gap.page_content import PageContent
    from tissueid.gap.diagnosis_curves import BudgetRow, SignalOverlay

_NAMES = 0.5
"""Most of the width that names left of the bars take; longer names stand above."""
_BAR_LINE, _NAME_LINE, _FIGURE = 22, 18, 62
"""Height of a bar and of a name above it, and width of a figure, pixels."""
_ONE_LINE, _STACKED = _BAR_LINE + 4, _BAR_LINE + _NAME_LINE + 4
"""Distance from one bar to the next, pixels."""
_SIDE, _ONE_ROW = 270, 660
"""Least width of the figures, and the width below which the plots stand below them, pixels."""


class ClosureTab(QWidget):
    """Bars of the gap on the left; one signal and its residual on the right."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._overlays: tuple[SignalOverlay, ...] = ()
        self.bars = _GapBars()
        self.closing = build.label()
        self.channel = build.styled(QComboBox(), name=_("Signal to look at"))
        self.channel.currentIndexChanged.connect(self._show_chosen)
        self.signals = PlotCanvas()
        self._arrange()

    def show_story(self, story: PageContent) -> None:
        """Draw the result of a diagnosis."""
        self.bars.show_rows(story.budget)
        self.closing.setText(translated(story.closing))
        self._overlays = story.overlays
        self.channel.blockSignals(True)
        self.channel.clear()
        self.channel.addItems([_(item.channel.capitalize()) for item in story.overlays])
        self.channel.blockSignals(False)
        self.channel.setEnabled(len(story.overlays) > 1)
        if not story.overlays:
            self.signals.say_missing(_("Every sample was used for the fit: there is no held-out data to compare with."))
        self._show_chosen()

    def _show_chosen(self) -> None:
        from tissueid.gap.diagnosis_plots import overlay_plots

        place = self.channel.currentIndex()
        if 0 <= place < len(self._overlays):
            self.signals.show_plots(overlay_plots(self._overlays[place]))

    def _arrange(self) -> None:
        choice = build.row(build.styled(QLabel(_("Signal")), buddy=self.channel), (self.channel, 1), spacing=8)
        side = build.styled(QFrame(), role="card", minimum_width=_SIDE)
        build.column(
            build.styled(
                QLabel(_("Gap on held-out data")),
                role="heading",
                word_wrap=True,
                tip=_("Error of the free run over the signals' deviation"),
            ),
            self.bars,
            self.closing,
            None,
            choice,
            spacing=8,
            margins=(12, 8, 12, 10),
            parent=side,
        )
        self.signals.setMinimumHeight(288)
        build.fill(FoldingBox(_ONE_ROW, self), side, (self.signals, 1), spacing=8, margins=(0, 6, 0, 0))


class _GapBars(QWidget):
    """Waterfall with values: gap before, what each named effect closes, gap after, noise alone."""

    def __init__(self) -> None:
        super().__init__()
        self._rows: tuple[BudgetRow, ...] = ()
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)

    def show_rows(self, rows: tuple[BudgetRow, ...]) -> None:
        """Show the rows from top to bottom."""
        self._rows = rows
        values = ", ".join(f"{translated(row.name)} {_percent(row.high - row.low)}" for row in rows)
        self.setToolTip("\n".join(f"{translated(row.name)}: {_percent(row.high - row.low)}" for row in rows))
        self.setAccessibleName(_("Gap: {values}").format(values=values))
        self._fit()
        self.update()

    def sizeHint(self) -> QSize:  # noqa: N802
        """Return a width for short names."""
        return QSize(220, self.height())

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        """Take a height of one line per bar, or of two where names need a line of their own."""
        self._fit()

    def _fit(self) -> None:
        self.setFixedHeight(self._pitch(self.width()) * max(len(self._rows), 3))

    def _pitch(self, width: int) -> int:
        return _STACKED if self._name_width() > _NAMES * width else _ONE_LINE

    def _name_width(self) -> int:
        letters = self.fontMetrics()
        return 8 + max((letters.horizontalAdvance(translated(row.name)) for row in self._rows), default=0)

    def paintEvent(self, event: QPaintEvent) -> None:  # noqa: N802
        """Draw the bars, each with its name left of it or above."""
        painter = QPainter(self)
        most = max((row.high for row in self._rows if np.isfinite(row.high)), default=1.0) or 1.0
        pitch = self._pitch(self.width())
        begin, below = (0.0, _NAME_LINE) if pitch == _STACKED else (float(self._name_width()), 0)
        room = max(self.width() - begin - _FIGURE, 10.0)
        for place, row in enumerate(self._rows):
            top = pitch * place
            painter.setPen(QColor(appearance.theme.text))
            name_room = QRectF(0, top, begin - 8.0 if begin else self.width(), below or _BAR_LINE)
            shown = self.fontMetrics().elidedText(
                translated(row.name), Qt.TextElideMode.ElideRight, int(name_room.width())
            )
            painter.drawText(name_room, Qt.AlignmentFlag.AlignVCenter, shown)
            left, right = (room * value / most if np.isfinite(value) else 0.0 for value in (row.low, row.high))
            width = max(right - left, 1.0)
            bar = QRectF(begin + left, top + below + 4, width, 14)
            painter.fillRect(bar, QColor(getattr(appearance.theme, row.role)))
            figure = QRectF(bar.right() + 6, top + below, _FIGURE, _BAR_LINE)
            painter.drawText(figure, Qt.AlignmentFlag.AlignVCenter, _percent(row.high - row.low))


def _percent(share: float) -> str:
    return f"{number(100.0 * share, 3)} %" if np.isfinite(share) else _("unknown")
