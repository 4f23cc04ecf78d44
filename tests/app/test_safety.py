"""What the window tells of safety: read-outs, the linear region, the calibration in force, and the quality gate."""

import dataclasses
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from app.benches import WAIT_MS, Gate, found
from app.test_window import idle, only_session, press, type_site, wait_for_result
from coded import reads
from hypothesis import given
from hypothesis import strategies as st
from PySide6.QtCore import Qt

from tissueid.acquisition.quality import Quality, QualityFinding
from tissueid.app.live_signals import LinearRange, Safety, SafetyWatch, linear_region
from tissueid.app.quality_gate import MOST_SHOWN, UNJUDGED, QualityGatePanel
from tissueid.app.readouts import KEYS_LOST, KEYS_REACH, SafetyReadouts
from tissueid.app.signals import LINEAR, OUTSIDE
from tissueid.app.words import UNKNOWN, calibration_state
from tissueid.calibration import CalibratedQuantity, Calibration, write_calibration
from tissueid.device import DeviceDescription
from tissueid.instrument import CLINICAL, SAMPLE, SimulatedInstrument
from tissueid.instrument.thermal import WindingTemperature
from tissueid.sessions import read_session, write_session
from tissueid.sessions.quality import HEADLINES

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]

DEVICE = DeviceDescription(calibration={"linear_region_min_m": 0.004, "linear_region_max_m": 0.0275})


def samples(count, **signals):
    block = np.zeros(count, SAMPLE)
    block["position"] = 0.012
    block["temperature"] = 25.0
    for name, values in signals.items():
        block[name] = values
    return block


# -- what is followed -----------------------------------------------------------------------------------------


def test_force_and_temperature_are_those_of_the_newest_quarter_of_a_second():
    watch = SafetyWatch(DEVICE, CLINICAL)
    assert watch.snapshot() == Safety(CLINICAL, region=LinearRange(0.004, 0.0275))
    watch.take(samples(500, current=3.0))
    watch.take(samples(400, current=-1.0, temperature=40.0))
    assert watch.snapshot().force_n == pytest.approx(9.0)
    watch.take(samples(100, current=np.nan, position=np.nan, temperature=np.nan))
    now = watch.snapshot()
    assert now.force_n == pytest.approx(3.0)
    assert now.temperature_c == 40.0
    assert not now.left_region


def test_the_coil_warms_by_calculation_whatever_its_sensor_says():
    watch, without = SafetyWatch(DEVICE, CLINICAL), SafetyWatch(DEVICE, CLINICAL, winding=False)
    for _ in range(60):
        for one in (watch, without):
            one.take(samples(2000, current=3.0))
    now = watch.snapshot()
    assert now.temperature_c == 25.0
    assert now.model_c > 100.0
    assert without.snapshot().model_c is None


@pytest.mark.parametrize("resistance_ohm", [10.8, 12.0, 13.9])
def test_the_temperature_by_calculation_does_not_hang_on_how_warm_the_coil_was_when_it_was_calibrated(resistance_ohm):
    """The judge of the host goes by the nominal resistance; what the window shows is the same."""
    watch = SafetyWatch(dataclasses.replace(DEVICE, coil_resistance_ohm=resistance_ohm), CLINICAL)
    judged_by = WindingTemperature(DeviceDescription())
    for _ in range(60):
        block = samples(2000, current=2.0)
        watch.take(block)
        judged_by.take(block["current"], block["temperature"], 0.0)
    assert watch.snapshot().model_c == pytest.approx(judged_by.temperature_c, abs=1e-6)
    assert judged_by.temperature_c > 60.0


def test_contact_is_known_once_the_surface_is():
    watch = SafetyWatch(DEVICE, CLINICAL)
    watch.take(samples(100))
    assert watch.snapshot().contact is None
    watch.surface_m = 0.010
    assert watch.snapshot().contact is True
    watch.take(samples(100, position=0.0095))
    assert watch.snapshot().contact is False
    watch.take(samples(500, position=0.0098))
    assert watch.snapshot().contact is True


@given(st.floats(0.0, 0.032), st.floats(0.0, 0.032))
def test_the_linear_region_is_left_for_the_rest_of_the_test(first, second):
    watch = SafetyWatch(DEVICE, CLINICAL)
    outside = False
    for position in (first, second, 0.012):
        watch.take(samples(20, position=position))
        outside = outside or not 0.004 <= position <= 0.0275
        assert watch.snapshot().left_region is outside


@pytest.mark.parametrize(
    "calibration",
    [
        {},
        {"linear_region_min_m": 0.004},
        {"linear_region_min_m": 0.02, "linear_region_max_m": 0.01},
        {"linear_region_min_m": "a", "linear_region_max_m": 0.01},
        {"linear_region_min_m": float("nan"), "linear_region_max_m": 0.01},
    ],
)
def test_without_a_region_nothing_is_outside(calibration):
    device = dataclasses.replace(DEVICE, calibration=calibration)
    assert linear_region(device) is None
    watch = SafetyWatch(device, CLINICAL)
    watch.take(samples(10, position=0.03))
    assert not watch.snapshot().left_region


# -- what is read ---------------------------------------------------------------------------------------------


@pytest.fixture
def readouts(qtbot):
    widget = SafetyReadouts()
    qtbot.addWidget(widget)
    return widget


@pytest.mark.parametrize(
    ("changes", "force", "coil", "contact", "levels"),
    [
        ({}, "—", "temperature not known", "finding the skin", ("", "check", "")),
        (
            {"force_n": 5.04, "temperature_c": 31.2, "model_c": 32.8, "contact": True},
            "5.0 N of 12 N",
            "31 °C, model 33 °C of 80 °C",
            "on the skin",
            ("", "", ""),
        ),
        (
            {"force_n": 11.0, "temperature_c": 31.2, "model_c": 66.0, "contact": False, "left_region": True},
            "11.0 N of 12 N",
            "31 °C, model 66 °C of 80 °C",
            "off the skin · outside linear region",
            ("check", "check", "check"),
        ),
    ],
)
def test_read_outs_are_quiet_until_something_comes_near_its_limit(readouts, changes, force, coil, contact, levels):
    readouts.expect()
    readouts.show_safety(Safety(CLINICAL, **changes))
    labels = (readouts.force, readouts.coil, readouts.contact)
    assert tuple(label.text() for label in labels) == (force, coil, contact)
    assert tuple(label.property("level") or "" for label in labels) == levels
    readouts.clear()
    assert [label.text() for label in labels] == ["—"] * 3
    assert reads(readouts.keys.text(), "stop.no_test")


def test_numbers_change_four_times_a_second_and_contact_at_once(readouts):
    readouts.expect()
    seen = []
    for number in range(30):
        readouts.show_safety(Safety(CLINICAL, force_n=float(number), contact=number < 3))
        seen.append((readouts.force.text(), readouts.contact.text()))
    assert len({force for force, _ in seen}) == 4
    assert seen[3][1] == "off the skin"


def test_it_is_said_when_the_keys_do_not_reach_the_window(readouts):
    readouts.expect()
    assert readouts.keys.text() == KEYS_REACH
    readouts.show_key_reach(reach=False)
    assert readouts.keys.text() == KEYS_LOST
    assert readouts.keys.property("level") == "check"
    readouts.show_key_reach(reach=True)
    assert readouts.keys.property("level") == ""


# -- the calibration in force ---------------------------------------------------------------------------------


def put(folder, *, days=12, verdict="passed", low_m=0.004, high_m=0.0275, serial_number="TWIN-3"):
    """A static calibration and a sweep of the simulation in this process, made some days ago."""
    made = (datetime.now(UTC) - timedelta(days=days)).strftime("%Y-%m-%dT%H:%M:%SZ")
    about = {
        "model": "desktop indenter (in-process simulation)",
        "serial_number": serial_number,
        "date": made,
        "software": "test",
        "verdict": verdict,
        "problems": ("too much scatter",) if verdict == "failed" else (),
    }
    resistance = {"coil_resistance_ohm": CalibratedQuantity(value=12.0, unit="ohm")}
    region = {
        "linear_region_min_m": CalibratedQuantity(value=low_m, unit="m"),
        "linear_region_max_m": CalibratedQuantity(value=high_m, unit="m"),
    }
    write_calibration(folder / "static.toml", Calibration(kind="static", quantities=resistance, **about))
    write_calibration(folder / "sweep.toml", Calibration(kind="sweep", quantities=region, **about))


@pytest.mark.parametrize(
    ("changes", "words", "level"),
    [
        ({}, "Calibrated 12 days ago, linear 4.0 to 27.5 mm", "good"),
        ({"days": 0}, "Calibrated today, linear 4.0 to 27.5 mm", "good"),
        ({"days": 200}, "Calibration is stale: calibrated 200 days ago, linear 4.0 to 27.5 mm", "check"),
        ({"verdict": "failed"}, "Not calibrated: the nominal figures are used", "check"),
        ({"serial_number": "OTHER"}, "Not calibrated: the nominal figures are used", "check"),
    ],
)
def test_the_state_of_the_calibration_stands_beside_the_instrument(
    qtbot, open_window, calibrations, changes, words, level
):
    def finder(*, probe, opener=None):
        if probe:
            opener("simulated://forearm").close()
        return found(probe=probe)

    put(calibrations, **changes)
    window = open_window(finder=finder)
    chooser = window.ui.form.instrument
    assert chooser.calibration.text() == UNKNOWN
    press(qtbot, chooser.refresh)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert (chooser.calibration.text(), chooser.calibration.property("level")) == (words, level)
    if changes.get("verdict") == "failed":
        assert "too much scatter" in chooser.calibration.toolTip()
    chooser.choice.setEditText("/dev/ttyACM7")
    assert chooser.calibration.text() == UNKNOWN


def test_no_calibration_in_words():
    state = calibration_state(DeviceDescription())
    assert (reads(state.summary, "calibration.none"), state.level) == (True, "check")


def test_a_test_that_leaves_the_linear_region_is_flagged_while_it_runs_and_afterwards(
    qtbot, open_window, calibrations, tmp_path
):
    put(calibrations, high_m=0.012)
    gate = Gate(passed=300)
    window = open_window(wait=gate.wait)
    signals = window.ui.signals
    type_site(qtbot, window)
    press(qtbot, window.ui.start)
    qtbot.waitUntil(gate.reached.is_set, timeout=WAIT_MS)
    qtbot.waitUntil(lambda: OUTSIDE in signals.position.legend.text(), timeout=WAIT_MS)
    assert [float(edge.getData()[1][0]) for edge in signals.region_edges] == [4.0, 12.0]
    assert "outside linear region" in window.ui.safety.contact.text()
    assert "on the skin" in window.ui.safety.contact.text()
    assert window.ui.form.instrument.calibration.text().startswith("Calibrated 12 days ago")
    gate.opened.set()
    wait_for_result(qtbot, window)
    assert OUTSIDE in signals.position.legend.text()
    assert any("4.0 to 12.0 mm" in words for words in window.ui.gate.texts)
    assert only_session(tmp_path)[1].instrument.calibration["linear_region_max_m"] == 0.012


def test_a_test_inside_the_region_is_shaded_and_not_flagged(qtbot, open_window, calibrations):
    put(calibrations)
    window = open_window()
    type_site(qtbot, window)
    press(qtbot, window.ui.start)
    wait_for_result(qtbot, window)
    assert LINEAR in window.ui.signals.position.legend.text()
    assert window.ui.gate.headline.text() == "Good test"


# -- the quality gate -----------------------------------------------------------------------------------------

LIFTED = QualityFinding("probe_lifted", "repeat", "The probe left the skin.", "Raise the lowest force.", 0.12)
SETTLING = QualityFinding("unsettled", "look", "The tissue was still settling.", "Leave the first test out.")
WARM = QualityFinding("coil_warm", "note", "The coil was at 52 °C.", "Let it cool.", 52.0)


@pytest.fixture
def gate(qtbot):
    widget = QualityGatePanel()
    qtbot.addWidget(widget)
    return widget


@pytest.mark.parametrize(
    ("findings", "headline", "level", "again"),
    [
        ((), "Good test", "good", False),
        ((WARM,), "Good test", "good", False),
        ((SETTLING, WARM), HEADLINES["look"], "check", False),
        ((LIFTED, SETTLING, WARM), HEADLINES["repeat"], "poor", True),
    ],
)
def test_the_light_the_words_and_the_offer(gate, findings, headline, level, again):
    gate.show_quality(Quality(findings), can_repeat=True)
    assert (gate.headline.text(), gate.light.property("level")) == (headline, level)
    assert gate.run_again.isVisibleTo(gate) is again
    assert gate.texts == tuple(f"{finding.message} {finding.advice}" for finding in findings)
    for line in gate.texts:
        assert line in gate.accessibleName()
    gate.show_quality(Quality(findings), can_repeat=False)
    assert not gate.run_again.isVisibleTo(gate)


def test_many_findings_are_unfolded_when_asked_for(qtbot, gate):
    findings = tuple(dataclasses.replace(WARM, message=f"Number {number}.") for number in range(7))
    gate.show_quality(Quality(findings), can_repeat=True)
    gate.show()
    assert gate.grid.count() == 2 * MOST_SHOWN
    assert gate.more.text() == "4 more"
    press(qtbot, gate.more)
    assert gate.grid.count() == 14
    press(qtbot, gate.more)
    assert gate.grid.count() == 2 * MOST_SHOWN


def test_a_test_that_was_never_judged_says_so(gate):
    gate.show_quality(None, can_repeat=True)
    assert gate.headline.text() == "Not judged"
    assert gate.texts == (UNJUDGED,)
    assert not gate.run_again.isVisibleTo(gate)


def test_a_reopened_session_shows_what_the_gate_said(qtbot, window, tmp_path, saved):
    session = read_session(saved)
    notes = session.tests[0].notes | Quality((SETTLING,)).as_notes()
    path = tmp_path / "again.h5"
    write_session(path, dataclasses.replace(session, tests=(dataclasses.replace(session.tests[0], notes=notes),)))
    window.open_session(path)
    wait_for_result(qtbot, window)
    assert window.ui.gate.isVisible()
    assert window.ui.gate.headline.text() == HEADLINES["look"]
    assert SETTLING.message not in window.ui.result.reasons.text()
    window.open_session(saved)
    qtbot.waitUntil(lambda: idle(window) and window.findings.path == saved, timeout=WAIT_MS)
    assert window.ui.gate.headline.text() != HEADLINES["look"]


def test_run_again_runs_the_same_test_into_another_file(qtbot, open_window, tmp_path):
    window = open_window()
    type_site(qtbot, window)
    # At -9 N the probe leaves the skin: the gate asks for another test.
    window.ui.form.options["min_force_n"].controls[0].setMinimum(-9.0)
    window.ui.form.fill({"min_force_n": -9.0})
    window.ui.form.fill({"seconds": 1.5})
    press(qtbot, window.ui.start)
    wait_for_result(qtbot, window)
    assert window.ui.gate.headline.text() == HEADLINES["repeat"]
    assert "probe_lifted" in {finding.code for finding in window.findings.quality.findings}
    press(qtbot, window.ui.gate.run_again)
    assert window.testing
    assert not window.ui.gate.isVisible()
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert len(list(tmp_path.glob("*.h5"))) == 2


# -- configuration and probe ----------------------------------------------------------------------------------


def test_only_what_goes_together_can_be_chosen_and_it_is_stored(qtbot, open_window, tmp_path):
    window = open_window(opener=lambda _: SimulatedInstrument("spring", seed=3))
    form = window.ui.form.set_up
    assert form.probe.count() == 3
    spring = form.settings["external_spring_n_per_m"]
    assert not spring.isVisible()
    form.choose(configuration="surface")
    assert [form.probe.itemText(row) for row in range(form.probe.count())] == ["slider-5x16mm"]
    assert spring.isVisible()
    assert spring.value() == 200.0
    spring.set_value(350.0)
    window.ui.form.fill({"seconds": 1.0})
    type_site(qtbot, window)
    press(qtbot, window.ui.start)
    assert window.ui.signals.position.heading.text() == "Displacement (mm)"
    wait_for_result(qtbot, window)
    test = only_session(tmp_path)[1].test()
    assert test.configuration == "surface"
    assert test.notes["external_spring_n_per_m"] == 350.0
    assert test.notes["probe_name"] == "slider-5x16mm"
    assert window.ui.signals.level.isVisible()
    assert not window.ui.signals.surface.isVisible()
    form.choose(configuration="indentation")
    assert form.values()["external_spring_n_per_m"] == 0.0


def test_the_form_says_how_the_probe_meets_the_tissue(window):
    form, lowest = window.ui.form.set_up, window.ui.form.options["min_force_n"].controls[0]
    assert form.values()["coupling"] == "none"
    # An attached probe can pull; one that is not is lifted off for a moment, within the same limits.
    assert lowest.minimum() == -window.ui.form.options["max_force_n"].controls[0].maximum()
    form.choose(coupling="adhesive")
    assert lowest.minimum() == -window.ui.form.options["max_force_n"].controls[0].maximum()
    form.settings["configuration"].controls[0].setCurrentIndex(1)
    for name, value in (("orientation_deg", 90.0), ("initial_length_m", 0.012)):
        form.settings[name].set_value(value)
    chosen = form.values()
    assert (chosen["coupling"], chosen["orientation_deg"]) == ("adhesive", 90.0)
    assert chosen["initial_length_m"] == pytest.approx(0.012)
    form.settings["configuration"].controls[0].setCurrentIndex(2)
    form.settings["normal_preload_n"].set_value(1.0)
    chosen = form.values()
    assert (chosen["coupling"], chosen["orientation_deg"], chosen["initial_length_m"]) == ("none", None, None)
    assert chosen["normal_preload_n"] == 1.0
    form.settings["normal_preload_n"].set_value(None)
    assert form.values()["normal_preload_n"] is None


def test_the_keys_reach_the_form_by_mnemonics(qtbot, open_window):
    window = open_window(role="researcher")
    form = window.ui.form.set_up
    qtbot.keyClick(window, Qt.Key.Key_P, Qt.KeyboardModifier.AltModifier)
    assert form.probe.hasFocus()
