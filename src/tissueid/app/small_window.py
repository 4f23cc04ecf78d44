"""Containers that keep a page usable in a small window: they scroll, or turn a row into a column."""

from __future__ import annotations

from PySide6.QtCore import QEvent, QObject, QRect, QSize, Qt
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QBoxLayout, QFrame, QLayoutItem, QScrollArea, QSplitter, QWidget

from tissueid.app import build

_LEAST = 80
"""Width and height below which scrolling is no longer practical, pixels."""


class PageScroll(QScrollArea):
    """A page in the room that is available, scrolled where the page needs more.

    ``QScrollArea.setWidgetResizable`` gives a page its preferred height as soon as one of its labels wraps; here the
    page shrinks to its minimum before anything scrolls.
    """

    def __init__(self, page: QWidget, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        build.styled(self, frame_shape=QFrame.Shape.NoFrame, focus_policy=Qt.FocusPolicy.NoFocus)
        self.viewport().setAutoFillBackground(False)
        self.setWidget(page)
        page.setAutoFillBackground(False)
        page.installEventFilter(self)

    def minimumSizeHint(self) -> QSize:  # noqa: N802
        """Return the least size at which scrolling is still practical."""
        return QSize(_LEAST, _LEAST).boundedTo(self._needed(_LEAST))

    def sizeHint(self) -> QSize:  # noqa: N802
        """Return that of the page."""
        return self.widget().sizeHint()

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        """Fit the page into the new size."""
        super().resizeEvent(event)
        self._fit()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:  # noqa: N802
        """Fit the page again when what it needs has changed."""
        if event.type() == QEvent.Type.LayoutRequest and watched is self.widget():
            layout = self.widget().layout()
            if layout is not None:
                layout.activate()  # until then it answers with the heights from before the change
            self._fit()
        return super().eventFilter(watched, event)

    def _needed(self, width: int) -> QSize:
        """Return the least size of the page where it is ``width`` pixels wide or, if it needs more, wider."""
        page = self.widget()
        least = page.minimumSizeHint().expandedTo(page.minimumSize())
        width = max(width, least.width())
        layout = page.layout()
        if layout is not None and layout.hasHeightForWidth():
            return QSize(width, max(least.height(), layout.totalMinimumHeightForWidth(width)))
        return QSize(width, least.height())

    def _fit(self) -> None:
        room = self.maximumViewportSize()
        needed = self._needed(room.width())
        bar = self.style().pixelMetric(self.style().PixelMetric.PM_ScrollBarExtent, None, self)
        if needed.height() > room.height():
            needed = self._needed(room.width() - bar)
            room -= QSize(bar, 0)
        if needed.width() > room.width():
            room -= QSize(0, bar)
        self.widget().resize(needed.expandedTo(room))


class FoldingBox(QBoxLayout):
    """A row that becomes a column where it gets fewer than ``least`` pixels of width, or less than its items need.

    Its minimum width is that of the column, so that what is around it can become narrow enough to fold it.
    """

    def __init__(self, least: int, parent: QWidget | None = None) -> None:
        super().__init__(QBoxLayout.Direction.LeftToRight, parent)
        self._least = least

    def setGeometry(self, room: QRect) -> None:  # noqa: N802
        """Arrange the items in the room that is available."""
        row = self._is_row(room.width())
        wanted = QBoxLayout.Direction.LeftToRight if row else QBoxLayout.Direction.TopToBottom
        if wanted != self.direction():
            self.setDirection(wanted)
            self.update()  # its parents know the height that the other direction needed
        super().setGeometry(room)

    def hasHeightForWidth(self) -> bool:  # noqa: N802
        """Return True: a column is higher than a row."""
        return True

    def minimumHeightForWidth(self, width: int) -> int:  # noqa: N802
        """Return the least height of the row or column that this width allows."""
        if self._is_row(width) == (self.direction() == QBoxLayout.Direction.LeftToRight):
            folds_within = super().hasHeightForWidth()
            return super().minimumHeightForWidth(width) if folds_within else super().minimumSize().height()
        heights = [item.minimumSize().height() for item in self._items()]
        margins = self.contentsMargins()
        inner = max(heights, default=0) if self._is_row(width) else sum(heights) + self._gaps(len(heights))
        return inner + margins.top() + margins.bottom()

    def sizeHint(self) -> QSize:  # noqa: N802
        """Return the width of the row, also while it is folded: what is around it knows when it can unfold."""
        items = self._items()
        width = sum(item.sizeHint().width() for item in items) + self._gaps(len(items))
        margins = self.contentsMargins()
        return QSize(width + margins.left() + margins.right(), super().sizeHint().height())

    def minimumSize(self) -> QSize:  # noqa: N802
        """Return the width of the widest item, and the height in the present direction."""
        margins = self.contentsMargins()
        widest = max((item.minimumSize().width() for item in self._items()), default=0)
        return QSize(widest + margins.left() + margins.right(), super().minimumSize().height())

    def _items(self) -> list[QLayoutItem]:
        return [item for k in range(self.count()) if (item := self.itemAt(k)) is not None and not item.isEmpty()]

    def _gaps(self, items: int) -> int:
        return max(0, items - 1) * self.spacing()

    def _is_row(self, width: int) -> bool:
        """Return whether the items stand in a row where the layout is ``width`` pixels wide."""
        items = self._items()
        margins = self.contentsMargins()
        needed = sum(item.minimumSize().width() for item in items) + self._gaps(len(items))
        return width >= max(self._least, needed + margins.left() + margins.right())


class FoldingSplitter(QSplitter):
    """A horizontal splitter that becomes vertical where its parts do not fit next to each other.

    Its minimum width is that of the widest part, so that what is around it can become narrow enough to fold it.
    ``height`` is that of the first part where it is folded, pixels.
    """

    def __init__(self, height: int, parent: QWidget | None = None) -> None:
        super().__init__(Qt.Orientation.Horizontal, parent)
        self._height = height

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        """Fold or unfold for the new width."""
        across, down = Qt.Orientation.Horizontal, Qt.Orientation.Vertical
        room = event.size().width()
        needed = sum(self._widths()) + (self.count() - 1) * self.handleWidth()
        wanted = across if room >= needed else down
        if wanted != self.orientation():
            self.setOrientation(wanted)
            if wanted == down:
                self.setSizes([self._height, max(self._height, event.size().height() - self._height)])
            else:
                first = self._widths()[0]
                self.setSizes([first, room - first])
        super().resizeEvent(event)

    def minimumSizeHint(self) -> QSize:  # noqa: N802
        """Return the width of the widest part, and the height in the present orientation."""
        return QSize(max(self._widths(), default=0), super().minimumSizeHint().height())

    def _widths(self) -> list[int]:
        parts = [self.widget(k) for k in range(self.count())]
        return [part.minimumSizeHint().expandedTo(part.minimumSize()).width() for part in parts]
