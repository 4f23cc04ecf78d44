import numpy as np
import pytest

from firmware_sim.bench import Bench
from firmware_sim.converters import CHANNELS, CODE_MAX, CODE_MIN, Converters

NAMES = ["command", "voltage", "current", "position", "temperature", "accelerometer_x", "accelerometer_y"]


def channel(name):
    return next(c for c in CHANNELS if c.name == name)


def decoded(block, bench, name):
    k = [c.name for c in bench.channels].index(name)
    return bench.channels[k].decode(block.codes[:, k])


def test_the_channel_table():
    assert [c.name for c in CHANNELS] == NAMES
    assert channel("position").gain == 0.5e-6
    ends = channel("position").decode(np.array([CODE_MIN, CODE_MAX], dtype=np.int16))
    assert ends[0] == pytest.approx(0.0, abs=1e-12)
    assert ends[1] == pytest.approx(0.0327675)
    assert channel("voltage").decode(np.array([CODE_MIN], dtype=np.int16))[0] == -60.0
    assert channel("current").decode(np.array([CODE_MIN], dtype=np.int16))[0] == -6.0


@pytest.mark.parametrize("name", NAMES)
def test_codes_come_back_within_half_a_step(name):
    c = channel(name)
    ends = c.decode(np.array([CODE_MIN, CODE_MAX], dtype=np.int16))
    values = np.linspace(*ends, 1001)
    codes, saturated = c.encode(values)
    assert not saturated.any()
    assert np.abs(c.decode(codes) - values).max() <= 0.5 * c.gain * (1 + 1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_out_of_range_saturates_and_says_so(name):
    c = channel(name)
    low, high = c.decode(np.array([CODE_MIN, CODE_MAX], dtype=np.int16))
    codes, saturated = c.encode(np.array([low - 2 * c.gain, high + 2 * c.gain]))
    assert list(codes) == [CODE_MIN, CODE_MAX]
    assert saturated.all()


def test_flags_carry_one_bit_a_channel():
    converters = Converters(seed=0)
    physical = np.zeros((3, len(CHANNELS)))
    physical[:, 3] = [0.01, 0.05, 0.01]
    physical[:, 4] = 23.0
    physical[2, 1] = 100.0
    _, flags = converters.read(physical)
    assert list(flags) == [0, 1 << 3, 1 << 1]


def test_noise_has_the_table_s_level_and_is_white():
    n = 40_000
    converters = Converters(seed=5)
    physical = np.tile([0.0, 1.0, 0.5, 0.01, 30.0, 9.8, 0.0], (n, 1))
    codes, _ = converters.read(physical)
    for k, c in enumerate(CHANNELS):
        error = c.decode(codes[:, k]) - physical[:, k]
        expected = np.hypot(c.noise_rms, c.gain / np.sqrt(12)) if c.noise_rms else 0.0
        assert error.std() == pytest.approx(expected, rel=0.03, abs=1e-12)
        if c.noise_rms:
            lags = [np.corrcoef(error[:-lag], error[lag:])[0, 1] for lag in (1, 2, 10)]
            assert np.abs(lags).max() < 4.5 / np.sqrt(n)


def test_blocks_of_any_length_give_the_same_codes():
    volts = 20.0 * np.sin(np.arange(400) / 7.0)
    whole = Bench(seed=3).block(volts, energised=True)
    cut = Bench(seed=3)
    parts = [cut.block(part, energised=True) for part in np.split(volts, [1, 7, 150, 151])]
    assert np.array_equal(np.concatenate([p.codes for p in parts]), whole.codes)
    assert np.array_equal(np.concatenate([p.flags for p in parts]), whole.flags)


def test_seed_and_reset():
    volts = np.full(50, 8.0)
    bench = Bench(seed=3)
    first = bench.block(volts, energised=True).codes
    assert not np.array_equal(Bench(seed=4).block(volts, energised=True).codes, first)
    bench.button = True
    bench.reset()
    block = bench.block(volts, energised=True)
    assert np.array_equal(block.codes, first)
    assert block.button is False


def test_the_command_is_recorded_as_the_converter_made_it():
    bench = Bench()
    volts = np.array([0.0, 1.23456, -70.0, 70.0])
    block = bench.block(volts, energised=False)
    assert decoded(block, bench, "command") == pytest.approx([0.0, 1.23456, -60.0, 60.0], abs=2e-3)
    assert list(block.flags & 1) == [0, 0, 1, 1]


def test_released_coil_reads_no_voltage_and_ambient_temperature():
    bench = Bench()
    block = bench.block(np.full(2000, 20.0), energised=False)
    assert np.abs(decoded(block, bench, "voltage")).max() < 0.05
    assert abs(decoded(block, bench, "current").mean()) < 0.01
    assert decoded(block, bench, "temperature").mean() == pytest.approx(23.0, abs=0.05)


@pytest.mark.parametrize(("tilt", "along", "across"), [(0.0, 1.0, 0.0), (90.0, 0.0, 1.0), (180.0, -1.0, 0.0)])
def test_the_accelerometer_follows_the_tilt(tilt, along, across):
    bench = Bench("linear-demo", tilt_deg=tilt)
    block = bench.block(np.zeros(2000), energised=False)
    assert decoded(block, bench, "accelerometer_x").mean() == pytest.approx(9.80665 * along, abs=0.02)
    assert decoded(block, bench, "accelerometer_y").mean() == pytest.approx(9.80665 * across, abs=0.02)
    assert bench.parameters.gravity_force_n == pytest.approx(0.588399 * along, abs=1e-6)


def test_the_accelerometer_feels_the_coil():
    bench = Bench("linear-demo")
    volts = 30.0 * np.sign(np.sin(2 * np.pi * 30.0 * np.arange(2000) / 2000.0))
    reading = decoded(bench.block(volts, energised=True), bench, "accelerometer_x")
    assert reading.std() > 3 * channel("accelerometer_x").noise_rms


def test_the_anti_alias_filter_is_first_order_at_2_khz():
    bench = Bench("linear-demo")
    trace = bench.plant.advance(np.array([10.0]))
    assert trace["voltage"][0] == 10.0
    assert trace["filtered_voltage"][0] == pytest.approx(10.0 * (1 - np.exp(-2 * np.pi)), rel=1e-3)


def test_an_unknown_preset_is_refused_by_name():
    with pytest.raises(ValueError, match=r"unknown tissue preset 'moon'; known: .*left-posterior-forearm"):
        Bench("moon")
