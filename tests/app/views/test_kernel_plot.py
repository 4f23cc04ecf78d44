"""Kernels on the page Research: one at a time, as an image or as a surface that is turned."""

import numpy as np
import pytest
from PySide6.QtCore import QPoint, Qt

from tissueid import units
from tissueid.analysis.curves import Axis, Plot, Surface
from tissueid.app.views.researcher.pictures import KernelPlot

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]


@pytest.fixture
def plots_rendered():
    return True


@pytest.fixture(autouse=True)
def clinical_again():
    yield
    units.use("clinical")


def kernel(count=24, name="Kernel"):
    lag = 0.5 * np.arange(count)
    wave = np.exp(-lag / 4.0) * np.sin(lag)
    surface = Surface(lag, lag, 0.03 * np.outer(wave, wave), name, "mm/(N²·s²)")
    return Plot(name, Axis("First lag", "ms"), Axis("Second lag", "ms"), (surface,))


class Outcome:
    """What the page takes of a result."""

    def __init__(self, label, *kernels):
        self.label, self.kernels = label, kernels
        self.plots = self


@pytest.fixture
def kernels(qtbot):
    made = KernelPlot()
    qtbot.addWidget(made)
    made.resize(640, 420)
    made.show()
    return made


def test_an_image_turns_into_a_surface_and_back(qtbot, kernels):
    assert not kernels.raised.isVisible()  # there is nothing to raise
    kernels.offer([Outcome("a", kernel()), Outcome("b", kernel(12))])
    assert kernels.canvas.axes[0].images
    assert not kernels.back.isVisible()
    qtbot.mouseClick(kernels.raised, Qt.MouseButton.LeftButton)
    assert kernels.canvas.axes[0].name == "3d"
    kernels.choice.setCurrentIndex(1)
    assert kernels.canvas.plots == (kernels.plot,)
    assert kernels.plot.surface.x.size == 12
    kernels.offer([])
    assert "Volterra" in kernels.canvas.missing.text()
    kernels.offer([Outcome("a", kernel())])
    assert kernels.canvas.axes[0].name == "3d"
    qtbot.mouseClick(kernels.flat, Qt.MouseButton.LeftButton)
    assert kernels.canvas.axes[0].images


def test_kernels_of_several_results_stand_side_by_side_on_one_scale(kernels):
    kernels.offer([Outcome("a", kernel())])
    assert kernels.choice.count() == 1
    kernels.offer([Outcome("a", kernel()), Outcome("b", kernel(12)), Outcome("c", kernel(name="Other"))])
    assert kernels.choice.itemText(3) == "Kernel: side by side"
    kernels.choice.setCurrentIndex(3)
    assert kernels.plot is None
    assert [plot.title for plot in kernels.side_by_side] == ["a", "b"]
    assert kernels.side_by_side[0].surface.limit == kernels.side_by_side[1].surface.limit
    drawn = [axes for axes in kernels.canvas.axes if axes.images]
    assert len(drawn) == 2
    assert drawn[0].get_position().x1 <= drawn[1].get_position().x0
    assert not kernels.raised.isVisible()
    kernels.choice.setCurrentIndex(0)
    assert kernels.side_by_side == ()
    assert kernels.raised.isVisible()


def test_mouse_and_keys_turn_it_and_the_button_turns_it_back(qtbot, kernels):
    kernels.offer([Outcome("a", kernel())])
    kernels.raised.click()
    (axes,) = kernels.canvas.axes
    inside, left = kernels.canvas.canvas, Qt.MouseButton.LeftButton
    first = axes.elev, axes.azim
    qtbot.mousePress(inside, left, pos=QPoint(200, 150))
    qtbot.mouseMove(inside, QPoint(260, 190))
    qtbot.mouseRelease(inside, left, pos=QPoint(260, 190))
    assert axes.azim != first[1]
    qtbot.mouseClick(kernels.back, left)
    assert (axes.elev, axes.azim) == first
    qtbot.keyClick(inside, Qt.Key.Key_Left)
    assert axes.azim != first[1]
    qtbot.keyClick(inside, Qt.Key.Key_Home)
    assert (axes.elev, axes.azim) == first


def test_it_says_what_it_shows_in_the_active_units(kernels):
    kernels.offer([Outcome("a", kernel())])
    surface, canvas = kernels.plot.surface, kernels.canvas
    assert canvas.accessibleName() == "Plot: Kernel, mm/(N²·s²)"
    row, column = np.unravel_index(np.argmax(surface.values), surface.values.shape)
    said = f"at First lag {surface.x[column]:g} ms and Second lag {surface.y[row]:g} ms."
    assert said in canvas.accessibleDescription()
    units.use("si")
    canvas.take_units()
    assert canvas.accessibleName() == "Plot: Kernel, m/(N²·s²)"
    assert "× 10⁻" in canvas.accessibleDescription()
