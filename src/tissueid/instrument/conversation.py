"""Requests to a device and their answers: numbered, repeated until answered, and the heartbeat between them."""

from __future__ import annotations

from collections import deque
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
STOP_S = 0.1
"""A release is not waited for so long."""


class Conversation:
    """The host's side of the requests on one link.

    ``pump`` reads the link once, waiting up to so many seconds, and hands every ACK to ``take``. ``repeated`` counts
    the requests that were sent again; ``unanswered`` says that the newest was given up; ``round_trips_s`` are the times
    from a request to its answer, of the newest that were sent but once. ``untold`` gives what went
    wrong meanwhile and nobody was told of yet: it is why a request is refused, or waited for no longer.

    ``silent`` says that the coil is to be free and that the device has not confirmed it yet: there is no heartbeat, so
    that its watchdog frees the coil whatever is lost. It is so from the beginning: a host that died may have left the
    coil on. ``lost`` is why a release was never confirmed: after that nothing but STOP is asked on this link.
    """

    def __init__(
        self,
        link: Link,
        clock: Callable[[], float],
        pump: Callable[[float], None],
        untold: Callable[[], TissueIDError | None] = lambda: None,
    ) -> None:
        self.repeated = 0
        self.round_trips_s: deque[float] = deque(maxlen=64)
        self.unanswered = False
        self.silent = True
        self.lost: LinkLostError | None = None
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
        """Send a heartbeat when one is due, and none while a release is not confirmed."""
        now = self._clock()
        if not self.silent and (force or now - self._last_heartbeat >= HEARTBEAT_S):
            self._last_heartbeat = now
            self.send(MessageType.HEARTBEAT)

    def take(self, ack: dict[str, Any]) -> None:
        """An answer has arrived."""
        self._ack = ack

    def ask(self, kind: MessageType, payload: bytes = b"", *, tries: int = TRIES) -> tuple[int, int]:
        """The result of a request and its detail. A repeat has the same number, so that it acts only once.

        Raises:
            LinkLostError: no answer, however often it was asked; or a release was not confirmed before.
            TissueIDError: something went wrong while the answer was waited for.
        """
        if self.lost is not None:
            raise self.lost
        return self._ask(kind, payload, tries, ANSWER_S)

    def _ask(self, kind: MessageType, payload: bytes, tries: int, patience_s: float) -> tuple[int, int]:
        sequence = self.number()
        for attempt in range(tries):
            self.send(kind, payload, sequence)
            self.repeated += attempt > 0
            sent = self._clock()
            deadline = sent + patience_s
            while self._clock() < deadline:
                self._ack = None
                self._pump(0.02)
                ack = self._ack
                if ack and ack["request_type"] == kind and ack["request_sequence"] == sequence:
                    self.unanswered = False
                    if attempt == 0:  # of one that was repeated nobody knows which of the two is answered
                        self.round_trips_s.append(self._clock() - sent)
                    return ack["result"], int(ack["detail"])
                if kind != MessageType.STOP and (error := self._untold()) is not None:
                    raise error
        self.unanswered = True
        raise LinkLostError(f"{self._link.name} does not answer {kind.name}; check the cable and the power")

    def stop(self, tries: int) -> None:
        """Free the coil, and say nothing that would keep it on until the device has confirmed that it is free.

        Raises:
            LinkLostError: it never did; this link carries no heartbeat any more.
        """
        self.silent = True
        try:
            result, detail = self._ask(MessageType.STOP, b"", tries, STOP_S)
            if result != Result.OK:
                raise refusal(MessageType.STOP, result, detail)
        except TissueIDError as error:
            self.lost = LinkLostError(
                f"{self._link.name} did not confirm the release of the coil, which its watchdog frees: {error}. "
                "Connect again"
            )
            raise self.lost from error
        self.silent = self.lost is not None

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
