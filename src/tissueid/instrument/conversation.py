"""Requests to a device and their answers: numbered, repeated until answered, and the heartbeat between them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tissueid import wire
from tissueid.errors import LinkLostError, TissueIDError
from tissueid.instrument.answers import refusal
from tissueid.instrument.link import Link
from tissueid.wire import Frame, MessageType, Result

HEARTBEAT_S = 0.1
ANSWER_S = 0.3
"""How long to wait for an answer before the request is sent again."""
TRIES = 5


class Conversation:
    """The host's side of the requests on one link.

    ``pump`` reads the link once, waiting up to so many seconds, and hands every ACK to ``take``. ``repeated`` counts
    the requests that were sent again; ``unanswered`` says that the newest was given up. ``untold`` gives what went
    wrong meanwhile and nobody was told of yet: it is why a request is refused.
    """

    def __init__(
        self,
        link: Link,
        clock: Callable[[], float],
        pump: Callable[[float], None],
        untold: Callable[[], TissueIDError | None] = lambda: None,
    ) -> None:
        self.repeated = 0
        self.unanswered = False
        self._untold = untold
        self._link = link
        self._clock = clock
        self._pump = pump
        self._sequence = 0
        self._ack: dict[str, Any] | None = None
        self._last_heartbeat = clock()

    def number(self) -> int:
        """The next sequence number, which is then taken."""
        sequence, self._sequence = self._sequence, (self._sequence + 1) & 0xFFFF
        return sequence

    def send(self, kind: MessageType, payload: bytes = b"", sequence: int | None = None) -> None:
        """Send a message and wait for nothing."""
        number = self.number() if sequence is None else sequence
        self._link.write(wire.encode_frame(Frame(kind, number, payload=payload)))

    def beat(self, *, force: bool = False) -> None:
        """Send a heartbeat when one is due."""
        now = self._clock()
        if force or now - self._last_heartbeat >= HEARTBEAT_S:
            self._last_heartbeat = now
            self.send(MessageType.HEARTBEAT)

    def take(self, ack: dict[str, Any]) -> None:
        """An answer has arrived."""
        self._ack = ack

    def ask(self, kind: MessageType, payload: bytes = b"", *, tries: int = TRIES) -> tuple[int, int]:
        """The result of a request and its detail. A repeat has the same number, so that it acts only once.

        Raises:
            LinkLostError: no answer, however often it was asked.
        """
        sequence = self.number()
        for attempt in range(tries):
            self.send(kind, payload, sequence)
            self.repeated += attempt > 0
            deadline = self._clock() + ANSWER_S
            while self._clock() < deadline:
                self._ack = None
                self._pump(0.02)
                ack = self._ack
                if ack and ack["request_type"] == kind and ack["request_sequence"] == sequence:
                    self.unanswered = False
                    return ack["result"], int(ack["detail"])
        self.unanswered = True
        raise LinkLostError(f"{self._link.name} does not answer {kind.name}; check the cable and the power")

    def request(self, kind: MessageType, payload: bytes = b"", *, tries: int = TRIES) -> int:
        """The detail of a request that is obeyed.

        Raises:
            TissueIDError: it is refused; the kind of error says why.
            LinkLostError: no answer.
        """
        result, detail = self.ask(kind, payload, tries=tries)
        if result != Result.OK:
            raise self._untold() or refusal(kind, result, detail)
        return detail
