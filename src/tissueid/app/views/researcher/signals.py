"""Panel of signals: overlaid plots of the selected tests, statistics and spectrum of the brushed interval."""

from __future__ import annotations

from collections.abc import Sequence

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import (
    QHBoxLayout,
    QLabel,
    QMenu,
    QPushButton,
    QSplitter,
    QWidget,
)

from tissueid.app import build
from tissueid.app.build import button, column, timer
from tissueid.app.context import AppContext
from tissueid.app.number_field import NumberField
from tissueid.app.small_window import FoldingBox
from tissueid.app.views.researcher.background_work import ProgressStrip
from tissueid.app.views.researcher.plot_stack import MOST_PLOTS, SHORTEST_S, PlotStack
from tissueid.app.views.researcher.save_dialog import SaveDialog
from tissueid.app.views.researcher.selected_test import SelectedTest
from tissueid.app.views.researcher.signal_figure import SignalFigure
from tissueid.app.views.researcher.signal_loading import MOST_TESTS, Channel, LoadedTest, SignalLoading
from tissueid.app.views.researcher.spectrum_card import SpectrumCard
from tissueid.app.views.researcher.statistics_table import StatisticsTable
from tissueid.app.widgets import ElidedLabel
from tissueid.app.window_state import load_texts, save_texts
from tissueid.formatting import fixed, grouped
from tissueid.language import _, marked

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
        self.setMenu(QMenu(self))
        self.setToolTip(_("Which signals are drawn"))
        self.offer([])

    def offer(self, channels: Sequence[Channel]) -> None:
        """Offer signals in this order."""
        self._channels = list(channels)
        menu = self.menu()
        menu.clear()
        drawn = self.drawn
        for channel in channels:
            action = menu.addAction(channel.title.replace("&", "&&"))
            action.setCheckable(True)
            action.setChecked(channel in drawn)
            action.setData(channel)
            action.setEnabled(channel in drawn or len(drawn) < MOST_PLOTS)
            action.toggled.connect(self._toggle)
        self.setEnabled(bool(channels))
        self.setText(
            _("Signals ({drawn} of {count})").format(drawn=len(drawn), count=len(channels))
            if channels
            else _("Signals")
        )

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
        checked = [action.data().name for action in self.menu().actions() if action.isChecked()]
        self.wanted = checked
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
        self.whole = button(_("Whole test"), tip=_("Show everything again (a double click on a plot does the same)"))
        self.save = button(
            _("Save figure…"), self._choose_figure, tip=_("What is shown, as PDF, SVG or PNG with 300 dpi")
        )
        self._saver = SaveDialog(context, self)
        self.about = ElidedLabel()
        self.stack = PlotStack()
        self.table = StatisticsTable()
        self.spectrum = SpectrumCard()
        self.empty = QLabel(_(NOTHING))
        self._figures = timer(self, _FIGURES_MS, self._show_figures)
        self._arrange()
        self.channels.changed.connect(self._redraw)
        self.stack.brushed.connect(self._brushed)
        self.low.valueChanged.connect(self._typed)
        self.high.valueChanged.connect(self._typed)
        self.whole.clicked.connect(self.stack.show_whole)
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

    def _failed(self, words: str) -> None:
        self._strip.clear()
        self._reading = None
        self.loaded = []
        self._redraw()
        self._context.say(words, problem=True)

    # -- showing --------------------------------------------------------------------------------------------

    def _redraw(self) -> None:
        found: dict[Channel, None] = {}
        for test in self.loaded:
            found.update(dict.fromkeys(test.tracks))
        self.channels.offer(sorted(found, key=lambda channel: channel.rank))
        self._say_empty("" if self.loaded else _(NOTHING))
        for field in (self.low, self.high, self.whole, self.channels):
            field.setEnabled(bool(self.loaded))
        self.save.setEnabled(bool(self.loaded) and not self._context.busy)
        self.spectrum.offer(self.channels.drawn)
        self.stack.show_tests(self.loaded, self.channels.drawn)
        self._brushed(*self.stack.stretch)

    def _say_empty(self, words: str) -> None:
        """Show a text in place of the plots if no test is shown."""
        self.empty.setText(words)
        self.empty.setVisible(not self.loaded)
        self.parts.setVisible(bool(self.loaded))

    def _brushed(self, low_s: float, high_s: float) -> None:
        end = self.stack.whole[1]
        for field, value in ((self.low, low_s), (self.high, high_s)):
            field.blockSignals(True)
            field.setRange(0.0, end)
            field.setValue(value)
            field.blockSignals(False)
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
        samples = max(last - first for test in self.loaded for first, last in [self._places(test, low, high)])
        what = _("Brushed") if self.stack.brush else _("Whole")
        words = _("{what}: {seconds} s, {samples} samples").format(
            what=what, seconds=fixed(high - low, 3), samples=grouped(samples)
        )
        left_out = len(self._chosen) - len(self.loaded)
        if left_out:
            words += _("; {shown} of {count} tests shown").format(shown=len(self.loaded), count=len(self._chosen))
        self.about.setText(words)

    @staticmethod
    def _places(test: LoadedTest, low: float, high: float) -> tuple[int, int]:
        return next(iter(test.tracks.values())).places(low, high)

    # -- figure ---------------------------------------------------------------------------------------------

    def _choose_figure(self) -> None:
        low, high = self.stack.stretch
        plan = SignalFigure(tuple(self.loaded), self.channels.drawn, low, high, self.spectrum.channel)
        self._saver.save_figure(plan, self._chosen[0].path.parent if self._chosen else None)

    # -- building -------------------------------------------------------------------------------------------

    def _arrange(self) -> None:
        for field, name in ((self.low, _("from")), (self.high, _("to"))):
            field.setAccessibleName(_("Brushed {name}").format(name=name))
            field.setPrefix(f"{name} ")
            field.setSuffix(" s")
            field.setDecimals(3)
            field.setSingleStep(_STEP_S)
            field.setToolTip(_("Selected time interval: the plots below show it"))
        for label in (self.about, self.empty):
            label.setProperty("role", "muted")
            label.setTextFormat(Qt.TextFormat.PlainText)
            label.setMinimumWidth(1)
        self.empty.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self.empty.setWordWrap(True)
        looked_at, kept = QHBoxLayout(), QHBoxLayout()
        for part in (self.channels, self.low, self.high):
            looked_at.addWidget(part)
        kept.addWidget(self.whole)
        kept.addStretch(1)
        kept.addWidget(self.save)
        top = FoldingBox(_ONE_ROW)
        for group in (top, looked_at, kept):
            group.setSpacing(6)
        top.addLayout(looked_at)
        top.addLayout(kept, 1)
        below = QWidget()
        self.about.setFixedHeight(self.spectrum.choice.sizeHint().height())
        build.row(
            (column(self.about, (self.table, 1), spacing=4), 5),
            (self.spectrum, 4),
            spacing=8,
            margins=(0, 4, 0, 0),
            parent=below,
        )
        self.parts = QSplitter(Qt.Orientation.Vertical)
        self.parts.addWidget(self.stack)
        self.parts.addWidget(below)
        self.parts.setChildrenCollapsible(False)
        self.parts.setStretchFactor(0, 3)
        self.parts.setStretchFactor(1, 1)
        self.parts.setSizes(list(_HEIGHTS))
        column(top, (self.parts, 1), (self.empty, 1), margins=(0, 6, 0, 0), parent=self)
