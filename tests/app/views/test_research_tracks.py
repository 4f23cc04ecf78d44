"""Figures and outlines of stretches, against numpy on the bare samples; and how fast they are drawn."""

import time
from pathlib import Path

import numpy as np
import pytest

from tissueid.app.views.researcher.plot_stack import Channel, LoadedTest, PlotStack, RecordedSignal
from tissueid.app.views.researcher.selected_test import SelectedTest

RATE = 2000.0


@pytest.fixture
def values():
    made = 1e3 + np.random.default_rng(2).normal(size=20_000)
    made[700:1500:3] = np.nan
    return made


@pytest.mark.parametrize(("first", "last"), [(0, 20_000), (3, 90), (255, 257), (256, 512), (100, 19_999), (650, 1600)])
def test_a_stretch_is_what_its_samples_are(values, first, last):
    found = RecordedSignal(values, RATE).stretch(first / RATE, last / RATE)
    known = values[first:last][np.isfinite(values[first:last])]
    assert found.samples == known.size
    assert found.lost == last - first - known.size
    assert found.mean == pytest.approx(known.mean(), abs=1e-9)
    assert found.std == pytest.approx(known.std(), abs=1e-9)


def test_nothing_is_known_of_an_empty_stretch():
    track = RecordedSignal(np.full(600, np.inf), RATE)
    assert np.isnan(track.stretch(0.1, 0.2).mean)
    assert track.stretch(0.2, 0.1).samples == 0


@pytest.mark.parametrize("samples", [1400, 60_000, 900_001])
def test_an_outline_reaches_from_the_least_to_the_greatest(samples):
    values = np.random.default_rng(3).normal(size=samples)
    times, drawn = RecordedSignal(values, RATE).outline(0.0, samples / RATE, 500)
    assert times.size == drawn.size <= 1400
    assert (drawn.min(), drawn.max()) == (values.min(), values.max())


def test_twenty_thousand_points_on_three_plots_are_drawn_thirty_times_a_second(qtbot):
    rng = np.random.default_rng(6)
    channels = [Channel("voltage", "V"), Channel("force", "N"), Channel("position", "m")]
    tracks = {channel: RecordedSignal(rng.normal(size=20_000), RATE) for channel in channels}
    stack = PlotStack()
    qtbot.addWidget(stack)
    stack.resize(900, 560)
    stack.show_tests([LoadedTest(SelectedTest(Path("x"), 1, "", "", "x"), 0.5, tracks)], channels)
    stack.show()
    taken = []
    for step in range(12):
        stack.set_brush(1.0 + 0.02 * step, 6.0 + 0.02 * step)
        start = time.process_time()  # of this process alone: other work on the machine does not count
        stack.draw()
        for card in stack.cards:
            card.plot.viewport().repaint()
        taken.append(time.process_time() - start)
    assert np.median(taken) < 1 / 30
