"""Set-points on their way to the firmware: sent again until they are acknowledged or past, the late ones counted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from tissueid.errors import TissueIDError
from tissueid.instrument.answers import refusal
from tissueid.wire import MessageType, Result

REPEAT_S = 0.03
"""About the time of a block: one that was not acknowledged by then is taken to be lost."""


@dataclass
class _Block:
    """Set-points ``offset`` to ``end`` of a run, as a frame, and when it was sent last."""

    offset: int
    end: int
    frame: bytes
    sent_s: float


class SetpointSender:
    """The blocks of one run that nobody has acknowledged yet. Never waits for an answer.

    ``late_blocks`` and ``repeated_blocks`` count; ``margin_samples`` is the least time, in samples, by which a block
    was in the firmware before it had to be played; ``refused`` is the first answer that means the run is over.
    """

    def __init__(self, write: Callable[[bytes], None], clock: Callable[[], float]) -> None:
        self._write = write
        self._clock = clock
        self._waiting: dict[int, _Block] = {}
        self.reset()

    def reset(self) -> None:
        """A new run: nothing sent, nothing late."""
        self.late_blocks = self.repeated_blocks = 0
        self.margin_samples: int | None = None
        self.refused: TissueIDError | None = None
        self._waiting.clear()

    def stop(self) -> None:
        """The run is over: what is still on its way does not matter any more, nor what comes of it."""
        self.refused = None
        self._waiting.clear()

    def put(self, sequence: int, offset: int, end: int, frame: bytes) -> None:
        """Send one block, as a frame with that sequence number."""
        self._waiting[sequence] = _Block(offset, end, frame, self._clock())
        self._write(frame)

    def acknowledge(self, ack: dict[str, Any], answered_at: int | None) -> None:
        """The answer to a block; ``answered_at`` is the number of the sample that was next when it was given."""
        block = self._waiting.pop(ack["request_sequence"], None)
        if block is None:
            return  # a second answer, or of a run that is over
        if answered_at is not None:
            margin = block.offset - answered_at
            self.margin_samples = margin if self.margin_samples is None else min(margin, self.margin_samples)
        if ack["result"] == Result.LATE:
            self.late_blocks += 1
        elif ack["result"] != Result.OK and self.refused is None:
            self.refused = refusal(MessageType.SETPOINTS, ack["result"], ack["detail"])

    def repeat(self, played: int) -> None:
        """Send again what seems to be lost; what lies before sample ``played`` is given up."""
        now = self._clock()
        for sequence, block in list(self._waiting.items()):
            if block.end <= played:
                del self._waiting[sequence]
            elif now - block.sent_s >= REPEAT_S:
                block.sent_s = now
                self.repeated_blocks += 1
                self._write(block.frame)
