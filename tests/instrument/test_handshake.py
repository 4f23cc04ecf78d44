"""A handshake whose figures cannot be: each is refused in one short line that names it."""

import numpy as np
import pytest
from support import LoopbackLink

from firmware_sim.bench import Bench
from firmware_sim.firmware import Firmware
from firmware_sim.models import MODELS
from tissueid import wire
from tissueid.errors import InstrumentError
from tissueid.instrument import SerialInstrument
from tissueid.instrument.handshake import RANGES, SPANS, read_hello
from tissueid.instrument.interface import SIGNALS
from tissueid.wire import MessageType

FLOATS = [name for name in RANGES if wire.HELLO_ACK.fields[name][0] == np.dtype("<f8")]
ODD = [float("nan"), float("inf"), -float("inf"), -1.0, 1e300, -1e300]


def said(plant=None):
    """The HELLO_ACK of a simulated device."""
    link, frames, decoder = LoopbackLink(Firmware(Bench(parameters=plant))), [], wire.FrameDecoder()

    def listen(data):
        frames.extend(decoder.feed(data))
        return data

    link.to_host = listen
    SerialInstrument(link, clock=link.clock).close()
    return next(frame.payload for frame in frames if frame.type == MessageType.HELLO_ACK)


@pytest.fixture(scope="module")
def payload():
    return said()


def with_figure(payload, name, value):
    at = wire.HELLO_ACK.fields[name][1]
    data = np.array(value, wire.HELLO_ACK.fields[name][0]).tobytes()
    return payload[:at] + data + payload[at + len(data) :]


def with_scale(payload, signal, field, value):
    at = wire.HELLO_ACK.itemsize + SIGNALS.index(signal) * wire.CHANNEL.itemsize + wire.CHANNEL.fields[field][1]
    return payload[:at] + np.float64(value).tobytes() + payload[at + 8 :]


def refused(payload):
    """What is said of a handshake that cannot be."""
    with pytest.raises(InstrumentError, match="impossible figures") as caught:
        read_hello(payload, "/dev/ttyACM0")
    words = str(caught.value)
    assert len(words) < 160, "one short line, whatever the number"
    assert "\n" not in words
    return words


def test_every_figure_that_the_host_uses_has_a_range():
    figures = {name for name in wire.HELLO_ACK.names if wire.HELLO_ACK.fields[name][0].kind == "f"}
    assert figures == set(FLOATS)
    assert set(SPANS) == set(SIGNALS)


@pytest.mark.parametrize("name", FLOATS)
@pytest.mark.parametrize("value", ODD)
def test_a_figure_that_cannot_be_is_named(payload, name, value):
    assert f"{name} is" in refused(with_figure(payload, name, value))


@pytest.mark.parametrize("name", FLOATS)
def test_the_ends_of_a_range_belong_to_it(payload, name):
    low, high = RANGES[name]
    for value in (low, high):
        read_hello(with_figure(payload, name, value), "port")
    refused(with_figure(payload, name, np.nextafter(low, -np.inf)))
    refused(with_figure(payload, name, np.nextafter(high, np.inf)))


@pytest.mark.parametrize("name", ["samples_per_frame", "stimulus_capacity"])
def test_counts_of_nothing_are_refused(payload, name):
    assert f"{name} is 0" in refused(with_figure(payload, name, 0))


def test_a_resistance_of_next_to_nothing_is_refused(payload):
    assert "coil_resistance_ohm is 1e-300" in refused(with_figure(payload, "coil_resistance_ohm", 1e-300))


@pytest.mark.parametrize("signal", SIGNALS)
@pytest.mark.parametrize("value", [*ODD, 0.0, 1e-300])
def test_a_scale_that_cannot_be_is_named(payload, signal, value):
    words = refused(with_scale(payload, signal, "gain", value))
    assert signal in words
    assert "other channels" not in words


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 1e300, -1e300])
def test_an_offset_that_cannot_be_is_named(payload, value):
    assert "offset of position" in refused(with_scale(payload, "position", "offset", value))


def test_other_channels_are_listed_in_one_short_line(payload):
    head = with_figure(payload, "channels", 255)[: wire.HELLO_ACK.itemsize]
    table = b"".join(wire.pack(wire.CHANNEL, name=b"weather-%d" % k, unit=b"", gain=1, offset=0) for k in range(255))
    with pytest.raises(
        InstrumentError, match="other channels than this software knows: weather-0, weather-1"
    ) as caught:
        read_hello(head + table, "port")
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize("name", MODELS)
def test_every_simulated_device_is_possible(name):
    assert read_hello(said(MODELS[name].plant), "port").device.coil_resistance_ohm == MODELS[name].plant.resistance_ohm
