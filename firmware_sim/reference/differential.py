"""Differential test: the C and the Python firmware answer the same traffic with the same bytes.

``python -m firmware_sim.reference.differential --frames 1000000`` measures it; the traffic follows from the seed alone.
"""

from __future__ import annotations

import argparse
import struct
import sys
import time
import zlib
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any, cast

import numpy as np

from firmware_sim.bench import Bench
from firmware_sim.firmware import Firmware
from firmware_sim.identity import Identity
from firmware_sim.reference.emulator import EmulatedLockstep
from firmware_sim.reference.lockstep import Disturbance, Lockstep
from firmware_sim.reference.script_bench import ScriptBench
from tissueid import wire
from tissueid.wire import MessageType

_IDENTITY = Identity(
    model="desktop indenter (reference)", serial_number="REF-0001", firmware_version="ref-1.0", stage=True
)
_NAN, _INFINITE = float("nan"), float("inf")
_FORCES = (1.0, 2.0, 5.0, 12.0, 12.0, 15.0, 15.1, 0.0, 5e-324, -1.0, _NAN, _INFINITE)
_LOWS = (-1e-3, 0.0, 0.0, 0.0003, 0.005, 0.016, -2e-3, _NAN, -_INFINITE)
_HIGHS = (0.033, 0.0317, 0.032, 0.032, 0.02, 0.0331, 0.001, _NAN, _INFINITE)
_TEMPERATURES = (20.0, -1e308, 80.0, 80.0, 85.0, 85.0, 90.0, _NAN, _INFINITE)
_STAGES = (0.0, 0.01, 0.032, 0.04, -1.0, _NAN, _INFINITE)
_SIZES = (0, 1, 5, 50, 200, 400, 400, 1000, 240_000, 240_001, 2**32 - 1)


class Traffic:
    """Random traffic of a host: requests that often fit the state, wrong ones, and damaged bytes.

    Args:
        seed: of the random numbers.
        without: types that are not sent.
    """

    def __init__(self, seed: int, without: tuple[int, ...] = ()) -> None:
        self._random = Random(seed)
        self._without = without
        self._number = 0
        self._newest = b""

    def bursts(self) -> Iterator[tuple[bytes, int]]:
        """Yield bytes for the firmware and the number of frames in them, without end."""
        while True:
            frames = self._run() if self._random.random() < 0.1 else [self._single()]
            data = b"".join(self._damaged(frame) for frame in frames)
            yield data, len(frames)

    def _frame(self, kind: int, payload: bytes = b"") -> bytes:
        self._number = (self._number + 1) & 0xFFFF
        return wire.encode_frame(wire.Frame(kind, self._number, payload=payload))

    def _codes(self, count: int, most: int) -> bytes:
        return struct.pack(f"<{count}h", *(self._random.randint(-most, most) for _ in range(count)))

    def _run(self) -> list[bytes]:
        """Return the requests of a whole run, which a random one rarely is."""
        choose = self._random.choice
        samples, most = choose((5, 50, 400)), choose((0, 300, 3000, 20_000))
        codes = self._codes(samples, most)
        force, low, high = choose((12.0, 15.0)), choose((0.0, 0.0003)), 0.032
        frames = [
            self._frame(MessageType.HELLO, wire.pack(wire.HELLO, protocol_min=1, protocol_max=1, host=b"x")),
            self._frame(MessageType.CLEAR_FAULTS),
            self._frame(MessageType.STREAM, b"\1"),
            self._frame(MessageType.STIMULUS_BEGIN, struct.pack("<III", 1, samples, zlib.crc32(codes))),
            self._frame(MessageType.STIMULUS_CHUNK, struct.pack("<II", 1, 0) + codes),
            self._frame(MessageType.STIMULUS_COMMIT, struct.pack("<I", 1)),
        ]
        if choose((True, False)):
            frames.append(self._frame(MessageType.FOLLOW, struct.pack("<IIh", 1, choose((50, 2000)), choose((0, 500)))))
        frames.append(
            self._frame(MessageType.ARM, struct.pack("<IIddddI", 5, 1, force, low, high, 80.0, choose((5000, 10_000))))
        )
        frames.append(self._frame(MessageType.START, struct.pack("<I", 5)))
        return frames

    def _single(self) -> bytes:
        choose, pick = self._random.choice, self._random.randrange
        if self._newest and self._random.random() < 0.05:
            return self._newest  # a repeated frame
        kind = choose(
            [*MessageType, MessageType.HEARTBEAT, MessageType.HEARTBEAT, MessageType.SETPOINTS, MessageType.SETPOINTS]
        )
        if self._random.random() < 0.02:
            kind = pick(256)
        if kind in self._without:
            kind = MessageType.HEARTBEAT
        payload = self._payload(kind)
        if self._random.random() < 0.03:
            payload = payload[: pick(len(payload) + 1)] if choose((True, False)) else payload + bytes(pick(9))
        self._newest = self._frame(kind, payload[: wire.MAX_PAYLOAD])
        return self._newest

    def _payload(self, kind: int) -> bytes:
        choose, pick = self._random.choice, self._random.randrange
        identity, token = choose((1, 1, 1, 2)), choose((5, 5, 5, 6))
        match kind:
            case MessageType.HELLO:
                low, high = choose(((1, 1), (1, 3), (0, 9), (2, 3), (0, 0)))
                return wire.pack(wire.HELLO, protocol_min=low, protocol_max=high, host=b"host")
            case MessageType.STREAM:
                return bytes((choose((0, 1, 1, 7)),))
            case MessageType.STIMULUS_BEGIN:
                return struct.pack("<III", identity, choose(_SIZES), choose((0, pick(2**32))))
            case MessageType.STIMULUS_CHUNK:
                head = struct.pack("<II", identity, choose((0, 0, 3, 200, 2**32 - 1)))
                return head + self._codes(choose((0, 1, 5, 50, 1000)), 3000)
            case MessageType.STIMULUS_COMMIT:
                return struct.pack("<I", identity)
            case MessageType.FOLLOW:
                samples = choose((0, 1, 50, 2000, 179_000, 180_000, 2**32 - 1))
                return struct.pack("<IIh", identity, samples, choose((0, 500, -500, 32767, -32768)))
            case MessageType.SETPOINTS:
                offset = choose((0, 5, 50, 55, 100, 400, 450, 500, 8500, 2**32 - 1)) + choose((0, pick(100)))
                codes = self._codes(choose((0, 1, 50, 50, 50, 1000)), choose((500, 500, 32767)))
                return struct.pack("<II", token, offset & 0xFFFFFFFF) + codes
            case MessageType.ARM:
                limits = (choose(_FORCES), choose(_LOWS), choose(_HIGHS), choose(_TEMPERATURES))
                return struct.pack(
                    "<IIddddI", token, identity, *limits, choose((0, 400, 5000, 180_000, 180_001, 2**32 - 1))
                )
            case MessageType.START:
                return struct.pack("<I", token)
            case MessageType.STAGE:
                return struct.pack("<d", choose(_STAGES))
            case MessageType.STOP | MessageType.RELEASE | MessageType.FINISH | MessageType.CLEAR_FAULTS:
                return bytes(choose((0, 0, 3)))
        return b""

    def _damaged(self, frame: bytes) -> bytes:
        chance, pick = self._random.random(), self._random.randrange
        if chance < 0.92:
            return frame
        if chance < 0.95:
            at = pick(len(frame))
            return frame[:at] + bytes((frame[at] ^ (1 << pick(8)),)) + frame[at + 1 :]
        if chance < 0.97:
            return frame[: pick(len(frame))]
        if chance < 0.98:
            return self._random.randbytes(pick(40)) + frame
        if chance < 0.985:
            return self._random.randbytes(4).replace(b"\0", b"\1") * pick(1200) + frame
        if chance < 0.99:
            return b"\0" * pick(4) + frame
        return frame + frame


def compare(program: Path, *, frames: int, seed: int, quick: bool = True) -> tuple[int, int]:
    """Compare the two firmwares on random traffic; return the number of frames and of compared bytes.

    Args:
        program: the built POSIX board.
        frames: number of frames of the host, at least.
        seed: of the traffic.
        quick: few samples between the frames; else also whole runs.

    Raises:
        AssertionError: the firmwares differ; the message says where.
    """
    random, traffic = Random(seed + 1), Traffic(seed).bursts()
    bench = ScriptBench()
    python = Firmware(cast(Bench, bench), _IDENTITY, seed=seed)
    now_us = sent = received = 0
    with Lockstep(program, "--plant", "script", "--boot-id", str(python.boot_id), "--stage", "0") as device:
        while sent < frames:
            data, count = next(traffic)
            sent += count
            device.receive(data, now_us)
            # Frame by frame: the Python firmware decodes a chunk whole before it handles the first frame.
            *ended, rest = data.split(b"\0")
            for piece in (*(piece + b"\0" for piece in ended), rest):
                python.receive(piece, now_us / 1e6)
            samples = random.choice((0, 0, 1, 2, 3) if quick else (0, 1, 5, 20, 60, 200))
            # Never a whole number of half milliseconds after a heartbeat, where rounding would decide.
            now_us += 500 * samples + (random.randrange(1000, 700_000) // 500 * 500 if random.random() < 0.003 else 0)
            device.advance(samples, now_us + 137)
            for _ in range(samples):
                python.advance(1, (now_us + 137) / 1e6)
            if random.random() < 0.01:
                _disturb(random, device, bench)
            if random.random() < 0.3 or sent >= frames:
                received += _same(device.transmit(), python.transmit(now_us / 1e6), sent)
    return sent, received


def compare_boards(program: Path, emulated: Path, *, frames: int, seed: int) -> tuple[int, int]:
    """Compare the firmware on this computer with the cross-compiled one; return the numbers of frames and bytes.

    Handshake and stage differ by their boards. A heartbeat before each burst keeps the watchdog of both quiet: their
    clocks differ by microseconds.

    Args:
        program: the built POSIX board.
        emulated: the built QEMU target.
        frames: number of frames of the host, at least.
        seed: of the traffic.

    Raises:
        AssertionError: the firmwares differ; the message says where.
        MissingToolError: QEMU is not installed.
    """
    random, traffic = Random(seed + 1), Traffic(seed, without=(MessageType.STAGE,)).bursts()
    heartbeat = wire.encode_frame(wire.Frame(MessageType.HEARTBEAT))
    now_us = sent = received = 0
    with (
        Lockstep(program, "--plant", "script", "--boot-id", "1") as one,
        EmulatedLockstep(emulated, "script", boot_id=1) as other,
    ):
        while sent < frames:
            data, count = next(traffic)
            data = heartbeat + data
            sent += count + 1
            one.receive(data, now_us)
            other.receive(data)
            samples = random.choice((0, 1, 5, 20, 60, 200))
            now_us += 500 * samples
            one.interrupts(samples)
            other.interrupts(samples)
            if random.random() < 0.05:
                now = Disturbance(random.choice((0, 0, 0, 1, 2, 4, 8)))
                one.disturb(now)
                other.disturb(now)
            here, there = _without_handshake(one.transmit()), _without_handshake(other.transmit())
            received += _same(here, there, sent, ("here", "emulated"))
    return sent, received


def _without_handshake(data: bytes) -> bytes:
    pieces = []
    for piece in data.split(b"\0")[:-1]:
        (frame,) = wire.FrameDecoder().feed(piece + b"\0")
        pieces += [] if frame.type == MessageType.HELLO_ACK else [piece + b"\0"]
    return b"".join(pieces)


def _disturb(random: Random, device: Lockstep, bench: ScriptBench) -> None:
    now = Disturbance(random.choice((0, 0, 0, 0, 0, 1, 2, 4, 8)))
    device.disturb(now)
    bench.button = Disturbance.BUTTON in now
    bench.supply_share = 0.1 if Disturbance.SUPPLY_LOW in now else 1.0
    bench.position_stuck = Disturbance.POSITION_STUCK in now
    bench.coil_open = Disturbance.COIL_OPEN in now


def _same(reference: bytes, python: bytes, sent: int, names: tuple[str, str] = ("C", "Python")) -> int:
    if reference != python:
        one, other = _shown(reference), _shown(python)
        at = next((k for k, (a, b) in enumerate(zip(one, other, strict=False)) if a != b), min(len(one), len(other)))
        raise AssertionError(
            f"after {sent} frames, answer {at}: {names[0]} {one[at : at + 1]}, {names[1]} {other[at : at + 1]}"
        )
    return len(python)


def _shown(data: bytes) -> list[Any]:
    found = []
    for frame in wire.FrameDecoder().feed(data):
        payload: Any = frame.payload
        if frame.type == MessageType.ACK:
            payload = wire.unpack(wire.ACK, frame.payload)[0]
        elif frame.type == MessageType.STATUS:
            payload = wire.unpack(wire.STATUS, frame.payload, tail=True)
        elif frame.type == MessageType.DATA:
            payload = np.frombuffer(frame.payload, wire.SAMPLE).tolist()
        found.append((frame.type, frame.sequence, frame.sample_index, payload))
    return found


def main() -> int:
    """Compare a number of frames and print the result; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--program", type=Path, default=None, help="built POSIX board; default: build it")
    parser.add_argument("--long", action="store_true", help="whole runs between the frames")
    options = parser.parse_args()
    program = options.program
    if program is None:
        from firmware_sim.reference.build import build_posix

        program = build_posix()
    begin = time.monotonic()
    try:
        sent, received = compare(program, frames=options.frames, seed=options.seed, quick=not options.long)
    except AssertionError as error:
        print(f"differential: {error}", file=sys.stderr)
        return 1
    seconds = time.monotonic() - begin
    print(f"{sent} frames, {received} bytes of answers, no difference ({seconds:.0f} s, seed {options.seed})")
    return 0


if __name__ == "__main__":
    sys.exit(main())
