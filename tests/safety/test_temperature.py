"""The winding's temperature by calculation, on either side, and a sensor that is not there."""

from dataclasses import replace

import numpy as np
import pytest
from coded import coded, holding, says
from safety.rigs import RATE, WIDE, rig, true_winding_c, volts, without_firmware, without_host
from support import LoopbackLink

from firmware_sim.bench import Bench
from firmware_sim.converters import CHANNELS
from firmware_sim.device_models import MODELS
from firmware_sim.firmware import Firmware
from firmware_sim.identity import Identity
from firmware_sim.presets import preset_names
from firmware_sim.thermal import WindingModel
from tissueid import wire
from tissueid.acquisition.stimulus_choice import usual_noise
from tissueid.device import DESKTOP, HANDHELD, DeviceDescription
from tissueid.errors import FirmwareFaultError, InstrumentError, LimitError
from tissueid.instrument import Limits, SerialInstrument
from tissueid.instrument.sample_monitor import SampleMonitor
from tissueid.instrument.thermal import WindingTemperature
from tissueid.wire import Fault

ROOM = np.full(200, 23.0)
ORDINARY = usual_noise(RATE)


# What a coil has, by the wire it is wound with: ohm, J/K, K/W. 12 ohm of 28 gage are 56 m, 9.5 ohm are 44 m.
COILS = {"desktop": (12.0, 18.0, 8.0), "handheld": (9.5, 18.0 * 9.5 / 12.0, 8.0 * 12.0 / 9.5)}
DEVICES = {"desktop": DESKTOP, "handheld": HANDHELD}


def warmth(kind, amperes, seconds, start_c=23.0, device="desktop"):
    """Return the temperature after a time of steady current, with a dead sensor."""
    block = np.full(200, float(amperes))
    sensor = np.full(200, start_c)
    model = WindingModel(COILS[device][0], RATE) if kind == "firmware" else WindingTemperature(DEVICES[device])
    for _ in range(round(seconds * RATE / 200)):
        model.advance(block, sensor) if kind == "firmware" else model.take(block, sensor, 0.0)
    return model.temperature_c


def coil(amperes, seconds, start_c=23.0, ambient_c=23.0, device="desktop"):
    """The coil itself, in closed form."""
    ohm, capacity, way_out = COILS[device]
    steady = ambient_c + ohm * amperes**2 * way_out
    return steady + (start_c - steady) * np.exp(-seconds / (capacity * way_out))


each_side = pytest.mark.parametrize("side", ["firmware", "host"])


each_device = pytest.mark.parametrize("device", ["desktop", "handheld"])


@each_side
@each_device
@pytest.mark.parametrize(("amperes", "seconds"), [(0.3, 600), (0.7, 120), (1.0, 60), (2.0, 20), (4.0, 4)])
def test_the_calculation_lies_on_the_hot_side_and_not_far(side, device, amperes, seconds):
    true = coil(amperes, seconds, device=device)
    assert true < warmth(side, amperes, seconds, device=device) < 28.0 + 1.5 * (true - 23.0) + 5.0


def with_a_dead_sensor(name, room_c, watchdog_s):
    """A driver on a device by its name, in a room of that temperature; its sensor says 23 degC from the beginning."""
    model = MODELS[name]
    truth = replace(model.plant, ambient_degc=room_c)
    bench = Bench("linear-demo", seed=1, parameters=truth, nominal=model.plant, frame_mass_kg=model.frame_mass_kg)
    bench.stuck.add("temperature")
    bench.frozen["temperature"] = int(CHANNELS[4].encode(np.array([23.0]))[0][0])
    identity = Identity(model=model.title, max_force_n=model.max_force_n)
    link = LoopbackLink(Firmware(bench, identity))
    instrument = SerialInstrument(link, clock=link.clock)
    link.firmware.watchdog_s = watchdog_s  # which a handshake may not say
    return instrument


@each_side
@each_device
@pytest.mark.parametrize("room_c", [23.0, 30.0])
@pytest.mark.parametrize("share", [1.0, 0.7])
def test_either_side_alone_keeps_either_device_below_its_limit_though_the_sensor_is_dead(
    monkeypatch, side, device, room_c, share
):
    (without_host if side == "firmware" else without_firmware)(monkeypatch)
    instrument = with_a_dead_sensor(device, room_c, 0.5 if side == "firmware" else 1e9)
    firmware = instrument.link.firmware
    # As hard as the device permits, and with half of that heat.
    force_n = min(firmware.identity.max_force_n, instrument.device.force_constant_n_per_a * 48.0 / COILS[device][0])
    level = share * min(48.0, instrument.device.voltage_for_force(force_n))
    instrument.load(volts(level, 12.0))
    instrument.arm(Limits(max_force_n=force_n, max_temperature_c=80.0))
    run = instrument.start()
    with pytest.raises((LimitError, FirmwareFaultError)) as caught:
        while (samples := instrument.poll(0.05))["index"][-1] < run.end_index:
            assert samples["temperature"] == pytest.approx(23.0, abs=0.05)
    if side == "firmware":
        assert caught.value.faults == Fault.OVER_TEMPERATURE
    else:
        assert says(caught.value.message, "limit.winding_temperature", limit=80.0)
    assert not firmware.energised
    assert 60.0 < true_winding_c(instrument) < 79.0


@each_device
@pytest.mark.parametrize("preset", preset_names())
def test_the_calculation_lets_ordinary_tests_pass(device, preset):
    """4.5 s of the noise that is played where nothing else is asked for, with 30 s of rest between, in a warm room.

    Five of them on the desktop device. The handheld has half of its force for an ampere, and warms four times as much.
    """
    model = MODELS[device]
    bench = Bench(preset, seed=2, parameters=model.plant)
    force_n = ORDINARY.values * min(1.0, model.max_force_n / ORDINARY.values.max())
    codes = bench.block(force_n * model.plant.resistance_ohm / model.plant.force_constant_n_per_a, energised=True).codes
    current_a, rest = np.array_split(CHANNELS[2].decode(codes[:, 2]), 45), np.zeros(2000)
    firmware, host = WindingModel(model.plant.resistance_ohm, RATE), WindingTemperature(DEVICES[device])
    hottest = 0.0
    for _ in range({"desktop": 5, "handheld": 2}[device]):
        for block in (*current_a, *[rest] * 30):
            firmware.advance(block, np.full(block.size, 23.0))
            host.take(block, np.full(block.size, 23.0), 0.0)
            hottest = max(hottest, firmware.temperature_c, host.temperature_c)
    assert 50.0 < hottest < 80.0


@each_side
def test_it_cools_as_slowly_as_the_coil_or_slower(side):
    model = WindingModel(12.0, RATE) if side == "firmware" else WindingTemperature(DeviceDescription())
    step = model.advance if side == "firmware" else lambda current, sensor: model.take(current, sensor, 0.0)
    step(np.zeros(200), np.full(200, 80.0))
    hot = model.temperature_c
    for _ in range(1200):
        step(np.zeros(200), ROOM)
    assert coil(0.0, 120.0, hot) < model.temperature_c < hot - 20.0


@each_side
def test_a_warm_sensor_is_believed_and_a_cool_one_is_not(side):
    model = WindingModel(12.0, RATE) if side == "firmware" else WindingTemperature(DeviceDescription())
    step = model.advance if side == "firmware" else lambda current, sensor: model.take(current, sensor, 0.0)
    step(np.zeros(200), np.full(200, 50.0))
    assert model.temperature_c >= 49.9
    step(np.zeros(200), np.full(200, 65.0))
    assert model.temperature_c >= 65.0
    step(np.zeros(200), ROOM)
    assert model.temperature_c > 64.0


def test_the_firmware_forgets_no_heat_when_it_is_stopped_or_its_faults_are_cleared():
    instrument = rig()
    firmware = instrument.link.firmware
    firmware.bench.stuck.add("temperature")
    instrument.load(volts(40.0, 3.0))
    warm = []
    for _ in range(2):
        instrument.arm(WIDE)
        run = instrument.start()
        while instrument.poll(0.05)["index"][-1] < run.first_index + 2 * RATE:
            pass
        instrument.release()
        instrument.clear_faults()
        warm.append(firmware.guard.winding.temperature_c)
    assert warm[0] > 38.0
    assert warm[1] > warm[0] + 10.0
    assert warm[1] > true_winding_c(instrument)
    firmware.reboot()
    firmware.bench.stuck.clear()
    instrument.link.run_for(1.0)
    sensor_c = CHANNELS[4].decode(firmware.bench.block(np.zeros(20), energised=False).codes[:, 4]).mean()
    assert firmware.guard.winding.temperature_c > sensor_c


def by_temperature(error):
    return error.code == "limit.winding_temperature" or error.faults == Fault.OVER_TEMPERATURE


def test_the_host_forgets_no_heat_from_test_to_test():
    instrument = rig()
    instrument.link.firmware.bench.stuck.add("temperature")
    with pytest.raises((LimitError, FirmwareFaultError), check=by_temperature):
        for _ in range(10):
            instrument.load(volts(40.0, 1.5))
            instrument.arm(WIDE)
            run = instrument.start()
            while instrument.poll(0.05)["index"][-1] < run.end_index:
                pass
    assert true_winding_c(instrument) < 80.0


def test_samples_that_were_lost_count_with_the_worst_that_was_asked_for():
    judge = SampleMonitor(DeviceDescription())
    winding = WindingTemperature(DeviceDescription())
    winding.take(np.zeros(20), np.full(20, 23.0), 4.0)
    winding.take(np.full(4000, np.nan), np.full(4000, np.nan), 4.0)
    assert winding.temperature_c == pytest.approx(23.0 + 192.0 * 2.0 * 1.06 / 16.5, abs=1.0)
    judge.arm(ROOM, WIDE)
    judge.expect_command(np.array([3.0, -24.0]))
    judge.expect_command(np.array([12.0]))
    assert judge.highest_expected_a == 2.0


def test_a_coil_that_is_hot_already_is_not_armed():
    judge = SampleMonitor(DeviceDescription())
    with pytest.raises(LimitError, check=coded("limit.temperature", temperature=81.0, limit=80.0)):
        judge.arm(np.full(20, 81.0), Limits())


def reporting(instrument, code):
    """The device reports this code of its temperature sensor from now on."""

    def tamper(data):
        out = b""
        for frame in wire.FrameDecoder().feed(data):
            payload = frame.payload
            if frame.type == wire.MessageType.DATA:
                samples = np.frombuffer(payload, wire.SAMPLE).copy()
                samples["temperature"] = code
                payload = samples.tobytes()
            fields = frame.type, frame.sequence, frame.device_time_us, frame.sample_index, payload
            out += wire.encode_frame(wire.Frame(*fields))
        return out

    instrument.link.to_host = tamper


@pytest.mark.parametrize(("code", "reading"), [(-32768, -25.0), (32767, 225.0), (15_000, 157.0)])
def test_the_host_does_not_arm_with_a_temperature_sensor_that_cannot_be_right(code, reading):
    instrument = rig()
    instrument.load(volts(4.0, 0.3))
    reporting(instrument, code)
    instrument.poll(0.05)
    temperature = pytest.approx(reading, abs=0.5)
    with pytest.raises(InstrumentError, check=coded("sensor.wrong_temperature", temperature=temperature)):
        instrument.arm(WIDE)


def test_the_host_does_not_arm_without_any_temperature():
    with pytest.raises(InstrumentError, check=coded("sensor.no_temperature")):
        SampleMonitor(DeviceDescription()).arm(np.full(20, np.nan), WIDE)


def test_the_host_releases_when_the_temperature_sensor_falls_off():
    instrument = rig()
    instrument.load(volts(8.0, 3.0))
    instrument.arm(WIDE)
    instrument.start()
    instrument.poll(0.3)
    reporting(instrument, -32768)
    with pytest.raises(InstrumentError, check=coded("sensor.no_temperature")):
        for _ in range(10):
            instrument.poll(0.05)
    assert not instrument.link.firmware.energised
    assert instrument.link.firmware.faults == Fault.NONE


def test_a_handshake_with_nan_scales_is_refused():
    firmware = Firmware(Bench(seed=1))
    firmware.channels["temperature"] = replace(firmware.channels["temperature"], offset=float("nan"))
    link = LoopbackLink(firmware)
    with pytest.raises(InstrumentError, check=holding("handshake.offset", name="temperature")):
        SerialInstrument(link, clock=link.clock)
