"""Sender of set-points: repeats blocks until they are acknowledged or too late, and counts late ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from tissueid.errors import TissueIDError
from tissueid.instrument.replies import refusal
from tissueid.wire import MessageType, Result

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
