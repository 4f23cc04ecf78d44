"""A device whose frames are heard, their checksums right, and whose samples cannot be used: nothing is played blind."""

from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from coded import coded, holding, part_of
from faults.cells import SURFACE_M, fault, feedback, open_loop
from faults.desk import LIMITS, Desk

from tissueid import wire
from tissueid.acquisition import run_guided_test
from tissueid.acquisition.surface_detection import place
from tissueid.calibration import check_coil
from tissueid.errors import InstrumentError, LinkLostError
from tissueid.wire import Fault, Flag, MessageType, State

FREED_S = 0.5 + 0.02
"""The firmware's watchdog counts from the last heartbeat, and that from the last sample that was judged."""
LATEST_S = 20.0
"""By the host's own clock: what goes on for longer goes on for ever."""


class Altering:
    """A cable that changes frames on their way to the host, from a moment on; the checksums are right."""

    def __init__(self, desk, change, after_s=0.3):
        self.since_s = None
        self._desk, self._change, self._after_s = desk, change, after_s
        self._decoder = wire.FrameDecoder()

    def __call__(self, data):
        return b"".join(wire.encode_frame(item) for frame in self._decoder.feed(data) for item in self._altered(frame))

    def _altered(self, frame):
        if self._desk.link.running < round(2000 * self._after_s) and self.since_s is None:
            return [frame]
        if self.since_s is None:
            self.since_s = self._desk.link.now
            self._desk.begun = self._desk.bench.samples
        return self._change(frame)


def only_data(change):
    """Change nothing but DATA."""
    return lambda frame: [change(frame) if frame.type == MessageType.DATA else frame]


UNUSABLE = {
    "part of a sample": only_data(lambda frame: replace(frame, payload=frame.payload[:-3])),
    "a byte too many": only_data(lambda frame: replace(frame, payload=frame.payload + b"\0")),
    "no sample": only_data(lambda frame: replace(frame, payload=b"")),
    "always index 0": only_data(lambda frame: replace(frame, sample_index=0)),
    "always the newest again": only_data(lambda frame: replace(frame, sample_index=frame.sample_index % 20)),
}


def guided(desk, instrument, folder):
    """The main run of a test."""
    run_guided_test(instrument, open_loop(seconds=4.0), desk.recorder(folder / "s.h5", instrument), surface_m=SURFACE_M)


def following(desk, instrument, folder):
    """The main run of a test with set-points."""
    run_guided_test(instrument, feedback(seconds=4.0), desk.recorder(folder / "s.h5", instrument), surface_m=SURFACE_M)


def placing(_desk, instrument, _folder):
    """The search for the surface."""
    place(instrument, LIMITS)


def calibrating(_desk, instrument, _folder):
    """The electrical check, as every calibration's levels are played."""
    check_coil(instrument)


OPERATIONS = {"test": guided, "feedback": following, "placing": placing, "calibration": calibrating}


def ended(desk, operation, folder):
    """The error by which an operation ends, in time; what it is of is closed, and opening again is no harm."""
    instrument = desk.open()
    tick, began = desk.link.tick, desk.link.now

    def counted():
        tick()
        assert desk.link.now - began < LATEST_S, "the host waits for ever"

    desk.link.tick = counted
    with pytest.raises(InstrumentError) as caught:
        operation(desk, instrument, folder)
    gave_up_s = desk.link.now
    desk.link.to_host = lambda data: data
    instrument.close()
    assert not desk.firmware.energised
    return caught.value, gave_up_s


@pytest.mark.parametrize("operation", OPERATIONS.values(), ids=OPERATIONS)
@pytest.mark.parametrize("change", UNUSABLE.values(), ids=UNUSABLE)
def test_samples_that_cannot_be_used_are_silence(tmp_path, change, operation):
    desk = Desk(seed=4)
    desk.link.to_host = cable = Altering(desk, change)
    error, gave_up_s = ended(desk, operation, tmp_path)
    assert isinstance(error, LinkLostError)
    assert part_of(error.message, "link.unusable")
    assert gave_up_s - cable.since_s < 1.2
    assert 0.3 < desk.energised_since(desk.begun) <= FREED_S
    assert desk.firmware.faults in (Fault.WATCHDOG, Fault.NONE)


def test_the_firmware_frees_the_coil_of_a_host_that_hears_nothing_it_can_use():
    desk = Desk(seed=4)
    instrument = desk.open()
    instrument.load(np.full(8000, 8.0))
    instrument.arm(LIMITS)
    instrument.start()
    instrument.poll(0.3)

    def change(frame):
        return [] if frame.type == MessageType.STATUS else UNUSABLE["part of a sample"](frame)

    desk.link.to_host = Altering(desk, change, after_s=0.0)
    with pytest.raises(LinkLostError, check=holding("link.unusable")):
        while True:
            instrument.poll(0.05)
    assert desk.firmware.faults == Fault.WATCHDOG
    assert desk.energised_since(desk.begun) <= FREED_S


def beginning(change):
    """Change the answer to START."""

    def altered(frame):
        if frame.type != MessageType.ACK or frame.payload[0] != MessageType.START:
            return [frame]
        ack, _ = wire.unpack(wire.ACK, frame.payload)
        ack["detail"] = change(ack["detail"]) % 2**64
        return [replace(frame, payload=wire.pack(wire.ACK, **ack))]

    return altered


@pytest.mark.parametrize(
    ("change", "operation"),
    [
        pytest.param(lambda _: 2**64 - 1, guided, id="2^64-1"),
        pytest.param(lambda _: 2**64 - 1, placing, id="2^64-1 while placing"),
        pytest.param(lambda _: 2**63, calibrating, id="2^63 while calibrating"),
        pytest.param(lambda _: 0, guided, id="0"),
        pytest.param(lambda first: first + 1_000_000, guided, id="+1,000,000"),
        pytest.param(lambda first: first + 1_000_000, following, id="+1,000,000 with set-points"),
        pytest.param(lambda first: first + 4000, guided, id="+4000"),
        pytest.param(lambda first: first + 30, guided, id="+30"),
        pytest.param(lambda first: first - 4000, guided, id="-4000"),
    ],
)
def test_a_run_that_cannot_have_begun_where_the_device_says_is_none(tmp_path, change, operation):
    desk = Desk(seed=4)
    desk.link.to_host = Altering(desk, beginning(change), after_s=0.0)
    desk.begun = desk.bench.samples
    error, _ = ended(desk, operation, tmp_path)
    assert error.code == "instrument.contradiction"
    assert desk.energised_since(desk.begun) <= 0.1


@pytest.mark.parametrize("played", [0, 1, 2**63])
def test_an_early_end_that_cannot_be_is_none(played):
    desk = Desk(seed=4)
    instrument = desk.open()
    instrument.load(np.full(8000, 8.0))
    instrument.arm(LIMITS)
    instrument.start()
    for _ in range(20):
        instrument.poll(0.05)

    def altered(frame):
        if frame.type != MessageType.ACK or frame.payload[0] != MessageType.FINISH:
            return [frame]
        ack, _ = wire.unpack(wire.ACK, frame.payload)
        return [replace(frame, payload=wire.pack(wire.ACK, **ack | {"detail": played}))]

    desk.link.to_host = Altering(desk, altered, after_s=0.0)
    with pytest.raises(InstrumentError, check=coded("instrument.contradiction")):
        instrument.finish()
    desk.link.run_for(0.1)
    assert not desk.firmware.energised


def test_a_run_has_a_limit_by_the_host_s_own_clock():
    desk = Desk(seed=4)
    instrument = desk.open()
    instrument.load(np.full(4000, 8.0))
    instrument.arm(LIMITS)
    instrument.start()
    began = desk.link.now
    seen = [0]

    def slowly(frame):
        """One sample of each frame, numbered as if time stood almost still."""
        if frame.type != MessageType.DATA:
            return [frame]
        seen[0] = seen[0] or frame.sample_index
        seen[0] += 1
        return [replace(frame, sample_index=seen[0] - 1, payload=frame.payload[:16])]

    for _ in range(10):
        instrument.poll(0.05)
    seen[0] = instrument.state.next_index
    desk.link.to_host = Altering(desk, slowly, after_s=0.0)
    desk.firmware.player.length = 10**6  # a device that does not end the run either
    desk.firmware.player.stimulus_v = np.full(10**6, 8.0)
    with pytest.raises(InstrumentError, check=coded("instrument.overdue", seconds=7.5)):
        while True:
            assert desk.link.now - began < LATEST_S
            instrument.poll(0.05)
    assert desk.link.now - began < 7.6
    assert not desk.firmware.energised
    assert desk.firmware.state is State.LOADED


def test_a_clock_that_is_a_tenth_slow_is_lived_with():
    desk = Desk(seed=4)
    instrument = desk.open()
    desk.befall(fault("drifting_clock", clock_error=-0.1))
    instrument.load(np.full(20_000, 4.0))
    instrument.arm(LIMITS)
    run = instrument.start()
    samples = [instrument.poll(0.05)]
    while samples[-1]["index"][-1] < run.end_index:
        samples.append(instrument.poll(0.05))
    inside = np.concatenate(samples)
    played = inside["index"][(inside["flags"] & Flag.PLAYING) > 0]
    assert (played[0], played[-1] + 1) == (run.first_index, run.end_index)
    with suppress(InstrumentError):
        instrument.close()
