"""The driver of a device on a link: handshake, requests with retries, decoding, heartbeat, limits, gaps."""

from __future__ import annotations

import logging
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid import __version__, wire
from tissueid.device import DeviceDescription
from tissueid.errors import (
    FirmwareFaultError,
    InstrumentError,
    LimitError,
    LinkLostError,
    ProtocolVersionError,
    TissueIDError,
)
from tissueid.instrument.interface import SAMPLE, SIGNALS, Gap, Run, empty_samples
from tissueid.instrument.limits import Limits, check_samples, check_stimulus
from tissueid.instrument.link import Link
from tissueid.wire import Fault, Frame, MessageType, Result, State

log = logging.getLogger(__name__)

HEARTBEAT_S = 0.1
ANSWER_S = 0.3
"""How long to wait for an answer before the request is sent again."""
TRIES = 5
SILENCE_S = 1.0
"""A device that streams says something every 10 ms; this much silence is a lost link."""
MAX_GAP_S = 5.0
CHUNK_CODES = 480

_FAULT_WORDS = {
    Fault.WATCHDOG: "the computer was silent for too long",
    Fault.OVER_FORCE: "the force went beyond its limit",
    Fault.STROKE: "the probe reached the end of its stroke",
    Fault.OVER_TEMPERATURE: "the coil is too hot",
    Fault.OVER_TIME: "the test lasted too long",
    Fault.BUTTON: "the button was pressed",
}

_RESULT_WORDS = {
    Result.BAD_STATE: "the instrument is not in a state for that",
    Result.BAD_ARGUMENT: "the instrument did not understand",
    Result.TOO_LARGE: "the stimulus is longer than the instrument can hold",
    Result.CHECKSUM: "the stimulus arrived damaged",
    Result.BEYOND_LIMITS: "the stimulus or the limits go beyond what the instrument allows",
    Result.UNKNOWN: "the instrument's firmware is too old for that",
}


def describe_faults(faults: Fault) -> str:
    """The latched faults in words, joined."""
    return " and ".join(words for fault, words in _FAULT_WORDS.items() if fault & faults) or "no fault"


@dataclass(frozen=True)
class Status:
    """What the firmware last said of itself."""

    state: State
    faults: Fault
    boot_id: int
    dropped_frames: int
    refused_frames: int
    played_samples: int


class SerialInstrument:
    """An instrument at the other end of a link. Opening it shakes hands and starts the stream.

    ``clock`` gives seconds that never go back; tests hand in their own.

    Raises:
        ProtocolVersionError: the firmware speaks other versions.
        LinkLostError: nothing answers.
    """

    def __init__(self, link: Link, *, clock: Callable[[], float] = time.monotonic) -> None:
        self.gaps: list[Gap] = []
        self.status: Status | None = None
        self.repeated_requests = 0
        self._link = link
        self._clock = clock
        self._decoder = wire.FrameDecoder()
        self._sequence = 0
        self._ack: dict[str, Any] | None = None
        self._hello: bytes | None = None
        self._ready: list[NDArray[np.void]] = []
        self._next_index: int | None = None
        self._error: TissueIDError | None = None
        self._limits: Limits | None = None
        self._run: Run | None = None
        self._stopped = False
        self._command = np.zeros(0)
        self._stimulus_id = 0
        self._gains = self._offsets = np.zeros(0)
        self._closed = False
        self._last_heard = self._last_heartbeat = clock()
        self._streaming = False
        try:
            self.device, self._gains, self._offsets, self._boot_id = self._shake_hands()
            self._request(MessageType.CLEAR_FAULTS)
            self._request(MessageType.RELEASE)
            self._request(MessageType.STREAM, wire.pack(wire.STREAM, on=1))
            # What a host before us left behind is not ours to miss.
            self._next_index, self.gaps = None, []
            self._ready.clear()
            self._streaming = True
        except BaseException:
            link.close()
            raise

    # -- the Instrument interface -------------------------------------------------------------------------

    def load(self, command_v: NDArray[np.float64]) -> None:
        """Send a stimulus, shape (n,), V; chunks are acknowledged one by one and repeated when lost.

        Raises:
            LimitError: the voltage cannot be expressed by the converter.
            InstrumentError: the firmware refuses it.
        """
        codes = np.rint((np.asarray(command_v) - self._offsets[0]) / self._gains[0])
        if np.any(np.abs(codes) > 32767):
            raise LimitError("the stimulus goes beyond the range of the instrument's converter")
        self._wait_for_release()
        data = codes.astype("<i2")
        self._stimulus_id += 1
        key = {"stimulus_id": self._stimulus_id}
        begin = wire.pack(wire.STIMULUS_BEGIN, samples=data.size, crc32=zlib.crc32(data.tobytes()), **key)
        self._request(MessageType.STIMULUS_BEGIN, begin)
        for offset in range(0, data.size, CHUNK_CODES):
            chunk = wire.pack(wire.STIMULUS_CHUNK, offset=offset, **key)
            chunk += data[offset : offset + CHUNK_CODES].tobytes()
            self._request(MessageType.STIMULUS_CHUNK, chunk)
        self._request(MessageType.STIMULUS_COMMIT, wire.pack(wire.STIMULUS_COMMIT, **key))
        self._command = np.asarray(command_v, np.float64)

    def arm(self, limits: Limits) -> None:
        """Agree on the limits, here and in the firmware.

        Raises:
            LimitError: the stimulus would break them.
        """
        check_stimulus(self._command, self.device, limits)
        self._limits = limits
        self._token = (self._stimulus_id << 8) ^ (self._sequence & 0xFF) ^ 0x5EED0000
        self._beat(force=True)
        self._request(
            MessageType.ARM,
            wire.pack(
                wire.ARM,
                token=self._token,
                stimulus_id=self._stimulus_id,
                max_force_n=limits.max_force_n,
                min_position_m=limits.min_position_m,
                max_position_m=limits.max_position_m,
                max_temperature_c=limits.max_temperature_c,
                max_samples=round(limits.max_seconds * self.device.sample_rate_hz),
            ),
        )

    def start(self) -> Run:
        """Energise the coil and play."""
        self._stopped = False
        self._beat(force=True)
        first = self._request(MessageType.START, wire.pack(wire.START, token=self._token))
        self._run = run = Run(first, self._command.size)
        if self.status is not None and self.status.faults:
            self._fail_by_fault(self.status.faults)  # it tripped before this answer was read
        return run

    def poll(self, timeout_s: float) -> NDArray[np.void]:
        """Samples that arrived, shape (k,) of SAMPLE; keeps the watchdog quiet; judges every sample.

        Raises:
            LinkLostError, FirmwareFaultError, LimitError: the coil is released. What arrived before is
                delivered first; the error comes with the next call.
        """
        if self._error is None and not self._ready:
            try:
                self._pump(timeout_s)
            except TissueIDError as error:
                self._fail(error)
        if self._ready:
            samples = np.concatenate(self._ready)
            self._ready.clear()
            self._judge(samples)
            return samples
        if self._error is not None:
            raise self._error
        return np.zeros(0, SAMPLE)

    def release(self) -> None:
        """Free the coil now; what cannot be said is left to the firmware's watchdog."""
        self._run = None
        self._limits = None
        try:
            self._request(MessageType.STOP, tries=2)
        except TissueIDError as error:
            log.warning("release not confirmed, the firmware's watchdog releases the coil: %s", error)

    def clear_faults(self) -> None:
        """Unlatch the firmware's faults and forget the failed run; the next test must be armed anew."""
        self._error = None
        self._request(MessageType.CLEAR_FAULTS)

    def close(self) -> None:
        """Release, end the stream, let go of the port."""
        if self._closed:
            return
        self._closed = True
        if not isinstance(self._error, LinkLostError):
            self.release()
            try:
                self._request(MessageType.STREAM, wire.pack(wire.STREAM, on=0), tries=2)
            except TissueIDError as error:
                log.info("the stream was not ended: %s", error)
        self._link.close()

    def __enter__(self) -> SerialInstrument:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def statistics(self) -> wire.FrameStatistics:
        """Frames accepted and refused since the link was opened."""
        return self._decoder.statistics

    def _wait_for_release(self) -> None:
        """Let the firmware's ramp down after a run come to its end."""
        deadline = self._clock() + ANSWER_S
        while self.status is not None and self.status.state is State.RUNNING and self._clock() < deadline:
            self._send(MessageType.STATUS_REQUEST)
            self._pump(0.02)

    # -- requests -----------------------------------------------------------------------------------------

    def _shake_hands(self) -> tuple[DeviceDescription, NDArray[np.float64], NDArray[np.float64], int]:
        hello = wire.pack(
            wire.HELLO,
            protocol_min=wire.PROTOCOL_VERSION,
            protocol_max=wire.PROTOCOL_VERSION,
            host=f"tissueid {__version__}".encode(),
        )
        for _ in range(TRIES):
            self._send(MessageType.HELLO, hello)
            deadline = self._clock() + ANSWER_S
            while self._hello is None and self._clock() < deadline:
                self._pump(0.05)
            if self._hello is not None:
                return self._read_hello(self._hello)
        raise LinkLostError(f"no instrument answers on {self._link.name}; check the cable and the power")

    def _read_hello(self, payload: bytes) -> tuple[DeviceDescription, NDArray[np.float64], NDArray[np.float64], int]:
        oldest, newest = payload[:2] if len(payload) >= 2 else (0, 0)
        if not oldest <= wire.PROTOCOL_VERSION <= newest:
            raise ProtocolVersionError(
                f"the instrument on {self._link.name} speaks protocol {oldest} to {newest}, "
                f"this software {wire.PROTOCOL_VERSION}: update the {'software' if oldest > 1 else 'firmware'}"
            )
        try:
            fields, table = wire.unpack(wire.HELLO_ACK, payload, tail=True)
            if len(table) != fields["channels"] * wire.CHANNEL.itemsize:
                raise wire.PayloadError("the channel table is cut short")
        except wire.PayloadError as error:
            raise InstrumentError(f"the handshake of {self._link.name} is damaged: {error}") from error
        channels = np.frombuffer(table, wire.CHANNEL)
        names = tuple(wire.text(name) for name in channels["name"])
        if names != SIGNALS or not np.all(np.isfinite(channels["gain"]) & (channels["gain"] != 0)):
            raise InstrumentError(f"{self._link.name} has other channels than this software knows: {names}")
        figures = {name: fields[name] for name in DeviceDescription.__dataclass_fields__ if name in fields}
        figures |= {name: wire.text(fields[name]) for name in ("model", "serial_number", "firmware_version")}
        device = DeviceDescription(**figures, protocol_version=str(wire.PROTOCOL_VERSION))
        if not 100 <= device.sample_rate_hz <= 100_000 or min(device.coil_resistance_ohm, device.stroke_m) <= 0:
            raise InstrumentError(f"{self._link.name} reports impossible figures of itself")
        return device, channels["gain"].astype(float), channels["offset"].astype(float), fields["boot_id"]

    def _request(self, kind: MessageType, payload: bytes = b"", *, tries: int = TRIES) -> int:
        """Send until answered, always under the same sequence number, so that a repeat acts only once."""
        sequence = self._sequence
        self._sequence = (self._sequence + 1) & 0xFFFF
        for attempt in range(tries):
            self._send(kind, payload, sequence)
            self.repeated_requests += attempt > 0
            deadline = self._clock() + ANSWER_S
            while self._clock() < deadline:
                self._ack = None
                self._pump(0.02)
                ack = self._ack
                if ack and ack["request_type"] == kind and ack["request_sequence"] == sequence:
                    return self._check_result(kind, ack)
        raise LinkLostError(f"{self._link.name} does not answer {kind.name}; check the cable and the power")

    def _check_result(self, kind: MessageType, ack: dict[str, Any]) -> int:
        result = ack["result"]
        if result == Result.OK:
            return int(ack["detail"])
        if result == Result.FAULT_LATCHED:
            faults = Fault(int(ack["detail"]))
            raise FirmwareFaultError(f"the instrument refuses after a fault: {describe_faults(faults)}")
        words = _RESULT_WORDS.get(result, f"the instrument answered {result}")
        if result == Result.BEYOND_LIMITS:
            raise LimitError(f"{words} ({kind.name})")
        raise InstrumentError(f"{words} ({kind.name})")

    def _send(self, kind: MessageType, payload: bytes = b"", sequence: int | None = None) -> None:
        if sequence is None:
            sequence, self._sequence = self._sequence, (self._sequence + 1) & 0xFFFF
        self._link.write(wire.encode_frame(Frame(kind, sequence, payload=payload)))

    def _beat(self, *, force: bool = False) -> None:
        now = self._clock()
        if force or now - self._last_heartbeat >= HEARTBEAT_S:
            self._last_heartbeat = now
            self._send(MessageType.HEARTBEAT)

    # -- bytes in -----------------------------------------------------------------------------------------

    def _pump(self, timeout_s: float) -> None:
        """Read once, and deal with every frame that came."""
        self._beat()
        data = self._link.read(timeout_s)
        for frame in self._decoder.feed(data):
            self._last_heard = self._clock()
            try:
                self._dispatch(frame)
            except ValueError as error:  # a payload of the wrong length, or a state that nobody knows
                log.warning("ignored a frame of type 0x%02x: %s", frame.type, error)
        if self._streaming and self._clock() - self._last_heard > SILENCE_S:
            raise LinkLostError(
                f"{self._link.name} went silent for {SILENCE_S:g} s; the firmware releases the coil by itself"
            )

    def _dispatch(self, frame: Frame) -> None:
        if self._streaming and frame.version != wire.PROTOCOL_VERSION:
            self._fail(
                ProtocolVersionError(
                    f"the instrument went over to protocol {frame.version} in mid-conversation; "
                    f"this software speaks {wire.PROTOCOL_VERSION}. Connect again"
                )
            )
        elif frame.type == MessageType.DATA:
            self._take_data(frame)
        elif frame.type == MessageType.ACK:
            ack, _ = wire.unpack(wire.ACK, frame.payload, tail=True)
            self._ack = ack
        elif frame.type == MessageType.STATUS:
            self._take_status(frame)
        elif frame.type == MessageType.HELLO_ACK:
            self._hello = frame.payload

    def _take_status(self, frame: Frame) -> None:
        fields, _ = wire.unpack(wire.STATUS, frame.payload, tail=True)
        del fields["streaming"]
        fields["state"], fields["faults"] = State(fields["state"]), Fault(fields["faults"])
        self.status = Status(**fields)
        if not self._streaming:
            return
        if fields["boot_id"] != self._boot_id:
            self._fail(FirmwareFaultError("the instrument restarted by itself; the coil is free. Connect again"))
        elif self._run is not None and self.status.faults:
            self._fail_by_fault(self.status.faults)
        elif self._run is not None and self._stopped and self.status.state is not State.RUNNING:
            self._fail(FirmwareFaultError("the instrument stopped the test by itself; the coil is free"))

    def _take_data(self, frame: Frame) -> None:
        if not self._gains.size:
            return  # still streaming for a host that died: the scales are not known yet
        if self._next_index is not None and frame.sample_index < self._next_index:
            return  # a duplicate, or late: its place is already taken
        if len(frame.payload) % wire.SAMPLE.itemsize:
            raise wire.PayloadError("a data frame holds part of a sample")
        if self._next_index is not None and frame.sample_index > self._next_index:
            missing = frame.sample_index - self._next_index
            if missing > MAX_GAP_S * self.device.sample_rate_hz:
                self._fail(LinkLostError(f"{missing} samples are missing at once; the link cannot be trusted"))
                return
            self.gaps.append(Gap(self._next_index, missing))
            log.warning("%d samples lost from sample %d on", missing, self._next_index)
            self._ready.append(empty_samples(self._next_index, missing))
        codes = np.frombuffer(frame.payload, wire.SAMPLE)
        samples = np.zeros(codes.size, SAMPLE)
        samples["index"] = frame.sample_index + np.arange(codes.size)
        samples["flags"] = codes["flags"]
        for channel, name in enumerate(SIGNALS):
            samples[name] = codes[name] * self._gains[channel] + self._offsets[channel]
        self._ready.append(samples)
        self._next_index = frame.sample_index + codes.size

    def _judge(self, samples: NDArray[np.void]) -> None:
        if self._limits is None or self._error is not None:
            return
        try:
            check_samples(samples, self.device, self._limits, self._run.first_index if self._run else None)
        except LimitError as error:
            self.release()
            self._error = error
            return
        if self._run is not None and samples["index"][-1] >= self._run.end_index:
            self._run = None
            self._limits = None
        elif self._run is not None and not self._stopped:
            received = np.isfinite(samples["position"]) & (samples["index"] >= self._run.first_index)
            if np.any(received & ~(samples["flags"] & wire.Flag.PLAYING).astype(bool)):
                # The message that says why may have been lost: ask again.
                self._stopped = True
                self._send(MessageType.STATUS_REQUEST)

    def _fail_by_fault(self, faults: Fault) -> None:
        self._fail(FirmwareFaultError(f"the instrument released the coil: {describe_faults(faults)}"))

    def _fail(self, error: TissueIDError) -> None:
        """Remember the first error; ``poll`` raises it once the samples before it are delivered."""
        if self._error is None:
            self._error = error
            self._run = None
            self._limits = None
