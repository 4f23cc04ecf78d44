"""What a static calibration makes of readings: each deviation is as large as the scatter, and each bound is sharp."""

from dataclasses import replace

import numpy as np
import pytest
from coded import coded, codes, message, says

from tissueid.calibration.coil import electrical_findings, force_by_spring, force_by_weights
from tissueid.calibration.file import CalibratedQuantity, CalibrationFindings, mean_of_repeats, quantity
from tissueid.calibration.plans import Spring, StaticPlan
from tissueid.calibration.sensors import (
    Crossing,
    acceleration_findings,
    position_findings,
    position_line,
    range_findings,
    supply_findings,
    temperature_findings,
)
from tissueid.calibration.static_procedure import LEVELS_V
from tissueid.calibration.step_levels import Levels, noise_of_mean
from tissueid.device import GRAVITY_M_S2, DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.instrument import SAMPLE
from tissueid.records import Estimate

DEVICE = DeviceDescription()
NOISE = {"command": 0.0, "voltage": 1e-4, "current": 2e-4, "position": 0.2e-6}
COMMAND_V = np.array(LEVELS_V)


def still(count=4000, random=None, **means):
    """Samples of an instrument at rest, upright, shape (count,); noise as it is usual."""
    random = random or np.random.default_rng(1)
    usual = {"voltage": 0.0, "current": 0.0, "position": 0.016, "temperature": 25.0, "acceleration_x": GRAVITY_M_S2}
    noise = {"voltage": 3e-3, "current": 13e-3, "position": 1e-6, "temperature": 0.05, "acceleration_x": 0.05}
    samples = np.zeros(count, SAMPLE)
    samples["index"] = np.arange(count)
    for name, mean in (usual | means).items():
        samples[name] = mean + noise.get(name, 0.0) * random.standard_normal(count)
    return samples


def held(random=None, *, gain=1.0, ohm=12.0, constant=3.0, zero_a=0.0, shift_m=0.0, **changes):
    """Levels on a spring of 1000 N/m, with noise where there is a generator."""
    draw = (lambda name: NOISE[name] * random.standard_normal(COMMAND_V.size)) if random else lambda _: 0.0
    volts = gain * COMMAND_V
    amperes = volts / ohm
    found = Levels(
        command_v=COMMAND_V,
        voltage_v=volts + draw("voltage"),
        current_a=amperes + zero_a + draw("current"),
        position_m=0.016 + shift_m + constant * amperes / 1000.0 + draw("position"),
        noise=NOISE,
        rest=still(400, random),
        first_temperature_c=25.0,
        last_temperature_c=25.5,
        heat_j=25.0,
    )
    return replace(found, **changes)


def pulls(truths, found):
    """Standard deviation of (figure - truth) / its deviation, over many."""
    return {
        name: float(np.std([(one.quantities[name].value - truth) / one.quantities[name].std for one in found]))
        for name, truth in truths.items()
    }


@pytest.mark.soak
def test_deviations_are_what_the_figures_scatter_by():
    """Three times too large or too small would be seen at once: 300 draws tell a deviation to 4 %."""
    random = np.random.default_rng(11)
    rests = [still(random=random) for _ in range(300)]
    found = [electrical_findings(held(random), rest, DEVICE) for rest in rests]
    truths = {"coil_resistance_ohm": 12.0, "voltage_gain": 1.0, "current_offset_a": 0.0, "voltage_offset_v": 0.0}
    electrical = pulls(truths, found)
    spring = [force_by_spring(held(random), DEVICE, Spring(), Estimate(1.0, 0.0), 0.0) for _ in range(300)]
    force = pulls({"force_constant_n_per_a": 3.0}, spring)
    places = np.linspace(0.003, 0.029, 9)
    lines = []
    for _ in range(300):
        line = position_line(places, [still(40, random, position=place) for place in places])
        lines.append(position_findings(places, line, line.intercept))
    position = pulls({"position_gain": 1.0, "position_offset_m": 0.0}, lines)
    for name, pull in (electrical | force | position).items():
        # Few points, of which now and then one is left out, make the tails somewhat heavier than normal ones.
        assert 0.8 < pull < 1.35, (name, pull)


def test_the_noise_of_a_mean_is_that_of_means():
    random = np.random.default_rng(12)
    rests = [still(2000, random) for _ in range(200)]
    said = np.mean([noise_of_mean(rest, "current") ** 2 for rest in rests]) ** 0.5
    assert said == pytest.approx(0.013 / 2000**0.5, rel=0.1)


# -- the coil -------------------------------------------------------------------------------------------------


def test_good_levels_have_no_problem():
    found = electrical_findings(held(), still(), DEVICE) + force_by_spring(held(), DEVICE, Spring(), None, 0.0)
    assert found.problems == ()
    assert found.notes == ()


@pytest.mark.parametrize(("leak_a", "said"), [(0.008, False), (0.012, True)])
def test_current_without_voltage_is_bounded(leak_a, said):
    found = electrical_findings(held(zero_a=leak_a), still(), DEVICE)
    assert ("calibration.leak" in codes(found.problems)) == said


@pytest.mark.parametrize(("share", "said"), [(0.008, False), (0.013, True)])
def test_a_bent_line_is_bounded(share, said):
    off = np.random.default_rng(3).uniform(-1.0, 1.0, COMMAND_V.size)
    off -= np.polyval(np.polyfit(COMMAND_V, off, 1), COMMAND_V)
    bend = 2.0 * share * off / np.abs(off).max()
    found = electrical_findings(held(current_a=COMMAND_V / 12.0 + bend), still(), DEVICE)
    assert ("calibration.bent" in codes(found.problems)) == said
    if said:
        assert message(found.problems, "calibration.bent").values["line"] == "current against voltage"


@pytest.mark.parametrize(("share", "said"), [(0.008, False), (0.012, True)])
def test_hysteresis_is_bounded(share, said):
    swing = 2 * 3.0 / 1000.0
    rising = np.concatenate([[1], np.sign(np.diff(COMMAND_V))])
    levels = held(position_m=held().position_m + 0.5 * share * swing * rising)
    found = force_by_spring(levels, DEVICE, Spring(), None, 0.0)
    assert ("calibration.hysteresis" in codes(found.problems)) == said


@pytest.mark.parametrize(("ohm", "said"), [(14.2, False), (14.6, True), (9.8, False), (9.4, True)])
def test_resistance_must_be_within_a_fifth_of_nominal(ohm, said):
    found = electrical_findings(held(ohm=ohm), still(), DEVICE)
    assert ("calibration.off_nominal" in codes(found.problems)) == said
    if said:
        assert message(found.problems, "calibration.off_nominal").values["nominal"] == 12.0


def test_a_clipped_supply_fails_the_calibration():
    voltage = np.clip(COMMAND_V, -9.6, 9.6)
    found = electrical_findings(held(voltage_v=voltage, current_a=voltage / 12.0), still(), DEVICE)
    clipped = message(found.problems, "calibration.clipped").values
    assert (clipped["voltage"], clipped["expected"]) == pytest.approx((9.6, 12.0), abs=0.005)
    assert says(found.notes[-1], "calibration.left_out", line="voltage against the command", count=2, points=13)
    once = np.minimum(COMMAND_V, 11.8)
    found = electrical_findings(held(voltage_v=once, current_a=once / 12.0), still(), DEVICE)
    assert "calibration.clipped" in codes(found.problems)


def test_an_inverted_current_is_refused():
    with pytest.raises(UnusableInputError, check=coded("calibration.inverted")):
        electrical_findings(held(ohm=-12.0), still(), DEVICE)
    with pytest.raises(UnusableInputError, check=coded("calibration.no_current")):
        electrical_findings(held(ohm=1e6), still(), DEVICE)


def test_a_negative_force_constant_fails_the_calibration_without_an_error():
    found = force_by_spring(held(constant=-3.0), DEVICE, Spring(), Estimate(1.0, 0.01), 0.0)
    assert found.quantities["force_constant_n_per_a"].std > 0
    assert message(found.problems, "calibration.off_nominal").values["value"] == pytest.approx(-3.0)
    backwards = force_by_spring(held(), DEVICE, Spring(), Estimate(-1.0, 0.01), 0.0)
    assert message(backwards.problems, "calibration.off_nominal").values["value"] == pytest.approx(-3.0)
    assert quantity(-1.0, "N", -0.5).std == 0.5


def test_with_weights_the_weights_are_checked_and_not_the_spring():
    series = [held(), held(shift_m=0.05 * GRAVITY_M_S2 / 1000.0), held(shift_m=0.1 * GRAVITY_M_S2 / 1000.0)]
    spring = Spring(1400.0, 0.02)
    assert force_by_spring(series[0], DEVICE, spring, None, 0.0).problems
    found = force_by_spring(series[0], DEVICE, spring, None, 0.0, check_nominal=False)
    found += force_by_weights(series, (0.0, 0.05, 0.1), DEVICE, 1.0, 0.0)
    assert found.problems == ()
    assert found.value("force_constant_n_per_a") == pytest.approx(3.0)
    assert force_by_weights(series, (0.0, 0.1, 0.2), DEVICE, 1.0, 0.0).problems
    bent = force_by_weights(series, (0.0, 0.05, 0.104), DEVICE, 1.0, 0.0)
    assert codes(bent.problems) == ["calibration.weights_line"]


# -- the sensors ----------------------------------------------------------------------------------------------


def test_a_position_that_never_changes_is_refused():
    places = np.linspace(0.003, 0.029, 9)
    with pytest.raises(UnusableInputError, check=coded("calibration.position_stuck")):
        position_line(places, [still(200) for _ in places])


def test_an_inverted_stage_fails_the_calibration():
    places = np.linspace(0.003, 0.029, 9)
    line = position_line(places, [still(200, position=0.032 - place) for place in places])
    reading = message(position_findings(places, line, None).problems, "calibration.position_gain").values["reading"]
    assert reading == pytest.approx(-1.0)


@pytest.mark.parametrize(("jump_c", "said"), [(1.8, False), (2.2, True)])
def test_a_jump_of_the_thermometer_is_bounded(jump_c, said):
    rest = still()
    rest["temperature"][2000:] += jump_c
    found = temperature_findings(rest, held(), None)
    assert ("calibration.thermometer_jumps" in codes(found.problems)) == said


@pytest.mark.parametrize(("off_c", "said"), [(9.8, False), (10.2, True)])
def test_the_thermometers_zero_is_bounded(off_c, said):
    found = temperature_findings(still(temperature=20.0 + off_c), held(), 20.0)
    assert ("calibration.thermometer_off" in codes(found.problems)) == said


@pytest.mark.parametrize(("gain", "said"), [(1.14, False), (1.16, True), (0.86, False), (0.84, True)])
def test_the_accelerometer_is_bounded(gain, said):
    found = acceleration_findings(still(acceleration_x=gain * GRAVITY_M_S2), None)
    assert ("calibration.accelerometer" in codes(found.problems)) == said
    assert found.value("acceleration_gain") == pytest.approx(gain, abs=1e-3)


USUAL = {"voltage": 3e-3, "current": 13e-3, "position": 1e-6, "temperature": 0.05, "acceleration_x": 0.05}


@pytest.mark.parametrize("channel", USUAL)
def test_noise_is_bounded_in_every_channel(channel):
    bound = {"voltage": 0.05, "current": 0.10, "position": 20e-6, "temperature": 1.0, "acceleration_x": 1.0}[channel]
    random, electrical = np.random.default_rng(5), electrical_findings(held(), still(), DEVICE)
    for share, said in ((0.9, False), (1.1, True)):
        rest = still()
        rest[channel] = rest[channel].mean() + share * bound * random.standard_normal(rest.size)
        found = supply_findings(electrical, electrical, rest, rest, DEVICE)
        assert ("calibration.noisy" in codes(found.problems)) == said, share


@pytest.mark.parametrize(
    ("name", "drift", "quantity"),
    [
        ("coil_resistance_ohm", 0.005 * 12.0, "resistance"),
        ("voltage_gain", 0.005, "voltage"),
        ("current_offset_a", 0.005, "zero of the current"),
    ],
)
def test_drift_of_the_supplies_is_bounded(name, drift, quantity):
    first = electrical_findings(held(), still(), DEVICE)
    exact = {key: found.model_copy(update={"std": 0.0}) for key, found in first.quantities.items()}
    for share, said in ((0.95, False), (1.05, True)):
        moved = exact[name].model_copy(update={"value": exact[name].value + share * drift})
        found = supply_findings(
            CalibrationFindings(exact), CalibrationFindings(exact | {name: moved}), still(), still(), DEVICE
        )
        drifts = [
            problem.values["quantity"] for problem in found.problems if problem.code == "calibration.supply_drift"
        ]
        assert (quantity in drifts) == said, share


@pytest.mark.parametrize(("drift_m", "said"), [(18e-6, False), (22e-6, True), (-22e-6, True)])
def test_drift_of_the_position_is_bounded(drift_m, said):
    electrical = electrical_findings(held(), still(), DEVICE)
    again = still(position=0.016 + drift_m)
    found = supply_findings(electrical, electrical, still(), again, DEVICE)
    assert ("calibration.position_drift" in codes(found.problems)) == said
    by_hand = supply_findings(electrical, electrical, still(), again, DEVICE, same_place=False)
    assert by_hand.problems == ()
    assert "supply_position_drift_m" not in by_hand.quantities


# -- the stroke -----------------------------------------------------------------------------------------------


def crossings(high_m):
    """Two ways there and two back, at 2 cm/s, with the coil's weight carried by -0.2 A."""
    speeds, ends = (-0.02, 0.02, -0.02, 0.02), (0.0, high_m, 0.0, high_m)
    return tuple(Crossing(v, -0.2 + 3.5 / 3.0 * v, 1e-4, end) for v, end in zip(speeds, ends, strict=True))


@pytest.mark.parametrize(("share", "said"), [(1.05, False), (1.07, True), (0.95, False), (0.93, True)])
def test_the_length_of_the_stroke_is_bounded(share, said):
    found = range_findings(
        crossings(0.032 * share),
        DEVICE,
        position_gain=1.0,
        position_offset=Estimate(0.0),
        force_constant_n_per_a=3.0,
        zero_a=0.0,
    )
    assert ("calibration.stroke" in codes(found.problems)) == said
    assert found.value("moving_weight_n") == pytest.approx(0.6)


def test_an_inverted_stroke_fails_the_calibration_without_an_error():
    found = range_findings(
        crossings(0.032),
        DEVICE,
        position_gain=-1.0,
        position_offset=Estimate(0.032, 1e-6),
        force_constant_n_per_a=-3.0,
        zero_a=0.0,
    )
    assert found.quantities["moving_weight_n"].std > 0
    assert str(message(found.problems, "calibration.stroke").values["found"]) == "-32.0 mm".replace("-", "−")


# -- repeats --------------------------------------------------------------------------------------------------


def test_repeats_make_only_what_is_random_smaller():
    random = np.random.default_rng(7)
    runs = [force_by_spring(held(random), DEVICE, Spring(1000.0, 0.02), None, 0.0) for _ in range(10)]
    both = mean_of_repeats(runs)
    assert both.quantities["spring_n_per_m"].std == pytest.approx(20.0)
    assert both.quantities["force_constant_n_per_a"].std == pytest.approx(0.030, rel=0.01)
    assert both.quantities["spring_slope_m_per_a"].std < 0.5 * runs[0].quantities["spring_slope_m_per_a"].std
    scaled = [force_by_spring(held(random), DEVICE, Spring(), Estimate(1.0, 0.01), 0.0) for _ in range(4)]
    assert mean_of_repeats(scaled).quantities["force_constant_n_per_a"].std == pytest.approx(0.015, rel=0.01)


def test_a_later_step_replaces_the_common_uncertainty():
    one = CalibrationFindings({"a": CalibratedQuantity(value=1.0, std=0.5)}, shared={"a": 0.5})
    both = one + CalibrationFindings({"a": CalibratedQuantity(value=2.0, std=0.1)})
    assert both.shared == {}
    assert mean_of_repeats([both] * 4).quantities["a"].std == pytest.approx(0.05)


@pytest.mark.parametrize("heights", [(0.0, 0.01, float("nan")), (0.0, 0.01, float("inf")), (0.0, 0.01, -0.01)])
def test_gauges_of_no_height_are_refused(heights):
    with pytest.raises(UnusableInputError, check=coded("calibration.gauge_height", limit=200.0)):
        StaticPlan(gauges_m=heights)
