"""Clinical or SI units: chosen on the page Start, shown at once, found again at the next start."""

from __future__ import annotations

import math

import numpy as np
import pytest
from app.test_live_analysis import seen
from app.test_window import press, wait_for_result
from app.views.technician_pages import sweep
from PySide6.QtCore import QSettings

from tissueid import units
from tissueid.app.live_analysis import LiveAnalysis
from tissueid.app.plotting import PlotCard
from tissueid.app.result import SittingSummary
from tissueid.app.views.clinician.comparing import ComparisonCard, Sighting, SittingComparison
from tissueid.app.views.clinician.sitting import Repeat, Sitting, standing
from tissueid.app.views.gap.result_tabs import CandidatesTab
from tissueid.app.views.researcher.plot_stack import Channel, LoadedTest, RecordedSignal, SpectrumCard
from tissueid.app.views.researcher.save_dialog import write_figure
from tissueid.app.views.researcher.selected_test import SelectedTest
from tissueid.app.views.researcher.signals import SignalFigure, StatisticsTable
from tissueid.app.views.technician.calibrations import SweepsPanel
from tissueid.app.words import figure_of
from tissueid.calibration import CalibratedQuantity
from tissueid.calibration.status import label_of
from tissueid.formatting import figure_text, value_and_rest
from tissueid.gap.diagnosis_content import Fitted, Rival
from tissueid.procedures.test_plan import TestPlan
from tissueid.records import Estimate
from tissueid.sessions import read_session

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]


@pytest.fixture
def plots_laid_out():
    return True


@pytest.fixture(autouse=True)
def clinical_again():
    units.use("clinical")
    yield
    units.use("clinical")


def ticks_of(card, side):
    """Values of the data at which ticks stand, and what is written there."""
    axis = card.plot.getAxis(side)
    low, high = axis.range
    spacing, places = next(level for level in axis.tickValues(low, high, 400) if len(level[1]) > 1)
    return list(zip(places, axis.tickStrings(places, axis.scale, spacing), strict=True))


# -- the units themselves ---------------------------------------------------------------------------------------------


def test_every_quantity_has_a_unit_in_both_systems_that_says_the_same():
    """The factors against those of the prefixes, which are written down here anew."""
    prefixes = {"mm": 1e-3, "mm/s": 1e-3, "g": 1e-3}
    assert set(units.FIGURES) == set(units.SYSTEMS)
    assert set(units.FIGURES["clinical"]) == set(units.FIGURES["si"])
    for quantity, unit in units.FIGURES["clinical"].items():
        assert unit.factor * prefixes.get(unit.symbol, 1.0) == pytest.approx(1.0), quantity
        assert units.FIGURES["si"][quantity].factor == 1.0
        assert unit.decimals >= 0
        # Both show the same place behind the decimal point of the quantity, to within a tenth.
        finer = units.FIGURES["si"][quantity]
        assert 10.0**-finer.decimals == pytest.approx(10.0**-unit.decimals / unit.factor, rel=10.0)


@pytest.mark.parametrize(
    ("unit", "si", "factor"),
    [
        ("mm", "m", 1e-3),
        ("g", "kg", 1e-3),
        ("mm/N", "m/N", 1e-3),
        ("mm/(N·s)", "m/(N·s)", 1e-3),
        ("mm/(N²·s²)", "m/(N²·s²)", 1e-3),
        ("mm²/Hz", "m²/Hz", 1e-6),
        ("N/mm", "N/m", 1e3),
        ("N/(mm·s)", "N/(m·s)", 1e3),
        ("N/mm²", "N/m²", 1e6),
        ("mm per s", "m per s", 1e-3),
        ("mm/A", "m/A", 1e-3),
        ("g·mm²", "kg·m²", 1e-9),
        *(
            (same, same, 1.0)
            for same in ("N/m", "N·s/m", "kg", "µm", "mA", "mH", "Hz", "°C", "%", "", "× noise", "µm/√Hz")
        ),
    ],
)
def test_a_unit_is_converted_by_its_parts(unit, si, factor):
    assert units.shown(unit) == (unit, 1.0)
    units.use("si")
    said, by = units.shown(unit)
    assert said == si
    assert by == pytest.approx(factor)


def test_labels_and_figures_are_converted():
    units.use("si")
    assert units.shown_label("Velocity (mm/s), positive goes in") == ("Velocity (m/s), positive goes in", 1e-3)
    assert units.shown_label("Response (mm/(N·s))") == ("Response (m/(N·s))", 1e-3)
    plain = "Input of the curve (N, or what the input is measured in)"
    assert units.shown_label(plain) == (plain, 1.0)
    assert units.shown_label("Coherence") == ("Coherence", 1.0)
    assert units.shown_si("kg") == ("kg", 1.0)
    assert figure_text("position", 0.0275) == "0.0275"
    assert figure_text("mass", None) == "—"
    assert value_and_rest(Estimate(0.0853, 0.0012), "kg") == ("0.0853", "± 0.0012 kg")
    units.use("clinical")
    assert figure_text("position", 0.0275) == "27.5"
    assert value_and_rest(Estimate(0.0853, 0.0012), "kg") == ("85.3", "± 1.2 g")
    assert value_and_rest(Estimate(1e-9, math.nan), "kg")[1].endswith("g")


@pytest.mark.parametrize("kept", ["", "imperial", None, 7, ["si"]])
def test_what_is_not_known_means_clinical_units(kept):
    units.use("si")
    units.use(kept)
    assert units.in_force() == "clinical"


# -- plots and tables by themselves -----------------------------------------------------------------------------------


def test_a_plot_changes_its_numbers_and_not_its_curve(qtbot):
    card = PlotCard("Position", "Depth (mm)", "mm/N")
    qtbot.addWidget(card)
    line = card.line("measured")
    line.setData(np.array([0.0, 20.0]), np.array([0.0, 4.0]))
    card.plot.setXRange(0.0, 20.0, padding=0.0)
    before = [axis_range[:] for axis_range in card.plot.viewRange()]
    units.use("si")
    card.take_units()
    assert card.heading.text() == "Position (m/N)"
    assert card.plot.accessibleName() == "Plot: Position, m/N"
    assert card.plot.getAxis("bottom").labelText == "Depth (m)"
    assert card.plot.viewRange() == before
    for side in ("left", "bottom"):
        for place, text in ticks_of(card, side):
            assert float(text) == pytest.approx(1e-3 * place, rel=1e-6, abs=1e-12)
    card.retitle("Force", "N")
    assert all(float(text) == pytest.approx(place) for place, text in ticks_of(card, "left"))
    card.relabel("Lag (ms)")
    assert card.plot.getAxis("bottom").labelText == "Lag (ms)"
    assert all(float(text) == pytest.approx(place) for place, text in ticks_of(card, "bottom"))


def test_a_logarithmic_axis_says_si_too(qtbot):
    card = PlotCard("Bode magnitude", "Frequency (Hz)", "mm/N", log_axes=("bottom", "left"))
    qtbot.addWidget(card)
    axis = card.plot.getAxis("left")
    assert axis.tickStrings([0.0, 1.0], axis.scale, 1.0) == ["1", "10"]
    units.use("si")
    card.take_units()
    assert axis.tickStrings([0.0, 1.0], axis.scale, 1.0) == ["0.001", "0.01"]
    frequencies = card.plot.getAxis("bottom")
    assert frequencies.tickStrings([1.0], frequencies.scale, 1.0) == ["10"]


def test_numbers_during_a_test_change_with_the_units(qtbot):
    panel = LiveAnalysis()
    qtbot.addWidget(panel)
    view = seen()
    panel.show_view(view)
    mass = view.parameters["mass"].value
    assert float(panel.numbers["mass"].text.split()[0]) == pytest.approx(1e3 * mass, rel=0.01)
    units.use("si")
    panel.take_units()
    value, *_, unit = panel.numbers["mass"].text.split()
    assert unit == "kg"
    assert float(value) == pytest.approx(mass, rel=0.01)
    assert panel.numbers["stiffness"].text.endswith("N/m")


def test_a_comparison_changes_the_axis_along_which_its_dots_lie(qtbot):
    card = ComparisonCard()
    qtbot.addWidget(card)
    card.resize(900, 200)
    values = {"mass_kg": Estimate(0.08, 0.001)}
    card.show_comparison(SittingComparison(tuple(Sighting(k, "2026-01-01", "left calf", values) for k in "ab")))
    units.use("si")
    for part in card.cards:
        part.take_units()
    (axes,) = card.cards[0].axes
    assert (axes.get_title(loc="left"), axes.get_xlabel()) == ("Mass", "± one SD (kg)")
    dots, _caps, (bars,) = axes.containers[0]
    np.testing.assert_allclose(dots.get_xdata(), 0.08)
    np.testing.assert_allclose(bars.get_segments()[0][:, 0], [0.079, 0.081])
    np.testing.assert_allclose(axes.get_yticks(), [2.0, 1.0])
    assert [label.get_text() for label in axes.get_yticklabels()] == ["2026-01-01  left calf"] * 2
    assert not any(label.get_text() for label in card.cards[1].axes[0].get_yticklabels())


def test_the_mean_of_repeats_is_shown_in_the_units_and_printed_as_always(qtbot, tmp_path, saved):
    sitting = Sitting(TestPlan(url="simulated://forearm", site="calf", out=tmp_path / "s.h5"))
    for number, value in enumerate((0.08, 0.085, 0.09)):
        path = tmp_path / f"{number}.h5"
        sitting.repeats.append(Repeat(path, read_session(saved).test(), "good", {"mass_kg": Estimate(value, 0.001)}))
    card = SittingSummary()
    qtbot.addWidget(card)
    found = standing(sitting, None, None)
    card.show_standing(found)
    assert card.cells["mass_kg"][1].text() == "85.0 ± 5.0 g"
    units.use("si")
    card.take_units()
    assert card.cells["mass_kg"][1].text() == "0.0850 ± 0.0050 kg"
    assert card.accessibleName().count("kg") == 2
    assert found.rows()["mass_kg"][1].endswith(" g")


@pytest.fixture
def loaded(tmp_path):
    rate = 1000.0
    time_s = np.arange(4000) / rate
    track = RecordedSignal(0.014 + 0.002 * np.sin(2.0 * np.pi * 50.0 * time_s), rate)
    return [
        LoadedTest(SelectedTest(tmp_path / "s.h5", 1, "calf", "P-1", "P-1 #1"), 0.0, {Channel("position", "m"): track})
    ]


def test_signals_are_tabled_and_saved_in_the_units(qtbot, loaded, tmp_path):
    table, channels = StatisticsTable(), list(loaded[0].tracks)
    qtbot.addWidget(table)
    table.show_stretch(loaded, channels, 0.0, 4.0)
    assert table.item(0, 1).text() == "14.0 ± 1.4"
    units.use("si")
    table.take_units()
    assert table.horizontalHeaderItem(1).text() == "Position (m)"
    assert table.item(0, 1).text() == "0.0140 ± 0.0014"
    path = write_figure(tmp_path / "figure.svg", SignalFigure(loaded, channels, 0.0, 4.0, channels[0]).draw)
    text = path.read_text(encoding="utf-8")
    assert "Position (m)" in text
    assert "(m²/Hz)" in text


def test_a_spectrum_is_six_decades_lower_in_square_metres(qtbot, loaded):
    card = SpectrumCard()
    qtbot.addWidget(card)
    card.offer(list(loaded[0].tracks))
    card.show_stretch(loaded, 0.0, 4.0)
    card.show()
    before = np.array(card.card.axes[0].get_ylim())
    units.use("si")
    card.take_units()
    (axes,) = card.card.axes
    np.testing.assert_allclose(axes.get_ylim(), 1e-6 * before)
    assert axes.get_ylabel().replace("\n", " ") == "Power spectrum (m²/Hz)"


def test_fitted_figures_of_an_effect_change_with_the_units(qtbot):
    tab = CandidatesTab()
    qtbot.addWidget(tab)
    fitted = (Fitted("Backlash", Estimate(0.0012, 0.0001), "m"), Fitted("Friction", Estimate(0.25, None), "N"))
    tab._rivals = (Rival("Backlash", "mechanics", True, 0.9, "90 %", "95 %", "", "a step", "mend it", fitted),)
    tab.table.fill([(("Backlash", "", "90 %", "90 %"), 0.9, True)])
    tab.table.selectRow(0)
    assert tab.figures.text().splitlines()[1:] == ["Backlash: 1.20 ± 0.10 mm", "Friction: 0.25 N"]
    units.use("si")
    tab.take_units()
    assert tab.figures.text().splitlines()[1:] == ["Backlash: 0.00120 ± 0.00010 m", "Friction: 0.25 N"]


def test_sweeps_are_compared_in_the_units(qtbot):
    panel = SweepsPanel()
    qtbot.addWidget(panel)
    panel.show_sweeps([sweep()])
    assert panel.remarks.text() == "Linear from 4.0 to 27.0 mm."
    units.use("si")
    panel.take_units()
    assert panel.remarks.text() == "Linear from 0.0040 to 0.0270 m."
    rows = [[panel.model.data(panel.model.index(row, column)) for column in (0, 5, 6)] for row in range(3)]
    assert [label_of("linear_region_min_m"), "0.004000 ± 0.000050", "m"] in rows
    older = sweep(date="2026-01-01T10:00:00+00:00")
    panel.show_sweeps([sweep(), older])
    assert panel.remarks.text().startswith("Over 0.0040 to 0.0270 m, where both are linear")


def test_a_figure_of_a_calibration_keeps_small_units_and_loses_large_ones():
    hysteresis, place = CalibratedQuantity(value=3e-5, unit="m"), CalibratedQuantity(value=0.012, std=1e-4, unit="m")
    slope = CalibratedQuantity(value=0.0021, unit="m/A")
    assert figure_of("force_position_m", place)[1:] == ("12.00 ± 0.10", "mm")
    units.use("si")
    assert figure_of("force_position_m", place)[1:] == ("0.01200 ± 0.00010", "m")
    assert figure_of("hysteresis_m", hysteresis)[1:] == ("30", "µm")
    assert figure_of("spring_slope_m_per_a", slope)[1:] == ("0.0021", "m/A")


# -- the window -------------------------------------------------------------------------------------------------------


def choose(window, system):
    choice = window.pages.start.units.choice
    choice.setCurrentIndex(choice.findData(system))


def test_the_choice_is_shown_at_once_on_every_page_and_kept(qtbot, open_window, saved, tmp_path):
    window = open_window(first_page="start", role="researcher")
    chooser = window.pages.start.units.choice
    assert [chooser.itemText(place) for place in range(chooser.count())] == ["Clinical (mm, g)", "SI (m, kg)"]
    assert chooser.currentData() == "clinical"
    window.open_session(saved)
    wait_for_result(qtbot, window)
    ui = window.ui
    tiles = {tile.label.text(): tile for tile in ui.result.tiles}
    grams = float(tiles["Mass"].value.text())
    choose(window, "si")
    assert window.settings.value("units") == "si"
    assert tiles["Mass"].rest.text().endswith(" kg")
    assert float(tiles["Mass"].value.text()) == pytest.approx(1e-3 * grams, rel=1e-3)
    assert "kg" in tiles["Mass"].accessibleName()
    assert ui.signals.position.heading.text() == "Position (m)"
    assert ui.result.bode.accessibleName() == "Plot: Bode magnitude, m/N"
    (axes,), (curve, *_rest) = ui.result.impulse.axes, ui.result.impulse.plots[0].curves
    assert axes.get_ylabel().replace("\n", " ") == "Impulse response (m/(N·s))"
    assert axes.lines[0].get_ydata().max() == pytest.approx(1e-3 * curve.y.max())

    window.pages.show("instrument")  # made only now
    view = next(view for view in window.pages.views if view.name == "instrument")
    qtbot.waitUntil(lambda: not window.jobs, timeout=20_000)
    press(qtbot, view.health.ask)
    qtbot.waitUntil(lambda: not window.jobs and view.health.checkup is not None, timeout=20_000)
    assert view.health.identity.facts["Position limits"].endswith(" m")
    assert view.health.state.facts["Moving mass"].endswith(" kg")
    choose(window, "clinical")
    assert view.health.identity.facts["Position limits"].endswith(" mm")
    assert view.health.state.facts["Moving mass"].endswith(" g")
    assert float(tiles["Mass"].value.text()) == grams

    choose(window, "si")
    window.settings.sync()
    again = QSettings(str(tmp_path / "window.ini"), QSettings.Format.IniFormat)
    assert again.value("units") == "si"
    units.use("clinical")
    other = open_window(first_page="start")
    assert other.pages.start.units.choice.currentData() == "si"
    assert other.ui.signals.position.heading.text() == "Position (m)"
