"""What pyqtgraph leaves behind by itself: references to ``None``, as many for every plot, curve and line made with it.

With PySide 6.9 and pyqtgraph 0.14 two are left of a plot and of a line across it, one of a curve and of the words at
a line. They hold no memory. A window is measured against bare plots of its own number, so that a reference
that the window itself loses is seen beside them.
"""

from __future__ import annotations

import gc
import sys
from dataclasses import dataclass

import pyqtgraph as pg
from PySide6.QtCore import QCoreApplication, QEvent
from PySide6.QtWidgets import QWidget

ROUNDS = 4


@dataclass(frozen=True)
class Counted:
    """How many of each there are; ``lines`` lie across plots, and ``labelled`` is how many of them have words."""

    plots: int
    curves: int
    lines: int
    labelled: int


def counted(window: QWidget) -> Counted:
    """What a window is made of."""
    items = [item for view in window.findChildren(pg.GraphicsView) for item in view.scene().items()]

    def how_many(kind: type) -> int:
        return sum(isinstance(item, kind) for item in items)

    return Counted(
        # A bar of colours is no plot, and leaves as much.
        plots=how_many(pg.PlotItem) + how_many(pg.ColorBarItem),
        curves=how_many(pg.PlotDataItem),
        lines=how_many(pg.InfiniteLine),
        labelled=how_many(pg.InfLineLabel),
    )


def references_left(made: Counted) -> float:
    """References to ``None`` that so many bare plots, curves and lines leave behind, without any of our code."""
    left = []
    for _ in range(ROUNDS + 1):  # the first fills caches
        _live_and_die(made)
        QCoreApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)
        gc.collect()
        left.append(sys.getrefcount(None))
    return (left[-1] - left[0]) / ROUNDS


def _live_and_die(made: Counted) -> None:
    plots = [pg.PlotWidget(enableMenu=False) for _ in range(made.plots)]
    for _ in range(made.curves):
        plots[0].plot([], [])
    for number in range(made.lines):
        plots[0].addItem(pg.InfiniteLine(label="x" if number < made.labelled else None))
    for plot in plots:
        plot.close()
        plot.deleteLater()
