"""The grid of a plot: faint, under what is plotted, and no other than pyqtgraph would draw."""

import numpy as np
import pyqtgraph as pg
import pytest
from PySide6.QtCore import QRectF
from PySide6.QtGui import QColor, QImage, QPainter

from tissueid.app.plotting import PlotCard, QuickAxis, without_overlaps
from tissueid.app.theme import DARK, LIGHT, appearance

SIZE = (500, 320)


def pixels(image):
    """Colours of an image, (height, width, 3)."""
    image = image.convertToFormat(QImage.Format.Format_RGB32)
    return np.array(image.constBits()).reshape(image.height(), -1, 4)[:, :, 2::-1].astype(int)


def colour(name):
    return np.array(QColor(name).getRgb()[:3])


@pytest.fixture
def plots_rendered():
    return True


@pytest.fixture
def card(qtbot):
    made = PlotCard("Force", "Time (s)", "N")
    qtbot.addWidget(made)
    made.plot.setXRange(0.0, 10.0, padding=0.0)
    made.plot.setYRange(-1.0, 1.0, padding=0.0)
    made.resize(*SIZE)
    made.show()
    return made


def inside(card):
    """What is drawn between the axes, without its rim."""
    box = card.plot.getViewBox()
    place = box.mapRectToScene(box.boundingRect()).toAlignedRect().adjusted(2, 2, -2, -2)
    return pixels(card.plot.grab(place).toImage())


@pytest.mark.parametrize("theme", [LIGHT, DARK])
def test_the_grid_lies_between_the_ground_and_the_colour_of_lines(card, theme):
    appearance.use(theme)
    drawn = inside(card)
    ground, line = colour(theme.panel), colour(theme.line)
    is_ground = (drawn == ground).all(axis=2)
    assert 0.7 < is_ground.mean() < 0.99
    share = (drawn[~is_ground] - ground) / (line - ground)  # of the colour of lines in each part of the colour
    assert share.min() > 0.0
    assert share.max() < 0.4
    assert np.ptp(share, axis=1).max() < 0.2  # as much of one part as of another, but for whole numbers
    assert is_ground.all(axis=0).sum() == 0  # level lines cross every column
    assert (~is_ground).all(axis=0).sum() >= 5  # and upright ones stand from bottom to top


def test_a_curve_is_not_cut_by_the_grid(card):
    card.line("measured").setData(np.array([0.0, 10.0]), np.array([0.0, 0.0]))  # along a line of the grid
    drawn = inside(card)
    assert (drawn == colour(LIGHT.measured)).all(axis=2).all(axis=1).any()


@pytest.mark.parametrize("side", ["left", "bottom"])
def test_lines_stand_where_pyqtgraph_draws_them(qtbot, side):
    """Both draw the same axis over one ground, each in its own way."""
    drawn = []
    for kind in (QuickAxis, pg.AxisItem):
        plot = pg.PlotWidget(axisItems={side: kind(side)}, enableMenu=False)
        qtbot.addWidget(plot)
        plot.setBackground("white")
        plot.setXRange(0.13, 9.4, padding=0.0)
        plot.setYRange(-3.3, 2.1, padding=0.0)
        axis = plot.getAxis(side)
        axis.setPen("black")
        axis.setGrid(255)
        axis.setStyle(tickLength=0, maxTickLevel=1)
        if kind is QuickAxis:
            axis.set_ground("white")
        plot.resize(*SIZE)
        plot.show()
        image = QImage(*SIZE, QImage.Format.Format_RGB32)
        painter = QPainter(image)
        plot.render(painter, QRectF(0.0, 0.0, *SIZE))
        painter.end()
        drawn.append(pixels(image))
    assert np.abs(drawn[0] - drawn[1])[5:-25, 50:-5].max() <= 3
    assert np.ptp(drawn[1][5:-25, 50:-5]) > 60


def test_an_axis_without_room_draws_nothing(qtbot):
    axis = QuickAxis("bottom")
    image = QImage(8, 8, QImage.Format.Format_RGB32)
    image.fill(QColor("white"))
    painter = QPainter(image)
    axis.paint(painter, None)
    painter.end()
    assert (pixels(image) == 255).all()


def test_numbers_never_touch_and_those_of_coarser_ticks_stay():
    def number(left, text):
        return QRectF(left, 0.0, 14.0, 10.0), 0, text

    coarse, fine = [number(0.0, "80"), number(30.0, "90")], [number(15.0, "85"), number(60.0, "95")]
    assert [text for _, _, text in without_overlaps([*coarse, *fine])] == ["80", "90", "95"]
