"""Faults on purpose: the line that damages what it carries, and the plan by which things go wrong."""

from unittest.mock import patch

import numpy as np
import pytest
from faults.desk import Desk
from pydantic import ValidationError

from firmware_sim.faults import FAULT_KINDS, PlannedFault
from firmware_sim.line_faults import LINE_KINDS, OTHER_VERSION, LineFaults
from tissueid import wire
from tissueid.instrument import CLINICAL
from tissueid.wire import Fault, State

FRAMES = [wire.encode_frame(wire.Frame(0x83, number, payload=bytes([number % 251]) * 40)) for number in range(2000)]
STREAM = b"".join(FRAMES)


def numbers(data):
    """The sequence numbers of the frames that are whole, and how many were refused."""
    decoder = wire.FrameDecoder()
    return [frame.sequence for frame in decoder.feed(data)], decoder.statistics.refused


def carried(kind, share=0.1, pieces="frames", seed=1, cut=None):
    line = LineFaults(seed)
    end = line.begin(kind, share, pieces)
    out = b"".join(line.to_host(part) for part in (cut or [STREAM]))
    end()
    return out + line.to_host(b""), line


def test_a_line_without_trouble_carries_what_it_gets():
    line = LineFaults()
    assert line.to_host(STREAM) == STREAM
    assert line.to_device(b"\1\2") == b"\1\2"
    assert line.touched == 0


@pytest.mark.parametrize("kind", sorted(LINE_KINDS))
@pytest.mark.parametrize("pieces", ["frames", "bursts"])
def test_the_same_seed_does_the_same(kind, pieces):
    out, line = carried(kind, pieces=pieces)
    assert out == carried(kind, pieces=pieces)[0]
    assert out != carried(kind, pieces=pieces, seed=2)[0]
    assert line.touched > 0


@pytest.mark.parametrize("kind", sorted(LINE_KINDS))
def test_frames_are_touched_however_the_stream_is_cut(kind):
    rng = np.random.default_rng(4)
    edges = np.sort(rng.integers(0, len(STREAM), 500))
    parts = [bytes(part) for part in np.split(np.frombuffer(STREAM, np.uint8), edges)]
    assert carried(kind, cut=parts)[0] == carried(kind)[0]


def test_a_flipped_bit_costs_its_frame_and_at_most_the_next():
    got, refused = numbers(carried("bit_flips")[0])
    assert set(got) <= set(range(2000))
    assert 150 < 2000 - len(got) < 300
    assert refused > 100
    assert got == sorted(got)


def test_dropped_frames_leave_no_trace():
    got, refused = numbers(carried("drops")[0])
    assert refused == 0
    assert 150 < 2000 - len(got) < 250


def test_duplicates_come_twice_and_in_order():
    got, _ = numbers(carried("duplicates")[0])
    assert got == sorted(got)
    assert 150 < len(got) - 2000 < 250
    assert set(got) == set(range(2000))


def test_reordered_frames_all_arrive_a_little_late():
    got, refused = numbers(carried("reordering")[0])
    assert sorted(got) == list(range(2000))
    assert refused == 0
    late = [place - number for place, number in enumerate(got)]
    assert got != sorted(got)
    assert max(late) <= 6


def test_frames_of_another_version_are_otherwise_the_same():
    frames = wire.FrameDecoder().feed(carried("wrong_version_frames")[0])
    versions = [frame.version for frame in frames]
    assert [frame.sequence for frame in frames] == list(range(2000))
    assert 150 < versions.count(OTHER_VERSION) < 250


def test_trouble_in_one_direction_leaves_the_other_alone():
    line = LineFaults(1)
    line.begin("drops", 1.0, direction="to_device")
    assert line.to_device(STREAM) == b""
    assert line.to_host(STREAM) == STREAM


def test_a_cut_cable_keeps_nothing():
    line = LineFaults(1)
    end = line.begin("reordering", 1.0)
    assert line.to_host(STREAM + b"\5\5") == b""
    line.cut()
    end()
    assert line.to_host(b"") == b""


# -- the plan ---------------------------------------------------------------------------------------------------------


def planned(*faults):
    desk = Desk(seed=3)
    desk.link.faults.planned = list(faults)
    return desk, desk.open()


def running(instrument, seconds=2.0):
    instrument.load(np.full(round(seconds * 2000), 8.0))
    instrument.arm(CLINICAL)
    return instrument.start()


def poll_for(desk, instrument, seconds):
    end = desk.link.now + seconds
    while desk.link.now < end:
        instrument.poll(0.01)


def test_a_fault_comes_so_long_after_the_first_start():
    desk, instrument = planned(PlannedFault(kind="open_coil", after_start_s=0.5, seconds=0.1))
    poll_for(desk, instrument, 2.0)
    assert not desk.bench.coil_open
    run = running(instrument)
    while not desk.bench.coil_open:
        desk.link.tick()
    assert desk.firmware.sample_index - run.first_index == pytest.approx(1000, abs=40)
    desk.link.run_for(0.15)
    assert not desk.bench.coil_open
    assert desk.link.faults.happened == 1


@pytest.mark.parametrize("state", ["idle", "loaded", "armed", "running"])
def test_a_fault_comes_in_its_state(state):
    desk, seen = Desk(seed=3), []
    faults = desk.link.faults
    with patch.object(faults, "begin", lambda fault, now: seen.append(desk.firmware.state)):
        faults.planned.append(PlannedFault(kind="stuck_sensor", in_state=state, channel="temperature"))
        instrument = desk.open()
        poll_for(desk, instrument, 0.05)
        running(instrument)
        poll_for(desk, instrument, 0.05)
    assert seen == [State[state.upper()]]


def test_a_state_that_is_left_too_early_is_waited_for():
    desk, instrument = planned(PlannedFault(kind="brown_out", in_state="running", after_s=0.3))
    running(instrument, 0.2)
    poll_for(desk, instrument, 1.0)
    assert desk.firmware.faults == Fault.NONE
    running(instrument, 2.0)
    desk.link.run_for(0.32)
    assert Fault.BROWN_OUT in desk.firmware.faults
    assert not desk.firmware.energised


def test_a_clock_that_is_off_and_drifts():
    desk, instrument = planned()
    poll_for(desk, instrument, 0.1)
    fault = PlannedFault(kind="drifting_clock", after_start_s=0.0, clock_error=0.02, clock_drift_per_s=0.01)
    desk.befall(fault)
    before, now = desk.firmware.sample_index, desk.link.now
    poll_for(desk, instrument, 2.0)
    taken, passed = desk.firmware.sample_index - before, desk.link.now - now
    assert taken / (2000 * passed) == pytest.approx(1.03, abs=0.002)
    desk.link.faults.clear()
    assert desk.link.faults.clock_rate == 1.0


def test_all_is_over_when_it_is_cleared():
    desk, instrument = planned()
    instrument.close()
    identity = desk.firmware.identity
    for kind in FAULT_KINDS:
        desk.befall(PlannedFault(kind=kind, after_start_s=0.0, seconds=100.0))
    desk.befall(PlannedFault(kind="wrong_version", after_start_s=0.0))
    desk.link.faults.clear()
    assert desk.link.plugged
    assert not desk.bench.stuck
    assert (desk.bench.coil_open, desk.bench.button, desk.bench.supply_share) == (False, False, 1.0)
    assert desk.firmware.identity == identity
    assert desk.link.faults.active == []
    assert desk.open().device.serial_number == "SIM-0001"


def test_nothing_that_was_planned_happens_after_it_is_cleared():
    desk, instrument = planned(PlannedFault(kind="unplug", after_start_s=0.5))
    running(instrument)
    poll_for(desk, instrument, 0.3)
    desk.link.faults.clear()
    desk.settle(1.0)
    assert desk.link.plugged
    assert desk.link.faults.happened == 0


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"kind": "meteor", "after_start_s": 1}, "no such fault; there are: bit_flips"),
        ({"kind": "reset"}, "either after_start_s or in_state"),
        ({"kind": "reset", "after_start_s": 1, "in_state": "idle"}, "either after_start_s or in_state"),
        ({"kind": "reset", "in_state": "asleep"}, "'idle', 'loaded', 'armed' or 'running'"),
        ({"kind": "drops", "after_start_s": 1, "share": 0}, "greater than 0"),
        ({"kind": "drifting_clock", "after_start_s": 1, "clock_error": 0.2}, "less than or equal to 0.1"),
        ({"kind": "stuck_sensor", "after_start_s": 1, "channel": "command"}, "'position', 'current' or 'temperature'"),
    ],
)
def test_a_plan_that_cannot_be(values, words):
    with pytest.raises(ValidationError, match=words):
        PlannedFault.model_validate(values)
