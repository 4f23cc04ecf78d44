"""Requests to a device: their payloads, numbers, repeats until they are acknowledged, and the heartbeat."""

from __future__ import annotations

import zlib
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

import tissueid.wire as wire
from tissueid.errors import LinkLostError, TissueIDError
from tissueid.instrument.limits import Limits
from tissueid.instrument.link import Link
from tissueid.instrument.replies import refusal
from tissueid.instrument.sample_stream import SetpointSender
from tissueid.messages import Message
from tissueid.version import SOFTWARE
from tissueid.wire import Frame, MessageType, Result

HEARTBEAT_S = 0.1
"""Time between two heartbeats, s: at most half of the shortest watchdog of a supported device."""
ANSWER_S = 0.3
"""Time for the answer to one attempt of a request, s."""
TRIES = 5
"""Attempts of a request before the link counts as lost."""
STOP_S = 0.1
"""Time for the answer to one attempt of STOP, s: shorter, because the watchdog releases the coil anyway."""
_PUMP_S = 0.02
_ROUND_TRIPS = 64


class RequestChannel:
    """The host's side of the requests on one link.

    Args:
        link: where frames are written.
        clock: monotonic time, s.
        pump: reads the link once, waits up to the given seconds for data and passes every ACK to ``on_ack``.
        take_error: returns an error of the run that has not been raised yet, and marks it as raised; else None.

    ``repeated`` counts the attempts after the first. ``unanswered`` is true when the newest request got no answer.
    ``round_trips_s`` are the newest times from a request to its answer, without repeated requests.

    ``silent`` is true while the coil must be free and the device has not confirmed it: no heartbeat is sent, so the
    watchdog releases the coil even if every frame is lost. It is true at the start, because a host that crashed may
    have left the coil energised. ``lost`` is set when a release was never confirmed; from then on this link sends
    nothing but STOP.
    """

    def __init__(
        self,
        link: Link,
        clock: Callable[[], float],
        pump: Callable[[float], None],
        take_error: Callable[[], TissueIDError | None] = lambda: None,
    ) -> None:
        self.repeated = 0
        self.round_trips_s: deque[float] = deque(maxlen=_ROUND_TRIPS)
        self.unanswered = False
        self.silent = True
        self.lost: LinkLostError | None = None
        self._take_error = take_error
        self._link = link
        self._clock = clock
        self._pump = pump
        self._sequence = 0
        self._ack: dict[str, Any] | None = None
        self._last_heartbeat = clock()

    def next_number(self) -> int:
        """Return the next sequence number and use it up."""
        sequence, self._sequence = self._sequence, (self._sequence + 1) & 0xFFFF
        return sequence

    def send(self, kind: MessageType, payload: bytes = b"", sequence: int | None = None) -> None:
        """Send a message without waiting for an answer."""
        number = self.next_number() if sequence is None else sequence
        self._link.write(wire.encode_frame(Frame(kind, number, payload=payload)))

    def send_heartbeat(self, *, force: bool = False) -> None:
        """Send a heartbeat if one is due or forced. Send none while a release is not confirmed."""
        now = self._clock()
        if not self.silent and (force or now - self._last_heartbeat >= HEARTBEAT_S):
            self._last_heartbeat = now
            self.send(MessageType.HEARTBEAT)

    def on_ack(self, ack: dict[str, Any]) -> None:
        """Receive an ACK."""
        self._ack = ack

    def result_of(self, kind: MessageType, payload: bytes = b"", *, tries: int = TRIES) -> tuple[int, int]:
        """Send a request and return result and detail of its answer. Repeats keep the number, so it acts only once.

        Raises:
            LinkLostError: no attempt was answered, or an earlier release was not confirmed.
            TissueIDError: the run failed while the answer was awaited.
        """
        if self.lost is not None:
            raise self.lost
        return self._result_of(kind, payload, tries, ANSWER_S)

    def _result_of(self, kind: MessageType, payload: bytes, tries: int, timeout_s: float) -> tuple[int, int]:
        sequence = self.next_number()
        for attempt in range(tries):
            self.send(kind, payload, sequence)
            self.repeated += attempt > 0
            sent = self._clock()
            deadline = sent + timeout_s
            while self._clock() < deadline:
                self._ack = None
                self._pump(_PUMP_S)
                ack = self._ack
                if ack and ack["request_type"] == kind and ack["request_sequence"] == sequence:
                    self.unanswered = False
                    if attempt == 0:  # the answer to a repeated request can belong to any of its attempts
                        self.round_trips_s.append(self._clock() - sent)
                    return ack["result"], int(ack["detail"])
                if kind != MessageType.STOP and (error := self._take_error()) is not None:
                    raise error
        self.unanswered = True
        raise LinkLostError(
            Message(
                "link.no_answer",
                "{port} does not answer {request}; check the cable and the power",
                port=self._link.name,
                request=kind.name,
            )
        )

    def stop(self, tries: int) -> None:
        """Release the coil. No heartbeat is sent until the device has confirmed the release.

        Raises:
            LinkLostError: the device did not confirm it; this link sends no heartbeat from now on.
        """
        self.silent = True
        try:
            result, detail = self._result_of(MessageType.STOP, b"", tries, STOP_S)
            if result != Result.OK:
                raise refusal(MessageType.STOP, result, detail)
        except TissueIDError as error:
            self.lost = LinkLostError(
                Message(
                    "link.release_unconfirmed",
                    "{port} did not confirm the release of the coil; its watchdog releases it: {why}. Connect again",
                    port=self._link.name,
                    why=error.message,
                )
            )
            raise self.lost from error
        self.silent = self.lost is not None

    def request(self, kind: MessageType, payload: bytes = b"", *, tries: int = TRIES) -> int:
        """Send a request that must succeed and return the detail of its answer.

        Raises:
            TissueIDError: the device refuses it; the class of the error depends on the result.
            LinkLostError: no attempt was answered.
        """
        result, detail = self.result_of(kind, payload, tries=tries)
        if result != Result.OK:
            raise self._take_error() or refusal(kind, result, detail)
        return detail


CHUNK_CODES = 480
"""Converter codes in one frame, 960 bytes."""

STAGE_TRIES = 100
"""Attempts of STAGE, whose answer arrives after the movement: 30 s, enough for the full travel."""


def send_hello(channel: RequestChannel) -> None:
    """Send HELLO with the name of this software and its protocol versions. The answer is a HELLO_ACK."""
    hello = wire.pack(
        wire.HELLO,
        protocol_min=wire.PROTOCOL_VERSION,
        protocol_max=wire.PROTOCOL_VERSION,
        host=SOFTWARE.encode(),
    )
    channel.send(MessageType.HELLO, hello)


def send_stimulus(channel: RequestChannel, stimulus_id: int, codes: NDArray[np.int16]) -> None:
    """Send the codes of a stimulus, shape (n,), in chunks. Each is acknowledged, and repeated if it is lost.

    Raises:
        InstrumentError: the firmware refuses the stimulus.
    """
    key = {"stimulus_id": stimulus_id}
    begin = wire.pack(wire.STIMULUS_BEGIN, samples=codes.size, crc32=zlib.crc32(codes.tobytes()), **key)
    channel.request(MessageType.STIMULUS_BEGIN, begin)
    for offset in range(0, codes.size, CHUNK_CODES):
        chunk = wire.pack(wire.STIMULUS_CHUNK, offset=offset, **key)
        channel.request(MessageType.STIMULUS_CHUNK, chunk + codes[offset : offset + CHUNK_CODES].tobytes())
    channel.request(MessageType.STIMULUS_COMMIT, wire.pack(wire.STIMULUS_COMMIT, **key))


def send_following(channel: RequestChannel, stimulus_id: int, samples: int, hold_code: int) -> None:
    """Announce ``samples`` set-points after the stimulus; ``hold_code`` is played where a set-point is missing.

    Raises:
        InstrumentError: there are too many set-points, or the firmware is too old.
    """
    payload = wire.pack(wire.FOLLOW, stimulus_id=stimulus_id, samples=samples, hold_code=hold_code)
    channel.request(MessageType.FOLLOW, payload)


def send_setpoints(
    channel: RequestChannel, sender: SetpointSender, token: int, offset: int, codes: NDArray[np.int16]
) -> None:
    """Send the codes of set-points, shape (k,), from sample ``offset`` of a run; ``sender`` repeats lost blocks."""
    for first in range(offset, offset + codes.size, CHUNK_CODES):
        part = codes[first - offset : first - offset + CHUNK_CODES]
        payload = wire.pack(wire.SETPOINTS, token=token, offset=first) + part.tobytes()
        sequence = channel.next_number()
        frame = wire.encode_frame(Frame(MessageType.SETPOINTS, sequence, payload=payload))
        sender.put(sequence, first, first + part.size, frame)


def send_limits(channel: RequestChannel, token: int, stimulus_id: int, limits: Limits, sample_rate_hz: float) -> None:
    """Send ARM: limits for one run of a stimulus. START refers to it by the token.

    Raises:
        LimitError: the limits exceed those of the device.
        InstrumentError: the firmware refuses.
    """
    payload = wire.pack(
        wire.ARM,
        token=token,
        stimulus_id=stimulus_id,
        max_force_n=limits.max_force_n,
        min_position_m=limits.min_position_m,
        max_position_m=limits.max_position_m,
        max_temperature_c=limits.max_temperature_c,
        max_samples=round(limits.max_seconds * sample_rate_hz),
    )
    channel.request(MessageType.ARM, payload)


def send_stage(channel: RequestChannel, position_m: float | None) -> bool:
    """Move the stage to a position, m, or out of reach with None, and wait. Return False without a stage.

    Raises:
        InstrumentError: the stage cannot move to this position, or not at this time.
    """
    payload = wire.pack(wire.STAGE, position_m=np.nan if position_m is None else position_m)
    result, detail = channel.result_of(MessageType.STAGE, payload, tries=STAGE_TRIES)
    if result not in (Result.OK, Result.UNKNOWN):
        raise refusal(MessageType.STAGE, result, detail)
    return result == Result.OK
