"""Handshakes with implausible values: each is refused with the name of the value."""

import numpy as np
import pytest
from coded import coded, says
from support import LoopbackLink

from firmware_sim.bench import Bench
from firmware_sim.device_models import MODELS
from firmware_sim.firmware import Firmware
from tissueid import wire
from tissueid.errors import InstrumentError
from tissueid.instrument import SerialInstrument
from tissueid.instrument.handshake import RANGES, SPANS, parse_hello
from tissueid.instrument.interface import SIGNALS
from tissueid.messages import joined
from tissueid.wire import MessageType

INTEGERS = ("samples_per_frame", "stimulus_capacity")
FLOATS = [name for name in RANGES if name not in INTEGERS]
ODD = [float("nan"), float("inf"), -float("inf"), -1.0, 1e300, -1e300]


def hello_of(plant=None):
    """Return the HELLO_ACK of a simulated device."""
    link, frames, decoder = LoopbackLink(Firmware(Bench(parameters=plant))), [], wire.FrameDecoder()

    def listen(data):
        frames.extend(decoder.feed(data))
        return data

    link.to_host = listen
    SerialInstrument(link, clock=link.clock).close()
    return next(frame.payload for frame in frames if frame.type == MessageType.HELLO_ACK)


@pytest.fixture(scope="module")
def payload():
    return hello_of()


def with_value(payload, name, value):
    if name in wire.HELLO_ACK_FILTER.names:
        return payload[: -wire.HELLO_ACK_FILTER.itemsize] + np.float64(value).tobytes()
    at = wire.HELLO_ACK.fields[name][1]
    data = np.array(value, wire.HELLO_ACK.fields[name][0]).tobytes()
    return payload[:at] + data + payload[at + len(data) :]


def with_scale(payload, signal, field, value):
    at = wire.HELLO_ACK.itemsize + SIGNALS.index(signal) * wire.CHANNEL.itemsize + wire.CHANNEL.fields[field][1]
    return payload[:at] + np.float64(value).tobytes() + payload[at + 8 :]


def problem_of(payload):
    """Return the problem for which a handshake is refused."""
    with pytest.raises(InstrumentError, check=coded("handshake.impossible", port="/dev/ttyACM0")) as caught:
        parse_hello(payload, "/dev/ttyACM0")
    text = caught.value.message
    assert len(text) < 160, "one short line, whatever the number"
    assert "\n" not in text
    return text.values["problem"]


def test_every_value_that_the_host_uses_has_a_range():
    fields = wire.HELLO_ACK.fields | wire.HELLO_ACK_FILTER.fields
    figures = {name for name, (kind, *_) in fields.items() if kind.kind == "f"}
    assert figures == set(FLOATS)
    assert set(SPANS) == set(SIGNALS)


@pytest.mark.parametrize("name", FLOATS)
@pytest.mark.parametrize("value", ODD)
def test_an_implausible_value_is_named(payload, name, value):
    assert says(problem_of(with_value(payload, name, value)), "handshake.value", name=name, low=RANGES[name][0])


@pytest.mark.parametrize("name", FLOATS)
def test_the_ends_of_a_range_are_inside(payload, name):
    low, high = RANGES[name]
    for value in (low, high):
        parse_hello(with_value(payload, name, value), "port")
    problem_of(with_value(payload, name, np.nextafter(low, -np.inf)))
    problem_of(with_value(payload, name, np.nextafter(high, np.inf)))


@pytest.mark.parametrize("name", ["samples_per_frame", "stimulus_capacity"])
def test_counts_of_zero_are_refused(payload, name):
    assert says(problem_of(with_value(payload, name, 0)), "handshake.value", name=name, value=0)


def test_a_tiny_resistance_is_refused(payload):
    problem = problem_of(with_value(payload, "coil_resistance_ohm", 1e-300))
    assert says(problem, "handshake.value", name="coil_resistance_ohm", value=1e-300)


@pytest.mark.parametrize("signal", SIGNALS)
@pytest.mark.parametrize("value", [*ODD, 0.0, 1e-300])
def test_an_implausible_scale_is_named(payload, signal, value):
    assert says(problem_of(with_scale(payload, signal, "gain", value)), "handshake.span", name=signal)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 1e300, -1e300])
def test_an_implausible_offset_is_named(payload, value):
    assert says(problem_of(with_scale(payload, "position", "offset", value)), "handshake.offset", name="position")


def test_the_corner_of_the_filters_is_optional(payload):
    assert parse_hello(payload, "port").device.filter_corner_hz == 2000.0
    assert parse_hello(payload[: -wire.HELLO_ACK_FILTER.itemsize], "port").device.filter_corner_hz == 0.0


def test_unknown_channels_are_listed_up_to_a_limit(payload):
    head = with_value(payload, "channels", 255)[: wire.HELLO_ACK.itemsize]
    table = b"".join(wire.pack(wire.CHANNEL, name=b"weather-%d" % k, unit=b"", gain=1, offset=0) for k in range(255))
    shown = joined([*(f"weather-{k}" for k in range(8)), "..."])
    with pytest.raises(InstrumentError, check=coded("handshake.channels", port="port", names=shown)):
        parse_hello(head + table, "port")


@pytest.mark.parametrize("name", MODELS)
def test_every_simulated_device_is_plausible(name):
    assert (
        parse_hello(hello_of(MODELS[name].plant), "port").device.coil_resistance_ohm
        == MODELS[name].plant.resistance_ohm
    )
