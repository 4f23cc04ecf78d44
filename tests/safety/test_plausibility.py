"""No false alarm, on anything that lies under the probe and at any rate; and what no sensor could say is noticed."""

import numpy as np
import pytest
from safety.rigs import RATE, WIDE, rig, shaken, volts

from firmware_sim.bench import Bench
from firmware_sim.converters import CHANNELS, CODE_MAX
from firmware_sim.plausibility import Plausibility as InFirmware
from firmware_sim.plausibility import Readings
from firmware_sim.presets import preset_names
from tissueid.device import DeviceDescription
from tissueid.errors import InstrumentError
from tissueid.instrument import SAMPLE
from tissueid.instrument.sample_monitor import Plausibility as InHost
from tissueid.wire import Fault


def commands(rate, seed):
    """What a coil may be asked for in a second: pushes that shake, hum, sweep, step, rise, and next to nothing."""
    random = np.random.default_rng(seed)
    time = np.arange(round(rate)) / rate
    rise = np.minimum(time / 0.25, 1.0)
    chirp = np.cumsum(np.geomspace(1.0, 0.45 * rate, time.size)) / rate
    return {
        "shaking": rise * np.clip(16.0 + 10.0 * random.standard_normal(time.size), -40.0, 46.0),
        "sweeping": rise * (20.0 + 20.0 * np.sin(2 * np.pi * chirp)),
        "stepping": rise * (24.0 + 20.0 * np.sign(np.sin(2 * np.pi * 3.0 * time))),
        "humming": rise * (10.0 + 20.0 * np.sin(2 * np.pi * 300.0 * time)),
        "quiet": 0.05 * random.standard_normal(time.size),
        "nothing": np.zeros(time.size),
        "pushing": rise * np.linspace(0.0, 46.0, time.size),
    }


def readings(bench, codes):
    """A block of the bench as each side sees it."""
    names = [channel.name for channel in CHANNELS]
    physical = {c.name: c.decode(codes[:, k]) for k, c in enumerate(CHANNELS)}
    return Readings(
        **{name: physical[name] for name in ("command", "voltage", "current", "position")},
        current_codes=codes[:, names.index("current")],
        position_codes=codes[:, names.index("position")],
    )


def samples(values: Readings, first=0):
    found = np.zeros(values.command.size, SAMPLE)
    found["index"] = first + np.arange(found.size)
    for name in ("command", "voltage", "current", "position"):
        found[name] = getattr(values, name)
    return found


def judged(bench, command, at_low_end=False):
    """What both sides say of a run on a bench: nothing, when all is well."""
    rate = bench.sample_rate_hz
    firmware = InFirmware(rate, 12.0, 3.0)
    host = InHost(DeviceDescription(sample_rate_hz=rate))
    firmware.begin(seen_low_end=at_low_end)
    host.begin(at_low_end=at_low_end)
    for part in np.array_split(command, 20):
        seen = readings(bench, bench.block(part, energised=True).codes)
        assert firmware.first_fault(seen) == (0, Fault.NONE)
        host.check(samples(seen))


@pytest.mark.parametrize("preset", preset_names())
def test_no_false_alarm_whatever_is_played_on_whatever_lies_there(preset):
    bench = Bench(preset, seed=1)
    for command in commands(RATE, 1).values():
        bench.reset()
        judged(bench, command)


@pytest.mark.parametrize("rate", [500.0, 1000.0, 10_000.0])
def test_no_false_alarm_at_other_rates(rate):
    for preset in ("left-posterior-forearm", "buna"):
        bench = Bench(preset, seed=2, sample_rate_hz=rate)
        for command in commands(rate, 2).values():
            bench.reset()
            judged(bench, command)


def test_no_false_alarm_at_the_ends_of_the_stroke():
    for level in (-7.9, 7.9):
        bench = Bench(seed=2)
        bench.place_fixture(None)
        sway = volts(level, 3.0) * (0.85 + 0.15 * np.sin(np.arange(3 * RATE) / 100.0))
        judged(bench, sway, at_low_end=True)


def test_no_false_alarm_over_a_link_that_loses_frames():
    import random

    instrument = rig()
    chance = random.Random(2)
    instrument.link.to_host = lambda data: b"" if chance.random() < 0.2 else data
    instrument.load(shaken(2.0))
    instrument.arm(WIDE)
    run = instrument.start()
    last = 0
    while last < run.end_index:
        block = instrument.poll(0.05)
        last = int(block["index"][-1]) + 1 if block.size else last


@pytest.mark.soak
@pytest.mark.parametrize("preset", preset_names())
def test_no_false_alarm_with_fifty_seeds(preset):
    for seed in range(50):
        bench = Bench(preset, seed=seed)
        for command in commands(RATE, seed).values():
            bench.reset()
            judged(bench, command)


# -- what cannot be ---------------------------------------------------------------------------------------------------


def either(values: Readings, at_low_end=False):
    """Return the fault of the firmware and the error code of the host for these readings; "" without an error."""
    firmware, host = InFirmware(RATE, 12.0, 3.0), InHost(DeviceDescription())
    firmware.begin(seen_low_end=at_low_end)
    host.begin(at_low_end=at_low_end)
    try:
        host.check(samples(values))
        code = ""
    except InstrumentError as error:
        code = error.code
    return firmware.first_fault(values)[1], code


def made(position_m, force_n, **other):
    """A second of readings of a coil that pushes with ``force_n`` while its position reads ``position_m``."""
    noise = np.random.default_rng(1).standard_normal((2, RATE))
    current = force_n / 3.0 + 0.013 * noise[0]
    voltage = np.asarray(other.get("voltage", 12.0 * current))
    position_codes = np.rint((np.broadcast_to(position_m, RATE) - 0.016384) / 0.5e-6).astype(np.int16)
    return Readings(
        voltage,
        voltage,
        other.get("current", current),
        position_codes * 0.5e-6 + 0.016384,
        np.rint(other.get("current", current) * 32768 / 6).astype(np.int16),
        other.get("position_codes", position_codes),
    )


TIME = np.arange(RATE) / RATE
NOISE_M = 1e-6 * np.random.default_rng(7).standard_normal(RATE)


def test_a_position_within_its_noise_while_the_force_swings_by_newtons_is_no_position():
    swinging = 3.0 + 2.0 * np.sin(2 * np.pi * 4 * TIME)
    assert either(made(0.012 + NOISE_M, swinging)) == (Fault.SENSOR, "sensor.position_stuck")
    moving = 0.012 + 1e-5 * np.sin(2 * np.pi * 4 * TIME) + NOISE_M
    assert either(made(moving, swinging)) == (Fault.NONE, "")
    assert either(made(0.012 + NOISE_M, 3.0 + 1.4 * np.sin(2 * np.pi * 4 * TIME))) == (Fault.NONE, "")


def test_a_position_that_stands_still_is_no_position_where_the_force_changes():
    swinging = 3.0 + 0.5 * np.sin(2 * np.pi * 4 * TIME)
    assert either(made(0.012, swinging)) == (Fault.SENSOR, "sensor.position_stuck")
    assert either(made(0.012, np.full(RATE, 3.0))) == (Fault.NONE, "")
    assert either(made(0.0, -1.0 + 0.5 * np.sin(2 * np.pi * 4 * TIME)), at_low_end=True) == (Fault.NONE, "")


def test_a_position_that_jumps_is_no_position():
    jumping = np.where(TIME < 0.5, 0.012, 0.020) + NOISE_M
    assert either(made(jumping, np.full(RATE, 3.0))) == (Fault.SENSOR, "sensor.position_jumps")
    quick = np.clip(0.012 + 4.0 * (TIME - 0.5), 0.012, 0.028) + NOISE_M  # as fast as the coil could ever make it
    assert either(made(quick, np.full(RATE, 3.0))) == (Fault.NONE, "")


def test_a_position_at_the_far_end_of_its_converter_is_no_position():
    codes = np.full(RATE, CODE_MAX, np.int16)
    fault, _ = either(made(0.03276, np.full(RATE, 1.0), position_codes=codes), at_low_end=True)
    assert fault == Fault.SENSOR


def test_faults_of_the_sensor_cable_and_the_coil_cable_are_distinguished():
    """The position's cable and the coil's are two faults: one is never called the other."""
    plugs = {
        Fault.SENSOR: lambda bench: bench.stuck.add("position"),
        Fault.OPEN_COIL: lambda bench: setattr(bench, "coil_open", True),
    }
    for fault, upset in plugs.items():
        instrument = rig()
        instrument.load(shaken(3.0))
        instrument.arm(WIDE)
        instrument.start()
        instrument.poll(0.5)
        upset(instrument.link.firmware.bench)
        with pytest.raises(InstrumentError):
            while True:
                instrument.poll(0.05)
        assert instrument.link.firmware.faults == fault


def test_what_is_too_weak_to_be_judged_is_not_judged():
    weak = np.full(RATE, 1.9)
    assert either(made(0.012 + NOISE_M, np.zeros(RATE), voltage=weak)) == (Fault.NONE, "")
    strong = np.full(RATE, 2.1)
    assert either(made(0.012 + NOISE_M, np.zeros(RATE), voltage=strong)) == (Fault.OPEN_COIL, "sensor.no_current")
