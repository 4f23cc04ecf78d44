"""A device under test: requests frame by frame, without any of the checks of the driver."""

from __future__ import annotations

import zlib
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid import wire
from tissueid.instrument.conformance.clause import NotTestedError, ViolationError, require, violated
from tissueid.instrument.conformance.line import Act, Attendant, Line, Unattended
from tissueid.instrument.handshake import Handshake, parse_hello
from tissueid.messages import Message
from tissueid.wire import Flag, MessageType, Result, State

GENTLE_N = 2.0
"""Largest force of the suite: with more, an end of the stroke is a fault, and a free coil lies there."""

ANSWER_S = 0.3
"""Time after which a request is repeated, as a host does (docs/protocol.md, 4.2)."""
_TRIES = 4
_HEARTBEAT_S = 0.1
_SLICE_S = 0.02
_MOST_BYTES = 8_000_000
"""Largest number of bytes that are read for one clause: a device may send without end."""
_KEPT_FRAMES = 2000
_CHUNK = 500


@dataclass(frozen=True)
class Confirmed:
    """What a person has confirmed: what is attached, and the largest force, N, and temperature, degC."""

    attached: str
    max_force_n: float
    max_temperature_c: float


@dataclass(frozen=True)
class Answer:
    """An ACK and the sample index of its frame."""

    result: Result | int
    detail: int
    index: int


@dataclass(frozen=True)
class Run:
    """A played run: its samples from the first played one on, as codes, and the last status."""

    first: int
    samples: NDArray[np.void]
    status: dict[str, Any]

    def flagged(self, flag: Flag) -> NDArray[np.bool_]:
        """Return the mask (n,) of samples with a flag."""
        mask: NDArray[np.bool_] = (self.samples["flags"] & int(flag)) != 0
        return mask


class DeviceUnderTest:
    """A connected device and what it sent.

    Args:
        line: to the device.
        confirmed: what a person has confirmed; no more is commanded.
        attendant: the person at the device.
        check: called while waiting; it raises an error to cancel.
    """

    def __init__(
        self,
        line: Line,
        confirmed: Confirmed,
        attendant: Attendant | None = None,
        check: Callable[[], object] = lambda: None,
    ) -> None:
        self.line = line
        self.confirmed = confirmed
        self.attendant = attendant or Unattended()
        self.measured: dict[str, float] = {}
        self._check = check
        self._decoder = wire.FrameDecoder()
        self._sequence = 0
        self._heartbeat_at: float | None = None
        self._deadline = line.clock() + 60.0
        self._bytes = 0
        self.handshake: Handshake | None = None
        self.properties: dict[str, Any] = {}
        self.frames: deque[wire.Frame] = deque(maxlen=_KEPT_FRAMES)
        self.blocks: list[tuple[int, NDArray[np.void]]] = []
        self.statuses: list[dict[str, Any]] = []

    @property
    def attended(self) -> bool:
        """Whether a person, or a test in place of one, is at the device."""
        return not isinstance(self.attendant, Unattended)

    # -- time and bytes -----------------------------------------------------------------------------------

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
        found: list[wire.Frame] = []
        while True:
            self._check()
            now = self.line.clock()
            if now > self._deadline:
                raise ViolationError(Message("conformance.too_long", "the clause took too long"))
            if self._heartbeat_at is not None and now >= self._heartbeat_at:
                self.send(MessageType.HEARTBEAT)
                self._heartbeat_at = now + _HEARTBEAT_S
            data = self.line.read(max(0.0, min(_SLICE_S, end - now)))
            self._bytes += len(data)
            if self._bytes > _MOST_BYTES:
                raise ViolationError(Message("conformance.floods", "the device sends without end"))
            for frame in self._decoder.feed(data):
                self._keep(frame)
                found.append(frame)
            if self.line.clock() >= end:
                return found

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

    # -- requests -----------------------------------------------------------------------------------------

    def ask(self, kind: int, payload: bytes = b"", *, sequence: int | None = None) -> Answer:
        """Send a request and return its answer; the same frame is repeated as a host does.

        Raises:
            ViolationError: no answer.
        """
        number = self.send(kind, payload, sequence=sequence)
        for _ in range(_TRIES):
            end = self.line.clock() + ANSWER_S
            while self.line.clock() < end:
                for frame in self.pump(0.0) or self.pump(_SLICE_S / 4):
                    if frame.type != MessageType.ACK:
                        continue
                    ack = _unpacked(wire.ACK, frame)
                    if (ack["request_type"], ack["request_sequence"]) == (kind, number):
                        return Answer(_result(ack["result"]), ack["detail"], frame.sample_index)
            self.send(kind, payload, sequence=number)
        raise violated(f"an answer to {_name(kind)}", "none")

    def expect(self, result: Result, kind: int, payload: bytes = b"", words: str = "") -> Answer:
        """Send a request and return its answer.

        Raises:
            ViolationError: the result is another one; ``words`` describe the request.
        """
        answer = self.ask(kind, payload)
        require(
            answer.result == result,
            f"{result.name} to {_name(kind)}{' ' + words if words else ''}",
            getattr(answer.result, "name", answer.result),
        )
        return answer

    def expect_silence(self, data: bytes, words: str) -> None:
        """Send bytes that the device must drop without an answer, and count as refused.

        Raises:
            ViolationError: there is an answer, the count is wrong, or the next request is not answered.
        """
        before = self.status()["refused_frames"]
        self.line.write(data)
        answers = [frame for frame in self.pump(0.1) if frame.type == MessageType.ACK]
        require(not answers, f"no answer to {words}", "an ACK")
        refused = self.status()["refused_frames"] - before
        require(refused == 1, f"refused_frames one higher after {words}", f"{refused} higher")

    def status(self) -> dict[str, Any]:
        """Request and return the status.

        Raises:
            ViolationError: there is none.
        """
        for _ in range(_TRIES):
            self.send(MessageType.STATUS_REQUEST)
            end = self.line.clock() + ANSWER_S
            while self.line.clock() < end:
                for frame in self.pump(0.0) or self.pump(_SLICE_S / 4):
                    if frame.type == MessageType.STATUS:
                        return _status(frame)
        raise violated("a STATUS", "none")

    def require_state(self, state: State, words: str = "") -> dict[str, Any]:
        """Return the status.

        Raises:
            ViolationError: the device is in another state.
        """
        status = self.status()
        require(status["state"] == state, f"state {state.name} {words}".rstrip(), _state(status["state"]))
        return status

    def hello(self, low: int = 1, high: int = 1, tail: bytes = b"") -> bytes:
        """Send HELLO and return the payload of HELLO_ACK.

        Raises:
            ViolationError: there is none.
        """
        payload = wire.pack(wire.HELLO, protocol_min=low, protocol_max=high, host=b"conformance") + tail
        for _ in range(_TRIES):
            self.send(MessageType.HELLO, payload)
            end = self.line.clock() + ANSWER_S
            while self.line.clock() < end:
                for frame in self.pump(0.0) or self.pump(_SLICE_S / 4):
                    if frame.type == MessageType.HELLO_ACK:
                        return frame.payload
        raise violated("HELLO_ACK", "no answer to HELLO")

    def prepare(self) -> None:
        """Connect, release the coil, clear faults, stop streaming, forget what was received.

        Raises:
            ViolationError: the device does not answer.
            InstrumentError: the handshake is damaged, or reports impossible values.
        """
        self._heartbeat_at = None
        payload = self.hello()
        if self.handshake is None:
            self.handshake, self.properties = parse_hello(payload, "the device"), _properties(payload)
        self.expect(Result.OK, MessageType.RELEASE)
        self.expect(Result.OK, MessageType.CLEAR_FAULTS)
        self.expect(Result.OK, MessageType.STREAM, b"\0")
        self.expect(Result.OK, MessageType.RELEASE)
        self.pump(0.0)
        self.frames.clear()
        self.blocks.clear()
        self.statuses.clear()

    # -- runs ---------------------------------------------------------------------------------------------

    @property
    def known(self) -> Handshake:
        """The handshake.

        Raises:
            NotTestedError: the device has not completed one.
        """
        if self.handshake is None:
            raise NotTestedError(Message("conformance.no_handshake", "the handshake failed"))
        return self.handshake

    @property
    def rate_hz(self) -> float:
        """Samples per second."""
        return self.known.device.sample_rate_hz

    @property
    def force_n(self) -> float:
        """Force limit of the runs: what is confirmed and what the device allows."""
        return min(self.confirmed.max_force_n, self.known.max_force_n, self.known.device.greatest_force_n, GENTLE_N)

    def codes(self, force_n: float, count: int = 1) -> NDArray[np.int16]:
        """Return ``count`` codes of a constant command with this static force, N.

        Raises:
            NotTestedError: the force exceeds the confirmed one.
        """
        if abs(force_n) > self.force_n * 1.05:
            raise NotTestedError(
                Message("conformance.more_force", "needs a confirmed force of {force:.2f} N", force=abs(force_n))
            )
        device = self.known.device
        volts = force_n * device.coil_resistance_ohm / (device.force_constant_n_per_a * device.amplifier_gain)
        return np.full(count, round((volts - self.known.offsets[0]) / self.known.gains[0]), "<i2")

    def load(self, codes: NDArray[np.int16], identity: int = 1) -> None:
        """Load a stimulus: BEGIN, CHUNKs and COMMIT, all OK."""
        data = codes.astype("<i2").tobytes()
        begin = wire.pack(wire.STIMULUS_BEGIN, stimulus_id=identity, samples=codes.size, crc32=zlib.crc32(data))
        self.expect(Result.OK, MessageType.STIMULUS_BEGIN, begin)
        for offset in range(0, codes.size, _CHUNK):
            head = wire.pack(wire.STIMULUS_CHUNK, stimulus_id=identity, offset=offset)
            self.expect(Result.OK, MessageType.STIMULUS_CHUNK, head + data[2 * offset : 2 * (offset + _CHUNK)])
        self.expect(Result.OK, MessageType.STIMULUS_COMMIT, wire.pack(wire.STIMULUS_COMMIT, stimulus_id=identity))

    def arm_payload(self, **changed: Any) -> bytes:
        """Return the payload of ARM with the widest limits that are confirmed; ``changed`` replaces fields."""
        beyond = 1e-3 if self.force_n <= 2.0 else 0.0
        fields = {
            "token": 7,
            "stimulus_id": 1,
            "max_force_n": self.force_n,
            "min_position_m": -beyond,
            "max_position_m": self.known.device.stroke_m + beyond,
            "max_temperature_c": min(self.confirmed.max_temperature_c, self.known.max_temperature_c),
            "max_samples": round(30.0 * self.rate_hz),
        }
        return wire.pack(wire.ARM, **(fields | changed))

    def arm(self, **changed: Any) -> None:
        """Arm with the widest limits that are confirmed; ``changed`` replaces fields. OK is expected."""
        self.send(MessageType.HEARTBEAT)
        self.expect(Result.OK, MessageType.ARM, self.arm_payload(**changed))

    def start(self, token: int = 7) -> int:
        """Start the armed run and return the index of its first sample."""
        self.send(MessageType.HEARTBEAT)
        return self.expect(Result.OK, MessageType.START, wire.pack(wire.START, token=token)).detail

    def stream(self) -> None:
        """Switch streaming on."""
        self.expect(Result.OK, MessageType.STREAM, b"\1")

    def begin_run(self, codes: NDArray[np.int16], *, follow: tuple[int, int] | None = None, **limits: Any) -> int:
        """Load and start codes, with heartbeats and streaming; return the index of the first sample.

        Args:
            codes: of the stimulus, shape (n,).
            follow: number of set-points and hold code.
            limits: fields of ARM that differ.
        """
        self.stream()
        self.load(codes)
        if follow is not None:
            payload = wire.pack(wire.FOLLOW, stimulus_id=1, samples=follow[0], hold_code=follow[1])
            self.expect(Result.OK, MessageType.FOLLOW, payload)
        self.keep_alive(True)
        self.arm(**limits)
        return self.start()

    def finish_run(self, first: int, seconds: float) -> Run:
        """Wait for the end of a run, and return it with the samples up to 20 ms after."""
        self.wait(lambda: self.statuses[-1]["state"] != State.RUNNING, seconds, "the end of the run")
        status = self.statuses[-1]
        self.keep_alive(False)
        self.pump(0.05)
        return Run(first, self.samples_from(first), status)

    def play(self, codes: NDArray[np.int16], **limits: Any) -> Run:
        """Play codes to their end, or to a fault."""
        first = self.begin_run(codes, **limits)
        return self.finish_run(first, codes.size / self.rate_hz + 1.0)

    def samples_from(self, first: int) -> NDArray[np.void]:
        """Return the received samples from an index on.

        Raises:
            ViolationError: samples are missing.
        """
        parts, expected = [], None
        for index, block in self.blocks:
            if index + block.size <= first:
                continue
            require(expected is None or index == expected, f"DATA from sample {expected} on", f"sample {index}")
            expected = index + block.size
            parts.append(block[max(0, first - index) :])
        return np.concatenate(parts) if parts else np.zeros(0, wire.SAMPLE)

    def physical(self, samples: NDArray[np.void], name: str) -> NDArray[np.float64]:
        """Return a channel in SI units, shape (n,)."""
        names = [item for item in wire.SAMPLE.names or () if item != "flags"]
        k = names.index(name)
        values: NDArray[np.float64] = self.known.gains[k] * samples[name].astype(np.float64) + self.known.offsets[k]
        return values

    def readings(self, seconds: float = 0.1) -> NDArray[np.void]:
        """Return samples of the released coil."""
        self.stream()
        self.blocks.clear()
        self.pump(seconds)
        require(self.blocks, "DATA while streaming", "none")
        return np.concatenate([block for _, block in self.blocks])

    def act(self, act: Act) -> float:
        """Request an act of the person at the device; return the time that it may take.

        Raises:
            NotTestedError: no person attends.
        """
        seconds = self.attendant.perform(act)
        if seconds <= 0.0:
            raise NotTestedError(Message("conformance.unattended", "needs a person at the instrument (--attended)"))
        return seconds


def _properties(payload: bytes) -> dict[str, Any]:
    return wire.unpack(wire.HELLO_ACK, payload, tail=True)[0]


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


def _name(kind: int) -> str:
    return MessageType(kind).name if kind in set(MessageType) else f"type 0x{kind:02X}"
