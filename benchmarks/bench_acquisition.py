"""Processing of a sample stream by the host: frames, checksums, scaling, limits, gaps, and the journal."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks import plain_acquisition
from benchmarks.base import Latency
from firmware_sim.bench import Bench
from firmware_sim.firmware import Firmware
from tissueid import wire
from tissueid.acquisition import SessionRecorder
from tissueid.instrument import SIGNALS, Limits, SerialInstrument

Array = NDArray[np.float64]

SECONDS = 10.0
FRAME_S = 0.01
"""Frame period: a device sends a hundred frames a second, and a host reads about as often."""
SHARE = 0.1
"""Largest permitted processor time for the samples of a frame, as a share of the frame period on one core."""
_HEARTBEAT = wire.encode_frame(wire.Frame(wire.MessageType.HEARTBEAT))


class _Tape:
    """Link that records the messages of a simulated device during a test and replays them."""

    def __init__(self, rate: float) -> None:
        self.name = "tape"
        self.firmware = Firmware(Bench("linear-demo", seed=1, sample_rate_hz=rate))
        self.pieces: list[bytes] = []
        self.now = 0.0
        self.playing = False
        self._samples = round(FRAME_S * rate)

    def clock(self) -> float:
        return self.now

    def read(self, _timeout_s: float) -> bytes:
        self.now += FRAME_S
        if self.playing:
            return self.pieces.pop(0)
        self.firmware.advance(self._samples, self.now)
        return self.firmware.transmit(self.now)

    def write(self, data: bytes) -> None:
        if not self.playing:
            self.firmware.receive(data, self.now)

    def close(self) -> None:
        pass


@lru_cache(maxsize=4)
def _stream(rate: float) -> tuple[list[bytes], list[float], list[float]]:
    """Return the messages of a device during a test, in pieces of one frame period, and the scales of its channels."""
    tape = _Tape(rate)
    _started(tape, rate)
    pieces = []
    for _ in range(round(SECONDS / FRAME_S)):
        tape.now += FRAME_S
        tape.firmware.receive(_HEARTBEAT, tape.now)
        tape.firmware.advance(round(FRAME_S * rate), tape.now)
        pieces.append(tape.firmware.transmit(tape.now))
    channels = tape.firmware.bench.channels
    return pieces, [channel.gain for channel in channels], [channel.offset for channel in channels]


def _started(tape: _Tape, rate: float) -> tuple[SerialInstrument, object]:
    """Return a driver with a run that has just started, and the run."""
    instrument = SerialInstrument(tape, clock=tape.clock)
    count = round((SECONDS + 1.0) * rate)
    instrument.load(8.0 + 4.0 * np.sin(2 * np.pi * 20.0 * np.arange(count) / rate))
    instrument.arm(Limits())
    return instrument, instrument.start()


def _record(rate: float) -> tuple[Array, Array]:
    """Return the processor time of each poll with recording, s, shape (k,), and the recorded rows, shape (n, 9)."""
    pieces, _, _ = _stream(rate)
    tape = _Tape(rate)
    with tempfile.TemporaryDirectory() as folder:
        instrument, run = _started(tape, rate)
        recorder = SessionRecorder(Path(folder) / "session.h5", instrument.device)
        recorder.begin_test(run, kind="stochastic", site="", sample_rate_hz=rate)
        tape.pieces, tape.playing = list(pieces), True
        seconds, blocks = [], []
        while tape.pieces:
            begin = time.thread_time()
            samples = instrument.poll(0.05)
            recorder.add(samples)
            seconds.append(time.thread_time() - begin)
            blocks.append(samples)
        recorder.abandon()
    samples = np.concatenate(blocks)
    samples = samples[-round(SECONDS * rate) :]  # without the messages received while the stimulus was sent
    rows = [samples["index"], *(samples[name] for name in SIGNALS), samples["flags"]]
    return np.array(seconds), np.stack(rows, axis=1, dtype=np.float64)


def latencies() -> Iterable[Latency]:
    for rate in (2000.0, 10_000.0):
        pieces, gains, offsets = _stream(rate)

        def plain(
            pieces: list[bytes] = pieces, gains: list[float] = gains, offsets: list[float] = offsets
        ) -> tuple[Array, Array]:
            with tempfile.TemporaryDirectory() as folder:
                return plain_acquisition.record(pieces, gains, offsets, Path(folder) / "rows")

        yield Latency(
            "poll and record",
            f"{FRAME_S * 1e3:g} ms of eight channels at {rate / 1e3:g} kHz, heartbeats and limits among it",
            lambda rate=rate: _record(rate),
            plain,
            tolerance=1e-12,
            limit_s=SHARE * FRAME_S,
        )
