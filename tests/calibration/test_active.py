"""Which calibration is in force: what is used, what is flagged, what is refused, and what it does to a measurement."""

import json
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest
from coded import coded, codes, is_german, message, says
from known_calibrations import DEVICE, NOW, made
from static_rig import ERRORS, TRUTH, rig

from firmware_sim.converters import ChannelError
from tissueid.acquisition.guided import play
from tissueid.calibration import (
    StaticPlan,
    Stored,
    activate_calibration,
    apply_calibrations,
    calibrate_static,
    calibration_folder,
    calibration_summary,
    stored_calibrations,
    write_calibration,
)
from tissueid.calibration.active import NO_REGION, NOT_CALIBRATED, corrections
from tissueid.calibration.status import VARIABLE, status_for_device
from tissueid.errors import InstrumentError, LimitError, UnusableInputError
from tissueid.instrument import Correction, Limits, SimulatedInstrument
from tissueid.messages import Message, code_of

pytestmark = pytest.mark.usefixtures("long_frames")


def test_calibrated_figures_lie_over_the_nominal_ones():
    device = apply_calibrations(DEVICE, [made(), made(5, "sweep")], NOW)
    assert device.coil_resistance_ohm == 12.3
    assert device.force_constant_n_per_a == 2.9
    assert device.moving_mass_kg == 0.066
    assert device.coil_inductance_h == DEVICE.coil_inductance_h
    known = device.calibration
    assert known["state"] == "valid"
    assert known["static_file"] == "static-10.toml"
    assert known["sweep_file"] == "sweep-5.toml"
    assert known["nominal_force_constant_n_per_a"] == 3.0
    assert (known["linear_region_min_m"], known["linear_region_max_m"]) == (0.004, 0.0275)
    assert all(isinstance(value, float | str) for value in known.values())
    assert "warnings" not in known


def test_without_any_the_nominal_figures_stay_and_say_so():
    device = apply_calibrations(DEVICE, [], NOW)
    assert device is DEVICE
    assert corrections(device) == {}


def test_the_newest_that_passed_is_used():
    stored = [made(40), made(20), made(3, verdict="failed", problems=("too noisy",)), made(9, "sweep")]
    device = apply_calibrations(DEVICE, stored, NOW)
    assert device.calibration["static_file"] == "static-20.toml"
    due = NOW + timedelta(days=90 - 20)
    assert device.calibration["valid_until"] == f"{due:%Y-%m-%d}"
    (warning,) = device.calibration_warnings
    assert says(warning, "calibration.about", file="static-3.toml")
    assert says(warning.values["warning"], "calibration.failed_because", problem="too noisy")


@pytest.mark.parametrize(
    ("item", "state", "code"),
    [
        (made(100), "stale", "calibration.stale"),
        (made(serial_number="B-2"), "foreign", "calibration.other_device"),
        (made(model="handheld"), "foreign", "calibration.other_model"),
        (made(verdict="failed"), "failed", "calibration.failed"),
        (made(figures={"force_constant_n_per_a": 3.7}), "implausible", "calibration.implausible.nominal"),
        (made(figures={"coil_resistance_ohm": 0.0}), "implausible", "calibration.implausible.nominal"),
        (made(figures={"current_offset_a": 2.0}), "implausible", "calibration.implausible.bounds"),
        (made(kind="sweep", figures={"linear_region_max_m": 0.09}), "implausible", "calibration.implausible.range"),
        (made(-30), "implausible", "calibration.future"),
        (Stored(Path("x.toml"), None, "x.toml is not a calibration"), "damaged", ""),
        (made(), "valid", ""),
    ],
)
def test_each_has_its_status_and_reason(item, state, code):
    found, reason = status_for_device(item, DEVICE, NOW)
    assert found == state
    assert code_of(reason) == code
    device = apply_calibrations(DEVICE, [item], NOW)
    assert (device.calibration.get("state", "none") != "none") == (state in ("valid", "stale"))
    if state == "stale":
        assert device.calibration["state"] == "stale"
    if state not in ("valid", "foreign") or code == "calibration.other_model":
        assert any(reason in warning for warning in device.calibration_warnings)
        assert all(is_german(warning) for warning in device.calibration_warnings if isinstance(warning, Message))


def test_a_static_calibration_and_a_sweep_that_disagree_are_flagged():
    device = apply_calibrations(DEVICE, [made(), made(5, "sweep", figures={"force_constant_n_per_a": 3.1})], NOW)
    assert device.force_constant_n_per_a == 2.9
    assert says(
        message(device.calibration_warnings, "calibration.disagree"), "calibration.disagree", static=2.9, sweep=3.1
    )


def test_it_is_told_in_a_line():
    instrument = SimulatedInstrument("spring")
    assert activate_calibration(instrument, wanted=False, now=NOW).summary == NOT_CALIBRATED


@pytest.mark.parametrize(
    ("items", "words"),
    [
        ([made(0), made(0, "sweep")], "calibrated today, linear 4.0 to 27.5 mm"),
        (
            [made(0, verdict="failed"), made(0, "sweep", figures={"force_constant_n_per_a": 2.9})],
            "static calibration refused: force by the sweep, sweep of today, linear 4.0 to 27.5 mm",
        ),
        ([made(0, "sweep")], "no static calibration: nominal force, sweep of today, linear 4.0 to 27.5 mm"),
        ([made(0, verdict="failed"), made(9), made(0, "sweep")], "calibrated 9 days ago, linear 4.0 to 27.5 mm"),
        ([made(0, verdict="failed")], "not calibrated: the nominal figures are used"),
    ],
)
def test_the_line_says_what_force_goes_by(items, words):
    found = calibration_summary(apply_calibrations(DEVICE, items, NOW), NOW)
    assert found == words
    assert is_german(found)


def test_the_folder_of_calibrations_does_not_depend_on_the_current_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "home"))
    assert calibration_folder() is None
    (tmp_path / "home" / "tissueid" / "calibration_data").mkdir(parents=True)
    assert calibration_folder() == tmp_path / "home" / "tissueid" / "calibration_data"
    (tmp_path / "calibration_data").mkdir()
    assert calibration_folder() == tmp_path / "home" / "tissueid" / "calibration_data"
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    assert calibration_folder() == tmp_path
    assert calibration_folder(tmp_path / "home") == tmp_path / "home"
    with pytest.raises(UnusableInputError, check=coded("calibration.no_folder", folder=str(tmp_path / "nowhere"))):
        calibration_folder(tmp_path / "nowhere")


def test_a_folder_is_read_newest_first_and_damage_is_kept_as_words(tmp_path):
    for item in (made(20), made(3), made(9, "sweep")):
        write_calibration(tmp_path / item.path, item.calibration)
    (tmp_path / "broken.toml").write_text("no = calibration")
    (tmp_path / "notes.txt").write_text("other")
    found = stored_calibrations(tmp_path)
    assert [item.path.name for item in found] == ["static-3.toml", "sweep-9.toml", "static-20.toml", "broken.toml"]
    assert says(found[-1].problem, "calibration.not_one", path=str(tmp_path / "broken.toml"))


def test_under_a_calibration_force_is_measured_right(tmp_path):
    """Half a percent of the true force, where nominal figures are 4 % off and have a zero of 30 mN."""
    instrument = rig()
    steps = ("electrical", "force", "position", "range")
    found = calibrate_static(instrument, StaticPlan(steps=steps)).calibration
    write_calibration(tmp_path / "a.toml", found)
    in_force = activate_calibration(instrument, tmp_path)
    assert in_force.state == "valid"
    assert says(in_force.summary, "calibration.summary.no_region")
    assert in_force.warnings == (NO_REGION,)
    assert codes(in_force.warnings) == ["calibration.no_region"]

    bench = instrument.link.firmware.bench
    assert instrument.move_stage(0.016)
    volts = np.repeat([0.0, 10.0, 0.0], 1200)
    blocks = []
    play(instrument, volts, Limits(max_force_n=12.0), on_samples=lambda samples, _: blocks.append(samples))
    samples = np.concatenate(blocks)
    late = samples[2000:2400]
    force = late["current"].mean() * instrument.device.force_constant_n_per_a
    true_force = TRUTH.force_constant_n_per_a * 10.0 / TRUTH.resistance_ohm
    assert force == pytest.approx(true_force, rel=0.005)
    true_position = 0.016 + (true_force + bench.parameters.gravity_force_n) / 1000.0
    assert late["position"].mean() == pytest.approx(true_position, abs=15e-6)
    assert samples[3000:]["current"].mean() == pytest.approx(0.0, abs=2e-3)


def test_a_calibration_never_loosens_a_limit():
    """With a force constant that is too small, 12.6 N by the nominal figures would count as 10.5 N."""
    instrument = rig(errors={})
    weak = replace(instrument.nominal, force_constant_n_per_a=2.5)
    instrument.use_calibration(weak, {})
    instrument.load(np.concatenate([np.linspace(0, 50.0 * 12.0 / 12.5, 400), np.full(100, 48.0)]))
    with pytest.raises(
        LimitError, check=coded("limit.stimulus_force", force=pytest.approx(12.0, abs=0.05), limit=11.0)
    ):
        instrument.arm(Limits(max_force_n=11.0))
    strong = replace(instrument.nominal, force_constant_n_per_a=3.5)
    instrument.use_calibration(strong, {})
    with pytest.raises(
        LimitError, check=coded("limit.stimulus_force", force=pytest.approx(14.0, abs=0.05), limit=13.0)
    ):
        instrument.arm(Limits(max_force_n=13.0))


def test_a_correction_that_is_none_is_refused():
    instrument = SimulatedInstrument("spring")
    with pytest.raises(InstrumentError, check=coded("calibration.implausible_correction", gain=0.0)):
        Correction(gain=0.0)
    with pytest.raises(InstrumentError, check=coded("calibration.unknown_channel", name="command")):
        instrument.use_calibration(instrument.nominal, {"command": Correction(offset=1.0)})


def test_it_is_not_changed_while_a_test_runs():
    instrument = SimulatedInstrument("spring")
    instrument.load(np.zeros(100))
    instrument.arm(Limits())
    with pytest.raises(InstrumentError, check=coded("instrument.calibration_in_test")):
        instrument.use_calibration(instrument.nominal, {})


def test_calibrating_starts_from_the_nominal_figures():
    instrument = rig(errors={"current": ChannelError(0.0, 0.05)} | {k: v for k, v in ERRORS.items() if k == "voltage"})
    instrument.use_calibration(replace(instrument.nominal, coil_resistance_ohm=10.0), {"current": Correction(1.0, 0.2)})
    found = calibrate_static(instrument, StaticPlan(steps=("electrical",))).calibration
    assert found.quantities["current_offset_a"].value == pytest.approx(0.05, abs=2e-3)
    assert instrument.device == instrument.nominal


@pytest.mark.parametrize("date", ["no date", "2026-13-01", "0001-01-01T00:00:00+14:00", ""])
def test_a_date_that_is_none_does_without_an_age(date):
    device = replace(DEVICE, calibration={"state": "valid", "static_date": date})
    assert calibration_summary(device, NOW)
    assert " days ago" not in calibration_summary(device, NOW) or date.startswith("0001")


def test_warnings_keep_their_codes_in_a_session(tmp_path):
    device = apply_calibrations(DEVICE, [made(100)], NOW)
    stored = replace(device, calibration=json.loads(json.dumps(device.calibration)))
    assert stored.calibration_warnings == device.calibration_warnings
    assert codes(stored.calibration_warnings) == ["calibration.about", "calibration.no_region"]
    assert says(stored.calibration_warnings[0].values["warning"], "calibration.stale", valid_days=90)


@pytest.mark.parametrize("hostile", ["no JSON", "3", '[{"code": 1}]', "[[]]", '{"a": 1}'])
def test_damaged_or_old_warnings_are_texts(hostile):
    for stored in ({"warnings": "a; b"}, {"warnings": "a; b", "warning_messages": hostile}):
        assert replace(DEVICE, calibration=stored).calibration_warnings == ("a", "b")
