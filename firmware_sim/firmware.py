"""The firmware: a state machine that owns the coil. Bytes and time in, bytes out; no ports, no clocks of its own.

``docs/protocol.md`` specifies what it speaks; the safety rules of its section 5 hold whatever the host does.
"""

from __future__ import annotations

import zlib
from collections import OrderedDict, deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from firmware_sim.bench import Bench, Block
from firmware_sim.plant import SAMPLE_RATE_HZ
from tissueid import wire
from tissueid.wire import Fault, Flag, Frame, MessageType, Result, State

SAMPLES_PER_FRAME = 20
WATCHDOG_S = 0.5
HOST_SILENCE_S = 2.0
"""A host that is silent for this long is gone: streaming ends, so that the next one finds a quiet line."""

RELEASE_RAMP_S = 0.05
STIMULUS_CAPACITY = 240_000
MAX_RUN_S = 60.0
TRANSMIT_QUEUE_BYTES = 64 * 1024
_SIGNALS = tuple(name for name in wire.SAMPLE.names or () if name != "flags")
FORCE_MARGIN = 1.05
"""Trips are set this far above the limit, so that converter noise on a test at the limit does not end it."""


@dataclass(frozen=True)
class Identity:
    """What the firmware says of itself in the handshake."""

    model: str = "desktop indenter (simulated)"
    serial_number: str = "SIM-0001"
    firmware_version: str = "sim-1.0"
    protocol_min: int = wire.PROTOCOL_VERSION
    protocol_max: int = wire.PROTOCOL_VERSION
    max_force_n: float = 15.0
    max_temperature_c: float = 85.0


@dataclass(frozen=True)
class _Armed:
    """The limits and the stimulus that ARM agreed on."""

    token: int
    max_force_n: float
    min_position_m: float
    max_position_m: float
    max_temperature_c: float
    max_samples: int


class Firmware:
    """The instrument's firmware on a simulated bench.

    Call ``receive`` with bytes from the host, ``advance`` as the device clock moves on, ``transmit`` for the
    bytes to send. ``now_s`` is the watchdog's own clock and must not go backwards.
    """

    def __init__(
        self,
        bench: Bench,
        identity: Identity | None = None,
        *,
        seed: int = 0,
        watchdog_s: float = WATCHDOG_S,
    ) -> None:
        self.identity = identity or Identity()
        self.bench = bench
        self.watchdog_s = watchdog_s
        self._random = np.random.default_rng([seed, 0xB007])
        self._channels = dict(zip(_SIGNALS, bench.channels, strict=True))
        self._power_up()

    def _power_up(self) -> None:
        self.state = State.IDLE
        self.faults = Fault.NONE
        self.streaming = False
        self.boot_id = int(self._random.integers(1, 2**32))
        self.sample_index = 0
        self.dropped_frames = 0
        self._decoder = wire.FrameDecoder()
        self._outbox: deque[bytes] = deque()
        self._outbox_bytes = 0
        self._sequence = 0
        self._answers: OrderedDict[tuple[int, int], bytes] = OrderedDict()
        self._greeted = False
        self._last_frame_s = self._last_heartbeat_s = 0.0
        self._samples = np.zeros(0, wire.SAMPLE)
        self._stimulus = np.zeros(0, "<i2")
        self._stimulus_id = 0
        self._stimulus_crc = 0
        self._armed: _Armed | None = None
        self._cursor = 0
        self._start_index = 0
        self._ramp_from = 0.0
        self.stalled_until_s = 0.0

    @property
    def energised(self) -> bool:
        """True while the amplifier is enabled."""
        return self.state is State.RUNNING

    def reboot(self) -> None:
        """A reset: everything is forgotten and the coil is free; the tissue under the probe goes on as it was."""
        self._power_up()
        self._send_status()

    def stall(self, until_s: float) -> None:
        """Hang until ``until_s``: nothing is heard or sent. The watchdog has its own oscillator and goes on."""
        self.stalled_until_s = until_s

    # -- bytes in -----------------------------------------------------------------------------------------

    def receive(self, data: bytes, now_s: float) -> None:
        """Take bytes from the host. Damaged frames are dropped and counted."""
        if now_s < self.stalled_until_s:
            return
        for frame in self._decoder.feed(data):
            self._last_frame_s = now_s
            self._handle(frame, now_s)

    def _handle(self, frame: Frame, now_s: float) -> None:
        if frame.type == MessageType.HEARTBEAT:
            self._last_heartbeat_s = now_s
        elif frame.type == MessageType.STATUS_REQUEST:
            self._send_status()
        elif frame.type == MessageType.HELLO:
            self._answers.clear()  # a new host counts its requests from the start again
            self._hello(frame)
        else:
            # A repeated request is a retry: it gets the same answer and acts no second time.
            key = (frame.type, frame.sequence)
            if key not in self._answers:
                self._answers[key] = self._answer(frame, now_s)
                if len(self._answers) > 64:
                    self._answers.popitem(last=False)
            self._send(MessageType.ACK, self._answers[key])

    def _answer(self, frame: Frame, now_s: float) -> bytes:
        result, detail = Result.BAD_STATE, 0
        if self._greeted:
            try:
                result, detail = self._obey(frame, now_s)
            except wire.PayloadError:
                result = Result.BAD_ARGUMENT
        return wire.pack(
            wire.ACK, request_type=frame.type, result=result, request_sequence=frame.sequence, detail=detail
        )

    def _hello(self, frame: Frame) -> None:
        try:
            hello, _ = wire.unpack(wire.HELLO, frame.payload, tail=True)
        except wire.PayloadError:
            return
        self._greeted = (
            hello["protocol_min"] <= self.identity.protocol_max and hello["protocol_max"] >= self.identity.protocol_min
        )
        coil = self.bench.parameters
        head = wire.pack(
            wire.HELLO_ACK,
            protocol_min=self.identity.protocol_min,
            protocol_max=self.identity.protocol_max,
            channels=len(self.bench.channels),
            samples_per_frame=SAMPLES_PER_FRAME,
            boot_id=self.boot_id,
            stimulus_capacity=STIMULUS_CAPACITY,
            firmware_version=self.identity.firmware_version.encode(),
            model=self.identity.model.encode(),
            serial_number=self.identity.serial_number.encode(),
            sample_rate_hz=SAMPLE_RATE_HZ,
            watchdog_s=self.watchdog_s,
            max_force_n=self.identity.max_force_n,
            max_temperature_c=self.identity.max_temperature_c,
            coil_resistance_ohm=coil.resistance_ohm,
            coil_inductance_h=coil.inductance_h,
            force_constant_n_per_a=coil.force_constant_n_per_a,
            moving_mass_kg=coil.moving_mass_kg,
            bearing_damping_n_s_per_m=coil.bearing_damping_n_s_per_m,
            amplifier_gain=coil.amplifier_gain,
            amplifier_limit_v=coil.amplifier_limit_v,
            stroke_m=coil.stroke_m,
        )
        table = b"".join(
            wire.pack(wire.CHANNEL, name=name.encode(), unit=c.unit.encode(), gain=c.gain, offset=c.offset)
            for name, c in self._channels.items()
        )
        self._send(MessageType.HELLO_ACK, head + table)

    def _obey(self, frame: Frame, now_s: float) -> tuple[Result, int]:
        if self.state is State.FAULT and MessageType.STIMULUS_BEGIN <= frame.type <= MessageType.START:
            return Result.FAULT_LATCHED, int(self.faults)
        match frame.type:
            case MessageType.STREAM:
                request, _ = wire.unpack(wire.STREAM, frame.payload)
                self.streaming = bool(request["on"])
                self._samples = self._samples[:0]
                return Result.OK, self.sample_index
            case MessageType.STIMULUS_BEGIN:
                return self._stimulus_begin(frame.payload)
            case MessageType.STIMULUS_CHUNK:
                return self._stimulus_chunk(frame.payload)
            case MessageType.STIMULUS_COMMIT:
                return self._stimulus_commit(frame.payload)
            case MessageType.ARM:
                return self._arm(frame.payload, now_s)
            case MessageType.START:
                return self._start(frame.payload)
            case MessageType.STOP | MessageType.RELEASE:
                return self._release(forget=frame.type == MessageType.RELEASE)
            case MessageType.CLEAR_FAULTS:
                self.faults = Fault.NONE
                if self.state is State.FAULT:
                    self._enter(State.IDLE)
                return Result.OK, 0
        return Result.UNKNOWN, 0

    # -- requests -----------------------------------------------------------------------------------------

    def _stimulus_begin(self, payload: bytes) -> tuple[Result, int]:
        request, _ = wire.unpack(wire.STIMULUS_BEGIN, payload)
        if self.state not in (State.IDLE, State.LOADED):
            return Result.BAD_STATE, 0
        if not 0 < request["samples"] <= STIMULUS_CAPACITY:
            return Result.TOO_LARGE, STIMULUS_CAPACITY
        self._stimulus = np.zeros(request["samples"], "<i2")
        self._stimulus_id, self._stimulus_crc = request["stimulus_id"], request["crc32"]
        self._enter(State.IDLE)
        return Result.OK, 0

    def _stimulus_chunk(self, payload: bytes) -> tuple[Result, int]:
        request, codes = wire.unpack(wire.STIMULUS_CHUNK, payload, tail=True)
        if self.state is not State.IDLE:
            return Result.BAD_STATE, 0
        end = request["offset"] + len(codes) // 2
        if request["stimulus_id"] != self._stimulus_id or len(codes) % 2 or end > self._stimulus.size:
            return Result.BAD_ARGUMENT, 0
        self._stimulus[request["offset"] : end] = np.frombuffer(codes, "<i2")
        return Result.OK, end

    def _stimulus_commit(self, payload: bytes) -> tuple[Result, int]:
        request, _ = wire.unpack(wire.STIMULUS_COMMIT, payload)
        if self.state is not State.IDLE:
            return Result.BAD_STATE, 0
        if request["stimulus_id"] != self._stimulus_id or self._stimulus.size == 0:
            return Result.BAD_ARGUMENT, 0
        crc = zlib.crc32(self._stimulus.tobytes())
        if crc != self._stimulus_crc:
            return Result.CHECKSUM, crc
        self._enter(State.LOADED)
        return Result.OK, self._stimulus.size

    def _arm(self, payload: bytes, now_s: float) -> tuple[Result, int]:
        request, _ = wire.unpack(wire.ARM, payload)
        if self.state is not State.LOADED or request["stimulus_id"] != self._stimulus_id:
            return Result.BAD_STATE, 0
        limits = [request[name] for name in ("max_force_n", "min_position_m", "max_position_m", "max_temperature_c")]
        beyond = (
            not np.all(np.isfinite(limits))
            or not 0 < request["max_force_n"] <= self.identity.max_force_n
            or not 0 <= request["min_position_m"] < request["max_position_m"] <= self.bench.parameters.stroke_m
            or request["max_temperature_c"] > self.identity.max_temperature_c
            or not 0 < request["max_samples"] <= MAX_RUN_S * SAMPLE_RATE_HZ
            or self._stimulus.size > request["max_samples"]
        )
        coil = self.bench.parameters
        newtons_per_volt = coil.amplifier_gain * coil.force_constant_n_per_a / coil.resistance_ohm
        static_force = np.abs(self._volts(self._stimulus)) * newtons_per_volt
        if beyond or static_force.max() > request["max_force_n"] * FORCE_MARGIN:
            return Result.BEYOND_LIMITS, 0
        self._armed = _Armed(
            **{name: request[name] for name in _Armed.__dataclass_fields__},
        )
        self._last_heartbeat_s = now_s
        self._enter(State.ARMED)
        return Result.OK, 0

    def _start(self, payload: bytes) -> tuple[Result, int]:
        request, _ = wire.unpack(wire.START, payload)
        if self.state is not State.ARMED or self._armed is None or request["token"] != self._armed.token:
            return Result.BAD_STATE, 0
        self._cursor = 0
        self._start_index = self.sample_index
        self._enter(State.RUNNING)
        return Result.OK, self._start_index

    def _release(self, *, forget: bool) -> tuple[Result, int]:
        self._armed = None
        if self.state in (State.ARMED, State.RUNNING):
            self._enter(State.LOADED)
        if forget and self.state is State.LOADED:
            self._stimulus = self._stimulus[:0]
            self._enter(State.IDLE)
        return Result.OK, self._cursor

    # -- the clock ----------------------------------------------------------------------------------------

    def advance(self, samples: int, now_s: float) -> None:
        """The device clock moves on by ``samples`` sample periods; the watchdog's clock reads ``now_s``."""
        self._check_watchdog(now_s)
        while samples > 0:
            count = min(samples, SAMPLES_PER_FRAME - self._samples.size)
            count = self._sample(count)
            samples -= count
            if self._samples.size == SAMPLES_PER_FRAME:
                self._emit(now_s)
        if self.streaming and now_s - self._last_frame_s > HOST_SILENCE_S:
            self.streaming = False

    def _check_watchdog(self, now_s: float) -> None:
        if self.state in (State.ARMED, State.RUNNING) and now_s - self._last_heartbeat_s > self.watchdog_s:
            self._trip(Fault.WATCHDOG)

    def _sample(self, count: int) -> int:
        """Play and sample up to ``count`` samples; fewer where the stimulus ends or a limit trips."""
        command, playing = self._command(count)
        before = self.bench.snapshot()
        block = self.bench.block(command, self.energised)
        fault = Fault.NONE
        if self.energised:
            first, fault = self._first_violation(block)
            if fault and first + 1 < command.size:
                # The trip acts on the very next sample, so what came after it never happened.
                self.bench.restore(before)
                command = command[: first + 1]
                block = self.bench.block(command, energised=True)
        taken = np.zeros(command.size, wire.SAMPLE)
        for column, name in enumerate(_SIGNALS):
            taken[name] = block.codes[:, column]
        taken["flags"] = (
            Flag.PLAYING * playing
            | Flag.ENERGISED * self.energised
            | Flag.BUTTON * block.button
            | np.where(block.flags, Flag.SATURATED, 0)
        )
        self._samples = np.concatenate((self._samples, taken))
        self.sample_index += command.size
        if self.state is State.RUNNING:
            self._cursor += command.size
            if fault:
                self._trip(fault)
            elif self._cursor >= self._stimulus.size + self._ramp_samples:
                self._armed = None
                self._enter(State.LOADED)
        return command.size

    @property
    def _ramp_samples(self) -> int:
        return round(RELEASE_RAMP_S * SAMPLE_RATE_HZ)

    def _command(self, count: int) -> tuple[NDArray[np.float64], bool]:
        """Volts for the next samples, and whether they belong to the stimulus."""
        if self.state is not State.RUNNING:
            return np.zeros(count), False
        left = self._stimulus.size - self._cursor
        if left > 0:
            return self._volts(self._stimulus[self._cursor : self._cursor + min(count, left)]), True
        done = -left
        count = min(count, self._ramp_samples - done)
        weight = 1.0 - (done + 1.0 + np.arange(count)) / self._ramp_samples
        return self._volts(self._stimulus[-1:]) * weight, False

    def _volts(self, codes: NDArray[np.int16]) -> NDArray[np.float64]:
        return self._channels["command"].decode(codes)

    def _first_violation(self, block: Block) -> tuple[int, Fault]:
        assert self._armed is not None
        limits = self._armed
        samples = block.codes.shape[0]

        def physical(name: str) -> NDArray[np.float64]:
            return self._channels[name].decode(block.codes[:, _SIGNALS.index(name)])

        force = np.abs(physical("current")) * self.bench.parameters.force_constant_n_per_a
        position = physical("position")
        checks = (
            (Fault.OVER_FORCE, force > limits.max_force_n * FORCE_MARGIN),
            (Fault.STROKE, (position < limits.min_position_m) | (position > limits.max_position_m)),
            (Fault.OVER_TEMPERATURE, physical("temperature") > limits.max_temperature_c),
            (
                Fault.OVER_TIME,
                self._cursor + np.arange(samples) >= limits.max_samples + self._ramp_samples,
            ),
            (Fault.BUTTON, np.full(samples, block.button)),
        )
        found = [(int(np.argmax(broken)), fault) for fault, broken in checks if broken.any()]
        return min(found, key=lambda item: item[0]) if found else (0, Fault.NONE)

    def _trip(self, fault: Fault) -> None:
        self.faults |= fault
        self._armed = None
        self._enter(State.FAULT)

    def _enter(self, state: State) -> None:
        self.state = state
        self._send_status()

    # -- bytes out ----------------------------------------------------------------------------------------

    def _emit(self, now_s: float) -> None:
        first = self.sample_index - self._samples.size
        if self.streaming and now_s >= self.stalled_until_s:
            self._send(MessageType.DATA, self._samples.tobytes(), first)
        self._samples = self._samples[:0]

    def _send_status(self) -> None:
        payload = wire.pack(
            wire.STATUS,
            state=self.state,
            streaming=self.streaming,
            faults=self.faults,
            boot_id=self.boot_id,
            dropped_frames=self.dropped_frames,
            refused_frames=self._decoder.statistics.refused,
            played_samples=min(self._cursor, self._stimulus.size),
        )
        self._send(MessageType.STATUS, payload)

    def _send(self, kind: MessageType, payload: bytes, index: int | None = None) -> None:
        index = self.sample_index if index is None else index
        frame = Frame(kind, self._sequence, round(index / SAMPLE_RATE_HZ * 1e6), index, payload)
        self._sequence = (self._sequence + 1) & 0xFFFF
        encoded = wire.encode_frame(frame)
        if self._outbox_bytes + len(encoded) > TRANSMIT_QUEUE_BYTES:
            # A host that does not read loses frames; the gap shows in the sample index, and the count in STATUS.
            self.dropped_frames += 1
            return
        self._outbox.append(encoded)
        self._outbox_bytes += len(encoded)

    def transmit(self, now_s: float) -> bytes:
        """Take everything that waits to be sent."""
        if now_s < self.stalled_until_s:
            return b""
        data = b"".join(self._outbox)
        self._outbox.clear()
        self._outbox_bytes = 0
        return data
