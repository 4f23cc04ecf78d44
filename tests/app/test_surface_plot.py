"""A surface in space: what it shows against rotations worked out anew, how it is turned, and how fast it is drawn."""

from __future__ import annotations

import math

import numpy as np
import pytest
from PySide6.QtCore import QPoint, QPointF, Qt
from PySide6.QtGui import QImage, QWheelEvent
from PySide6.QtWidgets import QApplication

from tissueid.app import units
from tissueid.app.surface_geometry import MOST_POINTS, Pose, drawing_order, mesh_of, ticks
from tissueid.app.surface_plot import SurfaceCanvas, SurfacePlot
from tissueid.app.theme import DARK, LIGHT
from tissueid.app.views.researcher.kernel_plot import KernelPlot
from tissueid.app.views.researcher.plot_data import Image, PlotData

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]


@pytest.fixture(autouse=True)
def clinical_again():
    yield
    units.use("clinical")


def image(values=None, count=24):
    lag = 0.5 * np.arange(count)
    if values is None:
        wave = np.exp(-lag / 4.0) * np.sin(lag)
        values = 0.03 * np.outer(wave, wave)
    axes = [0.5 * np.arange(size) for size in np.shape(values)]
    return Image("Second-order kernel", "mm/(N²·s²)", *axes, np.asarray(values), "First lag (ms)", "Second lag (ms)")


@pytest.fixture
def plot(qtbot):
    plot = SurfacePlot()
    qtbot.addWidget(plot)
    plot.apply_theme(LIGHT)
    plot.resize(640, 420)
    plot.show_image(image())
    plot.show()
    return plot


def picture(widget):
    """What is painted, as red, green and blue of shape (height, width, 3)."""
    shot = widget.grab().toImage().convertToFormat(QImage.Format.Format_RGB32)
    flat = np.frombuffer(shot.constBits(), np.uint8).reshape(shot.height(), shot.bytesPerLine())
    return flat[:, : 4 * shot.width()].reshape(shot.height(), shot.width(), 4)[:, :, 2::-1].astype(int)


def like(pixels, colour, within=70):
    wanted = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)])
    return np.abs(pixels - wanted).sum(axis=2) < within


# -- geometry ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("azimuth", [-2.5, -0.4, 0.3, 1.9])
@pytest.mark.parametrize("elevation", [0.2, 0.9, math.pi / 2.0])
def test_points_are_seen_where_rotation_matrices_put_them(azimuth, elevation):
    """About the upright axis, then about the one that runs to the right; the page is what is left without the depth."""
    c, s = math.cos(azimuth), math.sin(azimuth)
    around = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    c, s = math.cos(elevation), math.sin(elevation)
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    points = np.random.default_rng(3).uniform(-1.0, 1.0, (3, 50))
    right, _depth, up = tilt @ around @ points
    seen = Pose(azimuth, elevation).seen(*points)
    np.testing.assert_allclose(seen, (right, up), atol=1e-12)


@pytest.mark.parametrize("azimuth", [-3.0, -2.0, -0.6, 0.2, 1.2, 2.9])
def test_far_cells_are_drawn_before_near_ones(azimuth):
    """Where two cells cover the same place of the page, the one drawn last must be nearer to the eye."""
    mesh = mesh_of(np.random.default_rng(1).normal(size=(7, 9)))
    pose = Pose(azimuth, 0.5)
    cells, corners = drawing_order(mesh, pose)
    assert sorted(cells) == list(range(6 * 8))
    x, y = (axis.ravel() for axis in np.meshgrid(mesh.x, mesh.y, indexing="ij"))
    right = (x * math.cos(azimuth) - y * math.sin(azimuth))[corners]
    away = (x * math.sin(azimuth) + y * math.cos(azimuth))[corners]
    for before in range(len(cells)):
        for after in range(before + 1, len(cells)):
            overlap = (
                right[before].min() < right[after].max() - 1e-9 and right[after].min() < right[before].max() - 1e-9
            )
            if overlap:  # along the common stretch no corner of the later one is wholly behind the earlier one
                assert away[after].min() < away[before].max() + 1e-9


def test_corners_go_round_their_cell():
    mesh = mesh_of(np.arange(12.0).reshape(3, 4))
    _, corners = drawing_order(mesh, Pose())
    for cell in corners:
        columns, rows = cell // 4, cell % 4
        steps = np.abs(np.diff(np.append(columns, columns[0]))) + np.abs(np.diff(np.append(rows, rows[0])))
        assert steps.tolist() == [1, 1, 1, 1]


def test_large_images_are_thinned_by_means_and_small_ones_are_not():
    values = np.random.default_rng(2).normal(size=(130, 40))
    mesh = mesh_of(values)
    assert mesh.z.shape == (44, 40)
    means = np.array([values[start : start + 3].mean(axis=0) for start in range(0, 130, 3)])
    assert mesh.low == pytest.approx(means.min())
    assert mesh.high == pytest.approx(means.max())
    small = mesh_of(np.eye(MOST_POINTS))
    assert small.z.shape == (MOST_POINTS, MOST_POINTS)
    assert (small.low, small.high) == (0.0, 1.0)


def test_holes_are_left_out_and_levels_reach_from_end_to_end():
    values = np.zeros((5, 5))
    values[2, 2] = np.nan
    values[0, 0] = -4.0
    mesh = mesh_of(values)
    cells, _ = drawing_order(mesh, Pose())
    assert len(cells) == 16 - 4
    assert mesh.limit == 4.0
    assert np.nanmin(mesh.level) == pytest.approx(-0.25)  # the mean of one corner and three zeros


@pytest.mark.parametrize("values", [np.zeros((6, 6)), np.full((4, 4), np.nan), np.ones((1, 5)), np.ones((1, 1))])
def test_there_is_always_something_to_look_at(qtbot, values):
    plot = SurfacePlot()
    qtbot.addWidget(plot)
    plot.show_image(image(values))
    plot.show()
    assert plot.grab().width() > 0


def test_ticks_are_round_and_within():
    assert ticks(0.0, 31.5, 5) == [0.0, 10.0, 20.0, 30.0]
    found = ticks(-2.3e-5, 1.1e-5, 5)
    assert found[0] >= -2.3e-5
    assert found[-1] <= 1.1e-5
    assert 0.0 in found
    assert ticks(2.0, 2.0, 5) == [2.0]


def test_it_is_never_looked_at_from_below_and_comes_round():
    pose = Pose()
    for _ in range(50):
        pose = pose.turned(math.radians(30.0), math.radians(-30.0))
    assert 0.0 < pose.elevation < 0.1
    assert abs(pose.azimuth) <= math.pi
    assert pose.turned(0.0, 9.0).elevation == pytest.approx(math.pi / 2.0)
    assert pose.zoomed(1e9).zoom == pose.zoomed(1e9).zoomed(2.0).zoom
    assert 0.0 < pose.zoomed(1e-9).zoom < 1.0


# -- the widget -------------------------------------------------------------------------------------------------------


def test_the_keyboard_turns_it_and_home_and_the_button_turn_it_back(qtbot, plot):
    canvas = plot.canvas
    assert canvas.focusPolicy() & Qt.FocusPolicy.TabFocus
    for key in (Qt.Key.Key_Left, Qt.Key.Key_Up, Qt.Key.Key_Plus):
        before = canvas.pose
        qtbot.keyClick(canvas, key)
        assert canvas.pose != before
    qtbot.keyClick(canvas, Qt.Key.Key_Right)
    qtbot.keyClick(canvas, Qt.Key.Key_Down)
    qtbot.keyClick(canvas, Qt.Key.Key_Minus)
    assert canvas.pose.zoom == pytest.approx(1.0)
    qtbot.keyClick(canvas, Qt.Key.Key_Left)
    qtbot.keyClick(canvas, Qt.Key.Key_Home)
    assert canvas.pose == Pose()
    qtbot.keyClick(canvas, Qt.Key.Key_Left)
    qtbot.mouseClick(plot.back, Qt.MouseButton.LeftButton)
    assert canvas.pose == Pose()


def test_the_mouse_turns_it_while_it_is_held_and_the_wheel_comes_closer(qtbot, plot):
    canvas, left = plot.canvas, Qt.MouseButton.LeftButton
    qtbot.mouseMove(canvas, QPoint(100, 100))
    assert canvas.pose == Pose()
    qtbot.mousePress(canvas, left, pos=QPoint(100, 100))
    qtbot.mouseMove(canvas, QPoint(160, 120))
    qtbot.mouseRelease(canvas, left, pos=QPoint(160, 120))
    turned = canvas.pose
    assert turned.elevation > Pose().elevation  # pulled down, one looks more from above
    assert turned.azimuth != Pose().azimuth
    qtbot.mouseMove(canvas, QPoint(200, 200))
    assert canvas.pose == turned
    nothing, none = QPoint(), Qt.KeyboardModifier.NoModifier
    place = QPointF(50.0, 50.0)
    for angle, closer in ((120, True), (-240, False)):
        before = canvas.pose.zoom
        phase = Qt.ScrollPhase.NoScrollPhase
        event = QWheelEvent(place, place, nothing, QPoint(0, angle), Qt.MouseButton.NoButton, none, phase, False)
        QApplication.sendEvent(canvas, event)
        assert (canvas.pose.zoom > before) is closer


def test_it_says_what_it_shows(plot):
    canvas = plot.canvas
    assert plot.heading.text() == "Second-order kernel (mm/(N²·s²))"
    assert canvas.accessibleName() == "Surface: Second-order kernel, mm/(N²·s²)"
    shown = canvas.image
    column, row = np.unravel_index(np.argmax(shown.values), shown.values.shape)
    said = canvas.accessibleDescription()
    assert f"at First lag (ms) {shown.x[column]:g} and Second lag (ms) {shown.y[row]:g}." in said
    assert "Home turns it back" in said
    units.use("si")
    plot.take_units()
    assert plot.heading.text() == "Second-order kernel (m/(N²·s²))"
    assert "× 10⁻" in canvas.accessibleDescription()


def test_what_is_above_zero_has_one_colour_and_what_is_below_the_other(qtbot):
    ramp = np.linspace(-1.0, 1.0, 30)[:, None] * np.ones(30)
    for theme in (LIGHT, DARK):
        canvas = SurfaceCanvas()
        qtbot.addWidget(canvas)
        canvas.apply_theme(theme)
        canvas.resize(500, 400)
        canvas.show_image(image(ramp))
        canvas.pose = Pose(0.0, math.pi / 2.0)  # from above, the first axis to the right
        pixels = picture(canvas)[:, : 500 - 130]  # without the bar of the colours
        for colour, side in ((theme.measured, "left"), (theme.model, "right")):
            x = np.nonzero(like(pixels, colour, 140))[1]
            assert x.size > 200
            middle = np.median(x)
            assert middle < 170 if side == "left" else middle > 220


def test_a_near_wall_hides_what_is_behind_it(qtbot):
    """A plain behind a wall is not seen from the wall's side, and is seen from the other."""
    values = np.full((40, 40), -1.0)  # the plain lies on the ground, so that it is never seen from beneath
    values[:, 4:8] = 0.0
    canvas = SurfaceCanvas()
    qtbot.addWidget(canvas)
    canvas.apply_theme(LIGHT)
    canvas.resize(560, 420)
    canvas.show_image(image(values))

    def blue(azimuth):
        canvas.pose = Pose(azimuth, math.radians(20.0))
        return int(like(picture(canvas)[:, : 560 - 130], LIGHT.measured, 40).sum())

    assert blue(0.0) < 0.3 * blue(math.pi)  # at an azimuth of zero the second axis runs away from the eye


def test_turning_draws_something_else_and_turning_back_the_same(plot):
    first = picture(plot.canvas)
    plot.canvas.pose = Pose().turned(0.5, 0.2)
    assert np.any(picture(plot.canvas) != first)
    plot.canvas.turn_back()
    np.testing.assert_array_equal(picture(plot.canvas), first)


# -- beside the image -------------------------------------------------------------------------------------------------


class Outcome:
    """What the page takes of a result."""

    def __init__(self, label, *images):
        self.label = label
        self.plots = PlotData({}, {}, images, {})


def test_an_image_turns_into_a_surface_and_back(qtbot):
    kernels = KernelPlot()
    qtbot.addWidget(kernels)
    kernels.apply_theme(LIGHT)
    kernels.show()
    assert not kernels.raised.isVisible()  # there is nothing to raise
    kernels.offer([Outcome("a", image()), Outcome("b", image(count=12))])
    assert kernels.card.plot.isVisible()
    assert kernels.surface is None
    qtbot.mouseClick(kernels.raised, Qt.MouseButton.LeftButton)
    assert kernels.surface.isVisible()
    assert not kernels.card.isVisible()
    assert kernels.surface.canvas.image is kernels.image
    kernels.choice.setCurrentIndex(1)
    assert kernels.surface.canvas.image is kernels.image
    kernels.offer([])
    assert not kernels.surface.isVisible()
    assert kernels.card.isVisible()
    kernels.offer([Outcome("a", image())])
    assert kernels.surface.isVisible()
    qtbot.mouseClick(kernels.flat, Qt.MouseButton.LeftButton)
    assert kernels.card.plot.isVisible()


def test_the_image_too_is_said_in_the_units_in_force(qtbot):
    kernels = KernelPlot()
    qtbot.addWidget(kernels)
    kernels.apply_theme(LIGHT)
    lag, depth = np.linspace(0.0, 30.0, 20), np.linspace(5.0, 12.0, 60)
    along = Image("Kernels against depth", "mm/(N·s)", lag, depth, np.ones((20, 60)), "Lag (ms)", "Position (mm)")
    kernels.offer([Outcome("a", along)])
    units.use("si")
    for part in (kernels, kernels.card):  # in the order in which the window reaches them
        part.take_units()
    left, bottom = (kernels.card.plot.getAxis(side) for side in ("left", "bottom"))
    assert (left.labelText, left.scale) == ("Position (m)", 1e-3)
    assert (bottom.labelText, bottom.scale) == ("Lag (ms)", 1.0)
    assert kernels._bar.axis.scale == pytest.approx(1e-3)
    assert kernels.card._heading.text() == "Kernels against depth (m/(N·s))"
