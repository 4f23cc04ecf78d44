"""Figures for publications: vector or 300 dpi, on white, with the whole legend, and nothing replaced without asking."""

import dataclasses
from pathlib import Path

import pytest
from app.benches import WAIT_MS
from app.views.research_panels import answer, press, run, wait
from PySide6.QtGui import QImage
from PySide6.QtWidgets import QFileDialog, QMessageBox

from tissueid.app.views.researcher.engine_outcome import KERNELS, OUTPUT, PICTURES
from tissueid.app.views.researcher.save_dialog import FIGURES, free_name, write_figure
from tissueid.calibration.file import Calibration, write_calibration
from tissueid.errors import UnusableInputError

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]


@pytest.fixture
def plots_laid_out():
    return True


def svg_of(figure, tmp_path):
    return write_figure(tmp_path / "figure.svg", figure.draw).read_text(encoding="utf-8")


def test_every_picture_is_drawn_with_its_legend_and_units(qtbot, panel, two, tmp_path):
    odd = [dataclasses.replace(two[0], pseudonym="_P$1$"), two[1]]
    run(qtbot, panel, odd, "wiener")
    run(qtbot, panel, odd[:1], "depth")
    units = {OUTPUT: "Measured less simulated (mm)", "Impulse response": "mm/(N·s)", "Bode diagram": "Frequency (Hz)"}
    units |= {"Against depth": "Stiffness (N/m)", "Static nonlinearity": "Static nonlinearity (mm)"}
    for name in PICTURES:
        panel.pictures.choice.setCurrentText(name)
        text = svg_of(panel.pictures.figure, tmp_path)
        assert units.get(name, "") in text
        assert "mathdefault" not in text
        if name != KERNELS:
            assert "Wiener" in text
            assert "P-002" in text
        assert "_P$1$" in text
    panel.pictures.choice.setCurrentText(OUTPUT)
    text = svg_of(panel.pictures.figure, tmp_path)
    assert "VAF" in text
    assert "scheduled by the measured output" in text


def test_a_sweep_lies_below_the_results_against_depth(qtbot, panel, strip, two, tmp_path):
    run(qtbot, panel, two[:1], "depth")
    path = tmp_path / "sweep.toml"
    columns = {name: [0.06, 0.07] for name in ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m")}
    sweep = Calibration(
        kind="sweep",
        model="m",
        serial_number="s",
        date="2026-03-01T09:30:00Z",
        software="s",
        verdict="passed",
        tables={"sweep": {"position_m": [0.002, 0.03], **columns}},
    )
    write_calibration(path, sweep)
    assert not panel.calibration.isVisible()
    panel.calibration.draw_sweep(path)
    assert panel.calibration.isChecked()
    assert panel.calibration.isVisible()  # with the picture that it is for
    mass = panel.pictures.plots.plots[0]
    assert mass.curve("calibration spring").y.tolist() == [60.0, 70.0]
    assert "calibration spring" in svg_of(panel.pictures.figure, tmp_path)
    press(qtbot, panel.calibration)  # takes it away
    assert not panel.pictures.calibrated
    assert not any(curve.name == "calibration spring" for curve in panel.pictures.plots.plots[0].curves)
    write_calibration(path, sweep.model_copy(update={"kind": "static"}))
    panel.calibration.draw_sweep(path)
    assert strip.said[-1][1]
    assert not panel.calibration.isChecked()


def test_the_population_is_drawn(qtbot, panel, two, tmp_path):
    run(qtbot, panel, two)
    view = panel.population
    panel.tabs.setCurrentWidget(view)
    for key in ("distribution", "subject", "date", "repeat", "stiffness_n_per_m"):
        view.across.setCurrentIndex(view.across.findData(key))
        view._choose()
        if key == "date":  # these tests have none
            assert view.figure is None
            continue
        text = svg_of(view.figure, tmp_path)
        assert "2 of 2 fits drawn" in text
        assert "LMS: " in text
        assert "Mass (g)" in text
    view.across.setCurrentIndex(0)
    view._choose()
    press(qtbot, view.save_figure)
    answer(qtbot, panel, tmp_path / "population.pdf")
    assert (tmp_path / "population.pdf").read_bytes().startswith(b"%PDF")


def test_a_figure_is_vector_or_has_three_hundred_dots_an_inch_on_white(qtbot, panel, two, tmp_path):
    run(qtbot, panel, two[:1])
    written = [write_figure(tmp_path / f"f{ending}", panel.pictures.figure.draw) for ending in FIGURES]
    pdf, svg, png = sorted(written, key=lambda path: (".pdf", ".svg", ".png").index(path.suffix))
    image = QImage(str(png))
    assert image.width() == 7.2 * 300
    assert image.pixelColor(2, 2).name() == "#ffffff"
    assert b"<svg" in svg.read_bytes()
    assert pdf.read_bytes().startswith(b"%PDF")
    with pytest.raises(UnusableInputError):
        write_figure(tmp_path / "f.docx", panel.pictures.figure.draw)


def test_a_name_is_suggested_that_is_free(qtbot, panel, two, tmp_path):
    assert free_name(tmp_path, "Model output P-001, #1: 50 %", ".pdf") == "Model-output-P-001-1-50.pdf"
    (tmp_path / "a-b.pdf").touch()
    assert free_name(tmp_path, "a b", ".pdf") == "a-b-2.pdf"
    assert free_name(tmp_path, "../..", ".svg") == "tissueid.svg"
    run(qtbot, panel, two[:1])
    press(qtbot, panel.save_figure)
    (dialog,) = panel.findChildren(QFileDialog)
    name = Path(dialog.selectedFiles()[0]).name
    assert name.startswith("Model-output-LMS-P-001")
    assert name.endswith(".pdf")
    dialog.filterSelected.emit("SVG drawing (*.svg)")
    assert Path(dialog.selectedFiles()[0]).suffix == ".svg"
    dialog.reject()


def test_what_is_there_is_replaced_only_when_that_is_said(qtbot, panel, two, tmp_path):
    run(qtbot, panel, two[:1])
    figure, table = tmp_path / "kept.svg", tmp_path / "kept.csv"
    for path, button, replace in (
        (figure, panel.save_figure, False),
        (figure, panel.save_figure, True),
        (table, panel.save_table, False),
    ):
        path.write_text("mine")
        press(qtbot, button)
        answer(qtbot, panel, path)
        (question,) = panel.findChildren(QMessageBox)
        assert path.read_text() == "mine"
        press(qtbot, next(b for b in question.buttons() if (b.text() == "Replace") == replace))
        wait(qtbot, panel)
        assert (path.read_text(encoding="utf-8") == "mine") != replace
        qtbot.waitUntil(lambda: not panel.findChildren(QMessageBox), timeout=WAIT_MS)
    assert "<svg" in figure.read_text(encoding="utf-8")


def test_saving_does_not_hand_the_focus_to_the_button_that_clears(qtbot, panel, two):
    run(qtbot, panel, two[:1], "lms")
    panel.save_figure.setFocus()
    assert panel.save_figure.hasFocus()
    panel.update_enabled(busy=True, testing=False)
    assert panel.results.hasFocus()
