"""Exchange of frames with a device under test, without the checks of the driver; its line, and the person at it."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

import tissueid.wire as wire
from tissueid.instrument.link import Link
from tissueid.language import marked
from tissueid.wire import Fault, MessageType, Result, State
from tissueid_lab.conformance.clause import ViolationError, require, violated

ANSWER_S = 0.3
"""Time after which a request is repeated, as a host does (docs/protocol.md, 4.2)."""
_TRIES = 4
_HEARTBEAT_S = 0.1
_SLICE_S = 0.02
_MOST_BYTES = 8_000_000
"""Largest number of bytes that are read for one clause: a device may send without end."""
_KEPT_FRAMES = 2000


class Line(Protocol):
    """Bytes to and from the device, and the time in which they travel: real, or simulated in a test."""

    def read(self, timeout_s: float) -> bytes:
        """Return the bytes that have arrived; wait up to ``timeout_s`` for the first."""

    def write(self, data: bytes) -> None:
        """Send all of ``data``."""

    def clock(self) -> float:
        """Return the time in seconds."""

    def pause(self, seconds: float) -> None:
        """Let time pass without reading."""


class LinkLine:
    """A line over a port of this computer, in real time."""

    def __init__(self, link: Link) -> None:
        self._link = link

    def read(self, timeout_s: float) -> bytes:  # noqa: D102
        return self._link.read(timeout_s)

    def write(self, data: bytes) -> None:  # noqa: D102
        self._link.write(data)

    def clock(self) -> float:  # noqa: D102
        return time.monotonic()

    def pause(self, seconds: float) -> None:  # noqa: D102
        time.sleep(seconds)


class Act(Enum):
    """What a person does at the device for a clause; the value is the request to that person."""

    PRESS_BUTTON = marked("Press the button of the instrument, and hold it")
    RELEASE_BUTTON = marked("Release the button")
    LOWER_SUPPLY = marked("Switch the amplifier's supply off")
    RESTORE_SUPPLY = marked("Switch the amplifier's supply on")
    DISCONNECT_COIL = marked("Disconnect the coil")
    CONNECT_COIL = marked("Connect the coil")
    DISCONNECT_POSITION = marked("Disconnect the position sensor")
    CONNECT_POSITION = marked("Connect the position sensor")


class Attendant(Protocol):
    """The person at the device, or a test in place of one."""

    def perform(self, act: Act) -> float:
        """Request an act, and return the time in seconds within which it happens; 0: no person attends."""


class Unattended:
    """No person is at the device: clauses that need one are not begun."""

    def perform(self, act: Act) -> float:  # noqa: D102
        return 0.0


@dataclass(frozen=True)
class Answer:
    """An ACK and the sample index of its frame."""

    result: Result | int
    detail: int
    index: int


class Exchange:
    """A line and what arrived on it.

    Args:
        line: to the device.
        check: called while waiting; it raises an error to cancel.
    """

    def __init__(self, line: Line, check: Callable[[], object] = lambda: None) -> None:
        self.line = line
        self.measured: dict[str, float] = {}
        self._check = check
        self._decoder = wire.FrameDecoder()
        self._sequence = 0
        self._heartbeat_at: float | None = None
        self._deadline = line.clock() + 60.0
        self._bytes = 0
        self.frames: deque[wire.Frame] = deque(maxlen=_KEPT_FRAMES)
        self.blocks: list[tuple[int, NDArray[np.void]]] = []
        self.statuses: list[dict[str, Any]] = []

    def begin(self, limit_s: float) -> None:
        """Begin a clause, which may take ``limit_s`` seconds."""
        self._deadline = self.line.clock() + limit_s
        self._bytes = 0
        self.measured = {}

    def keep_alive(self, on: bool) -> None:
        """Send heartbeats while waiting, or stop that."""
        self._heartbeat_at = self.line.clock() if on else None

    def pump(self, seconds: float) -> list[wire.Frame]:
        """Let time pass; return the received frames.

        Raises:
            ViolationError: the time or the number of bytes of the clause is exceeded.
        """
        end = self.line.clock() + seconds
        frames: list[wire.Frame] = []
        while True:
            self._check()
            now = self.line.clock()
            if now > self._deadline:
                raise ViolationError("conformance.too_long", "the clause took too long")
            if self._heartbeat_at is not None and now >= self._heartbeat_at:
                self.send(MessageType.HEARTBEAT)
                self._heartbeat_at = now + _HEARTBEAT_S
            data = self.line.read(max(0.0, min(_SLICE_S, end - now)))
            self._bytes += len(data)
            if self._bytes > _MOST_BYTES:
                raise ViolationError("conformance.floods", "the device sends without end")
            for frame in self._decoder.feed(data):
                self._keep(frame)
                frames.append(frame)
            if self.line.clock() >= end:
                return frames

    def wait(self, condition: Callable[[], bool], seconds: float, expected: str) -> None:
        """Wait until a condition holds.

        Raises:
            ViolationError: it did not within the time.
        """
        end = self.line.clock() + seconds
        while not condition():
            if self.line.clock() >= end:
                raise violated(expected, f"nothing within {seconds:.2f} s")
            self.pump(min(_SLICE_S, end - self.line.clock()))

    def _keep(self, frame: wire.Frame) -> None:
        self.frames.append(frame)
        if frame.type == MessageType.DATA:
            whole = len(frame.payload) // wire.SAMPLE.itemsize * wire.SAMPLE.itemsize
            self.blocks.append((frame.sample_index, np.frombuffer(frame.payload[:whole], wire.SAMPLE)))
        elif frame.type == MessageType.STATUS:
            self.statuses.append(_status(frame))

    def send(self, kind: int, payload: bytes = b"", *, sequence: int | None = None) -> int:
        """Send a frame and return its sequence number; by default the next one."""
        if sequence is None:
            sequence = self._sequence = (self._sequence + 1) & 0xFFFF
        self.line.write(wire.encode_frame(wire.Frame(kind, sequence, payload=payload)))
        return sequence

    def _received(self, send: Callable[[], object]) -> Iterator[wire.Frame]:
        """Yield the frames that arrive after a request, which is sent again as a host does."""
        for _ in range(_TRIES):
            send()
            end = self.line.clock() + ANSWER_S
            while self.line.clock() < end:
                yield from self.pump(0.0) or self.pump(_SLICE_S / 4)

    def ask(self, kind: int, payload: bytes = b"", *, sequence: int | None = None) -> Answer:
        """Send a request and return its answer; the same frame is repeated as a host does.

        Raises:
            ViolationError: no answer.
        """
        number = (self._sequence + 1) & 0xFFFF if sequence is None else sequence
        self._sequence = number if sequence is None else self._sequence
        for frame in self._received(lambda: self.send(kind, payload, sequence=number)):
            ack = _unpacked(wire.ACK, frame) if frame.type == MessageType.ACK else {}
            if (ack.get("request_type"), ack.get("request_sequence")) == (kind, number):
                return Answer(_result(ack["result"]), ack["detail"], frame.sample_index)
        raise violated(f"an answer to {_name(kind)}", "none")

    def expect(
        self, result: Result, kind: int, payload: bytes = b"", case: str = "", *, detail: int | None = None
    ) -> Answer:
        """Send a request and return its answer.

        Raises:
            ViolationError: the result, or the detail if one is given, is another one; ``case`` describes the request.
        """
        answer = self.ask(kind, payload)
        request = f"{_name(kind)}{' ' + case if case else ''}"
        require(answer.result == result, f"{result.name} to {request}", getattr(answer.result, "name", answer.result))
        require(detail in (None, answer.detail), f"detail {detail} to {request}", answer.detail)
        return answer

    def expect_each(self, result: Result, *requests: tuple[int, bytes, str]) -> None:
        """Send requests, each with words that describe it.

        Raises:
            ViolationError: the result of one is another one.
        """
        for request in requests:
            self.expect(result, *request)

    def expect_silence(self, data: bytes, case: str) -> None:
        """Send bytes that the device must drop without an answer, and count as refused.

        Raises:
            ViolationError: there is an answer, the count is wrong, or the next request is not answered.
        """
        before = self.status()["refused_frames"]
        self.line.write(data)
        answers = [frame for frame in self.pump(0.1) if frame.type == MessageType.ACK]
        require(not answers, f"no answer to {case}", "an ACK")
        refused = self.status()["refused_frames"] - before
        require(refused == 1, f"refused_frames one higher after {case}", f"{refused} higher")

    def status(self) -> dict[str, Any]:
        """Request and return the status.

        Raises:
            ViolationError: there is none.
        """
        for frame in self._received(lambda: self.send(MessageType.STATUS_REQUEST)):
            if frame.type == MessageType.STATUS:
                return _status(frame)
        raise violated("a STATUS", "none")

    def samples(self) -> NDArray[np.void]:
        """Return the samples of the clause, shape (n,), n > 0, as codes.

        Raises:
            ViolationError: none have arrived.
        """
        require(any(block.size for _, block in self.blocks), "DATA while streaming", "none")
        return np.concatenate([block for _, block in self.blocks])

    @property
    def newest_state(self) -> int | None:
        """State in the newest STATUS of the clause; None before the first."""
        return self.statuses[-1]["state"] if self.statuses else None

    def newest_status(self) -> dict[str, Any]:
        """Return the newest STATUS of the clause.

        Raises:
            ViolationError: none has arrived.
        """
        require(self.statuses, "a STATUS at the change of state", "none")
        return self.statuses[-1]

    def require_state(self, state: State, case: str = "") -> dict[str, Any]:
        """Return the status.

        Raises:
            ViolationError: the device is in another state.
        """
        status = self.status()
        require(status["state"] == state, f"state {state.name} {case}".rstrip(), _state(status["state"]))
        return status

    def wait_for_fault(self, fault: Fault, seconds: float, case: str = "") -> dict[str, Any]:
        """Wait for a fault, and return the status that reports it.

        Raises:
            ViolationError: there is none within the time, or another one.
        """
        self.wait(lambda: self.newest_state == State.FAULT, seconds, f"fault {fault.name} {case}".rstrip())
        return require_status(self.newest_status(), faults=fault)

    def hello(self, low: int = 1, high: int = 1, tail: bytes = b"") -> bytes:
        """Send HELLO and return the payload of HELLO_ACK.

        Raises:
            ViolationError: there is none.
        """
        payload = wire.pack(wire.HELLO, protocol_min=low, protocol_max=high, host=b"conformance") + tail
        for frame in self._received(lambda: self.send(MessageType.HELLO, payload)):
            if frame.type == MessageType.HELLO_ACK:
                return frame.payload
        raise violated("HELLO_ACK", "no answer to HELLO")


def require_status(status: dict[str, Any], **expected: int) -> dict[str, Any]:
    """Return a status; raise ViolationError where a field is another one than expected."""
    for name, value in expected.items():
        text = {"state": _state, "faults": _faults}.get(name, str)
        require(status[name] == value, f"{name} {text(value)}", text(status[name]))
    return status


def _unpacked(dtype: np.dtype, frame: wire.Frame) -> dict[str, Any]:
    try:
        return wire.unpack(dtype, frame.payload, tail=True)[0]
    except wire.PayloadError as error:
        raise violated(f"a whole {_name(frame.type)}", error) from None


def _status(frame: wire.Frame) -> dict[str, Any]:
    fields = _unpacked(wire.STATUS, frame)
    rest = frame.payload[wire.STATUS.itemsize :]
    if len(rest) >= wire.STATUS_SETPOINTS.itemsize:
        fields |= wire.unpack(wire.STATUS_SETPOINTS, rest, tail=True)[0]
    return fields | {"index": frame.sample_index}


def _result(number: int) -> Result | int:
    return Result(number) if number in set(Result) else number


def _state(number: int) -> str:
    return State(number).name if number in set(State) else str(number)


def _faults(number: int) -> str:
    return Fault(number).name or "none"


def _name(kind: int) -> str:
    return MessageType(kind).name if kind in set(MessageType) else f"type 0x{kind:02X}"
