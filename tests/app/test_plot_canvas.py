"""Plots in the window: drawn when they are seen, zoomed, panned, read, turned and saved."""

import numpy as np
import pytest
from PySide6.QtCore import QEvent, QPoint, QPointF, Qt
from PySide6.QtGui import QMouseEvent, QWheelEvent

from tissueid.analysis.curves import Axis, Curve, Plot, Surface
from tissueid.app.plot_canvas import PlotCanvas
from tissueid.app.theme import DARK, LIGHT, appearance

X = np.linspace(1.0, 10.0, 50)
PLOT = Plot("Impulse response", Axis("Lag", "ms"), Axis("", "mm/(N·s)"), (Curve(X, np.sin(X), "measured"),))
LONG = Plot("Long", Axis("Time", "s"), Axis("", "mm"), (Curve(np.arange(1e5), np.sin(np.arange(1e5))),))
KERNEL = Plot("Kernel", Axis("Lag", "ms"), Axis("Lag", "ms"), (Surface(X, X, np.outer(X, X), "Kernel", "mm"),))


@pytest.fixture
def plots_rendered():
    return True


@pytest.fixture
def canvas(qtbot):
    made = PlotCanvas()
    qtbot.addWidget(made)
    made.resize(400, 300)
    return made


def shown(canvas, *plots, **how):
    canvas.show()
    canvas.show_plots(plots, **how)
    return canvas.canvas


def middle(widget):
    return QPointF(widget.rect().center())


def mouse(kind, at, button=Qt.MouseButton.LeftButton):
    return QMouseEvent(kind, at, at, button, button, Qt.KeyboardModifier.NoModifier)


def wheel(widget, steps=1):
    at = middle(widget)
    keys, buttons = Qt.KeyboardModifier.NoModifier, Qt.MouseButton.NoButton
    return QWheelEvent(at, at, QPoint(), QPoint(0, 120 * steps), buttons, keys, Qt.ScrollPhase.NoScrollPhase, False)


def span(axes):
    low, high = axes.get_xlim()
    return high - low


def test_it_draws_when_it_is_seen_and_says_what_it_shows(canvas):
    canvas.show_plots([PLOT])
    assert canvas.canvas is None
    canvas.show()
    assert canvas.canvas.isVisible()
    assert canvas.canvas.accessibleName() == "Plot: Impulse response, mm/(N·s)"
    canvas.show_plots([Plot("Bode", PLOT.x, PLOT.y, missing="no input was recorded")])
    assert not canvas.canvas.isVisible()
    assert canvas.missing.text() == "No input was recorded."


def test_it_takes_on_a_theme(canvas):
    inside = shown(canvas, PLOT)
    assert canvas.axes[0].lines[0].get_color() == LIGHT.measured
    appearance.use(DARK)
    assert canvas.axes[0].lines[0].get_color() == DARK.measured
    assert inside.figure.get_facecolor()[0] < 0.2


def test_the_wheel_and_keys_zoom_and_everything_comes_back(qtbot, canvas):
    inside = shown(canvas, PLOT)
    (axes,) = canvas.axes
    whole = span(axes)
    canvas.eventFilter(inside, wheel(inside))
    assert span(axes) == pytest.approx(0.8 * whole)
    qtbot.keyClick(inside, Qt.Key.Key_Plus)
    assert span(axes) == pytest.approx(0.64 * whole)
    before = axes.get_xlim()[0]
    qtbot.keyClick(inside, Qt.Key.Key_Right)
    assert axes.get_xlim()[0] > before
    qtbot.keyClick(inside, Qt.Key.Key_0)
    assert span(axes) == pytest.approx(whole)


def test_dragging_pans_and_the_cursor_reads_values(canvas):
    inside = shown(canvas, PLOT)
    (axes,) = canvas.axes
    low, high = axes.get_xlim()
    at = middle(inside)
    canvas.eventFilter(inside, mouse(QEvent.Type.MouseButtonPress, at))
    canvas.eventFilter(inside, mouse(QEvent.Type.MouseMove, at + QPointF(40.0, 0.0)))
    canvas.eventFilter(inside, mouse(QEvent.Type.MouseButtonRelease, at))
    assert axes.get_xlim()[0] < low
    assert span(axes) == pytest.approx(high - low)
    assert " ms   " in canvas.readout.text()
    canvas.eventFilter(inside, mouse(QEvent.Type.MouseButtonDblClick, at))
    assert axes.get_xlim() == (low, high)


def test_a_long_line_costs_no_more_than_its_pixels(canvas):
    shown(canvas, LONG)
    (axes,) = canvas.axes
    (line,) = axes.lines
    assert line.get_xdata().size <= 1800
    for _ in range(30):
        canvas.zoom(0.8)
    assert 2 <= line.get_xdata().size < 300


def test_a_surface_turns_by_keys(qtbot, canvas):
    inside = shown(canvas, KERNEL, relief=True)
    (axes,) = canvas.axes
    before = axes.azim, axes.elev
    qtbot.keyClick(inside, Qt.Key.Key_Left)
    qtbot.keyClick(inside, Qt.Key.Key_Up)
    assert (axes.azim, axes.elev) == (before[0] + 10.0, before[1] - 10.0)
    qtbot.keyClick(inside, Qt.Key.Key_0)
    assert (axes.azim, axes.elev) == before


@pytest.mark.parametrize(("ending", "starts"), [(".png", b"\x89PNG"), (".svg", b"<?xml"), (".csv", b"plot,name")])
def test_it_is_saved(canvas, tmp_path, ending, starts):
    shown(canvas, PLOT)
    canvas.save(tmp_path / f"plot{ending}")
    assert (tmp_path / f"plot{ending}").read_bytes().startswith(starts)


def test_canvases_are_drawn_one_in_each_turn_of_the_event_loop(qtbot):
    made = [PlotCanvas() for _ in range(3)]
    for one in made:
        qtbot.addWidget(one)
        one.resize(400, 300)
        one.show()
        one.show_plots([PLOT])
    assert [one.pending for one in made] == [False, True, True]
    assert made[2].axes  # made when they are asked for
    qtbot.waitUntil(lambda: not any(one.pending for one in made))


def test_a_label_longer_than_its_axis_is_wrapped_and_stays_inside(canvas):
    canvas.resize(300, 130)
    inside = shown(canvas, Plot("", PLOT.x, Axis("Impulse response by depth", "mm/(N·s)"), PLOT.parts))
    label = canvas.axes[0].yaxis.label
    assert label.get_text() == "Impulse response\nby depth\n(mm/(N·s))"
    box = label.get_window_extent()
    assert box.y0 >= 0.0
    assert box.y1 <= inside.figure.bbox.height
    assert box.x0 >= 0.0
    canvas.resize(600, 500)
    canvas.settle()
    assert canvas.axes[0].yaxis.label.get_text() == "Impulse response by depth (mm/(N·s))"


def test_a_key_that_would_fill_its_axes_stands_beside_the_title(canvas):
    canvas.resize(700, 130)
    curves = tuple(Curve(X, np.sin(X + k), f"curve {k}") for k in range(6))
    shown(canvas, Plot("By frequency", PLOT.x, PLOT.y, curves))
    (axes,) = canvas.axes
    assert axes.get_legend().get_window_extent().y0 >= axes.bbox.y1 - 1.0
    assert len(axes.get_legend().get_texts()) == 6
