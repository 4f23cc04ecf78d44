"""The cross-compiled firmware on an emulated microcontroller, in lockstep: its time passes in grants of the test."""

import struct

import pytest
from reference.lines import EmulatedLine, run_on

from firmware_sim.reference.bounds import TIMINGS, bounds_of
from tissueid.instrument.conformance import CLAUSES
from tissueid.wire import Frame, FrameDecoder, MessageType, encode_frame

QUICK = ("2a", "4.6c", "5.3a")


@pytest.mark.parametrize(
    ("plant", "clauses"),
    [
        ("free", QUICK),
        pytest.param("free", tuple(CLAUSES), marks=pytest.mark.soak),
        pytest.param("dummy", tuple(CLAUSES), marks=pytest.mark.soak),
    ],
)
def test_the_emulated_firmware_conforms(emulated, plant, clauses):
    line = EmulatedLine(emulated, plant)
    results = run_on(line, clauses)
    assert {item.id: (item.outcome, item.reason) for item in results.values() if item.outcome != "passed"} == {}
    assert results.keys() == set(clauses)
    assert line.device.counted_instructions < bounds_of(emulated, TIMINGS["qemu"]).instructions
    assert line.device.masked_instructions < 600
    print(
        f"{line.device.counted_instructions:.0f} instructions of a sample interrupt, masked for "
        f"{line.device.masked_instructions:.0f}"
    )


def test_two_runs_of_the_emulator_are_the_same(emulated):
    """Time is counted in instructions: the samples do not depend on how busy this computer is."""

    def samples():
        line = EmulatedLine(emulated)
        try:
            line.write(encode_frame(Frame(MessageType.HELLO, 1, payload=b"\1\1" + bytes(30))))
            line.write(encode_frame(Frame(MessageType.STREAM, 2, payload=b"\1")))
            line.advance(201)  # the first one only sets a command
            return line.received()
        finally:
            line.close()

    first, second = samples(), samples()
    assert first == second
    frames = [frame for frame in FrameDecoder().feed(first) if frame.type == MessageType.DATA]
    assert [frame.sample_index for frame in frames] == list(range(0, 200, 20))
    assert len({struct.unpack_from("<h", frame.payload, 4) for frame in frames}) > 1
