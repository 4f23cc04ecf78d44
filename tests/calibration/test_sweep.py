"""The sweep on the simulated instrument: unattended with its stage, with a person without, and what ends it."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from coded import coded, holding, says
from support import connect_scenario

from firmware_sim.coil import profile_values
from firmware_sim.scenario import Scenario
from tissueid.acquisition import SessionRecorder
from tissueid.calibration import apply_calibrations, read_calibration, write_calibration
from tissueid.calibration import sweep as procedure
from tissueid.calibration.plans import SweepPlan
from tissueid.calibration.status import Stored
from tissueid.calibration.sweep import Sweep, sweep_tests, wait_for_position
from tissueid.calibration.sweep_analysis import analyse_sweep, as_calibration
from tissueid.errors import CancelledError, FirmwareFaultError, UnusableInputError
from tissueid.instrument import SimulatedInstrument
from tissueid.messages import Quantity
from tissueid.sessions import read_session

SPRING = Scenario(preset="calibration-spring", coil="finite", seed=3)
TRUE = SPRING.model_copy(
    update={
        "truth": SPRING.truth.model_copy(
            update={
                "resistance_ohm": 12.31,
                "inductance_h": 1.1e-3,
                "force_constant_n_per_a": 2.93,
                "moving_mass_kg": 0.0625,
            }
        )
    }
)
pytestmark = pytest.mark.usefixtures("long_frames")

SHORT = SweepPlan(from_m=0.014, to_m=0.018, step_m=4e-3, seconds=1.0)


class Rehearsed:
    """A sweep on a simulated instrument, its session in a folder."""

    def __init__(self, folder: Path, plan: SweepPlan, scenario: Scenario = SPRING, **options: object) -> None:
        self.instrument = connect_scenario(scenario)
        self.bench = self.instrument.link.firmware.bench
        self.path = folder / "sweep.h5"
        self.recorder = SessionRecorder(self.path, self.instrument.device)
        self.sweep = Sweep(self.instrument, plan, self.recorder, **options)

    def tests(self):
        self.sweep.run()
        return sweep_tests(self.recorder.finish())


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """A whole sweep of a device that is not what it says of itself."""
    plan = SweepPlan(from_m=0.0013, to_m=0.0313, step_m=3e-3, seconds=1.0)
    rehearsed = Rehearsed(tmp_path_factory.mktemp("sweep"), plan, TRUE)
    rehearsed.result = analyse_sweep(rehearsed.tests(), rehearsed.instrument.device, remarks=rehearsed.sweep.remarks)
    return rehearsed


def test_it_recovers_the_coils_own_profile_within_3_percent_and_its_region_within_1_mm(swept):
    result, coil = swept.result, swept.bench.plant.coil
    places = np.linspace(result.positions_m[0], result.positions_m[-1], 300)
    assert np.abs(result.force_constant.at(places) / (2.93 * coil.along(places)) - 1.0).max() < 0.03
    truth = profile_values(coil, 2.93, 0.032)
    assert result.region.min_m.value == pytest.approx(truth["linear_region_min_m"], abs=1e-3)
    assert result.region.max_m.value == pytest.approx(truth["linear_region_max_m"], abs=1e-3)
    assert result.region.plateau_n_per_a.value == pytest.approx(truth["plateau_n_per_a"], rel=0.015)
    assert result.passed


def test_it_finds_what_the_device_really_is(swept):
    result = swept.result
    assert result.flux.resistance_ohm[5].value == pytest.approx(12.31, rel=0.005)
    assert result.flux.inductance_h.value == pytest.approx(1.1e-3, rel=0.1)
    assert result.moving_mass_kg.value == pytest.approx(0.0625, rel=0.03)
    assert result.bearing_damping_n_s_per_m.value == pytest.approx(3.6, rel=0.03)
    assert result.agreement.cause is None
    assert result.agreement.stage.value == pytest.approx(1.0, abs=0.01)


def test_no_swing_came_to_an_end_and_positions_without_room_are_said(swept):
    assert all(0.3e-3 < point.peak_to_peak_m < 7e-3 for point in swept.result.points)
    (remark,) = swept.result.remarks
    assert says(remark, "sweep.left_out")
    assert str(remark.values["position"]) == "31.3 mm"
    assert swept.result.points[0].position_m == pytest.approx(1.3e-3, abs=0.4e-3)
    assert swept.result.points[0].peak_to_peak_m < 1.1e-3


def test_everything_recorded_is_kept_as_spring_tests(swept):
    session = read_session(swept.path)
    assert {test.kind for test in session.tests} == {"spring"}
    assert {test.status for test in session.tests} == {"completed"}


def test_the_calibration_survives_its_file_and_comes_in_force(swept, tmp_path):
    device = swept.instrument.nominal
    made = as_calibration(swept.result, conditions={"by": "motorised stage"}, now=datetime(2026, 3, 1, tzinfo=UTC))
    path = tmp_path / "sweep.toml"
    write_calibration(path, made)
    assert read_calibration(path) == made
    assert {"sweep", "force_constant", "response"} <= set(made.tables)
    known = apply_calibrations(device, [Stored(path, made, "")], datetime(2026, 3, 2, tzinfo=UTC))
    assert known.force_constant_n_per_a == pytest.approx(2.93, rel=0.015)
    assert known.moving_mass_kg == pytest.approx(0.0625, rel=0.03)
    assert known.calibration["linear_region_min_m"] == pytest.approx(4.2e-3, abs=1e-3)
    assert known.calibration["sweep_date"] == "2026-03-01T00:00:00Z"


def test_an_end_that_is_hit_is_tried_again_at_half_and_then_left_out(tmp_path, monkeypatch):
    asked = []

    def too_strong(answer, stimulus, room_m, device, limits):
        asked.append(room_m)
        return 44.0 if len(asked) == 1 else 4.0

    monkeypatch.setattr(procedure, "noise_amplitude", too_strong)
    rehearsed = Rehearsed(tmp_path, SHORT.model_copy(update=dict(from_m=0.0015, to_m=0.0055)))
    tests = rehearsed.tests()
    assert [test.mean_position_m for test in tests] == pytest.approx([0.0055], abs=3e-4)
    (remark,) = rehearsed.sweep.remarks
    assert says(remark, "sweep.left_out", position=Quantity(1.5, "mm", 1))
    assert remark.values["reason"].code == "sweep.end_twice"
    statuses = [test.status for test in read_session(rehearsed.path).tests]
    assert statuses == ["aborted", "aborted", "completed"]


def test_without_stage_and_person_it_refuses_before_anything_moves(tmp_path):
    rehearsed = Rehearsed(tmp_path, SHORT, SPRING.model_copy(update={"stage": False}))
    with pytest.raises(UnusableInputError, check=coded("sweep.no_person")):
        rehearsed.sweep.run()
    assert rehearsed.recorder.tests_begun == 0


def test_a_person_moves_the_spring_where_there_is_no_stage(tmp_path):
    asked = []

    def bring(place_m):
        asked.append(place_m)
        rehearsed.bench.place_fixture(place_m - 0.3e-3)

    rehearsed = Rehearsed(tmp_path, SHORT, SPRING.model_copy(update={"stage": False}), bring=bring)
    tests = rehearsed.tests()
    assert asked == [0.014, pytest.approx(0.018)]
    assert [test.mean_position_m for test in tests] == pytest.approx([0.0143, 0.0183], abs=2e-4)
    assert all(np.isnan(test.stage_m) for test in tests)
    assert not rehearsed.sweep.has_stage


def test_a_person_is_waited_for_until_the_probe_stands_still_at_the_place(tmp_path):
    instrument = connect_scenario(SPRING)
    link, said = instrument.link, []

    def tell(standing):
        said.append(standing.in_place)
        link.firmware.bench.place_fixture(0.012 if link.now < 2.0 else 0.0155)

    wait_for_position(instrument, 0.016, tell)
    assert link.now > 2.9
    assert said[0] is False
    assert said[-1] is True


def test_a_person_may_give_up(tmp_path):
    instrument = connect_scenario(SPRING)
    with pytest.raises(CancelledError, check=coded("cancelled.coil_free")):
        wait_for_position(instrument, 0.030, cancelled=lambda: instrument.link.now > 1.0)


def test_a_cancelled_sweep_keeps_what_was_measured(tmp_path):
    done = []
    rehearsed = Rehearsed(tmp_path, SHORT, progress=done.append, cancelled=lambda: bool(done) and done[-1] > 0.7)
    with pytest.raises(CancelledError):
        rehearsed.sweep.run()
    session = rehearsed.recorder.finish_or_discard()
    assert [test.status for test in session.tests] == ["completed", "aborted"]
    assert len(sweep_tests(session)) == 1


def test_the_stop_button_is_not_taken_for_an_end_of_the_stroke(tmp_path):
    done = []

    def press(fraction):
        done.append(fraction)
        if fraction > 0.3:
            rehearsed.bench.button = True

    rehearsed = Rehearsed(tmp_path, SHORT, progress=press)
    with pytest.raises(FirmwareFaultError, check=holding("fault.button")):
        rehearsed.sweep.run()
    assert rehearsed.sweep.remarks == []


def test_a_repeat_goes_the_other_way(tmp_path):
    tests = Rehearsed(tmp_path, SHORT.model_copy(update=dict(repeats=2))).tests()
    assert [test.sweep for test in tests] == [0, 0, 1, 1]
    places = [test.mean_position_m for test in tests]
    assert places == pytest.approx([0.014, 0.018, 0.018, 0.014], abs=1e-3)


def test_a_spring_that_only_pushes_is_refused(tmp_path):
    instrument = SimulatedInstrument("spring")  # nothing holds the probe to it
    recorder = SessionRecorder(tmp_path / "sweep.h5", instrument.device)
    Sweep(instrument, SweepPlan(from_m=0.008, to_m=0.024, step_m=4e-3, seconds=1.0), recorder).run()
    with pytest.raises(UnusableInputError, check=coded("sweep.nonlinear")):
        analyse_sweep(sweep_tests(recorder.finish()), instrument.device)


@pytest.mark.parametrize(
    ("options", "code"),
    [
        ({"from_m": 0.02, "to_m": 0.01}, "sweep.range"),
        ({"step_m": 1e-4}, "sweep.step"),
        ({"to_m": 0.1, "step_m": 0.5e-3, "from_m": 0.0}, None),
        ({"seconds": 0.1}, "sweep.seconds"),
        ({"repeats": 0}, "option.refused"),
        ({"swing_m": 0.02}, "sweep.swing"),
    ],
)
def test_an_impossible_sweep_is_refused(options, code):
    if code is None:
        assert len(SweepPlan(**options).positions_m) == 201
        return
    with pytest.raises(UnusableInputError, check=coded(code)):
        SweepPlan(**options)


def test_positions_are_those_that_were_asked_for():
    assert SweepPlan().positions_m == pytest.approx(1e-3 * np.arange(2, 31, 2))
    assert SweepPlan(from_m=0.001, to_m=0.0085, step_m=2e-3).positions_m == pytest.approx([1e-3, 3e-3, 5e-3, 7e-3])
