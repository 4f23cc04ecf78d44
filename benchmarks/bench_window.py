"""One frame of the window: three plots of 20,000 points each, reduced to pixel columns, against pyqtgraph's own curves.

A second comparison drags a selected interval with the mouse in one of three plots of the research page, while the
others show the interval enlarged; against pyqtgraph's own means: a region, views set to it, and automatic ranges of the
visible data.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pyqtgraph as pg
from numpy.typing import NDArray
from PySide6.QtCore import QCoreApplication, QEvent, QPointF, Qt
from PySide6.QtGui import QMouseEvent
from PySide6.QtWidgets import QApplication, QVBoxLayout, QWidget

from benchmarks.base import Comparison
from tissueid.app.live_signals import decimated
from tissueid.app.plotting import PlotCard
from tissueid.app.theme import LIGHT
from tissueid.app.views.researcher.plot_stack import Channel, LoadedTest, PlotStack, RecordedSignal
from tissueid.app.views.researcher.selected_test import SelectedTest

Array = NDArray[np.float64]
RATE = 2000.0
_NOWHERE = Path("nowhere.h5")
POINTS = 20_000
PLOTS = 3
SIZE = (900, 560)
CHANNELS = tuple(Channel(name, "") for name in ("first", "second", "third"))
STRETCH = (2.0, 6.0)
"""Selected interval before dragging, s."""
TRAVEL_S, FRAMES = 3.0, 60
"""Distance of dragging, s, and number of frames."""
SHARE = 0.05
"""Tolerance of the displayed range of two plots, relative to the plot's height: the reduction must keep all peaks."""


def comparisons() -> Iterable[Comparison]:
    os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
    application = QApplication.instance() or QApplication(["benchmarks"])
    values = np.random.default_rng(6).normal(size=(PLOTS, POINTS))
    live, bare, stack, region = _Cards(values), _Bare(values), _Stack(values), _Region(values)
    _kept.extend([application, live, bare, stack, region])
    setting = f"{PLOTS} plots of {POINTS:,} points, {SIZE[0]} x {SIZE[1]} pixels"
    yield Comparison("frame of signals", setting, live.frame, bare.frame, _differ, SHARE, floor=1.5, runs_in_block=9)
    title = "frame of the research page, a stretch is dragged"
    yield Comparison(title, setting, stack.frame, region.frame, _differ, SHARE, floor=1.0, runs_in_block=15)


_kept: list[object] = []
"""Windows kept alive during timing."""


def _differ(ours: Array, theirs: Array) -> float:
    """Return the difference of the extremes that each plot shows, shape (plots, 2), relative to their range."""
    return float(np.abs(ours - theirs).max() / np.ptp(theirs, axis=1).min())


def _shown(made: Callable[[QWidget], None]) -> QWidget:
    home = QWidget()
    made(home)
    home.resize(*SIZE)
    home.show()
    QApplication.processEvents()
    return home


def _reach(plots: list[pg.PlotWidget]) -> Array:
    """Return the least and greatest value shown by each plot, shape (plots, 2)."""
    reach = []
    for plot in plots:
        curve = next(item for item in plot.plotItem.listDataItems() if item.yData is not None)
        low, high = plot.viewRange()[0]
        values = curve.yData[(curve.xData >= low) & (curve.xData <= high)]
        reach.append((np.nanmin(values), np.nanmax(values)))
    return np.array(reach)


class _Cards:
    """The signals of a running test, as the window draws them."""

    def __init__(self, values: Array) -> None:
        self._values, self._time = values, np.arange(POINTS) / RATE
        self._cards = [PlotCard(channel.name, "", channel.unit) for channel in CHANNELS]
        self._lines = [card.line("measured") for card in self._cards]
        self._home = _shown(self._arrange)

    def _arrange(self, home: QWidget) -> None:
        column = QVBoxLayout(home)
        for card in self._cards:
            card.plot.setXRange(0.0, POINTS / RATE, padding=0.0)
            column.addWidget(card)

    def frame(self) -> Array:
        for card, line, values in zip(self._cards, self._lines, self._values, strict=True):
            columns = max(50, int(card.plot.getViewBox().width()))
            line.setData(*decimated(self._time, values, 0.0, POINTS / RATE, columns))
            card.plot.viewport().repaint()
        return _reach([card.plot for card in self._cards])


class _Bare:
    """The same arrays, as pyqtgraph draws them."""

    def __init__(self, values: Array) -> None:
        self._values, self._time = values, np.arange(POINTS) / RATE
        self._plots = [pg.PlotWidget() for _ in values]
        self._lines = [plot.plot(pen=pg.mkPen(LIGHT.measured, width=1)) for plot in self._plots]
        self._home = _shown(self._arrange)

    def _arrange(self, home: QWidget) -> None:
        column = QVBoxLayout(home)
        for plot in self._plots:
            plot.setXRange(0.0, POINTS / RATE, padding=0.0)
            column.addWidget(plot)

    def frame(self) -> Array:
        for plot, line, values in zip(self._plots, self._lines, self._values, strict=True):
            line.setData(self._time, values)
            plot.viewport().repaint()
        return _reach(self._plots)


class _Region:
    """A region over the first of three plots, followed by the others, as in pyqtgraph's own example."""

    def __init__(self, values: Array) -> None:
        self._step = 0
        self._plots = [pg.PlotWidget() for _ in values]
        self._region = pg.LinearRegionItem(STRETCH)
        for plot, signal in zip(self._plots, values, strict=True):
            plot.plot(np.arange(POINTS) / RATE, signal, pen=pg.mkPen(LIGHT.measured, width=1))
            plot.setAutoVisible(y=True)
        self._plots[0].setXRange(0.0, POINTS / RATE, padding=0.0)
        self._plots[0].addItem(self._region, ignoreBounds=True)
        self._region.sigRegionChanged.connect(self._follow)
        self._home = _shown(self._arrange)

    def _arrange(self, home: QWidget) -> None:
        column = QVBoxLayout(home)
        for plot in self._plots:
            column.addWidget(plot)

    def _follow(self) -> None:
        for plot in self._plots[1:]:
            plot.setXRange(*self._region.getRegion(), padding=0.0)

    def frame(self) -> Array:
        self._step += 1
        self._region.setRegion([end + _dragged_s(self._step) for end in STRETCH])
        for plot in self._plots:
            plot.viewport().repaint()
        return _reach(self._plots)


class _Stack:
    """The selected signals, as the research page draws them during dragging."""

    def __init__(self, values: Array) -> None:
        self._stack = PlotStack()
        tracks = {channel: RecordedSignal(signal, RATE) for channel, signal in zip(CHANNELS, values, strict=True)}
        self._stack.show_tests([LoadedTest(SelectedTest(_NOWHERE, 1, "", "", "x"), 0.0, tracks)], list(CHANNELS))
        self._stack.resize(*SIZE)
        self._stack.show()
        QApplication.processEvents()
        self._stack.set_brush(*STRETCH)
        self._stack.draw()
        self._step = 0
        self._mouse(QEvent.Type.MouseButtonPress, sum(STRETCH) / 2.0)

    def _mouse(self, kind: QEvent.Type, time_s: float) -> None:
        plot = self._stack.cards[0].plot
        where = QPointF(plot.mapFromScene(plot.getViewBox().mapViewToScene(QPointF(time_s, 0.0))))
        left = Qt.MouseButton.LeftButton
        event = QMouseEvent(kind, where, plot.viewport().mapToGlobal(where), left, left, Qt.KeyboardModifier.NoModifier)
        QCoreApplication.sendEvent(plot.viewport(), event)

    def frame(self) -> Array:
        self._step += 1
        self._mouse(QEvent.Type.MouseMove, sum(STRETCH) / 2.0 + _dragged_s(self._step))
        self._stack.draw()
        for card in self._stack.cards:
            card.plot.viewport().repaint()
        return _reach([card.plot for card in self._stack.cards])


def _dragged_s(step: int) -> float:
    """Return the displacement of the mouse, s: to and fro, different in every frame."""
    return TRAVEL_S * abs((step / FRAMES + 1.0) % 2.0 - 1.0)
