"""One frame of the window: three plots of 20,000 points each, outlined to the pixel columns, against bare curves."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pyqtgraph as pg
from numpy.typing import NDArray
from PySide6.QtWidgets import QApplication, QVBoxLayout, QWidget

from benchmarks.base import Comparison
from tissueid.app.live import decimated
from tissueid.app.plotting import PlotCard
from tissueid.app.theme import LIGHT
from tissueid.app.views.researcher.chosen import Chosen
from tissueid.app.views.researcher.plot_stack import PlotStack
from tissueid.app.views.researcher.reading import Channel, Loaded
from tissueid.app.views.researcher.track import Track

Array = NDArray[np.float64]
RATE = 2000.0
_NOWHERE = Path("nowhere.h5")
POINTS = 20_000
PLOTS = 3
SIZE = (900, 560)
CHANNELS = tuple(Channel(name, "") for name in ("first", "second", "third"))
SHARE = 0.05
"""Share of a plot's height by which the reach of two pictures may differ: what is outlined loses no peak."""


def comparisons() -> Iterable[Comparison]:
    os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
    application = QApplication.instance() or QApplication(["benchmarks"])
    values = np.random.default_rng(6).normal(size=(PLOTS, POINTS))
    live, bare, stack, moving = _Cards(values), _Bare(values), _Stack(values), _Bare(values, moving=True)
    _kept.extend([application, live, bare, stack, moving])
    setting = f"{PLOTS} plots of {POINTS:,} points, {SIZE[0]} x {SIZE[1]} pixels"
    yield Comparison("frame of signals", setting, live.frame, bare.frame, _differ, SHARE, floor=1.5, runs_in_block=9)
    title = "frame of the research page, the stretch moves"
    yield Comparison(title, setting, stack.frame, moving.frame, _differ, SHARE, runs_in_block=9)


_kept: list[object] = []
"""What is drawn into, as long as it is timed."""


def _differ(ours: Array, theirs: Array) -> float:
    """How far least and greatest of what each plot shows (plots, 2) lie apart, over their distance."""
    return float(np.abs(ours - theirs).max() / np.ptp(theirs, axis=1).min())


def _shown(made: Callable[[QWidget], None]) -> QWidget:
    home = QWidget()
    made(home)
    home.resize(*SIZE)
    home.show()
    QApplication.processEvents()
    return home


def _reach(plots: list[pg.PlotWidget]) -> Array:
    """Least and greatest value of each plot's curve, (plots, 2)."""
    drawn = [next(item for item in plot.plotItem.listDataItems() if item.yData is not None).yData for plot in plots]
    return np.array([(np.nanmin(values), np.nanmax(values)) for values in drawn])


class _Cards:
    """As the signals of a running test are drawn."""

    def __init__(self, values: Array) -> None:
        self._values, self._time = values, np.arange(POINTS) / RATE
        self._cards = [PlotCard(channel.name, "", channel.unit) for channel in CHANNELS]
        self._lines = [card.line("measured") for card in self._cards]
        self._home = _shown(self._arrange)

    def _arrange(self, home: QWidget) -> None:
        column = QVBoxLayout(home)
        for card in self._cards:
            card.paint_with(LIGHT)
            card.plot.setXRange(0.0, POINTS / RATE, padding=0.0)
            column.addWidget(card)

    def frame(self) -> Array:
        for card, line, values in zip(self._cards, self._lines, self._values, strict=True):
            columns = max(50, int(card.plot.getViewBox().width()))
            line.setData(*decimated(self._time, values, 0.0, POINTS / RATE, columns))
            card.plot.viewport().repaint()
        return _reach([card.plot for card in self._cards])


class _Bare:
    """As pyqtgraph draws an array that is handed to it; ``moving`` shows another stretch in every frame."""

    def __init__(self, values: Array, *, moving: bool = False) -> None:
        self._moving, self._step = moving, 0
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
        self._step = 1 - self._step
        for plot, line, values in zip(self._plots, self._lines, self._values, strict=True):
            line.setData(self._time, values)
            if self._moving:
                plot.setXRange(1e-3 * self._step, POINTS / RATE, padding=0.0)
            plot.viewport().repaint()
        return _reach(self._plots)


class _Stack:
    """As the research page draws what is selected, the stretch another one in every frame."""

    def __init__(self, values: Array) -> None:
        self._stack = PlotStack()
        tracks = {channel: Track(signal, RATE) for channel, signal in zip(CHANNELS, values, strict=True)}
        self._stack.paint_with(LIGHT)
        self._stack.show_tests([Loaded(Chosen(_NOWHERE, 1, "", "", "x"), 0.0, tracks)], list(CHANNELS))
        self._stack.resize(*SIZE)
        self._stack.show()
        QApplication.processEvents()
        self._step = 0

    def frame(self) -> Array:
        self._step = 1 - self._step
        self._stack.set_brush(1e-3 * self._step, POINTS / RATE)
        self._stack.draw()
        for card in self._stack.cards:
            card.plot.viewport().repaint()
        return _reach([card.plot for card in self._stack.cards])
