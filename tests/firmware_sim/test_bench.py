"""The fixture under the probe, and what may go wrong on the bench at any time."""

import numpy as np
import pytest

from firmware_sim.bench import Bench
from firmware_sim.converters import CODE_MAX, ChannelError
from firmware_sim.plant import PlantParameters
from firmware_sim.presets import preset_names

NAMES = [channel.name for channel in Bench("linear-demo").channels]
WEIGHT_N = 0.060 * 9.80665


def decoded(block, bench, name):
    k = NAMES.index(name)
    return bench.channels[k].decode(block.codes[:, k])


def shaken(bench, seconds=0.5, volts=12.0):
    time = np.arange(round(seconds * bench.sample_rate_hz)) / bench.sample_rate_hz
    return bench.block(4.0 + volts * np.sin(2 * np.pi * 15 * time), energised=True)


# -- the fixture ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("preset", preset_names())
@pytest.mark.parametrize("tilt", [0.0, 120.0])
def test_a_fixture_is_brought_and_everything_is_at_rest(preset, tilt):
    bench = Bench(preset, tilt_deg=tilt, coil="finite")
    for position in (0.0, 0.004, 0.016, 0.032, None, 0.010):
        shaken(bench, 0.1)
        bench.place_fixture(position)
        before = bench.plant.state[1]
        trace = bench.plant.advance(np.zeros(200))
        assert np.abs(trace["position"] - before).max() < 1e-8
        assert np.abs(trace["current"]).max() < 1e-8


def test_a_spring_lies_where_the_stage_brought_it():
    bench = Bench("calibration-spring")
    for position in (0.004, 0.012, 0.028):
        bench.place_fixture(position)
        read = decoded(bench.block(np.zeros(500), energised=False), bench, "position").mean()
        assert read == pytest.approx(position + WEIGHT_N / 1000.0, abs=1e-6)
        assert bench.tissue.surface_m == position
    assert bench.tissue.stiffness.at(0.0) == 1000.0


@pytest.mark.parametrize(("tilt", "end"), [(0.0, 0.032), (180.0, 0.0)])
def test_without_a_fixture_the_coil_falls_to_its_stop_and_moves_freely(tilt, end):
    bench = Bench("left-posterior-forearm", tilt_deg=tilt)
    bench.place_fixture(None)
    assert bench.plant.state[1] == pytest.approx(end, abs=1e-5)
    away = -np.sign(end - 0.016)
    bench.plant.energised = True
    # 2 N less the weight on 60 g: free motion, and nothing but the bearing resists.
    trace = bench.plant.advance(np.full(60, away * 8.0))
    time = np.arange(1, 61) / 2000.0
    decay = (3.5 + 9.0 / 12.0) / 0.060  # bearing and back-EMF
    speed = away * (2.0 - WEIGHT_N) / 0.060 * (1 - np.exp(-decay * time)) / decay
    assert trace["velocity"][-1] == pytest.approx(speed[-1], rel=0.02)
    bench.place_fixture(0.010)
    assert bench.tissue.name == "left-posterior-forearm"


def test_a_moved_fixture_leaves_the_coil_as_warm_as_it_was():
    bench = Bench("calibration-spring")
    bench.block(np.full(8000, 24.0), energised=True)
    warm = decoded(bench.block(np.zeros(200), energised=False), bench, "temperature").mean()
    assert warm > 26.0
    bench.place_fixture(0.02)
    after = decoded(bench.block(np.zeros(200), energised=False), bench, "temperature").mean()
    assert after == pytest.approx(warm, abs=0.3)


def test_a_reset_leaves_the_fixture_where_it_is():
    bench = Bench("calibration-spring")
    bench.place_fixture(0.02)
    bench.reset()
    assert bench.plant.state[1] == pytest.approx(0.02 + WEIGHT_N / 1000.0, abs=1e-8)


@pytest.mark.parametrize("position", [-0.001, 0.033, float("nan")])
def test_a_fixture_beyond_the_stroke_is_refused(position):
    bench = Bench("calibration-spring")
    with pytest.raises(ValueError, match="surface_m must lie on the stroke"):
        bench.place_fixture(position)
    assert bench.tissue.surface_m == 0.010


# -- what may go wrong ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES[1:])
def test_a_stuck_sensor_gives_its_last_code_and_nothing_else_changes(name):
    sound, bench = Bench("linear-demo", seed=4), Bench("linear-demo", seed=4)
    k = NAMES.index(name)
    last = [shaken(b).codes[-1] for b in (sound, bench)][1][k]
    bench.stuck = {name}
    expected, found = shaken(sound), shaken(bench)
    assert set(found.codes[:, k]) == {last}
    others = np.arange(len(NAMES)) != k
    assert np.array_equal(found.codes[:, others], expected.codes[:, others])
    bench.stuck = set()
    assert np.array_equal(shaken(bench).codes, shaken(sound).codes)


def test_a_stuck_sensor_survives_a_snapshot():
    bench = Bench("linear-demo")
    shaken(bench)
    before = bench.snapshot()
    bench.stuck = {"position"}
    first = shaken(bench).codes
    bench.restore(before)
    assert np.array_equal(shaken(bench).codes, first)


def test_a_sensor_that_was_never_read_sticks_at_its_first_code():
    bench = Bench("linear-demo")
    bench.stuck = {"position"}
    found = decoded(shaken(bench), bench, "position")
    assert np.ptp(found) == 0.0
    assert found[0] == pytest.approx(0.010 + WEIGHT_N / 4670.0, abs=1e-4)


def test_a_saturated_flag_belongs_to_a_sensor_that_lives():
    bench = Bench("linear-demo", channel_errors={"voltage": ChannelError(gain_error=0.2, offset=50.0)})
    k = NAMES.index("voltage")
    block = bench.block(np.full(20, 20.0), energised=True)
    assert np.all(block.flags[5:] >> k & 1)
    assert block.codes[-1, k] == CODE_MAX
    bench.stuck = {"voltage"}
    block = bench.block(np.full(20, 20.0), energised=True)
    assert not np.any(block.flags >> k & 1)
    assert np.all(block.codes[:, k] == CODE_MAX)


@pytest.mark.parametrize("name", ["command", "heart"])
def test_only_sensors_can_be_stuck(name):
    bench = Bench("linear-demo")
    bench.stuck = {name}
    with pytest.raises(ValueError, match=f"no sensor '{name}' that could be stuck; there are: voltage, "):
        bench.block(np.zeros(2), energised=False)


def test_a_broken_wire_carries_no_current_and_brakes_nothing():
    bench = Bench("calibration-spring")
    bench.block(np.full(1000, 20.0), energised=True)
    bench.coil_open = True
    trace = bench.plant.state.copy()
    block = bench.block(np.full(1000, 20.0), energised=True)
    assert decoded(block, bench, "voltage")[10:].mean() == pytest.approx(20.0, abs=0.01)
    assert decoded(block, bench, "current")[10:].mean() == pytest.approx(0.0, abs=0.003)
    # The spring lets go: 66 g on 1000 N/m with 3.6 N s/m of bearing, and no back-EMF.
    position = decoded(block, bench, "position") - 0.010 - WEIGHT_N / 1000.0
    mass, damping, stiffness = 0.066, 3.6, 1000.0
    decay = damping / (2 * mass)
    turn = np.sqrt(stiffness / mass - decay**2)
    time = np.arange(1, 1001) / 2000.0 - 1 / (2 * np.pi * 2000.0)  # the anti-alias filter's delay
    start = trace[1] - 0.010 - WEIGHT_N / 1000.0
    expected = start * np.exp(-decay * time) * (np.cos(turn * time) + decay / turn * np.sin(turn * time))
    assert np.abs(position - expected)[5:].max() < 0.01 * start
    bench.coil_open = False
    healed = decoded(bench.block(np.full(1000, 20.0), energised=True), bench, "current")
    assert healed[-200:].mean() == pytest.approx(20.0 / 12.0, abs=0.01)


def test_a_sagging_supply_lowers_what_the_amplifier_gives():
    bench = Bench("linear-demo")
    bench.supply_share = 0.25
    volts = decoded(bench.block(np.array([5.0] * 20 + [20.0] * 20 + [-20.0] * 20), energised=True), bench, "voltage")
    assert volts[10:20].mean() == pytest.approx(5.0, abs=0.01)
    assert volts[30:40].mean() == pytest.approx(12.0, abs=0.01)
    assert volts[50:].mean() == pytest.approx(-12.0, abs=0.01)


def test_the_sensor_supply_scales_the_potentiometer_alone():
    sound, bench = Bench("linear-demo", seed=2), Bench("linear-demo", seed=2, sensor_supply_share=0.98)
    blocks = [shaken(b) for b in (sound, bench)]
    for name in NAMES:
        expected, found = (decoded(block, b, name) for block, b in zip(blocks, (sound, bench), strict=True))
        if name == "position":
            assert np.abs(found - 0.98 * expected).max() < 1e-6
            assert np.polyfit(expected, found, 1) == pytest.approx([0.98, 0.0], abs=5e-4)
        else:
            assert np.array_equal(found, expected)


def test_a_reset_mends_everything():
    bench = Bench("linear-demo", sensor_supply_share=0.99)
    first = shaken(bench).codes
    bench.stuck, bench.coil_open, bench.supply_share, bench.sensor_supply_share = {"position"}, True, 0.1, 0.5
    shaken(bench)
    bench.reset()
    assert np.array_equal(shaken(bench).codes, first)


# -- the converters' real scales --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_a_channel_error_is_a_gain_and_an_offset(name):
    error = ChannelError(gain_error=0.012, offset=0.01)
    sound, bench = Bench("linear-demo", seed=2), Bench("linear-demo", seed=2, channel_errors={name: error})
    blocks = [shaken(b) for b in (sound, bench)]
    expected, found = (decoded(block, b, name) for block, b in zip(blocks, (sound, bench), strict=True))
    k = NAMES.index(name)
    step = bench.channels[k].gain
    if name == "command":
        assert np.array_equal(found, expected)  # the command is recorded, and other volts come out
        volts = [decoded(block, b, "voltage") for block, b in zip(blocks, (sound, bench), strict=True)]
        assert np.abs(volts[1] - 1.012 * volts[0] - 0.01).max() < 0.05 * 0.012 * 60 + 2 * bench.channels[1].gain
        return
    noise = 6.0 * 0.012 * bench.channels[k].noise_rms
    inside = ~(blocks[1].flags >> k & 1).astype(bool)
    assert np.abs(found - (1.012 * expected + 0.01))[inside].max() < 2 * step + noise


def test_an_error_of_no_channel_is_refused():
    with pytest.raises(ValueError, match="no channel 'colour'; there are: command, voltage"):
        Bench("linear-demo", channel_errors={"colour": ChannelError()})


# -- what the device believes of itself -------------------------------------------------------------------------


def test_nominal_and_real_figures_stand_side_by_side():
    real = PlantParameters(resistance_ohm=12.31)
    bench = Bench("linear-demo", parameters=real, nominal=PlantParameters())
    assert (bench.nominal.resistance_ohm, bench.parameters.resistance_ohm) == (12.0, 12.31)
    current = decoded(bench.block(np.full(2000, 12.0), energised=True), bench, "current")
    assert current[1000:].mean() == pytest.approx(12.0 / 12.31, abs=2e-3)
    assert Bench("linear-demo", parameters=real).nominal == real  # the nominal values are the true ones by default


def test_the_temperature_sensor_lags_behind_the_winding():
    bench = Bench("linear-demo", parameters=PlantParameters(thermal_resistance_k_per_w=1e6))
    trace = bench.plant.advance(np.full(20_000, 24.0))
    time = np.arange(1, 20_001) / 2000.0
    rise = 48.0 / 18.0 * time  # 48 W into 18 J/K
    assert trace["temperature"] - 23.0 == pytest.approx(rise, rel=2e-3, abs=2e-3)
    lagged = rise - 48.0 / 18.0 * 2.5 * (1 - np.exp(-time / 2.5))
    assert trace["filtered_temperature"] - 23.0 == pytest.approx(lagged, rel=2e-3, abs=5e-3)
