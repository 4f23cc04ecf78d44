"""Firmware: a state machine that controls the coil. Bytes and time in, bytes out; it has no ports or clocks itself.

``docs/protocol.md`` specifies the protocol; the safety rules of its section 5 hold for any behaviour of the host.
"""

from __future__ import annotations

from math import isnan

import numpy as np
from numpy.typing import NDArray

from firmware_sim.bench import Bench
from firmware_sim.guard import Guard
from firmware_sim.identity import Identity
from firmware_sim.limits import MAX_RUN_S, ArmedLimits
from firmware_sim.outbox import Outbox
from firmware_sim.player import Player
from firmware_sim.response_cache import ResponseCache
from firmware_sim.sampler import SIGNALS, sampled
from firmware_sim.setpoints import Setpoints
from firmware_sim.stimulus_memory import Answer, StimulusMemory
from tissueid import wire
from tissueid.wire import Fault, Frame, MessageType, Result, State

FRAME_S = 0.01
"""Duration of the samples in a DATA frame, s."""

WATCHDOG_S = 0.5
ALWAYS_OBEYED = (MessageType.STOP, MessageType.RELEASE, MessageType.FINISH)
"""Requests that release the coil: accepted from any host, in any state, without a handshake."""

LEAST_SUPPLY_SHARE = 0.4
"""Supply voltage, relative to normal, below which the amplifier is off."""

HOST_SILENCE_S = 2.0
"""Silence of the host, s, after which streaming ends, so that the next host finds a quiet line."""

STIMULUS_CAPACITY_S = 120.0


class Firmware:
    """The firmware of the instrument on a simulated bench.

    Call ``receive`` with bytes from the host, ``advance`` when the device clock advances, ``transmit`` for the bytes to
    send. ``now_s`` is the clock of the watchdog and must not decrease.
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
        self.sample_rate_hz = bench.sample_rate_hz
        self.samples_per_frame = round(FRAME_S * self.sample_rate_hz)
        self.stimulus_capacity = round(STIMULUS_CAPACITY_S * self.sample_rate_hz)
        self._random = np.random.default_rng([seed, 0xB007])
        self.channels = dict(zip(SIGNALS, bench.channels, strict=True))
        self._power_up()

    def _power_up(self) -> None:
        self.state = State.IDLE
        self.faults = Fault.NONE
        self.streaming = False
        self.boot_id = int(self._random.integers(1, 2**32))
        self.sample_index = 0
        self._decoder = wire.FrameDecoder()
        self._outbox = Outbox(self.sample_rate_hz)
        self._answered = ResponseCache()
        self.greeted = False
        self._last_frame_s = self._last_heartbeat_s = 0.0
        self.frame_samples = np.zeros(0, wire.SAMPLE)
        self.stimulus = StimulusMemory(self.stimulus_capacity)
        self._setpoints = Setpoints(self.sample_rate_hz)
        self.player = Player(self._setpoints, self.sample_rate_hz, self.channels["command"].gain)
        self.guard = Guard(self.channels, self.bench.nominal, self.sample_rate_hz)
        self._token: int | None = None
        self.armed: ArmedLimits | None = None
        self.start_index = 0
        self.stalled_until_s = 0.0

    @property
    def energised(self) -> bool:
        """Whether the amplifier is enabled."""
        return self.state is State.RUNNING

    @property
    def samples_to_frame(self) -> int:
        """Number of samples until the next DATA frame is complete."""
        return self.samples_per_frame - self.frame_samples.size

    @property
    def samples_known(self) -> int:
        """Number of samples that can be played before a set-point is missing; the stimulus capacity if none is
        expected.
        """
        if self.state is not State.RUNNING or self.player.releasing or not self._setpoints.samples:
            return self.stimulus_capacity
        return self._setpoints.next_missing(self.player.cursor) - self.player.cursor

    @property
    def dropped_frames(self) -> int:
        """Number of frames dropped because the host did not read."""
        return self._outbox.dropped_frames

    def reboot(self) -> None:
        """Reset: the whole state is lost and the coil is released; the tissue is not affected."""
        self._power_up()
        self._send_status()

    def brown_out(self) -> None:
        """Handle a drop of the supply voltage: the amplifier is off until the fault is cleared."""
        self.trip(Fault.BROWN_OUT)

    def stall(self, until_s: float) -> None:
        """Hang until ``until_s``: nothing is received or sent. The watchdog has a separate oscillator and keeps
        running.
        """
        self.stalled_until_s = until_s

    # -- bytes in -----------------------------------------------------------------------------------------

    def connected(self) -> None:
        """Handle a new connection, on a line that has connections: its host has to send HELLO first."""
        self.greeted = False

    def receive(self, data: bytes, now_s: float) -> None:
        """Process bytes from the host. Damaged frames are dropped and counted."""
        if now_s < self.stalled_until_s:
            return
        for frame in self._decoder.feed(data):
            self._last_frame_s = now_s
            self._handle(frame, now_s)

    def _handle(self, frame: Frame, now_s: float) -> None:
        if frame.type == MessageType.HEARTBEAT:
            if self.greeted:
                self._last_heartbeat_s = now_s
        elif frame.type == MessageType.STATUS_REQUEST:
            self._send_status()
        elif frame.type == MessageType.HELLO:
            self._answered.forget()
            self._hello(frame)
        else:
            self._send(MessageType.ACK, self._answered.once(frame, lambda: self._answer(frame, now_s)))

    def _answer(self, frame: Frame, now_s: float) -> bytes:
        result, detail = Result.BAD_STATE, 0
        if self.greeted or frame.type in ALWAYS_OBEYED:
            try:
                result, detail = self.obey(frame, now_s)
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
        self.greeted = self.identity.speaks(hello["protocol_min"], hello["protocol_max"])
        if not self.greeted:
            self.release(forget=False)  # the host of the run has disconnected
        answer = self.identity.hello_ack(
            self.bench.nominal,
            self.channels,
            boot_id=self.boot_id,
            samples_per_frame=self.samples_per_frame,
            sample_rate_hz=self.sample_rate_hz,
            stimulus_capacity=self.stimulus_capacity,
            watchdog_s=self.watchdog_s,
        )
        self._send(MessageType.HELLO_ACK, answer)

    def obey(self, frame: Frame, now_s: float) -> Answer:
        """Carry out a request; return the result and its detail."""
        if self.state is State.FAULT and MessageType.STIMULUS_BEGIN <= frame.type <= MessageType.START:
            return Result.FAULT_LATCHED, int(self.faults)
        if self.bench.button and frame.type in (MessageType.ARM, MessageType.START, MessageType.STAGE):
            return Result.FAULT_LATCHED, int(Fault.BUTTON)  # no motion while the button is pressed
        match frame.type:
            case MessageType.STREAM:
                request, _ = wire.unpack(wire.STREAM, frame.payload)
                self.streaming = bool(request["on"])
                self.frame_samples = self.frame_samples[:0]
                return Result.OK, self.sample_index
            case MessageType.STIMULUS_BEGIN | MessageType.STIMULUS_CHUNK | MessageType.STIMULUS_COMMIT:
                return self._load(frame)
            case MessageType.FOLLOW:
                return self._follow(frame.payload)
            case MessageType.SETPOINTS:
                return self._take_setpoints(frame.payload)
            case MessageType.ARM:
                return self._arm(frame.payload, now_s)
            case MessageType.START:
                return self._start(frame.payload)
            case MessageType.STOP | MessageType.RELEASE:
                return self.release(forget=frame.type == MessageType.RELEASE)
            case MessageType.FINISH:
                return self._finish()
            case MessageType.STAGE if self.identity.stage:
                return self._move_stage(frame.payload)
            case MessageType.CLEAR_FAULTS:
                self.faults = Fault.NONE
                if self.state is State.FAULT:
                    self.enter(State.IDLE)
                return Result.OK, 0
        return Result.UNKNOWN, 0

    # -- requests -----------------------------------------------------------------------------------------

    def _load(self, frame: Frame) -> Answer:
        """Receive a stimulus: it is announced, sent in chunks, and can be played after a successful commit."""
        permitted = (State.IDLE, State.LOADED) if frame.type == MessageType.STIMULUS_BEGIN else (State.IDLE,)
        if self.state not in permitted:
            return Result.BAD_STATE, 0
        if frame.type == MessageType.STIMULUS_CHUNK:
            return self.stimulus.chunk(frame.payload)
        if frame.type == MessageType.STIMULUS_COMMIT:
            result, detail = self.stimulus.commit(frame.payload)
        else:
            result, detail = self.stimulus.begin(frame.payload)
        if result is Result.OK:
            self._setpoints.agree(0, 0.0)
            self.enter(State.LOADED if frame.type == MessageType.STIMULUS_COMMIT else State.IDLE)
        return result, detail

    def _follow(self, payload: bytes) -> Answer:
        request, _ = wire.unpack(wire.FOLLOW, payload)
        if self.state is not State.LOADED or request["stimulus_id"] != self.stimulus.id:
            return Result.BAD_STATE, 0
        room = round(MAX_RUN_S * self.sample_rate_hz) - self.stimulus.size
        if request["samples"] > room:
            return Result.TOO_LARGE, max(0, room)
        hold_v = float(self._volts(np.array([request["hold_code"]], "<i2"))[0])
        self._setpoints.agree(request["samples"], hold_v if request["samples"] else 0.0)
        return Result.OK, self.stimulus.size + request["samples"]

    def _arm(self, payload: bytes, now_s: float) -> Answer:
        request, _ = wire.unpack(wire.ARM, payload)
        if self.state is not State.LOADED or request["stimulus_id"] != self.stimulus.id:
            return Result.BAD_STATE, 0
        limits = ArmedLimits(**{name: request[name] for name in ArmedLimits.__dataclass_fields__})
        coil, length = self.bench.nominal, self.stimulus.size + self._setpoints.samples
        stimulus_v = self._volts(self.stimulus.codes)
        if (
            not limits.within(
                self.identity.max_force_n,
                self.identity.max_temperature_c,
                self.sample_rate_hz,
                self.channels,
                coil,
            )
            or length > limits.max_samples
            or not limits.permits(np.append(stimulus_v, self._setpoints.hold_v), coil)
        ):
            return Result.BEYOND_LIMITS, 0
        self.armed, self._token = limits, limits.token
        self.player.begin(stimulus_v, length)
        self.guard.begin(limits)
        self._last_heartbeat_s = now_s
        self.enter(State.ARMED)
        return Result.OK, 0

    def _start(self, payload: bytes) -> Answer:
        request, _ = wire.unpack(wire.START, payload)
        if self.state is not State.ARMED or self.armed is None or request["token"] != self.armed.token:
            return Result.BAD_STATE, 0
        self.start_index = self.sample_index
        self.bench.begin_test()
        self.enter(State.RUNNING)
        return Result.OK, self.start_index

    def _take_setpoints(self, payload: bytes) -> Answer:
        request, codes = wire.unpack(wire.SETPOINTS, payload, tail=True)
        if request["token"] != self._token:
            return Result.BAD_STATE, 0
        if self.armed is None or self.player.releasing:
            return Result.LATE, self.player.played  # the run is over
        volts = self._volts(np.frombuffer(codes[: len(codes) // 2 * 2], "<i2"))
        if len(codes) % 2 or not codes:
            result = Result.BAD_ARGUMENT
        elif not self.armed.permits(volts, self.bench.nominal):
            result = Result.BEYOND_LIMITS
        else:
            result = self._setpoints.take(request["offset"], volts, self.player.cursor)
        return result, self._setpoints.next_missing(self.player.cursor)

    def _finish(self) -> Answer:
        if self.state is State.FAULT:
            return Result.FAULT_LATCHED, int(self.faults)
        if self.state is State.ARMED:
            return self.release(forget=False)
        if self.state is State.RUNNING:
            self.player.finish()
        return Result.OK, self.player.played

    def _move_stage(self, payload: bytes) -> Answer:
        request, _ = wire.unpack(wire.STAGE, payload)
        if self.state is State.FAULT:
            return Result.FAULT_LATCHED, int(self.faults)
        if self.state in (State.ARMED, State.RUNNING):
            return Result.BAD_STATE, 0
        position_m = None if isnan(request["position_m"]) else request["position_m"]
        if position_m is not None and not 0.0 <= position_m <= self.bench.nominal.stroke_m:
            return Result.BAD_ARGUMENT, 0
        self.bench.place_fixture(position_m)
        return Result.OK, 0

    def release(self, *, forget: bool) -> Answer:
        """Release the coil and end the permission of the run; with ``forget``, drop the stimulus too."""
        self._disarm()
        if self.state in (State.ARMED, State.RUNNING):
            self.enter(State.LOADED)
        if forget and self.state is State.LOADED:
            self.stimulus.forget()
            self.enter(State.IDLE)
        return Result.OK, self.player.played

    def _disarm(self) -> None:
        """End the permission of a run: limits and set-points are agreed for one run only."""
        self.armed = None
        self._setpoints.agree(0, 0.0)

    # -- the clock ----------------------------------------------------------------------------------------

    def advance(self, samples: int, now_s: float) -> None:
        """Advance the device clock by ``samples`` sample periods; the clock of the watchdog reads ``now_s``."""
        self._check_watchdog(now_s)
        while samples > 0:
            count = min(samples, self.samples_per_frame - self.frame_samples.size)
            count = self._sample(count)
            samples -= count
            if self.frame_samples.size == self.samples_per_frame:
                self._emit(now_s)
        if self.streaming and now_s - self._last_frame_s > HOST_SILENCE_S:
            self.streaming = False

    def _check_watchdog(self, now_s: float) -> None:
        if self.state in (State.ARMED, State.RUNNING) and now_s - self._last_heartbeat_s > self.watchdog_s:
            self.trip(Fault.WATCHDOG)

    def _sample(self, count: int) -> int:
        """Play and sample up to ``count`` samples; fewer if the stimulus ends or a limit trips."""
        if self.bench.supply_share < LEAST_SUPPLY_SHARE and Fault.BROWN_OUT not in self.faults:
            self.brown_out()
        command, flags = self._command(count)
        taken = sampled(
            self.bench,
            self.guard,
            command,
            flags,
            energised=self.energised,
            limits=self.armed,
            cursor=self.player.cursor,
        )
        # A frame is usually sampled in one call; concatenating structured arrays is slow.
        self.frame_samples = (
            np.concatenate((self.frame_samples, taken.samples)) if self.frame_samples.size else taken.samples
        )
        self.sample_index += taken.samples.size
        if self.state is State.RUNNING:
            self.player.account(taken.command_v, taken.flags)
            self._go_on(taken.fault)
        elif self.state is State.ARMED and taken.button:
            self.trip(Fault.BUTTON)
        return taken.samples.size

    def _go_on(self, fault: Fault) -> None:
        """Continue or end the run after a block."""
        if fault:
            self.trip(fault)
        elif self._setpoints.starved:
            self.trip(Fault.STARVED)
        elif self.player.over:
            self._disarm()
            self.enter(State.LOADED)

    def _command(self, count: int) -> tuple[NDArray[np.float64], NDArray[np.uint16]]:
        """Return volts for up to ``count`` samples, and the flags of their source."""
        if self.state is State.RUNNING:
            return self.player.command(count)
        return np.zeros(count), np.zeros(count, np.uint16)

    def _volts(self, codes: NDArray[np.int16]) -> NDArray[np.float64]:
        return self.channels["command"].decode(codes)

    def trip(self, fault: Fault) -> None:
        """Latch a fault, which releases the coil."""
        self.faults |= fault
        self._disarm()
        self.enter(State.FAULT)

    def enter(self, state: State) -> None:
        """Change the state and report it."""
        self.state = state
        self._send_status()

    # -- bytes out ----------------------------------------------------------------------------------------

    def _emit(self, now_s: float) -> None:
        first = self.sample_index - self.frame_samples.size
        if self.streaming and now_s >= self.stalled_until_s:
            self._send(MessageType.DATA, self.frame_samples.tobytes(), first)
        self.frame_samples = self.frame_samples[:0]

    def _send_status(self) -> None:
        payload = wire.pack(
            wire.STATUS,
            state=self.state,
            streaming=self.streaming,
            faults=self.faults,
            boot_id=self.boot_id,
            dropped_frames=self.dropped_frames,
            refused_frames=self._decoder.statistics.refused,
            played_samples=self.player.played,
        ) + wire.pack(
            wire.STATUS_SETPOINTS, late_blocks=self._setpoints.late_blocks, held_samples=self.player.held_samples
        )
        self._send(MessageType.STATUS, payload)

    def _send(self, kind: MessageType, payload: bytes, index: int | None = None) -> None:
        self._outbox.put(kind, payload, self.sample_index if index is None else index)

    def transmit(self, now_s: float) -> bytes:
        """Return all bytes that wait to be sent."""
        return b"" if now_s < self.stalled_until_s else self._outbox.take()
