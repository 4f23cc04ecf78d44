"""Clauses of docs/protocol.md, sections 4.3, 4.4, 4.6 and 4.7: stimulus, states, ending early, stage."""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

import tissueid.wire as wire
from tissueid.language import marked
from tissueid.wire import Fault, Flag, MessageType, Result, State
from tissueid_lab.conformance.clause import clause, require
from tissueid_lab.conformance.device import DeviceRun, DeviceUnderTest
from tissueid_lab.conformance.exchange import require_status

RAMP_S = 0.05
STEP = 2
"""Difference between an expected and a played code that is accepted, in codes."""


def _begin(samples: int, crc: int = 0, identity: int = 1) -> bytes:
    return wire.pack(wire.STIMULUS_BEGIN, stimulus_id=identity, samples=samples, crc32=crc)


def gentle(device: DeviceUnderTest, seconds: float) -> NDArray[np.int16]:
    """Return codes of a sine of half the confirmed force that begins gradually."""
    time_s = np.arange(round(seconds * device.rate_hz)) / device.rate_hz
    wave = 0.5 * np.sin(2.0 * np.pi * 5.0 * time_s) * np.minimum(time_s / 0.2, 1.0)
    return np.rint(wave * float(device.codes(device.force_n)[0])).astype("<i2")


def require_released(device: DeviceUnderTest, run: DeviceRun, end: int) -> None:
    """Require the soft release from sample ``end`` of a run on: 50 ms to zero, amplifier on, then off."""
    ramp = round(RAMP_S * device.rate_hz)
    released = run.samples[end : end + ramp]
    require(released.size == ramp, f"{ramp} samples of the release", released.size)
    on, playing = run.flagged(Flag.ENERGISED), run.flagged(Flag.PLAYING)
    require(on[: end + ramp].all(), "the amplifier enabled to the end of the release", int(np.argmin(on)))
    require(not playing[end:].any(), f"no sample of the stimulus from {end} on", int(np.count_nonzero(playing[end:])))
    require(not on[end + ramp :].any(), f"the amplifier off after {end + ramp} samples", int(np.count_nonzero(on)))
    last = float(run.samples["command"][end - 1])
    expected = last * (1.0 - (1.0 + np.arange(ramp)) / ramp)
    worst = float(np.abs(released["command"] - expected).max())
    if not (run.flagged(Flag.LIMITED)[end - 1 : end + ramp]).any():
        require(worst <= STEP, "a straight ramp to zero", f"{worst:.0f} codes from it")


@clause("4.3a", marked("A stimulus of no samples is BAD_ARGUMENT, one that does not fit TOO_LARGE"))
def _sizes(device: DeviceUnderTest) -> None:
    most = device.properties["stimulus_capacity"]
    device.expect(Result.BAD_ARGUMENT, MessageType.STIMULUS_BEGIN, _begin(0), "with 0 samples")
    device.expect(Result.OK, MessageType.STIMULUS_BEGIN, _begin(most), f"with {most} samples")
    for samples in (most + 1, 2**32 - 1):
        device.expect(Result.TOO_LARGE, MessageType.STIMULUS_BEGIN, _begin(samples), f"with {samples} samples")


@clause("4.3b", marked("COMMIT compares the CRC"))
def _checksum(device: DeviceUnderTest) -> None:
    codes = np.arange(20, dtype="<i2").tobytes()
    device.expect(Result.OK, MessageType.STIMULUS_BEGIN, _begin(20, zlib.crc32(codes) ^ 1))
    device.expect(Result.OK, MessageType.STIMULUS_CHUNK, struct.pack("<II", 1, 0) + codes)
    device.expect(Result.CHECKSUM, MessageType.STIMULUS_COMMIT, struct.pack("<I", 1), "with a wrong CRC")
    device.require_state(State.IDLE)


@clause("4.3c", marked("Chunks arrive in any order and more than once; wrong ones are BAD_ARGUMENT"))
def _chunks(device: DeviceUnderTest) -> None:
    codes = np.arange(100, dtype="<i2").tobytes()
    device.expect(Result.OK, MessageType.STIMULUS_BEGIN, _begin(100, zlib.crc32(codes)))
    for offset in (60, 0, 30, 60):
        data = codes[2 * offset : 2 * (offset + 40)]
        payload = struct.pack("<II", 1, offset) + data
        device.expect(Result.OK, MessageType.STIMULUS_CHUNK, payload, detail=offset + len(data) // 2)
    for identity, offset, data in ((1, 99, bytes(4)), (1, 2**32 - 1, bytes(2)), (1, 0, bytes(3)), (2, 0, bytes(2))):
        chunk = struct.pack("<II", identity, offset) + data
        device.expect(Result.BAD_ARGUMENT, MessageType.STIMULUS_CHUNK, chunk, f"{len(data)} bytes at {offset}")
    device.expect(Result.BAD_ARGUMENT, MessageType.STIMULUS_COMMIT, struct.pack("<I", 2), "of another stimulus")
    device.expect(Result.OK, MessageType.STIMULUS_COMMIT, struct.pack("<I", 1), detail=100)


@clause("4.3d", marked("A loaded stimulus can be played again after a new ARM"), drives=True)
def _again(device: DeviceUnderTest) -> None:
    device.play(np.zeros(100, "<i2"))
    device.expect(Result.BAD_STATE, MessageType.START, struct.pack("<I", 7), "without a new ARM")
    device.keep_alive(True)
    device.arm(token=8)
    device.expect(Result.BAD_STATE, MessageType.START, struct.pack("<I", 7), "with the token of the last run")
    run = device.finish_run(device.start(8), 2.0)
    require_status(run.status, state=State.LOADED, played_samples=100)


@clause("4.4a", marked("A request that does not fit the state is BAD_STATE and changes nothing"))
def _states(device: DeviceUnderTest) -> None:
    start = struct.pack("<I", 7)
    device.expect_each(
        Result.BAD_STATE, (MessageType.ARM, device.arm_payload(), "in IDLE"), (MessageType.START, start, "in IDLE")
    )
    device.load(np.zeros(10, "<i2"))
    device.expect_each(
        Result.BAD_STATE,
        (MessageType.STIMULUS_CHUNK, struct.pack("<IIh", 1, 0, 0), "in LOADED"),
        (MessageType.STIMULUS_COMMIT, struct.pack("<I", 1), "in LOADED"),
        (MessageType.START, start, "in LOADED"),
        (MessageType.ARM, device.arm_payload(stimulus_id=2), "of another stimulus"),
    )
    device.arm()
    device.expect_each(
        Result.BAD_STATE,
        (MessageType.ARM, device.arm_payload(), "in ARMED"),
        (MessageType.STIMULUS_BEGIN, _begin(10), "in ARMED"),
        (MessageType.START, struct.pack("<I", 8), "with another token"),
    )
    device.send(MessageType.HEARTBEAT)
    device.require_state(State.ARMED)


@clause("4.4b", marked("STATUS is sent at every change of state"), drives=True)
def _announced(device: DeviceUnderTest) -> None:
    device.play(np.zeros(100, "<i2"))
    states = [item["state"] for item in device.statuses]
    changes = [state for k, state in enumerate(states) if k == 0 or state != states[k - 1]]
    expected = [State.IDLE, State.LOADED, State.ARMED, State.RUNNING, State.LOADED]
    require(changes[-5:] == expected, "IDLE, LOADED, ARMED, RUNNING, LOADED", [State(item).name for item in changes])


@clause("4.4c", marked("A stimulus is played as it was sent, from the sample that START names"), drives=True)
def _played(device: DeviceUnderTest) -> None:
    codes = gentle(device, 0.6)
    run = device.play(codes)
    require_status(run.status, state=State.LOADED, played_samples=codes.size)
    played = run.samples[: codes.size]
    changed = run.flagged(Flag.SOFT_START)[: codes.size] | run.flagged(Flag.LIMITED)[: codes.size]
    require(run.flagged(Flag.PLAYING)[: codes.size].all(), "flag 2 on every sample of the stimulus", "some without")
    different = (played["command"] != codes) & ~changed
    require(not different.any(), "the sent codes in the command channel", f"{np.count_nonzero(different)} others")


@clause("4.4d", marked("The end of a stimulus is a ramp to zero in 50 ms, then the amplifier is off"), drives=True)
def _soft_end(device: DeviceUnderTest) -> None:
    codes = device.codes(0.5 * device.force_n, round(0.3 * device.rate_hz))
    run = device.play(codes)
    require_released(device, run, codes.size)


@clause("4.4e", marked("A device that receives no frame for 2 s stops streaming"))
def _silence(device: DeviceUnderTest) -> None:
    device.stream()
    device.pump(1.7)
    device.blocks.clear()
    device.pump(0.1)
    require(device.blocks, "streaming for 2 s", "an end after 1.7 s")
    device.pump(0.5)
    device.blocks.clear()
    device.pump(0.2)
    require(not device.blocks, "no streaming after 2.3 s of silence", f"{len(device.blocks)} frames")
    require(device.status()["streaming"] == 0, "streaming 0 in STATUS", 1)


@clause("4.6a", marked("FINISH ends a run by the ramp, and returns the number of played samples"), drives=True)
def _finish(device: DeviceUnderTest) -> None:
    first = device.begin_run(device.codes(0.5 * device.force_n, round(2.0 * device.rate_hz)))
    device.pump(0.2)
    answer = device.expect(Result.OK, MessageType.FINISH)
    run = device.finish_run(first, 1.0)
    played = int(np.count_nonzero(run.flagged(Flag.PLAYING)))
    require(answer.detail == played, f"detail {played}, the number of samples with flag 2", answer.detail)
    require_status(run.status, state=State.LOADED, played_samples=played)
    require_released(device, run, played)


@clause("4.6b", marked("FINISH disarms; after a run it returns the number of its samples"), drives=True)
def _finish_elsewhere(device: DeviceUnderTest) -> None:
    device.play(np.zeros(100, "<i2"))
    device.expect(Result.OK, MessageType.FINISH, detail=100)
    device.arm()
    device.expect(Result.OK, MessageType.FINISH)
    device.require_state(State.LOADED, "after FINISH in ARMED")


@clause("4.6c", marked("STOP releases the coil at once"), drives=True)
def _stop(device: DeviceUnderTest) -> None:
    first = device.begin_run(device.codes(0.5 * device.force_n, round(2.0 * device.rate_hz)))
    device.pump(0.2)
    answer = device.expect(Result.OK, MessageType.STOP)
    run = device.finish_run(first, 1.0)
    after = run.flagged(Flag.ENERGISED)[answer.detail + 2 :]
    require(not after.any(), "the amplifier off from the next sample on", f"{np.count_nonzero(after)} samples on")
    require_status(run.status, state=State.LOADED)


@clause("4.7a", marked("STAGE refuses infinite positions and those beyond the stroke, or there is no stage"))
def _stage(device: DeviceUnderTest) -> None:
    for position in (np.inf, -np.inf, -0.001, device.known.device.stroke_m + 0.001):
        answer = device.ask(MessageType.STAGE, struct.pack("<d", position))
        refused = answer.result in (Result.BAD_ARGUMENT, Result.UNKNOWN)
        require(refused, f"BAD_ARGUMENT to STAGE at {position} m", getattr(answer.result, "name", answer.result))


@clause("4.7b", marked("STAGE is refused while a test is armed and while a fault is latched"))
def _stage_states(device: DeviceUnderTest) -> None:
    centre = struct.pack("<d", 0.5 * device.known.device.stroke_m)
    device.load(np.zeros(10, "<i2"))
    device.arm()
    answer = device.ask(MessageType.STAGE, centre)
    if answer.result == Result.UNKNOWN:
        return
    require(answer.result == Result.BAD_STATE, "BAD_STATE to STAGE in ARMED", answer.result)
    device.wait_for_fault(Fault.WATCHDOG, 1.5)
    device.expect(Result.FAULT_LATCHED, MessageType.STAGE, centre, "in FAULT", detail=Fault.WATCHDOG)
