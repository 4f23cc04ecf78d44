"""The signals of chosen tests on the page Research: laid over each other, brushed, saved."""

import csv

import numpy as np
import pytest
from app.benches import WAIT_MS
from app.views.research_hosts import RATE, drag, listed, ranges, show, signals, wait_shown
from coded import reads
from PySide6.QtCore import Qt
from PySide6.QtGui import QColor, QImage
from PySide6.QtWidgets import QFileDialog

from tissueid.app.theme import DARK, LIGHT

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]


def test_signals_of_selected_tests_are_laid_over_one_another(qtbot, opened):
    window, view = opened()
    assert view.signals.empty.isVisible()
    show(qtbot, window, view, (0, 1), tests=3)
    assert reads(view.browser.picked.text(), "research.selected", tests="3 tests", sessions="2 sessions")
    table = view.signals.table
    assert [table.horizontalHeaderItem(column).text() for column in range(4)] == [
        "Mean ± SD",
        "Voltage (V)",
        "Force (N)",
        "Position (mm)",
    ]
    assert table.rowCount() == 3
    assert table.item(0, 0).text().startswith("P-2, right calf, 2026-05-01 ")
    assert [table.item(row, 0).text()[-2:] for row in range(3)] == ["#1", "#1", "#2"]
    # A sine of 2 mm deviates by 2 / sqrt(2) mm from its mean.
    assert table.item(0, 3).text() == "14.0 ± 1.4"
    curve = view.signals.spectrum.card.plots[0].curves[0]
    assert curve.x[np.argmax(curve.y)] == pytest.approx(50.0, abs=2.0)
    tree = view.browser.tree
    tree.clearSelection()
    qtbot.waitUntil(view.signals.empty.isVisible, timeout=WAIT_MS)


def test_a_brush_over_one_plot_zooms_the_others_and_tells_its_figures(qtbot, opened):
    window, view = opened()
    show(qtbot, window, view, (0,), tests=1)
    panel = view.signals
    stack = panel.stack
    drag(qtbot, stack.cards[1], 0.5, 1.0)
    wait_shown(qtbot, window, view, 1)
    low, high = stack.brush
    assert (low, high) == (pytest.approx(0.5, abs=0.01), pytest.approx(1.0, abs=0.01))
    assert ranges(view) == [(low, high), (0.0, 2.0), (low, high)]
    force = signals(1)["force"]
    first, last = (int(np.ceil(round(time * RATE, 6))) for time in (low, high))
    mean, std = force[first:last].mean(), force[first:last].std()
    assert panel.table.item(0, 2).text() == f"{mean:.1f} ± {std:.1f}"
    assert panel.about.text().startswith(f"Brushed: {high - low:.3f} s, ")
    drag(qtbot, stack.cards[1], (low + high) / 2, (low + high) / 2 + 0.3)  # takes hold of the brush and moves it
    assert stack.brush == (pytest.approx(low + 0.3, abs=0.01), pytest.approx(high + 0.3, abs=0.01))
    panel.low.setFocus()
    panel.low.selectAll()
    qtbot.keyClicks(panel.low, "0.25")
    qtbot.keyClick(panel.low, Qt.Key.Key_Return)
    assert stack.brush[0] == pytest.approx(0.25)
    qtbot.mouseClick(panel.whole, Qt.MouseButton.LeftButton)
    wait_shown(qtbot, window, view, 1)
    assert stack.brush is None
    assert ranges(view) == [(0.0, 2.0)] * 3
    drag(qtbot, stack.cards[0], 0.5, 0.501)  # a click is no brush
    assert stack.brush is None


def test_the_menu_chooses_the_signals_and_the_choice_is_kept(qtbot, opened):
    window, view = opened()
    show(qtbot, window, view, (0,), tests=1)
    menu = view.signals.channels.menu()
    action = next(action for action in menu.actions() if action.text() == "Command")
    assert not action.isChecked()
    action.trigger()
    assert len(view.signals.stack.cards) == 4
    view.browser.bar.search.setText("calf")
    view.save_state()
    again, view = opened()
    assert view.browser.bar.search.text() == "calf"
    assert listed(view) == ["b.h5"]
    show(qtbot, again, view, (0,), tests=1)
    assert view.signals.channels.text() == "Signals (4 of 4)"


def test_data_are_exported_and_nothing_raw_is_changed(qtbot, opened, year, tmp_path):
    window, view = opened()
    before = {path: path.read_bytes() for path in year.rglob("*.h5")}
    assert not view.export.isEnabled()
    show(qtbot, window, view, (0, 1), tests=3)
    for folder in ("b-csv", "a-csv"):
        assert not (tmp_path / folder).exists()
    view.export.menu().actions()[0].trigger()
    (dialog,) = window.findChildren(QFileDialog)
    dialog.fileSelected.emit(str(tmp_path))
    dialog.reject()
    qtbot.waitUntil(lambda: (tmp_path / "a-csv").exists() and not window.jobs, timeout=WAIT_MS)
    assert sorted(path.name for path in (tmp_path / "a-csv").glob("*.csv")) == ["test-0001.csv", "test-0002.csv"]
    with (tmp_path / "b-csv" / "test-0001.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    np.testing.assert_array_equal([float(row["force (N)"]) for row in rows], signals(1)["force"])
    assert "Exported 2 sessions" in window.said[-1]
    assert {path: path.read_bytes() for path in year.rglob("*.h5")} == before


def test_the_figure_is_saved(qtbot, opened, tmp_path):
    window, view = opened()
    show(qtbot, window, view, (0,), tests=1)
    png, svg = tmp_path / "figure.png", tmp_path / "figure.svg"
    for path in (png, svg):
        qtbot.mouseClick(view.signals.save, Qt.MouseButton.LeftButton)
        dialog = window.findChildren(QFileDialog)[-1]
        dialog.fileSelected.emit(str(path))
        dialog.reject()
        qtbot.waitUntil(lambda path=path: path.exists() and not window.jobs, timeout=WAIT_MS)
        assert str(path) in window.said[-1]
    assert QImage(str(png)).width() > 1000
    text = svg.read_text(encoding="utf-8")
    assert "Position (mm)" in text
    assert "right calf" in text


@pytest.mark.parametrize("theme", [LIGHT, DARK], ids=["light", "dark"])
def test_colours_of_tests_stand_out(theme):
    from tissueid.app.views.researcher.plot_stack import series

    def luminance(name):
        parts = [value / 255 for value in QColor(name).getRgb()[:3]]
        linear = [value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4 for value in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    for colour in series(theme):
        lighter, darker = sorted((luminance(colour), luminance(theme.panel)), reverse=True)
        assert (lighter + 0.05) / (darker + 0.05) >= 3.0
