"""The samples of a run in engineering units, and the set points that a test sends during it."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import tissueid.wire as wire
from tissueid.errors import LinkLostError, TissueIDError
from tissueid.instrument.handshake import Handshake
from tissueid.instrument.interface import SAMPLE, SIGNALS, Gap, empty_samples, join_blocks
from tissueid.instrument.replies import refusal
from tissueid.messages import Message
from tissueid.wire import Flag, Frame, MessageType, Result

log = logging.getLogger(__name__)

REPEAT_S = 0.03
"""Time after which a block without an acknowledgement is sent again, s: about the duration of a block."""


@dataclass
class _Block:
    """Set-points ``offset`` to ``end`` of a run as a frame, and the time of its last sending."""

    offset: int
    end: int
    frame: bytes
    sent_s: float


class SetpointSender:
    """Sends the blocks of one run without waiting for their acknowledgements.

    ``late_blocks`` and ``repeated_blocks`` count blocks. ``margin_samples`` is the least time, in samples, between the
    arrival of a block and its first sample. ``refused`` is the error of the first block that the firmware refused.
    """

    def __init__(self, write: Callable[[bytes], None], clock: Callable[[], float]) -> None:
        self._write = write
        self._clock = clock
        self._waiting: dict[int, _Block] = {}
        self.reset()

    def reset(self) -> None:
        """Begin a new run: forget blocks, counts and errors."""
        self.late_blocks = self.repeated_blocks = 0
        self.margin_samples: int | None = None
        self.refused: TissueIDError | None = None
        self._waiting.clear()

    def stop(self) -> None:
        """End the run: forget blocks that are not acknowledged, and their errors."""
        self.refused = None
        self._waiting.clear()

    def put(self, sequence: int, offset: int, end: int, frame: bytes) -> None:
        """Send the frame of one block, with set-points ``offset`` to ``end``."""
        self._waiting[sequence] = _Block(offset, end, frame, self._clock())
        self._write(frame)

    def acknowledge(self, ack: dict[str, Any], answered_at: int | None) -> None:
        """Process the ACK of a block. ``answered_at`` is the sample of the run at which the firmware sent it."""
        block = self._waiting.pop(ack["request_sequence"], None)
        if block is None:
            return  # a repeated answer, or one of an earlier run
        if answered_at is not None:
            margin = block.offset - answered_at
            self.margin_samples = margin if self.margin_samples is None else min(margin, self.margin_samples)
        if ack["result"] == Result.LATE:
            self.late_blocks += 1
        elif ack["result"] != Result.OK and self.refused is None:
            self.refused = refusal(MessageType.SETPOINTS, ack["result"], ack["detail"])

    def repeat(self, played: int) -> None:
        """Send lost blocks again, except those that end before sample ``played``."""
        now = self._clock()
        for sequence, block in list(self._waiting.items()):
            if block.end <= played:
                del self._waiting[sequence]
            elif now - block.sent_s >= REPEAT_S:
                block.sent_s = now
                self.repeated_blocks += 1
                self._write(block.frame)


MAX_GAP_S = 5.0
"""Longest gap in the samples that the link may have, s; a longer one counts as a lost link."""


_HELD = int(Flag.HELD)


class SampleStream:
    """Samples in the order of their index, each once.

    ``next_index`` is the index of the next sample; None before the first. ``received`` counts received samples,
    ``held_samples`` those with the flag HELD. ``gaps`` lists lost samples.
    """

    def __init__(self) -> None:
        self.gaps: list[Gap] = []
        self.next_index: int | None = None
        self.held_samples = self.received = 0
        self.newest: NDArray[np.void] | None = None
        """The samples of the newest frame; None before the first."""
        self._hello: Handshake | None = None
        self._ready: list[NDArray[np.void]] = []

    def begin(self, hello: Handshake) -> None:
        """Begin the stream of a device: forget earlier samples and gaps."""
        self._hello = hello
        self.gaps.clear()
        self.next_index = self.newest = None
        self._ready.clear()

    def __bool__(self) -> bool:
        return bool(self._ready)

    def drain(self) -> NDArray[np.void]:
        """Return all samples since the last call, shape (k,) of SAMPLE, k >= 0."""
        samples = join_blocks(self._ready)
        self._ready.clear()
        return samples

    def take(self, frame: Frame) -> NDArray[np.void]:
        """Return the new samples of one DATA frame, shape (k,) of SAMPLE, with the lost ones before it.

        Raises:
            LinkLostError: the gap is longer than ``MAX_GAP_S``.
            PayloadError: the payload is empty or ends within a sample.
        """
        if self._hello is None:
            return empty_samples(0, 0)  # sent before the handshake: the scales are not known yet
        if self.next_index is not None and frame.sample_index < self.next_index:
            return empty_samples(0, 0)  # a duplicate, or late: already filled in
        if not frame.payload or len(frame.payload) % wire.SAMPLE.itemsize:
            raise wire.PayloadError("a data frame holds no sample, or part of one")
        lost: NDArray[np.void] | None = None
        if self.next_index is not None and frame.sample_index > self.next_index:
            missing = frame.sample_index - self.next_index
            if missing > MAX_GAP_S * self._hello.device.sample_rate_hz:
                raise LinkLostError(
                    Message(
                        "link.gap",
                        "{missing} samples are missing at once; the connection is not reliable: check the cable, and "
                        "connect again",
                        missing=missing,
                    )
                )
            self.gaps.append(Gap(self.next_index, missing))
            log.warning("%d samples lost from sample %d on", missing, self.next_index)
            lost = empty_samples(self.next_index, missing)
            self._ready.append(lost)
        codes = np.frombuffer(frame.payload, wire.SAMPLE)
        samples = np.zeros(codes.size, SAMPLE)
        samples["index"] = frame.sample_index + np.arange(codes.size)
        samples["flags"] = codes["flags"]
        for channel, name in enumerate(SIGNALS):
            samples[name] = codes[name] * self._hello.gains[channel] + self._hello.offsets[channel]
        self._ready.append(samples)
        self.newest = samples
        self.held_samples += int(np.count_nonzero(codes["flags"] & _HELD))
        self.next_index = frame.sample_index + codes.size
        self.received += codes.size
        return samples if lost is None else np.concatenate((lost, samples))
