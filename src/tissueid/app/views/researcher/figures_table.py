"""What the brushed stretch amounts to: one row a test, one column a signal. Its colours are the key to the plots."""

from __future__ import annotations

from collections.abc import Sequence

from PySide6.QtCore import Qt
from PySide6.QtGui import QColor, QPixmap, QResizeEvent
from PySide6.QtWidgets import QHeaderView, QTableWidget, QTableWidgetItem, QWidget

from tissueid.app.theme import Theme
from tissueid.app.units import shown_si
from tissueid.app.views.researcher.colours import series
from tissueid.app.views.researcher.labels import labels_apart
from tissueid.app.views.researcher.reading import Channel, Loaded
from tissueid.app.views.researcher.tips import plain_tip
from tissueid.language import _
from tissueid.records import Estimate
from tissueid.wording import MISSING, plus_minus

_ROW = 22
_NAME_WIDTH = 150
_SWATCH = 10


class FiguresTable(QTableWidget):
    """Mean and standard deviation of every signal that is drawn."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(0, 1, parent)
        self._theme: Theme | None = None
        self._stretch: tuple[Sequence[Loaded], Sequence[Channel], float, float] = (), (), 0.0, 0.0
        self.setAccessibleName(_("Mean and standard deviation of the brushed stretch"))
        self.setEditTriggers(QTableWidget.EditTrigger.NoEditTriggers)
        self.setSelectionMode(QTableWidget.SelectionMode.SingleSelection)
        self.setTabKeyNavigation(False)
        self.setShowGrid(False)
        self.setWordWrap(False)
        self.setTextElideMode(Qt.TextElideMode.ElideMiddle)
        self.verticalHeader().hide()
        self.verticalHeader().setDefaultSectionSize(_ROW)
        header = self.horizontalHeader()
        header.setDefaultAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter)
        header.setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        header.setHighlightSections(False)
        self.setToolTip(_("The selected test is drawn over the others"))

    def show_stretch(self, loaded: Sequence[Loaded], channels: Sequence[Channel], low_s: float, high_s: float) -> None:
        """Fill it in for the stretch between two times."""
        self._stretch = loaded, channels, low_s, high_s
        self.setColumnCount(1 + len(channels))
        self.setRowCount(len(loaded))
        titles = [f"{channel.title} ({unit})" if unit else channel.title for channel, unit in _units(channels)]
        self.setHorizontalHeaderLabels([_("Mean ± SD"), *titles])
        _common, labels = labels_apart([[test.chosen] for test in loaded])
        for row, test in enumerate(loaded):
            name = QTableWidgetItem(labels[row])
            name.setToolTip(plain_tip(labels_apart([[test.chosen]])[1][0]))
            self.setItem(row, 0, name)
            for column, channel in enumerate(channels, 1):
                self.setItem(row, column, _figure(test, channel, low_s, high_s))
        self._colour()
        self.horizontalHeader().setSectionResizeMode(0, QHeaderView.ResizeMode.Fixed)
        self._give_room()

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        """Give the names what the figures leave."""
        super().resizeEvent(event)
        self._give_room()

    def take_units(self) -> None:
        """Show it in the units in force."""
        self.show_stretch(*self._stretch)

    def paint_with(self, theme: Theme) -> None:
        """Take on the colours of a theme."""
        self._theme = theme
        self._colour()

    def _give_room(self) -> None:
        """Make the names as wide as they are, or as there is room; at least so that they can be told apart."""
        others = sum(self.columnWidth(column) for column in range(1, self.columnCount()))
        room = max(_NAME_WIDTH, self.viewport().width() - others)
        self.horizontalHeader().resizeSection(0, min(room, self.sizeHintForColumn(0) + _SWATCH))

    def _colour(self) -> None:
        if self._theme is None:
            return
        for row, colour in zip(range(self.rowCount()), series(self._theme), strict=False):
            swatch = QPixmap(_SWATCH, _SWATCH)
            swatch.fill(QColor(colour))
            if (item := self.item(row, 0)) is not None:
                item.setData(Qt.ItemDataRole.DecorationRole, swatch)


def _units(channels: Sequence[Channel]) -> list[tuple[Channel, str]]:
    return [(channel, shown_si(channel.unit)[0]) for channel in channels]


def _figure(test: Loaded, channel: Channel, low_s: float, high_s: float) -> QTableWidgetItem:
    track = test.tracks.get(channel)
    if track is None:
        return QTableWidgetItem(MISSING)
    stretch = track.stretch(low_s, high_s)
    item = QTableWidgetItem(plus_minus(Estimate(stretch.mean, stretch.std), shown_si(channel.unit)[1]))
    lost = _(", {lost} lost").format(lost=stretch.lost) if stretch.lost else ""
    item.setToolTip(_("{samples} samples{lost}").format(samples=stretch.samples, lost=lost))
    return item


__all__ = ["FiguresTable"]
