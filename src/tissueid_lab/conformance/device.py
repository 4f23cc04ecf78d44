"""A device under test: its handshake, what a person has confirmed, and runs on it."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import tissueid.wire as wire
from tissueid.instrument.handshake import Handshake, parse_hello
from tissueid.wire import Flag, MessageType, Result, State
from tissueid_lab.conformance.clause import NotTestedError, require
from tissueid_lab.conformance.exchange import Act, Attendant, Exchange, Line, Unattended

GENTLE_N = 2.0
"""Largest force of the suite: with more, an end of the stroke is a fault, and a free coil lies there."""

_CHUNK = 500


@dataclass(frozen=True)
class Confirmed:
    """What a person has confirmed: what is attached, and the largest force, N, and temperature, degC."""

    attached: str
    max_force_n: float
    max_temperature_c: float


@dataclass(frozen=True)
class DeviceRun:
    """A played run: its samples from the first played one on, as codes, and the last status."""

    first: int
    samples: NDArray[np.void]
    status: dict[str, Any]

    def flagged(self, flag: Flag) -> NDArray[np.bool_]:
        """Return the mask (n,) of samples with a flag."""
        mask: NDArray[np.bool_] = (self.samples["flags"] & int(flag)) != 0
        return mask


class DeviceUnderTest(Exchange):
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
        super().__init__(line, check)
        self.confirmed = confirmed
        self.attendant = attendant or Unattended()
        self.handshake: Handshake | None = None
        self.properties: dict[str, Any] = {}

    @property
    def attended(self) -> bool:
        """Whether a person, or a test in place of one, is at the device."""
        return not isinstance(self.attendant, Unattended)

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

    @property
    def known(self) -> Handshake:
        """The handshake.

        Raises:
            NotTestedError: the device has not completed one.
        """
        if self.handshake is None:
            raise NotTestedError("conformance.no_handshake", "the handshake failed")
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
                "conformance.more_force", "needs a confirmed force of {force:.2f} N", force=abs(force_n)
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

    def finish_run(self, first: int, seconds: float) -> DeviceRun:
        """Wait for the end of a run, and return it with the samples up to 20 ms after."""
        self.wait(lambda: self.newest_state != State.RUNNING, seconds, "the end of the run")
        status = self.newest_status()
        self.keep_alive(False)
        self.pump(0.05)
        return DeviceRun(first, self.samples_from(first), status)

    def play(self, codes: NDArray[np.int16], **limits: Any) -> DeviceRun:
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
        return self.samples()

    def act(self, act: Act) -> float:
        """Request an act of the person at the device; return the time that it may take."""
        return self.attendant.perform(act)


def _properties(payload: bytes) -> dict[str, Any]:
    return wire.unpack(wire.HELLO_ACK, payload, tail=True)[0]
