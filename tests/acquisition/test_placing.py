"""Placing: which way the instrument points, and the same surface whichever way that is."""

import json

import numpy as np
import pytest
from coded import coded, holding
from safety.rigs import last_energised, without_firmware, without_host
from support import LoopbackLink

from firmware_sim.bench import Bench
from firmware_sim.device_models import MODELS
from firmware_sim.firmware import Firmware
from firmware_sim.kernel import POSITION
from firmware_sim.limits import LIFT_S
from firmware_sim.tissue import FREE_AIR
from tissueid.acquisition import GuidedTest, SessionRecorder, run_guided_test, usual_noise
from tissueid.acquisition.quality import quality_of
from tissueid.acquisition.surface_detection import Orientation, Placement, orientation_of, place, place_in_air
from tissueid.errors import FirmwareFaultError, LimitError, UnusableInputError
from tissueid.instrument import CLINICAL, SAMPLE, SerialInstrument, SimulatedInstrument
from tissueid.messages import code_of
from tissueid.test_settings import TestSettings

RATE = 2000.0
GENTLE = usual_noise(RATE, force_min_n=1.5, force_max_n=6.0, seconds=1.0)


def held(tilt_deg, model="desktop", tissue="left-posterior-forearm"):
    figures = MODELS[model]
    bench = Bench(tissue, seed=2, tilt_deg=tilt_deg, parameters=figures.plant, frame_mass_kg=figures.frame_mass_kg)
    link = LoopbackLink(Firmware(bench, seed=2))
    return SerialInstrument(link, clock=link.clock)


@pytest.mark.parametrize("model", ["desktop", "handheld"])
@pytest.mark.parametrize("tilt", [0.0, 45.0, 90.0, 135.0, 180.0])
def test_the_surface_is_found_whichever_way_it_points(tilt, model, tmp_path):
    instrument = held(tilt, model)
    placement = place(instrument)
    assert placement.surface_m == pytest.approx(0.01025, abs=3e-5)
    assert placement.orientation.measured
    assert placement.orientation.tilt_deg == pytest.approx(tilt, abs=1.0)
    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device)
    run_guided_test(instrument, GuidedTest(GENTLE, TestSettings(site="arm")), recorder, surface_m=placement)
    test = recorder.finish().test()
    weight = MODELS[model].plant.moving_mass_kg * 9.80665 * np.cos(np.radians(tilt))
    assert test.notes["net_force_n"] == pytest.approx(np.mean(test.signals["force"][1000:]) + weight, abs=5e-3)
    assert test.notes["tilt_deg"] == pytest.approx(tilt, abs=1.0)
    assert test.notes["gravity_along_stroke_m_s2"] == pytest.approx(9.80665 * np.cos(np.radians(tilt)), abs=0.03)
    assert {finding.code for finding in quality_of(test).findings} <= {"calibration_none"}


def test_a_turn_between_placing_and_test_is_found(tmp_path):
    instrument = held(0.0)
    placement = Placement(place(instrument).surface_m, Orientation(9.0, 3.9, measured=True))
    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device)
    run_guided_test(instrument, GuidedTest(GENTLE, TestSettings(site="arm")), recorder, surface_m=placement)
    quality = quality_of(recorder.finish().test())
    assert quality.verdict == "repeat"
    assert quality.findings[0].code == "orientation_changed"


@pytest.mark.parametrize(
    ("along", "across", "measured", "code"),
    [
        (9.8, 0.1, True, ""),
        (-6.9, 6.9, True, ""),
        (3.0, 2.0, True, ""),
        (14.0, 0.0, False, "placing.implausible"),
        (0.0, 0.0, False, "placing.zero"),
        (np.nan, 0.0, False, "placing.no_acceleration"),
    ],
)
def test_an_implausible_accelerometer_is_not_used(along, across, measured, code):
    found = orientation_of(np.full(400, along), np.full(400, across))
    assert found.measured is measured
    assert code_of(found.why) == code
    if not measured:
        assert found.along_m_s2 == pytest.approx(9.80665)
        assert found.as_notes()["orientation"] == str(found.why)
        assert "gravity_across_stroke_m_s2" not in found.as_notes()
    json.dumps(found.as_notes(), allow_nan=False)


def test_a_third_axis_may_hold_the_rest_of_gravity():
    assert Orientation(0.0, 5.0, measured=True).tilt_deg == pytest.approx(90.0)
    assert Orientation(4.903, 0.0, measured=True).tilt_deg == pytest.approx(60.0, abs=0.1)


def test_an_implausible_accelerometer_leaves_straight_down(tmp_path):
    instrument = SimulatedInstrument()
    poll = instrument.poll

    def broken(timeout_s):
        samples = poll(timeout_s)
        samples["acceleration_x"] = 21.0
        return samples

    instrument.poll = broken
    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device)
    run_guided_test(instrument, GuidedTest(GENTLE, TestSettings(site="arm")), recorder)
    notes = recorder.finish().test().notes
    assert notes["gravity_along_stroke_m_s2"] == pytest.approx(9.80665)
    assert "21.0 m/s²" in notes["orientation"]


# -- the near end of the stroke, where a probe that points upwards rests -------------------------------------------


def upwards(monkeypatch, side):
    """Return a device that points upwards, watched by one side only, the error of that side and a check of it."""
    (without_firmware if side == "host" else without_host)(monkeypatch)
    if side == "host":
        return held(180.0), LimitError, coded("limit.position")
    return held(180.0), FirmwareFaultError, holding("fault.stroke")


each_side = pytest.mark.parametrize("side", ["host", "firmware"])


@each_side
def test_a_probe_that_stays_at_the_near_end_is_released(monkeypatch, side):
    """Half a second it may take to lift off; then the near limit counts, on the host and in the firmware."""
    instrument, error, check = upwards(monkeypatch, side)
    instrument.load(np.full(6000, 1.0))  # 0.25 N: less than its weight
    instrument.arm(CLINICAL)
    run = instrument.start()
    blocks = []
    with pytest.raises(error, check=check):
        blocks.extend(instrument.poll(0.05) for _ in range(400))
    assert not instrument.link.firmware.energised
    assert 0 <= last_energised(np.concatenate(blocks)) - (run.first_index + LIFT_S * RATE) <= 60


@each_side
def test_once_lifted_the_near_limit_counts_at_once(monkeypatch, side):
    instrument, error, check = upwards(monkeypatch, side)
    volts = np.concatenate([np.full(500, 8.0), np.full(3000, -2.0)])  # up, and back before half a second is over
    instrument.load(volts)
    instrument.arm(CLINICAL)
    run = instrument.start()
    blocks = []
    with pytest.raises(error, check=check):
        blocks.extend(instrument.poll(0.05) for _ in range(400))
    assert not instrument.link.firmware.energised
    samples = np.concatenate(blocks)
    lifted = (samples["index"] >= run.first_index) & (samples["position"] > CLINICAL.min_position_m)
    back = lifted.argmax() + (samples["position"][lifted.argmax() :] < CLINICAL.min_position_m).argmax()
    assert last_energised(samples) - samples["index"][back] <= 60


def test_in_free_air_nothing_is_pressed_and_the_probe_is_where_it_lies(tmp_path):
    instrument = held(90.0, tissue=FREE_AIR)
    instrument.link.firmware.bench.plant.state[POSITION] = 0.016
    placement = place_in_air(instrument)
    assert placement.surface_m == pytest.approx(0.016, abs=1e-4)
    assert placement.orientation.tilt_deg == pytest.approx(90.0, abs=1.0)
    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device)
    shaken = usual_noise(RATE, force_min_n=-1.5, force_max_n=1.5, seconds=0.6)
    run_guided_test(
        instrument, GuidedTest(shaken, TestSettings(site="free air"), "free_air"), recorder, surface_m=placement
    )
    test = recorder.finish().test()
    assert (test.kind, test.status) == ("free_air", "completed")
    assert test.surface_position_m == placement.surface_m


def test_in_free_air_it_must_lie_level():
    with pytest.raises(UnusableInputError, check=coded("placing.not_level")):
        place_in_air(held(45.0, tissue=FREE_AIR))


class Reading:
    """An instrument that says where its probe is, or does not."""

    device = SimulatedInstrument().device

    def __init__(self, position_m):
        self.position_m = position_m

    def poll(self, timeout_s):
        samples = np.zeros(400, SAMPLE)
        samples["position"] = self.position_m
        samples["acceleration_y"] = 9.81
        return samples


@pytest.mark.parametrize(
    ("position_m", "code"),
    [(0.0, "placing.at_end_in_air"), (0.0319, "placing.at_end_in_air"), (np.nan, "placing.no_position")],
)
def test_a_probe_at_an_end_in_free_air_is_refused(position_m, code):
    with pytest.raises(UnusableInputError, check=coded(code)):
        place_in_air(Reading(position_m))
