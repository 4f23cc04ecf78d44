"""Panel of signals: overlaid plots of the selected tests, statistics and spectrum of the brushed interval."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtGui import QColor, QPixmap, QResizeEvent
from PySide6.QtWidgets import (
    QHeaderView,
    QMenu,
    QPushButton,
    QTableWidget,
    QTableWidgetItem,
    QWidget,
)

from tissueid.app import build
from tissueid.app.context import AppContext
from tissueid.app.number_field import NumberField
from tissueid.app.small_window import FoldingBox
from tissueid.app.theme import LIGHT, appearance
from tissueid.app.views.researcher.background_work import ProgressStrip
from tissueid.app.views.researcher.plot_stack import (
    MOST_PLOTS,
    MOST_TESTS,
    SHORTEST_S,
    Channel,
    LoadedTest,
    PlotStack,
    SignalLoading,
    SpectrumCard,
    series,
    spectrum_of,
)
from tissueid.app.views.researcher.save_dialog import SaveDialog
from tissueid.app.views.researcher.selected_test import SelectedTest, distinguishing_labels
from tissueid.app.widgets import ElidedLabel, plain_tip
from tissueid.app.window_state import load_texts, save_texts
from tissueid.formatting import fixed, grouped, plus_minus
from tissueid.language import _, marked
from tissueid.messages import MISSING
from tissueid.records import Estimate
from tissueid.units import shown, shown_si

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from tissueid.analysis.curves import Plot

_WIDTH, _PANEL, _REST = 7.2, 1.7, 1.1
"""Inches."""
_COLUMNS = 1200


@dataclass(frozen=True)
class SignalFigure:
    """Signals of tests between two times (s), and the spectrum of one signal below."""

    loaded: Sequence[LoadedTest]
    channels: Sequence[Channel]
    low_s: float
    high_s: float
    spectrum: Channel | None

    @property
    def title(self) -> str:
        """Title of the figure, from which the file name is made."""
        common, labels = distinguishing_labels([[test.chosen] for test in self.loaded])
        return f"{_('Signals')} {common or ' '.join(labels[:1])}"

    @property
    def plots(self) -> list[Plot]:
        """The signals from the top, and the spectrum."""
        from tissueid.analysis.curves.signals import time_plot

        ends_s, colours = (self.low_s, self.high_s), series(LIGHT)
        labels = distinguishing_labels([[test.chosen] for test in self.loaded])[1]
        made = []
        for channel in self.channels:
            tracks = [test.tracks.get(channel) for test in self.loaded]
            lines = [track.outline(*ends_s, _COLUMNS) if track else None for track in tracks]
            made.append(time_plot(channel.title, channel.unit, lines, colours, labels, ends_s))
        if self.spectrum is not None:
            plot = spectrum_of(self.spectrum, self.loaded, ends_s, colours)
            made.append(replace(plot, title=_("Power spectrum of {title}").format(title=self.spectrum.title)))
        return made

    def draw(self) -> Figure:
        """Draw a panel per signal, and the spectrum below."""
        from tissueid.reports.plot_renderer import draw_plots
        from tissueid.reports.style import new_figure

        plots = self.plots
        figure = new_figure(_WIDTH, _PANEL * len(plots) + _REST)
        every, _long = draw_plots(figure, plots, units=shown, key=False)
        for axes in every[: len(self.channels) - 1]:
            axes.set_xlabel("")
        common = distinguishing_labels([[test.chosen] for test in self.loaded])[0]
        handles, labels = every[0].get_legend_handles_labels()
        figure.legend(handles, labels, title=common, loc="outside lower center", ncols=1 + (len(labels) > 3))
        return figure


_ROW = 22
_NAME_WIDTH = 150
_SWATCH = 10


class StatisticsTable(QTableWidget):
    """Mean and standard deviation of every drawn signal."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(0, 1, parent)
        self._stretch: tuple[Sequence[LoadedTest], Sequence[Channel], float, float] = (), (), 0.0, 0.0
        build.for_reading(
            self,
            _("Mean and standard deviation of the brushed stretch"),
            _ROW,
            selection_behavior=QTableWidget.SelectionBehavior.SelectItems,
            selection_mode=QTableWidget.SelectionMode.SingleSelection,
            text_elide_mode=Qt.TextElideMode.ElideMiddle,
            tip=_("The selected test is drawn over the others"),
        )
        appearance.follow(self._colour)

    def show_stretch(
        self, loaded: Sequence[LoadedTest], channels: Sequence[Channel], low_s: float, high_s: float
    ) -> None:
        """Show the statistics between two times, s."""
        self._stretch = loaded, channels, low_s, high_s
        self.setColumnCount(1 + len(channels))
        self.setRowCount(len(loaded))
        units = [(channel.title, shown_si(channel.unit)[0]) for channel in channels]
        titles = [f"{title} ({unit})" if unit else title for title, unit in units]
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


def _figure(test: LoadedTest, channel: Channel, low_s: float, high_s: float) -> QTableWidgetItem:
    track = test.tracks.get(channel)
    if track is None:
        return QTableWidgetItem(MISSING)
    stretch = track.stretch(low_s, high_s)
    item = QTableWidgetItem(plus_minus(Estimate(stretch.mean, stretch.std), shown_si(channel.unit)[1]))
    lost = _(", {lost} lost").format(lost=stretch.lost) if stretch.lost else ""
    item.setToolTip(_("{samples} samples{lost}").format(samples=stretch.samples, lost=lost))
    return item


_FIRST = ("force", "position", "voltage", "input", "output", "current")
"""Signals drawn by default: the first three of these that exist."""
_AT_FIRST = 3


class ChannelButton(QPushButton):
    """Button with a checkable menu of all signals; ``changed`` is emitted on each change."""

    changed = Signal()

    def __init__(self, wanted: Sequence[str], parent: QWidget | None = None) -> None:
        super().__init__(_("Signals"), parent)
        self.wanted = list(wanted)
        """Names of the selected signals; none before a selection."""
        self._channels: list[Channel] = []
        build.styled(self, menu=QMenu(self), tip=_("Which signals are drawn"))
        self.offer([])

    def offer(self, channels: Sequence[Channel]) -> None:
        """Offer signals in this order."""
        self._channels = list(channels)
        menu = self.menu()
        menu.clear()
        drawn = self.drawn
        for channel in channels:
            title, enabled = channel.title.replace("&", "&&"), channel in drawn or len(drawn) < MOST_PLOTS
            build.add_check(menu, title, channel in drawn, self._toggle, channel, enabled)
        some = _("Signals ({drawn} of {count})").format(drawn=len(drawn), count=len(channels))
        build.styled(self, enabled=bool(channels), text=some if channels else _("Signals"))

    @property
    def drawn(self) -> list[Channel]:
        """Signals to draw, from top to bottom."""
        names = {channel.name for channel in self._channels}
        wanted = [name for name in self.wanted if name in names]
        if not wanted:
            wanted = [name for name in _FIRST if name in names][:_AT_FIRST]
        if not wanted:
            wanted = [channel.name for channel in self._channels][:_AT_FIRST]
        return [channel for channel in self._channels if channel.name in wanted][:MOST_PLOTS]

    def _toggle(self) -> None:
        self.wanted = [action.data().name for action in self.menu().actions() if action.isChecked()]
        self.offer(self._channels)
        self.changed.emit()


_SIGNALS = "research/signals"
_STEP_S = 0.1
_FIGURES_MS = 40
_HEIGHTS = (330, 170)
_ONE_ROW = 640
"""Width below which the buttons stand below what is looked at, pixels."""
NOTHING = marked("Select a test in the list to see its signals; select several to lay them over one another.")
WAITS = marked("The signals are read as soon as nothing else goes on.")


class SignalsPanel(QWidget):
    """Panel of signals; ``work_waits`` is emitted when :meth:`go_on` has work to start."""

    work_waits = Signal()

    def __init__(self, context: AppContext, strip: ProgressStrip, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._context = context
        self._strip = strip
        self._chosen: list[SelectedTest] = []
        self._wanted: list[SelectedTest] | None = None
        self._reading: SignalLoading | None = None
        self.loaded: list[LoadedTest] = []
        self.channels = ChannelButton(load_texts(context.settings, _SIGNALS))
        self.low, self.high = NumberField(), NumberField()
        self.stack = PlotStack()
        self.whole = build.button(
            _("Whole test"),
            self.stack.show_whole,
            tip=_("Show everything again (a double click on a plot does the same)"),
        )
        self.save = build.button(
            _("Save figure…"), self._choose_figure, tip=_("What is shown, as PDF, SVG or PNG with 300 dpi")
        )
        self._saver = SaveDialog(context, self)
        self.about = build.styled(ElidedLabel(), role="muted")
        self.table = StatisticsTable()
        self.spectrum = SpectrumCard()
        self.empty = build.label("muted", _(NOTHING), alignment=Qt.AlignmentFlag.AlignCenter)
        self._figures = build.timer(self, _FIGURES_MS, self._show_figures)
        self._arrange()
        self.channels.changed.connect(self._redraw)
        self.stack.brushed.connect(self._brushed)
        self.low.valueChanged.connect(self._typed)
        self.high.valueChanged.connect(self._typed)
        self.table.currentCellChanged.connect(self.stack.bring_forward)
        self._redraw()

    # -- for the page ---------------------------------------------------------------------------------------

    def show_tests(self, chosen: Sequence[SelectedTest]) -> None:
        """Show tests when they are loaded."""
        self._chosen = list(chosen)
        self._wanted = self._chosen[:MOST_TESTS]
        if self._reading is not None:
            self._reading.cancel()  # what it reads is not wanted any more
        if not chosen:
            self._wanted = None
            self.loaded = []
            self._redraw()
            return
        self._say_empty(_(WAITS))
        self.work_waits.emit()

    def go_on(self) -> bool:
        """Start loading the waiting tests; return whether a job was started."""
        if self._wanted is None:
            return False
        self._reading = SignalLoading(self._wanted, {test.chosen: test for test in self.loaded})
        self._wanted = None
        self._strip.watch(self._reading)
        why = _("Sessions are being read on Research: cancel it there, or wait.")
        self._context.jobs.do(self._reading.run, self._read, self._failed, why=why)
        return True

    def update_enabled(self, *, busy: bool, testing: bool) -> None:
        """Disable the controls during a test, and saving while a job runs."""
        self.setEnabled(not testing)
        self.save.setEnabled(not busy and bool(self.loaded))

    def save_state(self) -> None:
        """Save which signals are drawn."""
        save_texts(self._context.settings, _SIGNALS, self.channels.wanted)

    # -- reading --------------------------------------------------------------------------------------------

    def _read(self, reading: SignalLoading) -> None:
        self._strip.clear()
        self._reading = None
        if self._wanted is not None:
            return  # the selection has changed since
        self.loaded = reading.loaded if self._chosen else []
        self._redraw()
        if reading.problems:
            self._context.say(" ".join(reading.problems), problem=True)

    def _failed(self, message: str) -> None:
        self._strip.clear()
        self._reading = None
        self.loaded = []
        self._redraw()
        self._context.say(message, problem=True)

    # -- showing --------------------------------------------------------------------------------------------

    def _redraw(self) -> None:
        offered = dict.fromkeys(channel for test in self.loaded for channel in test.tracks)
        self.channels.offer(sorted(offered, key=lambda channel: channel.rank))
        self._say_empty("" if self.loaded else _(NOTHING))
        for field in (self.low, self.high, self.whole, self.channels):
            field.setEnabled(bool(self.loaded))
        self.save.setEnabled(bool(self.loaded) and not self._context.busy)
        self.spectrum.offer(self.channels.drawn)
        self.stack.show_tests(self.loaded, self.channels.drawn)
        self._brushed(*self.stack.stretch)

    def _say_empty(self, text: str) -> None:
        """Show a text in place of the plots if no test is shown."""
        self.empty.setText(text)
        self.empty.setVisible(not self.loaded)
        self.parts.setVisible(bool(self.loaded))

    def _brushed(self, low_s: float, high_s: float) -> None:
        end = self.stack.whole[1]
        for field, value in ((self.low, low_s), (self.high, high_s)):
            with QSignalBlocker(field):
                build.styled(field, range=(0.0, end), value=value)
        self.whole.setEnabled(self.stack.brush is not None)
        if not self._figures.isActive():
            self._figures.start()

    def _typed(self) -> None:
        low, high = self.low.value(), self.high.value()
        if self.sender() is self.low and high - low < SHORTEST_S:
            high = min(self.stack.whole[1], low + SHORTEST_S)
        if high - low < SHORTEST_S:
            low = max(0.0, high - SHORTEST_S)
        self.stack.set_brush(low, high)

    def _show_figures(self) -> None:
        low, high = self.stack.stretch
        self.table.show_stretch(self.loaded, self.channels.drawn, low, high)
        self.spectrum.show_stretch(self.loaded, low, high)
        if not self.loaded:
            self.about.setText("")
            return
        tracks = [next(iter(test.tracks.values())) for test in self.loaded]
        samples = max(last - first for first, last in (track.places(low, high) for track in tracks))
        what = _("Brushed") if self.stack.brush else _("Whole")
        text = _("{what}: {seconds} s, {samples} samples").format(
            what=what, seconds=fixed(high - low, 3), samples=grouped(samples)
        )
        left_out = len(self._chosen) - len(self.loaded)
        if left_out:
            text += _("; {shown} of {count} tests shown").format(shown=len(self.loaded), count=len(self._chosen))
        self.about.setText(text)

    # -- figure ---------------------------------------------------------------------------------------------

    def _choose_figure(self) -> None:
        low, high = self.stack.stretch
        plan = SignalFigure(tuple(self.loaded), self.channels.drawn, low, high, self.spectrum.channel)
        self._saver.save_figure(plan, self._chosen[0].path.parent if self._chosen else None)

    # -- building -------------------------------------------------------------------------------------------

    def _arrange(self) -> None:
        for field, name in ((self.low, _("from")), (self.high, _("to"))):
            build.styled(
                field,
                name=_("Brushed {name}").format(name=name),
                prefix=f"{name} ",
                suffix=" s",
                decimals=3,
                single_step=_STEP_S,
                tip=_("Selected time interval: the plots below show it"),
            )
        looked_at = build.row(self.channels, self.low, self.high)
        top = build.fill(FoldingBox(_ONE_ROW), looked_at, (build.row(self.whole, None, self.save), 1))
        self.about.setFixedHeight(self.spectrum.choice.sizeHint().height())
        figures = build.column(self.about, (self.table, 1), spacing=4)
        below = build.holder(build.row((figures, 5), (self.spectrum, 4), spacing=8, margins=(0, 4, 0, 0)))
        self.parts = build.splitter((self.stack, 3), (below, 1), sizes=_HEIGHTS, upright=True)
        build.column(top, (self.parts, 1), (self.empty, 1), margins=(0, 6, 0, 0), parent=self)
