"""Static calibration against instruments whose truth is known and differs from what they say of themselves."""

import numpy as np
import pytest
from coded import coded, codes, holding, message
from static_rig import ERRORS, EXPECTED, MASS_KG, TRUTH, Person, rig
from support import connect

from firmware_sim.converters import ChannelError
from firmware_sim.plant import STANDARD_GRAVITY, PlantParameters
from tissueid.calibration import StaticPlan, calibrate_static, read_calibration, write_calibration
from tissueid.calibration.file import CalibratedQuantity, CalibrationFindings, mean_of_repeats
from tissueid.calibration.plans import Spring
from tissueid.calibration.sensors import mains, position_findings
from tissueid.calibration.static_procedure import PUSH_ONLY
from tissueid.calibration.status import problems_of
from tissueid.calibration.step_levels import straight_line
from tissueid.errors import CancelledError, FirmwareFaultError, LimitError, UnusableInputError
from tissueid.instrument import SimulatedInstrument
from tissueid.records import Estimate

pytestmark = pytest.mark.usefixtures("long_frames")

QUICK = ("electrical", "force")


@pytest.fixture(scope="module")
def found():
    """Everything, on a device with a stage and a finite coil."""
    instrument = rig(coil="finite")
    return calibrate_static(instrument, StaticPlan(ambient_c=21.0)).calibration


def values(calibration):
    return {name: quantity.value for name, quantity in calibration.quantities.items()}


def test_it_finds_the_truth_within_half_a_percent(found):
    assert found.verdict == "passed"
    assert found.problems == ()
    for name, truth in EXPECTED.items():
        quantity = found.quantities[name]
        assert quantity.value == pytest.approx(truth, rel=0.005)
        assert abs(quantity.value - truth) < 4.5 * quantity.std
    figures = values(found)
    assert figures["current_offset_a"] == pytest.approx(0.010, abs=1e-3)
    assert figures["voltage_offset_v"] == pytest.approx(0.020, abs=5e-4)
    assert figures["temperature_offset_c"] == pytest.approx(1.5, abs=0.02)


def test_the_ends_of_the_stroke_and_the_weight_are_found_by_moving_gently(found):
    figures = values(found)
    assert figures["stroke_min_m"] == pytest.approx(0.0, abs=20e-6)
    assert figures["stroke_max_m"] == pytest.approx(0.032, abs=20e-6)
    assert figures["moving_weight_n"] == pytest.approx(MASS_KG * STANDARD_GRAVITY, rel=0.02)
    offset = found.quantities["position_offset_m"]
    assert abs(offset.value - 150e-6) < 4.0 * offset.std < 20e-6


def test_what_limits_the_force_is_the_spring_and_is_said_apart(found):
    force, spring = found.quantities["force_constant_n_per_a"], found.quantities["spring_n_per_m"]
    assert force.std / force.value < 0.001
    assert spring.std / spring.value == pytest.approx(0.02)
    assert found.quantities["calibration_relative_uncertainty"].value == pytest.approx(0.02, rel=0.01)


def test_residuals_are_kept(found, tmp_path):
    for name in ("electrical", "force", "position", "range"):
        assert found.tables[name]
    residuals = np.array(found.tables["force"]["residual_m"])
    # 2 um is what the current's noise makes of the position: with 13 levels the worst is within three times that.
    assert np.sqrt(np.mean(residuals**2)) < 2.5e-6
    assert np.abs(residuals).max() < 6e-6
    assert sum(found.tables["force"]["outlier"]) <= 1
    write_calibration(tmp_path / "a.toml", found)
    assert read_calibration(tmp_path / "a.toml") == found


def test_a_spring_of_another_stiffness_fails_the_calibration():
    instrument = rig()
    result = calibrate_static(instrument, StaticPlan(steps=QUICK, spring=Spring(1300.0, 0.02)))
    assert result.calibration.verdict == "failed"
    assert problems_of(result.calibration)[0].values["value"] == pytest.approx(3.75, abs=0.1)


def test_without_a_known_position_scale_its_uncertainty_counts():
    result = calibrate_static(rig(), StaticPlan(steps=QUICK))
    assert result.calibration.quantities["force_constant_n_per_a"].std > 0.009 * 2.93
    assert "position_gain" not in result.calibration.quantities


def test_a_person_does_what_a_stage_would():
    instrument = rig(stage=False)
    person = Person(instrument)
    plan = StaticPlan(steps=(*QUICK, "position", "range"), gauges_m=(0.005, 0.015, 0.025))
    figures = values(calibrate_static(instrument, plan, ask=person).calibration)
    assert figures["position_gain"] == pytest.approx(1.008, rel=1e-4)
    assert figures["force_constant_n_per_a"] == pytest.approx(EXPECTED["force_constant_n_per_a"], rel=0.005)
    assert "position_offset_m" not in figures  # heights tell distances, not where they begin
    assert [sum(word in words for words in person.asked) for word in ("spring", "gauge", "everything")] == [1, 3, 1]


def test_known_weights_need_no_known_spring():
    instrument = rig(errors=ERRORS | {"position": ChannelError(0.05, 0.0)})
    plan = StaticPlan(steps=QUICK, weights_kg=(0.1,), spring=Spring(1400.0, 0.02))
    found = calibrate_static(instrument, plan, ask=Person(instrument)).calibration
    assert (found.verdict, found.problems) == ("passed", ())
    constant = found.quantities["force_constant_n_per_a"]
    assert constant.value == pytest.approx(EXPECTED["force_constant_n_per_a"], rel=0.005)
    assert abs(constant.value - EXPECTED["force_constant_n_per_a"]) < 4 * constant.std
    assert found.quantities["spring_n_per_m"].value == pytest.approx(1000.0 / 1.05, rel=0.005)
    assert found.quantities["calibration_relative_uncertainty"].value < 0.005


def test_turned_over_the_accelerometers_zero_is_known_too():
    instrument = rig()
    plan = StaticPlan(steps=("acceleration",), orientations=2)
    figures = values(calibrate_static(instrument, plan, ask=Person(instrument)).calibration)
    assert figures["acceleration_gain"] == pytest.approx(1.03, abs=1e-3)
    assert figures["acceleration_offset_m_s2"] == pytest.approx(0.2, abs=0.01)


def test_neither_person_nor_stage_is_refused():
    with pytest.raises(UnusableInputError, check=coded("calibration.no_person")):
        calibrate_static(rig(stage=False), StaticPlan())


def test_in_place_leaves_out_what_needs_a_person():
    result = calibrate_static(rig(stage=False), StaticPlan(steps=("electrical", "position", "range"), in_place=True))
    assert result.calibration.verdict == "passed"
    assert {"calibration.skipped.position", "calibration.skipped.range"} <= set(codes(result.notes))
    assert "stroke_max_m" not in result.calibration.quantities


def test_the_spring_must_stand_where_it_has_room():
    instrument = rig(stage=False, surface_m=0.029)
    with pytest.raises(UnusableInputError, check=coded("calibration.spring_place", low=4.0, high=28.0)) as caught:
        calibrate_static(instrument, StaticPlan(in_place=True))
    assert caught.value.message.values["position"].value == pytest.approx(30.5, abs=0.5)


def test_a_thermometer_that_does_not_follow_heat_fails_it():
    instrument = rig()
    instrument.link.firmware.bench.stuck = {"temperature"}
    result = calibrate_static(instrument, StaticPlan(steps=("temperature",)))
    assert result.calibration.verdict == "failed"
    stuck = message(problems_of(result.calibration), "calibration.thermometer_stuck")
    assert stuck.values["rise"].value == pytest.approx(0.0, abs=0.005)


def test_a_supply_that_changes_meanwhile_fails_it():
    instrument, plan, shares = rig(), StaticPlan(steps=("electrical", "supply")), []
    bench = instrument.link.firmware.bench

    def sag(label, fraction):
        shares.append(fraction)
        if label.code == "calibration.step.rest_again":
            bench.converters.scale[1] = 0.97  # what the voltage channel makes of a volt

    result = calibrate_static(instrument, plan, progress=sag)
    drifts = [(problem.code, problem.values.get("quantity")) for problem in problems_of(result.calibration)]
    assert ("calibration.supply_drift", "voltage") in drifts
    assert plan.shown_steps == 4  # the progress is that of the whole calibration
    assert shares == sorted(shares)
    assert shares[0] < 0.25
    assert shares[-1] == pytest.approx(1.0)


def test_repeats_are_averaged_and_their_spread_is_kept():
    result = calibrate_static(rig(), StaticPlan(steps=("electrical",), repeats=2)).calibration
    spread = np.array(result.tables["repeats"]["coil_resistance_ohm"])
    assert spread.size == 2
    assert result.quantities["coil_resistance_ohm"].value == pytest.approx(spread.mean())
    assert np.ptp(spread) > 0


def test_a_repeat_that_fails_fails_all():
    one = CalibrationFindings({"coil_resistance_ohm": CalibratedQuantity(value=12.0, std=0.1)})
    other = CalibrationFindings({"coil_resistance_ohm": CalibratedQuantity(value=12.4, std=0.1)}, problems=("hot",))
    both = mean_of_repeats([one, other])
    assert both.problems == ("hot",)
    assert both.quantities["coil_resistance_ohm"].value == pytest.approx(12.2)
    assert both.quantities["coil_resistance_ohm"].std == pytest.approx(0.2)  # they scatter by more than they say


def test_cancelling_frees_the_coil():
    instrument = rig()
    firmware = instrument.link.firmware
    seen = []

    def note(label, fraction):
        seen.append(firmware.energised)

    with pytest.raises(CancelledError):
        calibrate_static(instrument, StaticPlan(), progress=note, cancelled=lambda: any(seen))
    instrument.link.run_for(0.2)
    assert any(seen)
    assert not firmware.energised


def test_an_open_coil_is_refused():
    instrument = rig(parameters=PlantParameters(resistance_ohm=300.0, inductance_h=30e-3))
    with pytest.raises(FirmwareFaultError, check=holding("fault.open_coil")):
        calibrate_static(instrument, StaticPlan(steps=("electrical",)))


def test_the_simulation_in_this_process_is_calibrated_too():
    result = calibrate_static(SimulatedInstrument("spring"), StaticPlan(push_only=True))
    assert result.calibration.verdict == "passed"
    assert values(result.calibration)["force_constant_n_per_a"] == pytest.approx(3.0, rel=0.001)


def test_what_was_sampled_before_the_stage_moved_is_not_taken(monkeypatch):
    """A host that was busy for a second finds a second of samples of the place before."""
    instrument = rig(errors={})
    move = instrument.move_stage

    def slow(place):
        done = move(place)
        instrument.link.run_for(0.5)  # read on at the new place
        return done

    def busy(place):
        instrument.link.run_for(1.0)
        return slow(place)

    monkeypatch.setattr(instrument, "move_stage", busy)
    found = calibrate_static(instrument, StaticPlan(steps=("position",))).calibration
    assert found.quantities["position_gain"].value == pytest.approx(1.0, rel=1e-4)
    assert found.quantities["position_nonlinearity_m"].value < 3e-6


def test_an_inverted_stage_fails_the_calibration(monkeypatch):
    instrument = rig(errors={})
    move = instrument.move_stage
    monkeypatch.setattr(instrument, "move_stage", lambda place: move(None if place is None else 0.032 - place))
    found = calibrate_static(instrument, StaticPlan(steps=("electrical", "force", "position", "range"))).calibration
    assert found.verdict == "failed"
    reading = message(problems_of(found), "calibration.position_gain").values["reading"]
    assert reading == pytest.approx(-1.0, abs=0.05)


def test_pulling_at_a_loose_spring_is_refused():
    with pytest.raises(LimitError, check=coded("calibration.spring_missing", action=PUSH_ONLY)):
        calibrate_static(SimulatedInstrument("spring"), StaticPlan(steps=QUICK))


def test_another_fixture_than_the_spring_is_asked_for_on_an_instrument_too():
    instrument = connect("left-posterior-forearm")
    with pytest.raises((LimitError, FirmwareFaultError), check=coded("calibration.spring_missing")):
        calibrate_static(instrument, StaticPlan(steps=QUICK))


@pytest.mark.parametrize(
    ("wrong", "code"),
    [
        ({"steps": ("dance",)}, "calibration.step"),
        ({"repeats": 0}, "option.refused"),
        ({"spring": Spring(1.0, 0.02)}, "calibration.spring"),
        ({"weights_kg": (2.0,)}, "calibration.weights"),
        ({"gauges_m": (0.01, 0.01, 0.02)}, "calibration.gauges"),
        ({"ambient_c": 80.0}, "calibration.ambient"),
    ],
)
def test_an_impossible_plan_is_refused(wrong, code):
    with pytest.raises(UnusableInputError, check=coded(code)):
        StaticPlan(**wrong)


def test_mains_are_found_and_noise_is_not_taken_for_them():
    time = np.arange(4000) / 2000.0
    random = np.random.default_rng(3)
    assert all(mains(random.standard_normal(1000), 500.0) == (0.0, 0.0) for _ in range(200))
    hertz, amplitude = mains(random.standard_normal(4000) + 0.3 * np.sin(2 * np.pi * 50.0 * time), 2000.0)
    assert hertz == 50.0
    assert amplitude == pytest.approx(0.3, abs=0.08)


def test_a_nonlinear_position_sensor_fails_the_calibration():
    places = np.linspace(0.003, 0.029, 9)
    bent = places + 3e-3 * np.sin(places / 0.032 * 2 * np.pi)
    result = position_findings(places, straight_line(places, bent, 1e-3), Estimate(0.0))
    assert "calibration.nonlinear" in codes(result.problems)


@pytest.mark.soak
def test_ten_seeds_stay_within_half_a_percent():
    for seed in range(10):
        figures = values(calibrate_static(rig(seed, coil="finite"), StaticPlan(ambient_c=21.0)).calibration)
        for name, truth in EXPECTED.items():
            assert figures[name] == pytest.approx(truth, rel=0.005)
        assert figures["moving_weight_n"] == pytest.approx(TRUTH.gravity_force_n, rel=0.02)
