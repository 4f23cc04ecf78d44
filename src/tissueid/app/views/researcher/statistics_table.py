"""Statistics of the brushed interval: a row per test, a column per signal, in the colours of the plots."""

from __future__ import annotations

from collections.abc import Sequence

from PySide6.QtCore import Qt
from PySide6.QtGui import QColor, QPixmap, QResizeEvent
from PySide6.QtWidgets import QHeaderView, QTableWidget, QTableWidgetItem, QWidget

from tissueid.app.theme import appearance
from tissueid.app.views.researcher.colours import series
from tissueid.app.views.researcher.selected_test import distinguishing_labels
from tissueid.app.views.researcher.signal_loading import Channel, LoadedTest
from tissueid.app.widgets import plain_tip
from tissueid.formatting import plus_minus
from tissueid.language import _
from tissueid.messages import MISSING
from tissueid.records import Estimate
from tissueid.units import shown_si

_ROW = 22
_NAME_WIDTH = 150
_SWATCH = 10


class StatisticsTable(QTableWidget):
    """Mean and standard deviation of every drawn signal."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(0, 1, parent)
        self._stretch: tuple[Sequence[LoadedTest], Sequence[Channel], float, float] = (), (), 0.0, 0.0
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
        appearance.follow(self._colour)

    def show_stretch(
        self, loaded: Sequence[LoadedTest], channels: Sequence[Channel], low_s: float, high_s: float
    ) -> None:
        """Show the statistics between two times, s."""
        self._stretch = loaded, channels, low_s, high_s
        self.setColumnCount(1 + len(channels))
        self.setRowCount(len(loaded))
        titles = [f"{channel.title} ({unit})" if unit else channel.title for channel, unit in _units(channels)]
        self.setHorizontalHeaderLabels([_("Mean ± SD"), *titles])
        _common, labels = distinguishing_labels([[test.chosen] for test in loaded])
        for row, test in enumerate(loaded):
            name = QTableWidgetItem(labels[row])
            name.setToolTip(plain_tip(distinguishing_labels([[test.chosen]])[1][0]))
            self.setItem(row, 0, name)
            for column, channel in enumerate(channels, 1):
                self.setItem(row, column, _figure(test, channel, low_s, high_s))
        self._colour()
        self.horizontalHeader().setSectionResizeMode(0, QHeaderView.ResizeMode.Fixed)
        self._give_room()

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        """Fit the width of the names."""
        super().resizeEvent(event)
        self._give_room()

    def take_units(self) -> None:
        """Show the values in the active unit system."""
        self.show_stretch(*self._stretch)

    def _give_room(self) -> None:
        """Fit the width of the names to the available room, but not below a minimum."""
        others = sum(self.columnWidth(column) for column in range(1, self.columnCount()))
        room = max(_NAME_WIDTH, self.viewport().width() - others)
        self.horizontalHeader().resizeSection(0, min(room, self.sizeHintForColumn(0) + _SWATCH))

    def _colour(self) -> None:
        for row, colour in zip(range(self.rowCount()), series(appearance.theme), strict=False):
            swatch = QPixmap(_SWATCH, _SWATCH)
            swatch.fill(QColor(colour))
            if (item := self.item(row, 0)) is not None:
                item.setData(Qt.ItemDataRole.DecorationRole, swatch)


def _units(channels: Sequence[Channel]) -> list[tuple[Channel, str]]:
    return [(channel, shown_si(channel.unit)[0]) for channel in channels]


def _figure(test: LoadedTest, channel: Channel, low_s: float, high_s: float) -> QTableWidgetItem:
    track = test.tracks.get(channel)
    if track is None:
        return QTableWidgetItem(MISSING)
    stretch = track.stretch(low_s, high_s)
    item = QTableWidgetItem(plus_minus(Estimate(stretch.mean, stretch.std), shown_si(channel.unit)[1]))
    lost = _(", {lost} lost").format(lost=stretch.lost) if stretch.lost else ""
    item.setToolTip(_("{samples} samples{lost}").format(samples=stretch.samples, lost=lost))
    return item
