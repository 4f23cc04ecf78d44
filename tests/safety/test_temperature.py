"""The winding's temperature by calculation, on either side, and a sensor that is not there."""

import numpy as np
import pytest
from safety.rigs import RATE, WIDE, rig, true_winding_c, volts

from firmware_sim.converters import CHANNELS
from firmware_sim.thermal import WindingModel
from tissueid import wire
from tissueid.device import DeviceDescription
from tissueid.errors import FirmwareFaultError, InstrumentError, LimitError
from tissueid.instrument import Limits
from tissueid.instrument.judge import Judge
from tissueid.instrument.thermal import Winding
from tissueid.wire import Fault

ROOM = np.full(200, 23.0)


def warmth(kind, amperes, seconds, start_c=23.0):
    """The temperature after so many seconds of a steady current, the sensor dead."""
    block = np.full(200, float(amperes))
    sensor = np.full(200, start_c)
    model = WindingModel(12.0, RATE) if kind == "firmware" else Winding(DeviceDescription())
    for _ in range(round(seconds * RATE / 200)):
        model.advance(block, sensor) if kind == "firmware" else model.take(block, sensor, 0.0)
    return model.temperature_c


def coil(amperes, seconds, start_c=23.0, ambient_c=23.0):
    """The coil itself, in closed form: 18 J/K and 8 K/W."""
    steady = ambient_c + 12.0 * amperes**2 * 8.0
    return steady + (start_c - steady) * np.exp(-seconds / 144.0)


each_side = pytest.mark.parametrize("side", ["firmware", "host"])


@each_side
@pytest.mark.parametrize(("amperes", "seconds"), [(0.3, 600), (0.7, 120), (1.0, 60), (2.0, 20), (4.0, 4)])
def test_the_calculation_lies_on_the_hot_side_and_not_far(side, amperes, seconds):
    true = coil(amperes, seconds)
    assert true < warmth(side, amperes, seconds) < 28.0 + 1.5 * (true - 23.0) + 5.0


@each_side
def test_it_cools_as_slowly_as_the_coil_or_slower(side):
    model = WindingModel(12.0, RATE) if side == "firmware" else Winding(DeviceDescription())
    step = model.advance if side == "firmware" else lambda current, sensor: model.take(current, sensor, 0.0)
    step(np.zeros(200), np.full(200, 80.0))
    hot = model.temperature_c
    for _ in range(1200):
        step(np.zeros(200), ROOM)
    assert coil(0.0, 120.0, hot) < model.temperature_c < hot - 20.0


@each_side
def test_a_warm_sensor_is_believed_and_a_cool_one_is_not(side):
    model = WindingModel(12.0, RATE) if side == "firmware" else Winding(DeviceDescription())
    step = model.advance if side == "firmware" else lambda current, sensor: model.take(current, sensor, 0.0)
    step(np.zeros(200), np.full(200, 50.0))
    assert model.temperature_c >= 49.9
    step(np.zeros(200), np.full(200, 65.0))
    assert model.temperature_c >= 65.0
    step(np.zeros(200), ROOM)
    assert model.temperature_c > 64.0


def test_the_firmware_forgets_no_heat_when_it_is_stopped_or_its_faults_are_cleared():
    instrument = rig()
    firmware = instrument._link.firmware
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
        warm.append(firmware._guard.winding.temperature_c)
    assert warm[0] > 38.0
    assert warm[1] > warm[0] + 10.0
    assert warm[1] > true_winding_c(instrument)
    firmware.reboot()
    firmware.bench.stuck.clear()
    instrument._link.run_for(1.0)
    sensor_c = CHANNELS[4].decode(firmware.bench.block(np.zeros(20), energised=False).codes[:, 4]).mean()
    assert firmware._guard.winding.temperature_c > sensor_c


def test_the_host_forgets_no_heat_from_test_to_test():
    instrument = rig()
    instrument._link.firmware.bench.stuck.add("temperature")
    with pytest.raises((LimitError, FirmwareFaultError), match=r"°C by its current|too hot"):
        for _ in range(10):
            instrument.load(volts(40.0, 1.5))
            instrument.arm(WIDE)
            run = instrument.start()
            while instrument.poll(0.05)["index"][-1] < run.end_index:
                pass
    assert true_winding_c(instrument) < 80.0


def test_samples_that_were_lost_count_with_the_worst_that_was_asked_for():
    judge = Judge(DeviceDescription())
    winding = Winding(DeviceDescription())
    winding.take(np.zeros(20), np.full(20, 23.0), 4.0)
    winding.take(np.full(4000, np.nan), np.full(4000, np.nan), 4.0)
    assert winding.temperature_c == pytest.approx(23.0 + 192.0 * 2.0 * 1.06 / 16.5, abs=1.0)
    judge.arm(ROOM, WIDE)
    judge.ask(np.array([3.0, -24.0]))
    judge.ask(np.array([12.0]))
    assert judge._worst_a == 2.0


def test_a_coil_that_is_hot_already_is_not_armed():
    judge = Judge(DeviceDescription())
    with pytest.raises(LimitError, match="the coil is at 81 °C; the limit is 80 °C: let it cool"):
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

    instrument._link.to_host = tamper


@pytest.mark.parametrize(("code", "words"), [(-32768, r"\(-25 °C\)"), (32767, r"\(225 °C\)"), (15_000, r"\(157 °C\)")])
def test_the_host_does_not_arm_with_a_temperature_sensor_that_cannot_be_right(code, words):
    instrument = rig()
    instrument.load(volts(4.0, 0.3))
    reporting(instrument, code)
    instrument.poll(0.05)
    with pytest.raises(InstrumentError, match=f"gives no usable reading {words}: check its plug and cable"):
        instrument.arm(WIDE)


def test_the_host_does_not_arm_without_any_temperature():
    with pytest.raises(InstrumentError, match="gives no usable reading: check its plug"):
        Judge(DeviceDescription()).arm(np.full(20, np.nan), WIDE)


def test_the_host_releases_when_the_temperature_sensor_falls_off():
    instrument = rig()
    instrument.load(volts(8.0, 3.0))
    instrument.arm(WIDE)
    instrument.start()
    instrument.poll(0.3)
    reporting(instrument, -32768)
    with pytest.raises(InstrumentError, match="temperature sensor gives no usable reading"):
        for _ in range(10):
            instrument.poll(0.05)
    assert not instrument._link.firmware.energised
    assert instrument._link.firmware.faults == Fault.NONE


def test_a_handshake_whose_scales_are_no_numbers_is_refused():
    from dataclasses import replace

    from support import LoopbackLink

    from firmware_sim.bench import Bench
    from firmware_sim.firmware import Firmware
    from tissueid.instrument import SerialInstrument

    firmware = Firmware(Bench(seed=1))
    firmware._channels["temperature"] = replace(firmware._channels["temperature"], offset=float("nan"))
    link = LoopbackLink(firmware)
    with pytest.raises(InstrumentError, match="other channels"):
        SerialInstrument(link, clock=link.clock)
