"""Clauses of docs/protocol.md, section 4.5: set-points that are computed during the run."""

from __future__ import annotations

import struct

import numpy as np

import tissueid.wire as wire
from tissueid.language import marked
from tissueid.wire import Fault, Flag, MessageType, Result, State
from tissueid_lab.conformance.clause import clause, require
from tissueid_lab.conformance.device import DeviceUnderTest
from tissueid_lab.conformance.exchange import require_status
from tissueid_lab.conformance.run_clauses import STEP

BUFFER = 8192
_MAX_RUN_S = 90.0


def _follow(samples: int, hold: int = 0, identity: int = 1) -> bytes:
    return wire.pack(wire.FOLLOW, stimulus_id=identity, samples=samples, hold_code=hold)


def _block(offset: int, codes: np.ndarray, token: int = 7) -> bytes:
    return wire.pack(wire.SETPOINTS, token=token, offset=offset) + codes.astype("<i2").tobytes()


def _armed(device: DeviceUnderTest, *, stimulus: int, follow: int, hold: int = 0) -> None:
    """Arm a stimulus of zeros that set-points follow, with heartbeats."""
    device.stream()
    device.load(np.zeros(stimulus, "<i2"))
    device.expect(Result.OK, MessageType.FOLLOW, _follow(follow, hold))
    device.keep_alive(True)
    device.arm()


@clause("4.5a", marked("FOLLOW needs a loaded stimulus, and no more set-points than the longest run"))
def _announced(device: DeviceUnderTest) -> None:
    device.expect(Result.BAD_STATE, MessageType.FOLLOW, _follow(10), "in IDLE")
    device.load(np.zeros(10, "<i2"))
    device.expect(Result.BAD_STATE, MessageType.FOLLOW, _follow(10, identity=2), "for another stimulus")
    most = round(_MAX_RUN_S * device.rate_hz) - 10
    device.expect(Result.OK, MessageType.FOLLOW, _follow(100), detail=110)
    for samples in (most + 1, 2**32 - 1):
        device.expect(Result.TOO_LARGE, MessageType.FOLLOW, _follow(samples), f"with {samples} samples")


@clause("4.5b", marked("ARM checks the hold level, and counts the set-points"))
def _hold_level(device: DeviceUnderTest) -> None:
    low = 0.5 * device.force_n
    device.load(np.zeros(10, "<i2"))
    for sign in (1.0, -1.0):
        hold = int(device.codes(sign * 1.1 * low)[0])
        device.expect(Result.OK, MessageType.FOLLOW, _follow(100, hold))
        payload = device.arm_payload(max_force_n=low)
        device.expect(Result.BEYOND_LIMITS, MessageType.ARM, payload, "with a hold level 10 % above the force limit")
    device.expect(Result.OK, MessageType.FOLLOW, _follow(100))
    payload = device.arm_payload(max_samples=109)
    device.expect(Result.BEYOND_LIMITS, MessageType.ARM, payload, "with 110 samples where 109 are agreed")
    device.arm(max_samples=110)


@clause("4.5c", marked("Blocks that are empty, odd, in the stimulus, over-long or of another run are refused"))
def _wrong_blocks(device: DeviceUnderTest) -> None:
    follow = BUFFER + 1000
    _armed(device, stimulus=10, follow=follow)
    zeros = np.zeros(50, "<i2")
    device.expect_each(
        Result.BAD_ARGUMENT,
        (MessageType.SETPOINTS, _block(10, zeros[:0]), "without codes"),
        (MessageType.SETPOINTS, _block(10, zeros) + b"\0", "with half a code"),
        (MessageType.SETPOINTS, _block(9, zeros), "in the stimulus"),
        (MessageType.SETPOINTS, _block(10 + follow - 49, zeros), "beyond the announced end"),
        (MessageType.SETPOINTS, _block(2**32 - 1, zeros), "at the largest offset"),
        (MessageType.SETPOINTS, b"\7\0\0\0", "without an offset"),
    )
    device.expect(Result.TOO_LARGE, MessageType.SETPOINTS, _block(10 + BUFFER - 49, zeros), "beyond the buffer")
    device.expect(Result.BAD_STATE, MessageType.SETPOINTS, _block(10, zeros, token=8), "with another token")
    last = _block(10 + BUFFER - 50, zeros)
    device.expect(Result.OK, MessageType.SETPOINTS, last, "at the buffer's end: next missing sample", detail=10)
    device.expect(Result.OK, MessageType.SETPOINTS, _block(10, zeros), "before: next missing sample", detail=60)


@clause("4.5d", marked("A block with one set-point above the force limit is refused as a whole"), drives=True)
def _too_strong(device: DeviceUnderTest) -> None:
    low, lead = 0.5 * device.force_n, round(0.1 * device.rate_hz)
    device.stream()
    device.load(np.zeros(lead, "<i2"))
    device.expect(Result.OK, MessageType.FOLLOW, _follow(100))
    device.keep_alive(True)
    device.arm(max_force_n=low)
    for sign in (1.0, -1.0):
        codes = np.zeros(100, "<i2")
        codes[-1] = device.codes(sign * 1.1 * low)[0]
        device.expect(Result.BEYOND_LIMITS, MessageType.SETPOINTS, _block(lead, codes), "10 % above the force limit")
    run = device.finish_run(device.start(), 2.0)
    require_status(run.status, held_samples=100)
    require(not run.samples["command"].any(), "no set-point of a refused block", "a command")


@clause("4.5e", marked("Set-points are played as sent; the newest code counts, a replayed block does not"), drives=True)
def _played(device: DeviceUnderTest) -> None:
    lead = round(0.1 * device.rate_hz)
    _armed(device, stimulus=lead, follow=300)
    wave = 0.3 * np.sin(np.arange(300) / 300.0 * 2.0 * np.pi) * float(device.codes(device.force_n)[0])
    wanted = np.rint(wave).astype("<i2")
    old = _block(lead, np.zeros(100, "<i2"))
    first = device.ask(MessageType.SETPOINTS, old, sequence=0x5000)
    require(first.result == Result.OK, "OK to SETPOINTS", first.result)
    for offset in (200, 0, 100):
        device.expect(Result.OK, MessageType.SETPOINTS, _block(lead + offset, wanted[offset : offset + 100]))
    again = device.ask(MessageType.SETPOINTS, old, sequence=0x5000)
    require((again.result, again.detail) == (first.result, first.detail), "the first answer to a replayed block", again)
    run = device.finish_run(device.start(), 2.0)
    played = run.samples[lead : lead + 300]
    limited = run.flagged(Flag.LIMITED)[lead : lead + 300]
    different = (played["command"] != wanted) & ~limited
    require(not different.any(), "the newest codes in the command channel", f"{np.count_nonzero(different)} others")
    require_status(run.status, held_samples=0)


@clause("4.5f", marked("Missing set-points: a ramp to the hold level, and a return, all flagged"), drives=True)
def _held(device: DeviceUnderTest) -> None:
    lead, ramp, fade = (round(share * device.rate_hz) for share in (0.1, 0.05, 0.005))
    level, hold = float(device.codes(0.2 * device.force_n)[0]), float(device.codes(0.1 * device.force_n)[0])
    size, back, end = ramp, round(0.35 * device.rate_hz), round(0.5 * device.rate_hz)
    _armed(device, stimulus=lead, follow=end, hold=int(hold))
    for offset in (0, back):
        device.expect(Result.OK, MessageType.SETPOINTS, _block(lead + offset, np.full(size, level)))
    run = device.finish_run(device.start(), 3.0)
    fall = level + (hold - level) * (1.0 + np.arange(ramp)) / ramp
    expected = np.full(end, hold)
    expected[:size] = level
    expected[size : size + ramp] = fall
    expected[back : back + size] = level
    expected[back : back + fade] = hold + (level - hold) * (1.0 + np.arange(fade)) / (fade + 1)
    expected[back + size : back + size + ramp] = fall
    played = run.samples["command"][lead : lead + end].astype(np.float64)
    require(played.size == end, f"{end} set-points", played.size)
    free = ~run.flagged(Flag.LIMITED)[lead : lead + end]
    worst = float(np.abs(played - expected)[free].max(initial=0.0))
    require(worst <= STEP, "the ramp, the hold level and the return", f"{worst:.0f} codes from it")
    held = np.ones(end, dtype=bool)
    held[:size] = held[back + fade : back + size] = False
    wrong = np.count_nonzero(run.flagged(Flag.HELD)[lead : lead + end] != held)
    require(wrong == 0, "flag 16 on every sample that is not the host's", f"{wrong} wrong")
    require_status(run.status, held_samples=int(np.count_nonzero(held)))


@clause("4.5g", marked("A late block is LATE and counted, and its rest is played"), drives=True)
def _late(device: DeviceUnderTest) -> None:
    lead = round(0.05 * device.rate_hz)
    most = (wire.MAX_PAYLOAD - 8) // 2
    level = int(device.codes(0.2 * device.force_n)[0])
    _armed(device, stimulus=lead, follow=most)
    first = device.start()
    device.pump(0.15)
    device.expect(Result.LATE, MessageType.SETPOINTS, _block(lead, np.full(most, level)))
    device.expect(Result.LATE, MessageType.SETPOINTS, _block(lead, np.full(10, level)))
    run = device.finish_run(first, 3.0)
    require_status(run.status, late_blocks=2)
    end = run.samples["command"][lead + most - 10 : lead + most]
    free = ~run.flagged(Flag.LIMITED)[lead + most - 10 : lead + most]
    require((end[free] == level).all(), "the rest of a late block to be played", end.tolist())


@clause("4.5h", marked("The coil is released with STARVED after 0.5 s without set-points"), drives=True)
def _starved(device: DeviceUnderTest) -> None:
    lead = round(0.05 * device.rate_hz)
    _armed(device, stimulus=lead, follow=round(2.0 * device.rate_hz))
    run = device.finish_run(device.start(), 2.0)
    require_status(run.status, faults=Fault.STARVED)
    held = int(np.count_nonzero(run.flagged(Flag.HELD)))
    expected = round(0.5 * device.rate_hz)
    require(abs(held - expected) <= 2, f"{expected} held samples", held)
    on = np.flatnonzero(run.flagged(Flag.ENERGISED))
    require(on.size and on[-1] <= lead + expected + 1, f"the amplifier off after sample {lead + expected}", on[-1:])


@clause("4.5i", marked("A block after the run is LATE and not counted; FOLLOW holds for one run"), drives=True)
def _over(device: DeviceUnderTest) -> None:
    lead = round(0.05 * device.rate_hz)
    _armed(device, stimulus=lead, follow=10)
    device.finish_run(device.start(), 2.0)
    device.expect(Result.LATE, MessageType.SETPOINTS, _block(lead, np.zeros(10)), "after the run")
    require_status(device.require_state(State.LOADED), late_blocks=0)
    device.arm(max_samples=lead)
    device.expect(Result.BAD_ARGUMENT, MessageType.SETPOINTS, _block(lead, np.zeros(10)), "without a new FOLLOW")
    device.expect(Result.OK, MessageType.STOP)
    device.expect(Result.LATE, MessageType.SETPOINTS, struct.pack("<IIh", 7, lead, 0), "after STOP")
