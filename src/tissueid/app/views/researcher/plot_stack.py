"""Signals of tests, loaded in a thread: over time with a brushed interval, and their spectra in that interval."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pyqtgraph as pg
from numpy.typing import NDArray
from PySide6.QtCore import QEvent, QObject, QPoint, Qt, Signal
from PySide6.QtGui import QMouseEvent, QResizeEvent
from PySide6.QtWidgets import QLabel, QWidget

from tissueid.app import build
from tissueid.app.live_signals import decimated
from tissueid.app.plot_canvas import PlotCanvas
from tissueid.app.plotting import PlotCard
from tissueid.app.theme import DARK, Theme, appearance, faint
from tissueid.app.views.researcher.background_work import BackgroundWork
from tissueid.app.views.researcher.selected_test import SelectedTest, signal_title
from tissueid.app.words import in_words
from tissueid.errors import CancelledError, TissueIDError
from tissueid.formatting import fixed
from tissueid.language import _, plural
from tissueid.sessions import read_test
from tissueid.units import display_unit

if TYPE_CHECKING:
    from tissueid.analysis.curves import Plot

Array = NDArray[np.float64]

_BLOCK = 256


@dataclass(frozen=True)
class IntervalStatistics:
    """Statistics of the received samples of an interval, in the unit of the signal; NaN if there are none."""

    mean: float
    std: float
    samples: int
    lost: int


class RecordedSignal:
    """A signal: ``values`` of shape (n,) in SI units, NaN for lost samples; ``sample_rate_hz`` is its sample rate.

    Sums and extremes of blocks are worked out once, so that twenty million samples take no longer to look at than some
    thousands.
    """

    def __init__(self, values: Array, sample_rate_hz: float) -> None:
        self.values = np.where(np.isfinite(values), values, np.nan)
        self.sample_rate_hz = sample_rate_hz
        finite = np.isfinite(self.values)
        self._middle = float(self.values[finite].mean()) if finite.any() else 0.0
        padding = np.full(-self.values.size % _BLOCK, np.nan)
        whole = np.concatenate([self.values, padding]).reshape(-1, _BLOCK)  # (blocks, _BLOCK)
        self._low, self._high = np.fmin.reduce(whole, axis=1), np.fmax.reduce(whole, axis=1)
        centred = whole - self._middle
        self._count = np.isfinite(whole).sum(axis=1)
        self._sum, self._square = np.nansum(centred, axis=1), np.nansum(centred**2, axis=1)

    @property
    def seconds(self) -> float:
        """Duration, s."""
        return self.values.size / self.sample_rate_hz

    def places(self, low_s: float, high_s: float) -> tuple[int, int]:
        """Return the first sample at or after ``low_s``, and the first at or after ``high_s``."""
        first, last = (math.ceil(round(time * self.sample_rate_hz, 6)) for time in (low_s, high_s))
        return max(0, min(first, self.values.size)), max(0, min(last, self.values.size))

    def stretch(self, low_s: float, high_s: float) -> IntervalStatistics:
        """Return mean and standard deviation of the received samples from ``low_s`` to ``high_s``."""
        first, last = self.places(low_s, high_s)
        if last <= first:
            return IntervalStatistics(math.nan, math.nan, 0, 0)
        head, tail = min(last, -(-first // _BLOCK) * _BLOCK), max(first, last // _BLOCK * _BLOCK)
        loose = self.values[first:last]
        blocks = slice(0, 0)
        if head < tail:
            loose = np.concatenate([self.values[first:head], self.values[tail:last]])
            blocks = slice(head // _BLOCK, tail // _BLOCK)
        centred = loose[np.isfinite(loose)] - self._middle
        count = centred.size + int(self._count[blocks].sum())
        if not count:
            return IntervalStatistics(math.nan, math.nan, 0, last - first)
        mean = float(centred.sum() + self._sum[blocks].sum()) / count
        square = float((centred**2).sum() + self._square[blocks].sum()) / count
        return IntervalStatistics(
            self._middle + mean, math.sqrt(max(0.0, square - mean**2)), count, last - first - count
        )

    def outline(self, low_s: float, high_s: float, columns: int) -> tuple[Array, Array]:
        """Return times and values to draw: minimum and maximum in each of ``columns`` columns."""
        first, last = self.places(low_s, high_s)
        first, last = max(0, first - 1), min(self.values.size, last + 1)
        if last - first > 4 * _BLOCK * columns:
            rows = slice(first // _BLOCK, -(-last // _BLOCK))
            times = np.arange(rows.start, rows.stop) * (_BLOCK / self.sample_rate_hz)
            ends = np.stack([self._low[rows], self._high[rows]], axis=1).reshape(-1)
            return decimated(np.repeat(times, 2), ends, low_s, high_s, columns)
        times = np.arange(first, last) / self.sample_rate_hz
        return decimated(times, self.values[first:last], low_s, high_s, columns)


MOST_TESTS = 8
"""Maximum number of overlaid tests."""
_MOST_NUMBERS = 60_000_000

_FIRST = ("command", "voltage", "current", "force", "position", "input", "output", "temperature")


@dataclass(frozen=True)
class Channel:
    """A signal: name and SI unit ("" if it has none). Each channel has one plot."""

    name: str
    unit: str

    @property
    def title(self) -> str:
        """Title of the signal in the language of the window."""
        return signal_title(self.name)

    @property
    def rank(self) -> tuple[int, str]:
        """Sort key: from the command of the coil to its motion."""
        return _FIRST.index(self.name) if self.name in _FIRST else len(_FIRST), self.name


@dataclass(frozen=True)
class LoadedTest:
    """A test with its signals. ``preload_s`` is the end of its preload, s; 0 without preload."""

    chosen: SelectedTest
    preload_s: float
    tracks: Mapping[Channel, RecordedSignal]

    @property
    def seconds(self) -> float:
        """Duration, s."""
        return max(track.seconds for track in self.tracks.values())


class SignalLoading(BackgroundWork):
    """Loads tests; those in ``previous`` are reused. Errors are added to ``problems``."""

    def __init__(self, chosen: Sequence[SelectedTest], previous: Mapping[SelectedTest, LoadedTest]) -> None:
        super().__init__(plural("Reading {count} test", "Reading {count} tests", len(chosen)).format(count=len(chosen)))
        self.loaded: list[LoadedTest] = []
        self.problems: list[str] = []
        self._chosen = tuple(chosen)
        self._previous = dict(previous)

    def run(self) -> SignalLoading:
        """Load the tests."""
        numbers = 0
        try:
            for done, selected in enumerate(self._chosen):
                self.tell(done / len(self._chosen))
                if (loaded := self._previous.get(selected) or self._load(selected)) is None:
                    continue
                numbers += sum(track.values.size for track in loaded.tracks.values())
                if self.loaded and numbers > _MOST_NUMBERS:
                    self.problems.append(
                        _("These tests are too long to be shown together; {count} are shown.").format(
                            count=len(self.loaded)
                        )
                    )
                    break
                self.loaded.append(loaded)
        except CancelledError:
            pass  # what is read is shown
        return self

    def _load(self, selected: SelectedTest) -> LoadedTest | None:
        try:
            test = read_test(selected.path, selected.number)
        except (TissueIDError, OSError) as error:
            self.problems.append(in_words(error))
            return None
        tracks = {
            Channel(name, test.unit(name)): RecordedSignal(values, test.sample_rate_hz)
            for name, values in test.signals.items()
            if name != "time"
        }
        return LoadedTest(selected, test.preload_s, tracks)


class SpectrumCard(QWidget):
    """Power spectral density of one signal of every test."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.choice = build.choice({}, characters=10, name=_("Signal of the spectrum"))
        self.card = PlotCanvas(_("Power spectrum"))
        self._shown: tuple[Sequence[LoadedTest], tuple[float, float]] = ((), (0.0, 1.0))
        self._wanted = "position"
        build.column(self.choice, (self.card, 1), spacing=4, parent=self)
        self.choice.activated.connect(self._choose)
        appearance.changed.connect(self._show_again)

    @property
    def channel(self) -> Channel | None:
        """Signal of the spectrum."""
        channel = self.choice.currentData()
        return channel if isinstance(channel, Channel) else None

    def offer(self, channels: Sequence[Channel]) -> None:
        """Offer signals; the selection stays if possible."""
        self.choice.clear()
        for channel in channels:
            self.choice.addItem(_("Spectrum of {title}").format(title=channel.title), channel)
        names = [channel.name for channel in channels]
        self.choice.setCurrentIndex(names.index(self._wanted) if self._wanted in names else len(names) - 1)

    def show_stretch(self, loaded: Sequence[LoadedTest], low_s: float, high_s: float) -> None:
        """Show the spectrum between two times, s."""
        self._shown = loaded, (low_s, high_s)
        channel = self.channel
        if channel is None or not loaded:
            self.card.say_missing("")
            return
        self.card.show_plots([spectrum_of(channel, loaded, (low_s, high_s), series(appearance.theme))])

    def take_units(self) -> None:
        """Show the values in the active unit system."""
        self.card.take_units()

    def _choose(self) -> None:
        channel = self.channel
        if channel is not None:
            self._wanted = channel.name
        self._show_again()

    def _show_again(self) -> None:
        loaded, (low_s, high_s) = self._shown
        self.show_stretch(loaded, low_s, high_s)


def spectrum_of(
    channel: Channel, loaded: Sequence[LoadedTest], ends_s: tuple[float, float], colours: Sequence[str]
) -> Plot:
    """Return the power spectra of one signal of tests between two times."""
    from tissueid.analysis.curves.signals import spectrum_plot

    tracks = [test.tracks.get(channel) for test in loaded]
    signals = [
        (track.values[slice(*track.places(*ends_s))], track.sample_rate_hz) if track else None for track in tracks
    ]
    return spectrum_plot(_("Power spectrum"), channel.unit, signals, colours)


_LIGHT_SERIES = ("#1f6f9f", "#c25400", "#1c7a4d", "#8e44ad", "#9a6200", "#b3266b", "#4a5a64", "#0f7f86")
_DARK_SERIES = ("#62b3e4", "#f2a155", "#58c491", "#c39bea", "#e0cf4a", "#f07ab0", "#b4c0c7", "#4fd0d6")
"""In the order of selection; each stands out from its theme's panel by 3 to 1 or more."""


def series(theme: Theme) -> tuple[str, ...]:
    """Return the colours of overlaid tests for a theme."""
    return _DARK_SERIES if theme is DARK else _LIGHT_SERIES


MOST_PLOTS = 6
SHORTEST_S = 0.005
"""A drag over less is a click."""
_FRAME_MS = 16
_GRIP_PX = 6
_ROOM = 0.06
_AXIS_HEIGHT = 17
_NOTHING = np.zeros(0)


class PlotStack(QWidget):
    """Stack of plots; ``brushed`` carries start and end of the interval (s), the whole test without a brush."""

    brushed = Signal(float, float)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._plots: list[_Plot] = []
        self._loaded: Sequence[LoadedTest] = ()
        self._channels: Sequence[Channel] = ()
        self._whole = (0.0, 1.0)
        self.brush: tuple[float, float] | None = None
        self._source: _Plot | None = None
        self._held: tuple[float, float] | None = None
        self._grip = ""
        self._pressed_on: _Plot | None = None
        self._frame = build.timer(self, _FRAME_MS, self.draw)
        self._axis = build.styled(
            QLabel(_("Time from the start of the test (s)")), role="field", alignment=Qt.AlignmentFlag.AlignCenter
        )
        self._column = build.column(self._axis, spacing=4, parent=self)
        appearance.changed.connect(self._paint)

    @property
    def cards(self) -> list[PlotCard]:
        """The shown plots, from top to bottom."""
        return [plot.card for plot in self._plots[: len(self._channels)]]

    @property
    def stretch(self) -> tuple[float, float]:
        """The brushed interval, or the whole test."""
        return self.brush or self._whole

    @property
    def whole(self) -> tuple[float, float]:
        """Interval of the longest test."""
        return self._whole

    def show_tests(self, loaded: Sequence[LoadedTest], channels: Sequence[Channel]) -> None:
        """Draw signals of tests; keep the brush if it lies within them."""
        self._loaded, self._channels = loaded[:MOST_TESTS], channels[:MOST_PLOTS]
        self._whole = 0.0, max((test.seconds for test in self._loaded), default=1.0)
        while len(self._plots) < len(self._channels):
            self._add()
        for index, plot in enumerate(self._plots):
            used = index < len(self._channels)
            plot.card.setVisible(used)
            if used:
                plot.show_channel(self._channels[index], self._loaded)
        self._axis.setVisible(bool(self._channels))
        inside = self.brush is not None and self.brush[1] <= self._whole[1]
        if self.brush is not None and inside and self._source in self._plots[: len(self._channels)]:
            self._place_views(self.brush)
        else:
            self.show_whole()

    def show_whole(self) -> None:
        """Clear the brush."""
        self.brush = self._source = None
        for plot in self._plots:
            plot.view = self._whole
        self._tell()

    def set_brush(self, low_s: float, high_s: float) -> None:
        """Brush an interval; the plot that was brushed last keeps its view."""
        low, high = max(self._whole[0], low_s), min(self._whole[1], high_s)
        if not self._channels or high - low < SHORTEST_S:
            return
        if self._source is None:
            self._source = self._plots[0]
        self.brush = low, high
        self._place_views(self.brush)
        self._tell()

    def _paint(self) -> None:
        for plot in self._plots:
            plot.paint()

    def bring_forward(self, index: int) -> None:
        """Draw a test over the others."""
        for plot in self._plots:
            plot.bring_forward(index)

    def draw(self) -> None:
        """Draw the current views."""
        for plot in self._plots[: len(self._channels)]:
            plot.draw(self._loaded, self.brush if plot is self._source else None)

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        """Redraw for the new width."""
        super().resizeEvent(event)
        self._frame.start()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:  # noqa: N802
        """Brush by dragging; move the brush or its ends; clear it by a double click."""
        plot = next((plot for plot in self._plots if plot.card.plot.viewport() is watched), None)
        if plot is None or not isinstance(event, QMouseEvent) or not self._loaded:
            return super().eventFilter(watched, event)
        kind = event.type()
        if kind == QEvent.Type.MouseButtonDblClick:
            self._held = None
            self.show_whole()
        elif kind == QEvent.Type.MouseButtonPress and event.button() == Qt.MouseButton.LeftButton:
            self._take_hold(plot, event.position().toPoint())
        elif kind == QEvent.Type.MouseMove and self._held is not None:
            self._drag(plot.time_at(event.position().toPoint()))
        elif kind == QEvent.Type.MouseButtonRelease and self._held is not None:
            self._drag(plot.time_at(event.position().toPoint()))
            self._held = None
        else:
            return super().eventFilter(watched, event)
        return True

    # -- brushing -------------------------------------------------------------------------------------------

    def _take_hold(self, plot: _Plot, where: QPoint) -> None:
        time = plot.time_at(where)
        self._grip, self._held = "new", (time, time)
        if self.brush is not None and plot is self._source:
            reach = _GRIP_PX * plot.seconds_per_pixel
            low, high = self.brush
            if abs(time - low) <= reach:
                self._grip, self._held = "end", (high, time)
            elif abs(time - high) <= reach:
                self._grip, self._held = "end", (low, time)
            elif low < time < high:
                self._grip, self._held = "move", (time - low, high - low)
        self._pressed_on = plot

    def _drag(self, time: float) -> None:
        if self._held is None:
            return
        fixed_at, length = self._held
        if self._grip == "move":
            low = min(max(self._whole[0], time - fixed_at), self._whole[1] - length)
            ends = low, low + length
        else:
            ends = min(fixed_at, time), max(fixed_at, time)
        if ends[1] - ends[0] >= SHORTEST_S:
            self._source = self._pressed_on
            self.set_brush(*ends)

    def _place_views(self, brush: tuple[float, float]) -> None:
        for plot in self._plots:
            if plot is not self._source:
                plot.view = brush
            elif not (plot.view[0] <= brush[0] and brush[1] <= plot.view[1]):
                plot.view = self._whole

    def _tell(self) -> None:
        if not self._frame.isActive():
            self._frame.start()
        self.brushed.emit(*self.stretch)

    def _add(self) -> None:
        plot = _Plot(self)
        plot.paint()
        plot.card.plot.viewport().installEventFilter(self)
        plot.card.plot.viewport().setCursor(Qt.CursorShape.CrossCursor)
        self._column.insertWidget(len(self._plots), plot.card, 1)
        self._plots.append(plot)


class _Plot:
    """Plot of one signal of every test over the times in ``view``."""

    def __init__(self, parent: QWidget) -> None:
        self.card = build.styled(
            PlotCard(_("Signal"), "", "", parent=parent),
            tip=_("Drag to select a time interval: the other plots show it. A double click shows everything"),
        )
        self.view = (0.0, 1.0)
        self._channel = Channel("", "")
        self._curves: list[pg.PlotDataItem] = []
        # Each plot may show other times than its neighbours.
        self.card.plot.getAxis("bottom").setStyle(showValues=True)
        self.card.plot.getAxis("bottom").setHeight(_AXIS_HEIGHT)
        self._region = pg.LinearRegionItem(movable=False)
        self._region.setZValue(-10)
        self._region.hide()
        self.card.plot.addItem(self._region, ignoreBounds=True)
        self._preload = self.card.mark()
        self._drawn: tuple[tuple[float, float], int] | None = None
        """Key of the drawn curves; they are redrawn when it changes."""

    @property
    def seconds_per_pixel(self) -> float:
        """Time per pixel, s."""
        return (self.view[1] - self.view[0]) / max(1.0, float(self.card.plot.getViewBox().width()))

    def time_at(self, where: QPoint) -> float:
        """Return the time at a position in the plot, limited to its view."""
        box = self.card.plot.getViewBox()
        time = float(box.mapSceneToView(self.card.plot.mapToScene(where)).x())
        return min(max(time, self.view[0]), self.view[1])

    def show_channel(self, channel: Channel, loaded: Sequence[LoadedTest]) -> None:
        """Show another signal."""
        self._channel = channel
        self.card.retitle(channel.title, display_unit(channel.unit)[0])
        while len(self._curves) < len(loaded):
            self._curves.append(self.card.plot.plot(_NOTHING, _NOTHING, connect="finite", skipFiniteCheck=False))
            self._colour()
        ends = {test.preload_s for test in loaded if test.preload_s > 0.0}
        self._preload.setVisible(len(ends) == 1)
        if len(ends) == 1:
            self._preload.setValue(ends.pop())
            self._preload.setToolTip(_("The preload ends here"))
        self._drawn = None

    def bring_forward(self, index: int) -> None:
        """Draw a test over the others."""
        for number, curve in enumerate(self._curves):
            curve.setZValue(1 if number == index else 0)

    def draw(self, loaded: Sequence[LoadedTest], brush: tuple[float, float] | None) -> None:
        """Draw the view; ``brush`` is the shaded interval or None."""
        self._region.setVisible(brush is not None)
        if brush is not None:
            self._region.setRegion(brush)
        box = self.card.plot.getViewBox()
        columns = max(50, int(box.width()))
        if self._drawn == (self.view, columns):
            return
        self._drawn = self.view, columns
        scale = display_unit(self._channel.unit)[1]
        low, high = math.inf, -math.inf
        for index, curve in enumerate(self._curves):
            track = loaded[index].tracks.get(self._channel) if index < len(loaded) else None
            if track is None:
                curve.setData(_NOTHING, _NOTHING)
                continue
            times, values = track.outline(*self.view, columns)
            values = scale * values
            received = values[np.isfinite(values)]
            # Where nothing was lost, pyqtgraph need not look for gaps, once for the path and once for its bounds.
            curve.setData(times, values, connect="all" if received.size == values.size else "finite")
            if received.size:
                low, high = min(low, float(received.min())), max(high, float(received.max()))
        room = (_ROOM * (high - low) or 0.5 * abs(high) or 1.0) if low <= high else 0.0
        across = (low - room, high + room) if low <= high else None
        box.setRange(xRange=self.view, yRange=across, padding=0.0)
        self.card.remark(_("{low} to {high} s").format(low=fixed(self.view[0], 3), high=fixed(self.view[1], 3)))

    def paint(self) -> None:
        """Apply the colours of the active theme."""
        accent = appearance.theme.accent
        self._region.setBrush(faint(accent, 45))
        for line in self._region.lines:
            line.setPen(pg.mkPen(accent, width=1))
        self._colour()

    def _colour(self) -> None:
        for curve, colour in zip(self._curves, series(appearance.theme), strict=False):
            curve.setPen(pg.mkPen(colour, width=1))
