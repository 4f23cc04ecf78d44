"""A run of an instrument as one state machine, without input, output, clock or thread.

``step(state, event)`` returns the next state and the actions; it changes neither of its arguments. Events carry the
time by the host's clock. ``TABLE`` names the reaction to every event in every mode; docs/safety.md shows it. The loop
for input and output is ``driver.SerialInstrument`` for a device on a link, and ``host_played.HostPlayedInstrument`` for
a card and for the simulation in this process.

What keeps the coil safe on this side:

1. A command is checked against the limits in the step that sends it, every sample in the step that receives it.
2. A heartbeat follows only samples that passed the checks. From a release until the device has confirmed it, and after
   every failure, none is sent: the watchdog of the device releases the coil even if every frame is lost.
3. Every failure ends the run, and its last action is ``ReleaseCoil``.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

import tissueid.wire as wire
from tissueid.device import DeviceDescription
from tissueid.errors import FirmwareFaultError, InstrumentError, LinkLostError, TissueIDError
from tissueid.instrument.handshake import Handshake
from tissueid.instrument.interface import (
    SAMPLE,
    SIGNALS,
    Corrections,
    Gap,
    Run,
    calibration_while_running,
    checked_descriptions,
    corrected,
    empty_samples,
    not_armed,
    nothing_loaded,
    unexpected_set_points,
)
from tissueid.instrument.limits import Limits, check_command, check_limits, check_stimulus
from tissueid.instrument.replies import (
    CONTRADICTION,
    RESTARTED,
    STOPPED,
    Status,
    end_unseen,
    long_gap,
    no_answer,
    overdue,
    parse_status,
    refusal,
    release_unconfirmed,
    released_by_faults,
    silent,
    version_changed,
    watched,
)
from tissueid.instrument.sample_monitor import SampleMonitor, shallow_copy
from tissueid.version import SOFTWARE
from tissueid.wire import Fault, Flag, Frame, MessageType, Result, State

Volts = NDArray[np.float64]
Samples = NDArray[np.void]

HEARTBEAT_S = 0.1
"""Time between two heartbeats, s: at most half of the shortest watchdog of a supported device."""
SILENCE_S = 1.0
"""Time without new usable samples after which the link counts as lost, s. A device sends samples every 10 ms."""
UNJUDGED_S = 0.25
"""Time without usable samples after which a watchdog fault is attributed to the link, s."""
ANSWER_S = 0.3
"""Time for the answer to one attempt of a request, s."""
TRIES = 5
"""Attempts of a request before the link counts as lost."""
STAGE_TRIES = 100
"""Attempts of STAGE, whose answer arrives after the movement: 30 s, enough for the full travel."""
STOP_S = 0.1
"""Time for the answer to one attempt of STOP, s: shorter, because the watchdog releases the coil anyway."""
STOP_TRIES = 3
"""Attempts of STOP if the request before it was not answered; twice as many if it was."""
REPEAT_S = 0.03
"""Time after which a block of set-points without an answer is sent again, s: about the duration of a block."""
ROUND_TRIPS = 64
CHUNK_CODES = 480
"""Converter codes in one frame, 960 bytes."""
MAX_GAP_S = 5.0
"""Longest gap in the samples that the link may have, s; a longer one counts as a lost link."""
FREE_S = 0.1
"""Time after the end of a run until the coil must be free, s: twice the soft release."""
UNSEEN_END_S = 0.06
"""Time that the device has to report whether it played the last samples of a run, if these were lost, s."""
OVERDUE_SHARE, OVERDUE_S = 1.25, 5.0
"""Maximum duration of a run by the host's clock: factor on its nominal duration, plus seconds. The clock of a device
deviates by at most 10 %; a simulated device stalls while its computer is busy.
"""

_PLAYING, _ENERGISED, _HELD = int(Flag.PLAYING), int(Flag.ENERGISED), int(Flag.HELD)


class Mode(Enum):
    """Where a run stands, as the host knows it."""

    OPENING = "the handshake is not complete; the coil may be on from an earlier host"
    FREE = "no run is armed: the coil must be free"
    ARMED = "the limits of a run are agreed on"
    STARTING = "START is sent, and its answer is awaited"
    RUNNING = "the run is played"
    STOPPED = "the device stopped the run by itself, and is asked for the reason"
    FINISHING = "FINISH is sent, and its answer is awaited"
    UNSEEN_END = "the run is over, but its last samples were lost: the device is asked whether it played them"
    RELEASING = "STOP is sent, and its answer is awaited"
    FAILED = "the run ended with an error"
    LOST = "a release was never confirmed: nothing but STOP is sent on this link"


# -- events -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class RunEvent:
    """An event ``at`` a monotonic time of the host, s."""

    at: float


@dataclass(frozen=True)
class FrameReceived(RunEvent):
    """A frame that was decoded."""

    frame: Frame


class BytesRefused(RunEvent):
    """Bytes that could not be decoded."""


@dataclass(frozen=True)
class SamplesTaken(RunEvent):
    """Samples that this process took itself, shape (k,) of SAMPLE, as a card or a simulation gives them."""

    samples: Samples


class ClockTick(RunEvent):
    """The clock goes on, and all bytes that had arrived are processed."""


@dataclass(frozen=True)
class PortFailed(RunEvent):
    """The port failed when it was read or written."""

    error: LinkLostError


class HelloAsked(RunEvent):
    """HELLO is to be sent."""


@dataclass(frozen=True)
class Greeted(RunEvent):
    """The answer to HELLO is read and accepted."""

    handshake: Handshake


@dataclass(frozen=True)
class RequestAsked(RunEvent):
    """A request that no other event stands for is to be sent."""

    kind: MessageType
    payload: bytes = b""
    tries: int = TRIES


@dataclass(frozen=True)
class LoadAsked(RunEvent):
    """A stimulus, shape (n,), V, is to be sent."""

    command_v: Volts


@dataclass(frozen=True)
class FollowAsked(RunEvent):
    """Set-points after the stimulus are to be announced."""

    samples: int
    hold_v: float


@dataclass(frozen=True)
class ArmAsked(RunEvent):
    """The loaded stimulus is to be armed with these limits."""

    limits: Limits


class StartAsked(RunEvent):
    """The armed run is to be started."""


@dataclass(frozen=True)
class SetPointsGiven(RunEvent):
    """Set-points, shape (k,), V, for the samples of the run from ``offset`` are to be sent."""

    offset: int
    command_v: Volts


class FinishAsked(RunEvent):
    """The run is to end by its soft release."""


class StopAsked(RunEvent):
    """The coil is to be released now."""


class StatusAsked(RunEvent):
    """STATUS is to be requested."""


class ClearAsked(RunEvent):
    """The error of the last run and the latched faults of the device are to be cleared."""


@dataclass(frozen=True)
class CalibrationChosen(RunEvent):
    """A calibration is to be used: its device description and corrections."""

    device: DeviceDescription
    corrections: Corrections


# -- actions ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SendFrame:
    """Send ``data``, the encoded frame of a message."""

    kind: MessageType
    sequence: int
    data: bytes


@dataclass(frozen=True)
class DeliverSamples:
    """Deliver samples, shape (k,) of SAMPLE. Lost ones come first, as NaN, and are named by ``gap``."""

    samples: Samples
    gap: Gap | None


@dataclass(frozen=True)
class ReleaseCoil:
    """Drive nothing from now on, and send ``stop``, the frame of STOP, if there is one.

    There is none where the device reported that the coil is free, and where the link is lost: then the missing
    heartbeat releases the coil.
    """

    stop: SendFrame | None


@dataclass(frozen=True)
class EndRun:
    """Take the run for ended, by this error if it failed."""

    error: TissueIDError | None


@dataclass(frozen=True)
class GiveAnswer:
    """Give the caller the outcome of what was asked: result and detail of the device, or an error."""

    error: TissueIDError | None = None
    result: int = Result.OK
    detail: int = 0


@dataclass(frozen=True)
class Greet:
    """Read the payload of a HELLO_ACK."""

    payload: bytes


@dataclass(frozen=True)
class WriteLine:
    """Write a line to the log."""

    text: str


RunAction = SendFrame | DeliverSamples | ReleaseCoil | EndRun | GiveAnswer | Greet | WriteLine
_Out = list[RunAction]


# -- state ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class PendingRequest:
    """A request without an answer so far. ``then`` are the requests that follow it."""

    sent: SendFrame
    asked: RunEvent
    """What the request was sent for."""
    error: TissueIDError | None
    """Error of the run at that time: another one ends the request."""
    sent_s: float
    tries: int = TRIES
    repeated: bool = False
    then: tuple[tuple[MessageType, bytes], ...] = ()
    limits: Limits | None = None


@dataclass(frozen=True)
class SetPointBlock:
    """A block without an answer so far: set-points ``offset`` to ``end`` of the run."""

    offset: int
    end: int
    sent: SendFrame
    sent_s: float


@dataclass
class RunState:
    """All that the machine knows. ``step`` changes a copy; its values are never changed in place.

    Only ``error``, ``lost``, the counts and ``status`` stay from run to run.
    """

    port: str
    mode: Mode = Mode.OPENING
    handshake: Handshake | None = None
    """None where this process plays the run itself."""
    nominal: DeviceDescription = field(default_factory=DeviceDescription)
    device: DeviceDescription | None = None
    """Description by the active calibration; None without one."""
    corrections: Corrections = field(default_factory=dict)
    checks: SampleMonitor = field(default_factory=lambda: SampleMonitor(DeviceDescription()))
    tail: int = 1
    """Samples after a run that must have arrived before its checks end: with a card, all of the soft release."""

    # The link.
    sequence: int = 0
    heartbeat_s: float = 0.0
    """Time of the last heartbeat."""
    heard_s: float = 0.0
    """Time of the last new samples."""
    fresh: bool = False
    """Whether new samples passed the checks since the last tick."""
    unusable: bool = False
    """Whether the newest samples could not be used."""
    request: PendingRequest | None = None
    stop: PendingRequest | None = None
    unanswered: bool = False
    """Whether the newest request got no answer."""
    repeated_requests: int = 0
    round_trips_s: tuple[float, ...] = ()
    """Newest times from a request to its answer, without repeated requests, s."""
    status: Status | None = None

    # The samples.
    next_index: int | None = None
    temperature_c: Volts = field(default_factory=lambda: np.zeros(0))
    """Readings of the newest samples, degC."""

    # The run.
    stimulus_id: int = 0
    command_v: Volts = field(default_factory=lambda: np.zeros(0))
    following: int = 0
    hold_v: float = 0.0
    token: int = 0
    limits: Limits | None = None
    """Limits of the armed run; without them the coil must be free."""
    armed_s: float = 0.0
    """Time of the answer to ARM. Its limits do not apply to samples that arrived together with it."""
    run: Run | None = None
    earliest: int = 0
    """First index that a run may have whose START is not answered."""
    seen_first: int | None = None
    """Index of the first played sample before the answer to START."""
    received_to: int = 0
    played_to: int = 0
    stopped_at: int | None = None
    """Index of the first sample of the run that was not played."""
    unseen: Run | None = None
    """A run that is over, the last samples of which were lost."""
    free_from: int = 0
    """Index of the first sample at which the coil must be free after a run."""
    began_s: float = 0.0
    """Time of the answer to START."""
    allowed_s: float = 0.0
    """Time that the run may take by the host's clock."""
    error: TissueIDError | None = None
    lost: LinkLostError | None = None

    # The set-points.
    blocks: tuple[SetPointBlock, ...] = ()
    refused: TissueIDError | None = None
    late_answers: int = 0
    late_blocks: int = 0
    repeated_blocks: int = 0
    margin_samples: int | None = None
    """Least time between the arrival of a block and its first sample, in samples."""
    held_received: int = 0
    held_samples: int = 0

    def descriptions(self) -> tuple[DeviceDescription, ...]:
        """Return the descriptions for which limits must hold."""
        return checked_descriptions(self.nominal, self.device or self.nominal)

    def samples_in(self, seconds: float) -> int:
        """Return the number of samples in this time."""
        return round(seconds * self.nominal.sample_rate_hz)

    def effective_limits(self, limits: Limits) -> Limits:
        """Return ``limits``, reduced to the fixed limits of the device."""
        return limits if self.handshake is None else self.handshake.effective_limits(limits)


# -- frames -----------------------------------------------------------------------------------------------------------


def _frame(s: RunState, kind: MessageType, payload: bytes = b"") -> SendFrame:
    sequence, s.sequence = s.sequence, (s.sequence + 1) & 0xFFFF
    return SendFrame(kind, sequence, wire.encode_frame(Frame(kind, sequence, payload=payload)))


def _codes(s: RunState, volts: Volts) -> NDArray[np.int16]:
    return np.zeros(0, np.int16) if s.handshake is None else s.handshake.codes(volts)


def _ask(s: RunState, at: float, out: _Out, asked: RunEvent, *requests: tuple[MessageType, bytes], **more: Any) -> None:
    """Send the first of these requests; each of the others follows when the one before it is answered.

    A request that is not answered yet, because its caller was interrupted, is dropped.
    """
    sent = _frame(s, *requests[0])
    s.request = PendingRequest(sent, asked, s.error, at, then=requests[1:], **more)
    out.append(sent)


def _answer(s: RunState, out: _Out, error: TissueIDError | None) -> None:
    """End the pending request, if there is one."""
    if s.request is not None:
        s.request = None
        out.append(GiveAnswer(error))


def _beat(s: RunState, at: float, out: _Out) -> None:
    s.heartbeat_s = at
    out.append(_frame(s, MessageType.HEARTBEAT))


# -- ends -------------------------------------------------------------------------------------------------------------


def _end(s: RunState, out: _Out, error: TissueIDError | None = None) -> None:
    """End the run, if one is armed or running. The coil must be free after its soft release."""
    if s.limits is not None or error is not None:
        out.append(EndRun(error))
    s.run = s.limits = s.refused = None
    s.following = 0
    s.blocks = ()
    s.free_from = (s.next_index or 0) + s.samples_in(FREE_S)
    if s.mode is not Mode.RELEASING:
        s.mode = _rest(s)


def _rest(s: RunState) -> Mode:
    if s.lost is not None:
        return Mode.LOST
    if s.error is not None:
        return Mode.FAILED
    return Mode.FREE if s.unseen is None else Mode.UNSEEN_END


def _fail(s: RunState, at: float, out: _Out, error: TissueIDError, *, stop: bool = False) -> None:
    """End the run by an error and release the coil, by STOP where it may be on. Of several errors the first is kept."""
    if s.error is not None:
        return
    s.error, s.unseen = _with_watchdog(s, error), None
    _end(s, out, s.error)
    if stop and s.mode is Mode.FAILED:
        _release(s, at, out)
    else:
        out.append(ReleaseCoil(None))


def _release(s: RunState, at: float, out: _Out) -> None:
    """Send STOP. A request that could drive the coil is never repeated from now on."""
    if s.error is None and s.request is not None and s.request.sent.kind in (MessageType.ARM, MessageType.START):
        _answer(s, out, not_armed())
    s.mode = Mode.RELEASING
    sent = _frame(s, MessageType.STOP)
    s.stop = PendingRequest(sent, StopAsked(at), None, at, STOP_TRIES * (1 if s.unanswered else 2))
    out.append(ReleaseCoil(sent))


def _released(s: RunState) -> None:
    """End the release. Samples from before it have arrived by now."""
    s.stop = None
    s.free_from = (s.next_index or 0) + s.samples_in(FREE_S)
    s.mode = _rest(s)


def _lose(s: RunState, at: float, out: _Out, why: str) -> None:
    """Give up a release that the device did not confirm: send no heartbeat on this link any more."""
    s.lost = release_unconfirmed(s.port, why)
    out.append(WriteLine(str(s.lost)))
    _released(s)
    _answer(s, out, s.lost)
    _fail(s, at, out, s.lost)


def _with_watchdog(s: RunState, error: TissueIDError) -> TissueIDError:
    """Return the error of a lost link with the timeout of the watchdog: the coil may still be energised."""
    if s.handshake is None or not isinstance(error, LinkLostError) or error.watchdog_s is not None:
        return error
    return watched(error, s.handshake.watchdog_s)


def _silent(s: RunState, at: float) -> LinkLostError:
    return silent(s.port, at - s.heard_s, unusable=s.unusable)


# -- reactions: samples -----------------------------------------------------------------------------------------------


def check_data(s: RunState, event: FrameReceived, out: _Out) -> None:
    """Mark lost samples, deliver, and check all; new samples that pass permit the next heartbeat."""
    s.unusable = True
    frame, expected = event.frame, s.next_index
    if s.handshake is None or (expected is not None and frame.sample_index < expected):
        return  # a duplicate, or late: already marked as lost
    if not frame.payload or len(frame.payload) % wire.SAMPLE.itemsize:
        raise wire.PayloadError("a data frame holds no sample, or part of one")
    missing = 0 if expected is None else frame.sample_index - expected
    if missing > MAX_GAP_S * s.nominal.sample_rate_hz:
        _fail(s, event.at, out, long_gap(missing))
        return
    codes = np.frombuffer(frame.payload, wire.SAMPLE)
    samples = np.zeros(codes.size, SAMPLE)
    samples["index"] = frame.sample_index + np.arange(codes.size)
    samples["flags"] = codes["flags"]
    for channel, name in enumerate(SIGNALS):
        samples[name] = codes[name] * s.handshake.gains[channel] + s.handshake.offsets[channel]
    s.unusable, s.fresh, s.heard_s = False, True, event.at
    s.held_received += int(np.count_nonzero(codes["flags"] & _HELD))
    # Held samples among the lost ones are counted by the STATUS at the end of the run.
    s.held_samples = max(s.held_samples, s.held_received)
    s.temperature_c = samples["temperature"]
    gap = None
    if missing and expected is not None:
        gap = Gap(expected, missing)
        samples = np.concatenate((empty_samples(expected, missing), samples))
    _check(s, event.at, samples, gap, out)


def check_samples(s: RunState, event: SamplesTaken, out: _Out) -> None:
    """Deliver and check samples that this process took itself."""
    s.temperature_c = event.samples["temperature"]
    _check(s, event.at, event.samples, None, out)


def _check(s: RunState, at: float, read: Samples, gap: Gap | None, out: _Out) -> None:
    """Deliver samples and check them, as read and as corrected, and whether they end the run."""
    out.append(DeliverSamples(read, gap))
    s.next_index = int(read["index"][-1]) + 1
    _check_unseen_end(s, at, out)
    if s.mode is Mode.STARTING and s.seen_first is None:
        playing = read["index"][(read["flags"] & _PLAYING) > 0]
        s.seen_first = int(playing[0]) if playing.size else None
    run = s.run
    if s.mode is Mode.STARTING and s.seen_first is not None:
        run = Run(s.seen_first, s.command_v.size + s.following)
    s.checks = s.checks.copy()
    try:
        calibrated = None if s.device is None else (corrected(read, s.corrections), s.device)
        limits = None if s.mode is Mode.ARMED and at <= s.armed_s else s.limits
        s.checks.check(read, limits, run, calibrated)
    except TissueIDError as error:
        _fail(s, at, out, error, stop=True)
        return
    if s.limits is None:
        energised = read["index"][(read["flags"] & _ENERGISED) > 0]
        if energised.size and energised[-1] >= s.free_from:
            _release_again(s, at, out, "its samples show it")
    elif s.run is not None:
        _check_playing(s, at, read, s.run, out)


def _check_playing(s: RunState, at: float, read: Samples, run: Run, out: _Out) -> None:
    """Check which samples were played. A run with an idle sample inside was stopped by the device."""
    index, played = read["index"], (read["flags"] & _PLAYING) > 0
    inside = (index >= run.first_index) & (index < run.end_index) & np.isfinite(read["position"])
    if inside.any():
        s.received_to = int(index[inside][-1]) + 1
    if s.mode is Mode.RUNNING and (idle := inside & ~played).any():
        s.stopped_at, s.mode = int(index[idle][0]), Mode.STOPPED
    if played.any():
        s.played_to = int(index[played][-1]) + 1
        if (played & ~inside).any() or s.played_to > (run.end_index if s.stopped_at is None else s.stopped_at):
            _fail(s, at, out, InstrumentError(CONTRADICTION), stop=True)
            return
    over = index[-1] + 1 >= run.end_index + s.tail
    if s.stopped_at is not None:
        if over:
            _fail(s, at, out, FirmwareFaultError(STOPPED))
        else:  # the STATUS with the reason was lost; ask with every frame, as answers may be lost too
            out.append(_frame(s, MessageType.STATUS_REQUEST))
    elif over:
        if s.received_to < run.end_index:
            s.unseen = run
            out.append(_frame(s, MessageType.STATUS_REQUEST))
        _end(s, out)


def _check_unseen_end(s: RunState, at: float, out: _Out) -> None:
    """Fail a run whose last samples were lost if the device does not report in time that it played them."""
    run = s.unseen
    if run is None or s.next_index is None:
        return
    if s.next_index <= run.end_index + s.samples_in(UNSEEN_END_S):
        out.append(_frame(s, MessageType.STATUS_REQUEST))
        return
    _fail(s, at, out, end_unseen(run.end_index - max(run.first_index, s.received_to)))


def _release_again(s: RunState, at: float, out: _Out, why: str) -> None:
    """Release a coil that is energised although no run is armed."""
    if s.mode not in (Mode.RELEASING, Mode.LOST):
        out.append(WriteLine(f"the coil is on although nothing runs ({why}): released again"))
        _end(s, out)
        _release(s, at, out)


# -- reactions: other frames ------------------------------------------------------------------------------------------


def note_status(s: RunState, event: FrameReceived, out: _Out) -> None:
    """Keep the STATUS."""
    del out
    s.status = parse_status(event.frame.payload)


def check_status(s: RunState, event: FrameReceived, out: _Out) -> None:
    """Fail after a restart, a fault or an end by the device; release a coil that is on without a run."""
    s.status = status = parse_status(event.frame.payload)
    index, at = event.frame.sample_index, event.at
    s.late_blocks = max(s.late_blocks, status.late_blocks)
    s.held_samples = max(s.held_samples, status.held_samples)
    if status.faults == Fault.WATCHDOG and s.limits is not None and at - s.heard_s > UNJUDGED_S:
        _fail(s, at, out, _silent(s, at))
    if s.handshake is not None and status.boot_id != s.handshake.boot_id:
        _fail(s, at, out, FirmwareFaultError(RESTARTED))
    elif s.unseen is not None and index >= s.unseen.end_index:
        _end_by_status(s, at, status, s.unseen, out)
    elif s.limits is not None and status.faults:
        _fail(s, at, out, released_by_faults(status.faults))
    elif s.run is not None and s.stopped_at is not None and status.state is not State.RUNNING:
        _fail(s, at, out, FirmwareFaultError(STOPPED))
    elif s.limits is None and status.state is State.RUNNING and index >= s.free_from:
        _release_again(s, at, out, "its STATUS shows it")


def _end_by_status(s: RunState, at: float, status: Status, run: Run, out: _Out) -> None:
    """End a run whose last samples were lost by what the device reports of it."""
    if status.faults:
        _fail(s, at, out, released_by_faults(status.faults))
    elif status.state is not State.ARMED and status.played_samples < run.samples:
        _fail(s, at, out, FirmwareFaultError(STOPPED))
    s.unseen = None
    if s.mode is Mode.UNSEEN_END:
        s.mode = Mode.FREE


def read_hello(s: RunState, event: FrameReceived, out: _Out) -> None:
    """Have the HELLO_ACK read."""
    del s
    out.append(Greet(event.frame.payload))


def fail_version(s: RunState, event: FrameReceived, out: _Out) -> None:
    """Fail: the device speaks another version."""
    s.unusable = s.unusable or event.frame.type == MessageType.DATA
    _fail(s, event.at, out, version_changed(event.frame.version))


def react_by_type(s: RunState, event: FrameReceived, out: _Out) -> None:
    """React as to a frame of this version: the answer to HELLO says which version the device speaks."""
    TABLE[_FRAMES.get(event.frame.type, "a frame of another type")][s.mode](s, event, out)


def take_answer(s: RunState, event: FrameReceived, out: _Out) -> None:
    """Answer the pending request, and change the mode by what was agreed on."""
    ack, _ = wire.unpack(wire.ACK, event.frame.payload, tail=True)
    kind, sequence, result, detail = (ack[name] for name in ("request_type", "request_sequence", "result", "detail"))
    if kind == MessageType.SETPOINTS:
        _take_block_answer(s, event.frame.sample_index, sequence, result, detail)
        return
    request = s.stop if kind == MessageType.STOP else s.request
    if request is None or (kind, sequence) != (request.sent.kind, request.sent.sequence):
        return  # a repeated answer
    s.unanswered = False
    if request is s.stop and result == Result.OK:
        _released(s)
        return
    if request is s.stop:
        _lose(s, event.at, out, refusal(MessageType.STOP, result, detail).message)
        return
    if not request.repeated:  # the answer to a repeated request can belong to any of its attempts
        s.round_trips_s = (*s.round_trips_s[1 - ROUND_TRIPS :], event.at - request.sent_s)
    if result == Result.OK and request.then:
        s.request = None
        _ask(s, event.at, out, request.asked, *request.then)
        return
    s.request, before = None, s.error
    if result == Result.OK:
        _agree(s, event.at, request, detail, out)
        error = None if s.error is before else s.error  # a contradiction
    else:
        error = refusal(request.sent.kind, result, detail)
        s.mode = _continued(s) if s.mode in (Mode.STARTING, Mode.FINISHING) else s.mode
    out.insert(0, GiveAnswer(error, result, detail))
    begun = kind == MessageType.START and s.mode is Mode.RUNNING
    if begun and s.status is not None and s.status.faults:
        _fail(s, event.at, out, released_by_faults(s.status.faults))  # reported before this answer was read


def _continued(s: RunState) -> Mode:
    """Return the mode of an armed run, whether or not it runs."""
    if s.run is None:
        return Mode.ARMED if s.limits is not None else _rest(s)
    return Mode.RUNNING if s.stopped_at is None else Mode.STOPPED


def _agree(s: RunState, at: float, request: PendingRequest, detail: int, out: _Out) -> None:
    """Change the state by a request that the device has carried out."""
    kind, asked = request.sent.kind, request.asked
    if kind == MessageType.STREAM and s.mode is Mode.OPENING:
        s.mode, s.heard_s = Mode.FREE, at
    elif isinstance(asked, LoadAsked):
        s.command_v = np.asarray(asked.command_v, np.float64)
    elif isinstance(asked, FollowAsked):
        s.following, s.hold_v = asked.samples, asked.hold_v
    elif isinstance(asked, ArmAsked) and s.mode in (Mode.FREE, Mode.ARMED):  # nothing failed meanwhile
        s.limits, s.mode, s.run, s.armed_s = request.limits, Mode.ARMED, None, at
        s.refused = s.margin_samples = None
        s.late_answers = s.late_blocks = s.repeated_blocks = s.held_received = s.held_samples = 0
    elif kind == MessageType.START and s.mode is Mode.STARTING:
        _begin_run(s, at, detail, out)
    elif kind == MessageType.FINISH:
        _shorten_run(s, at, detail, out)
    elif isinstance(asked, ClearAsked) and s.mode is Mode.FAILED:
        s.error, s.mode = None, Mode.FREE


def _begin_run(s: RunState, at: float, first: int, out: _Out) -> None:
    """Begin the run at the sample that the device names, unless the samples contradict it."""
    run = Run(first, s.command_v.size + s.following)
    latest = (s.next_index or 0) + s.samples_in(MAX_GAP_S) if s.seen_first is None else s.seen_first
    if not s.earliest <= first <= latest:
        _fail(s, at, out, InstrumentError(CONTRADICTION), stop=True)
        return
    s.run, s.played_to, s.mode = run, first, Mode.RUNNING
    s.began_s, s.allowed_s = at, OVERDUE_SHARE * run.samples / s.nominal.sample_rate_hz + OVERDUE_S


def _shorten_run(s: RunState, at: float, played: int, out: _Out) -> None:
    """End the run after the samples that the device has played, unless the samples contradict it."""
    if s.run is None:
        _end(s, out)
    elif s.played_to - s.run.first_index <= played <= s.run.samples:
        s.run, s.blocks, s.refused = Run(s.run.first_index, played), (), None
        s.mode = _continued(s)
    else:
        _fail(s, at, out, InstrumentError(CONTRADICTION), stop=True)


def _take_block_answer(s: RunState, answered_at: int, sequence: int, result: int, detail: int) -> None:
    """Take the answer to a block of set-points, sent at the sample ``answered_at``."""
    block = next((block for block in s.blocks if block.sent.sequence == sequence), None)
    if block is None:
        return  # a repeated answer, or one of an earlier run
    s.blocks = tuple(other for other in s.blocks if other is not block)
    if s.run is not None:
        margin = block.offset - (answered_at - s.run.first_index)
        s.margin_samples = margin if s.margin_samples is None else min(margin, s.margin_samples)
    if result == Result.LATE:
        s.late_answers += 1
        s.late_blocks = max(s.late_blocks, s.late_answers)
    elif result != Result.OK and s.refused is None:
        s.refused = refusal(MessageType.SETPOINTS, result, detail)


# -- reactions: time and port -----------------------------------------------------------------------------------------


def wait(s: RunState, event: RunEvent, out: _Out) -> None:
    """Repeat the pending request; give it up after its last attempt, and after a new error of the run."""
    _give_up(s, out)
    request = s.request
    if request is None or event.at < request.sent_s + ANSWER_S:
        return
    if request.tries > 1:
        s.request = replace(request, tries=request.tries - 1, sent_s=event.at, repeated=True)
        s.repeated_requests += 1
        out.append(request.sent)
        return
    s.unanswered = True
    _answer(s, out, no_answer(s.port, request.sent.kind))
    if s.mode is Mode.STARTING:  # the answers were lost; START may have arrived
        _end(s, out)
        _release(s, event.at, out)
    elif s.mode is Mode.FINISHING:
        s.mode = _continued(s)


def _give_up(s: RunState, out: _Out) -> None:
    """End a request during which the run failed, except the one that clears the failure."""
    request = s.request
    if request is not None and s.error is not request.error and not isinstance(request.asked, ClearAsked):
        _answer(s, out, s.error)


def watch(s: RunState, event: RunEvent, out: _Out) -> None:
    """Send the heartbeat if samples passed the checks, repeat requests; after 1 s without samples fail."""
    if s.fresh and event.at - s.heartbeat_s >= HEARTBEAT_S:
        _beat(s, event.at, out)
    _repeat_blocks(s, event.at, out)
    wait_heard(s, event, out)


def watch_run(s: RunState, event: RunEvent, out: _Out) -> None:
    """As ``watch``, with lost set-points; also fail by a refused set-point or a run that does not end."""
    if s.run is not None and event.at > s.began_s + s.allowed_s:
        _fail(s, event.at, out, overdue(s.allowed_s), stop=True)
    elif s.refused is not None and s.mode is not Mode.FINISHING:
        _fail(s, event.at, out, s.refused, stop=True)
    else:
        watch(s, event, out)


def _repeat_blocks(s: RunState, at: float, out: _Out) -> None:
    """Send set-points without an answer again, unless they are played already."""
    if s.run is None or s.next_index is None or not s.blocks:
        return
    played = s.next_index - s.run.first_index
    due = [block for block in s.blocks if block.end > played and at - block.sent_s >= REPEAT_S]
    s.blocks = tuple(replace(block, sent_s=at) if block in due else block for block in s.blocks if block.end > played)
    s.repeated_blocks += len(due)
    out.extend(block.sent for block in due)


def wait_heard(s: RunState, event: RunEvent, out: _Out) -> None:
    """Repeat the pending request; after 1 s without samples fail."""
    s.fresh = False
    if event.at - s.heard_s > SILENCE_S:
        _break(s, event.at, _silent(s, event.at), out)
    else:
        wait(s, event, out)


def wait_release(s: RunState, event: RunEvent, out: _Out) -> None:
    """Repeat STOP; after its last attempt, or 1 s without samples, give up the link."""
    s.fresh = False
    _give_up(s, out)
    stop = s.stop
    if event.at - s.heard_s > SILENCE_S:
        _lose(s, event.at, out, _with_watchdog(s, _silent(s, event.at)).message)
    elif stop is None or event.at < stop.sent_s + STOP_S:
        return
    elif stop.tries > 1:
        s.stop = replace(stop, tries=stop.tries - 1, sent_s=event.at)
        s.repeated_requests += 1
        out.append(stop.sent)
    else:
        s.unanswered = True
        _lose(s, event.at, out, no_answer(s.port, MessageType.STOP).message)


def lose_link(s: RunState, event: PortFailed, out: _Out) -> None:
    """Give up the link: STOP cannot be confirmed."""
    _lose(s, event.at, out, _with_watchdog(s, event.error).message)


def fail_link(s: RunState, event: PortFailed, out: _Out) -> None:
    """Fail; while START is pending, try STOP."""
    _break(s, event.at, event.error, out)


def _break(s: RunState, at: float, error: LinkLostError, out: _Out) -> None:
    """Fail by a lost link. The missing heartbeat releases the coil; START may have arrived, so try STOP after it."""
    _answer(s, out, _with_watchdog(s, error))
    _fail(s, at, out, error, stop=s.mode is Mode.STARTING)


# -- reactions: what the caller asks for ------------------------------------------------------------------------------


def say_hello(s: RunState, event: RunEvent, out: _Out) -> None:
    """Send HELLO with the name of this software and its protocol version."""
    del event
    versions = {"protocol_min": wire.PROTOCOL_VERSION, "protocol_max": wire.PROTOCOL_VERSION}
    out.append(_frame(s, MessageType.HELLO, wire.pack(wire.HELLO, host=SOFTWARE.encode(), **versions)))


def accept_device(s: RunState, event: Greeted, out: _Out) -> None:
    """Use the properties of the device."""
    del out
    s.handshake, s.nominal = event.handshake, event.handshake.device
    s.checks = SampleMonitor(s.nominal)


def ask(s: RunState, event: RequestAsked, out: _Out) -> None:
    """Send a request that cannot drive the coil."""
    if event.kind not in (MessageType.CLEAR_FAULTS, MessageType.RELEASE, MessageType.STREAM, MessageType.STAGE):
        raise RuntimeError(f"{event.kind.name} has an event of its own")
    _ask(s, event.at, out, event, (event.kind, event.payload), tries=event.tries)


def load(s: RunState, event: LoadAsked, out: _Out) -> None:
    """Send the stimulus in chunks."""
    codes = _codes(s, event.command_v)
    s.stimulus_id += 1
    s.following = 0
    key = {"stimulus_id": s.stimulus_id}
    begin = wire.pack(wire.STIMULUS_BEGIN, samples=event.command_v.size, crc32=zlib.crc32(codes.tobytes()), **key)
    chunks = [
        wire.pack(wire.STIMULUS_CHUNK, offset=offset, **key) + codes[offset : offset + CHUNK_CODES].tobytes()
        for offset in range(0, codes.size, CHUNK_CODES)
    ]
    requests = [(MessageType.STIMULUS_BEGIN, begin), *((MessageType.STIMULUS_CHUNK, chunk) for chunk in chunks)]
    commit = wire.pack(wire.STIMULUS_COMMIT, **key)
    _ask(s, event.at, out, event, *requests, (MessageType.STIMULUS_COMMIT, commit))


def follow(s: RunState, event: FollowAsked, out: _Out) -> None:
    """Announce set-points after the stimulus, and the level to hold where one is missing."""
    if not s.command_v.size:
        raise nothing_loaded()
    hold = _codes(s, np.array([event.hold_v]))
    payload = wire.pack(
        wire.FOLLOW,
        stimulus_id=s.stimulus_id,
        samples=event.samples,
        hold_code=int(hold[0]) if hold.size else 0,
    )
    _ask(s, event.at, out, event, (MessageType.FOLLOW, payload))


def arm(s: RunState, event: ArmAsked, out: _Out) -> None:
    """Check stimulus, hold level, limits and temperature, then send the limits after a heartbeat."""
    check_limits(event.limits, s.nominal)
    limits = s.effective_limits(event.limits)
    for description in s.descriptions():
        check_stimulus(s.command_v, description, limits, s.following)
        if s.following:
            check_command(np.array([s.hold_v]), description, limits)
    s.checks = s.checks.copy()
    s.checks.arm(s.temperature_c, limits)
    s.checks.expect_command(np.append(s.command_v, s.hold_v if s.following else 0.0))
    s.token = (s.stimulus_id << 8) ^ (s.sequence & 0xFF) ^ 0x5EED0000
    _beat(s, event.at, out)
    payload = wire.pack(
        wire.ARM,
        token=s.token,
        stimulus_id=s.stimulus_id,
        max_force_n=limits.max_force_n,
        min_position_m=limits.min_position_m,
        max_position_m=limits.max_position_m,
        max_temperature_c=limits.max_temperature_c,
        max_samples=s.samples_in(limits.max_seconds),
    )
    _ask(s, event.at, out, event, (MessageType.ARM, payload), limits=limits)


def start(s: RunState, event: RunEvent, out: _Out) -> None:
    """Send START after a heartbeat."""
    _beat(s, event.at, out)
    _ask(s, event.at, out, event, (MessageType.START, wire.pack(wire.START, token=s.token)))
    s.mode = Mode.STARTING
    s.stopped_at = s.seen_first = None
    s.earliest = s.next_index or 0
    s.received_to = 0


def start_nothing(s: RunState, event: RunEvent, out: _Out) -> None:
    """Send START with a token that no ARM has, so that the device says why it cannot start."""
    _ask(s, event.at, out, event, (MessageType.START, wire.pack(wire.START, token=0)))


def give(s: RunState, event: SetPointsGiven, out: _Out) -> None:
    """Check the set-points and send them, if they were announced for an armed run."""
    first, end = s.command_v.size, event.offset + event.command_v.size
    if s.limits is None or not first <= event.offset < end <= first + s.following:
        raise unexpected_set_points(event.offset, end)
    for description in s.descriptions():
        check_command(event.command_v, description, s.limits)
    s.checks = s.checks.copy()
    s.checks.expect_command(event.command_v)
    codes = _codes(s, event.command_v)
    for at in range(0, codes.size, CHUNK_CODES):
        part = codes[at : at + CHUNK_CODES]
        offset = event.offset + at
        payload = wire.pack(wire.SETPOINTS, token=s.token, offset=offset) + part.tobytes()
        sent = _frame(s, MessageType.SETPOINTS, payload)
        s.blocks = (*s.blocks, SetPointBlock(offset, offset + part.size, sent, event.at))
        out.append(sent)


def finish(s: RunState, event: RunEvent, out: _Out) -> None:
    """Send FINISH. Samples after the end may arrive before its answer."""
    _ask(s, event.at, out, event, (MessageType.FINISH, b""))
    if s.run is not None:
        s.mode = Mode.FINISHING


def release(s: RunState, event: RunEvent, out: _Out) -> None:
    """End the run and send STOP; no heartbeat until it is answered."""
    _end(s, out)
    _release(s, event.at, out)


def release_unheard(s: RunState, event: RunEvent, out: _Out) -> None:
    """Send STOP once, without waiting for its answer."""
    del event
    out.append(ReleaseCoil(_frame(s, MessageType.STOP)))


def ask_status(s: RunState, event: RunEvent, out: _Out) -> None:
    """Request STATUS."""
    del event
    out.append(_frame(s, MessageType.STATUS_REQUEST))


def clear(s: RunState, event: RunEvent, out: _Out) -> None:
    """Send CLEAR_FAULTS; its answer clears the error as well."""
    _ask(s, event.at, out, event, (MessageType.CLEAR_FAULTS, b""))


def calibrate(s: RunState, event: CalibrationChosen, out: _Out) -> None:
    """Check samples and commands by the calibration as well, unless a run is armed."""
    del out
    if s.limits is not None:
        raise calibration_while_running()
    s.device = None if event.device is s.nominal else event.device
    s.corrections = event.corrections


def refuse(s: RunState, event: RunEvent, out: _Out) -> None:
    """Refuse, with the error that prevents it."""
    kind = event.kind if isinstance(event, RequestAsked) else _KINDS[type(event)]
    raise s.lost or s.error or refusal(kind, Result.BAD_STATE, 0)


def ignore(s: RunState, event: RunEvent, out: _Out) -> None:
    """Change nothing."""


# -- the table --------------------------------------------------------------------------------------------------------

Reaction = Callable[[RunState, Any, _Out], None]


def _row(usual: Reaction, **other: Reaction) -> dict[Mode, Reaction]:
    """Return the reaction in each mode: the usual one, or the one of the group of modes that is named."""
    groups = {
        "opening": (Mode.OPENING,),
        "ready": (Mode.ARMED,),
        "running": (Mode.RUNNING, Mode.STOPPED, Mode.FINISHING),
        "starting": (Mode.STARTING,),
        "busy": (Mode.STARTING, Mode.FINISHING),
        "unseen": (Mode.UNSEEN_END,),
        "releasing": (Mode.RELEASING,),
        "failed": (Mode.FAILED,),
        "lost": (Mode.LOST,),
    }
    row = dict.fromkeys(Mode, usual)
    for name, reaction in other.items():
        row |= dict.fromkeys(groups[name], reaction)
    return row


_CLOSED = {"opening": refuse, "releasing": refuse, "lost": refuse}

TABLE: dict[str | type[RunEvent], dict[Mode, Reaction]] = {
    "DATA": _row(check_data, opening=ignore),
    "STATUS": _row(check_status, opening=note_status),
    "ACK": _row(take_answer),
    "HELLO_ACK": _row(ignore, opening=read_hello),
    "a frame of another type": _row(ignore),
    "a frame of another version": _row(fail_version, opening=react_by_type),
    BytesRefused: _row(ignore),
    SamplesTaken: _row(check_samples),
    ClockTick: _row(watch, opening=wait, running=watch_run, releasing=wait_release, failed=wait_heard, lost=wait_heard),
    PortFailed: _row(fail_link, releasing=lose_link),
    HelloAsked: _row(ignore, opening=say_hello),
    Greeted: _row(ignore, opening=accept_device),
    RequestAsked: _row(ask, releasing=refuse, lost=refuse, busy=refuse),
    LoadAsked: _row(load, **_CLOSED, busy=refuse),
    FollowAsked: _row(follow, **_CLOSED, busy=refuse),
    ArmAsked: _row(arm, **_CLOSED, starting=refuse, running=refuse, unseen=refuse, failed=refuse),
    StartAsked: _row(start_nothing, **_CLOSED, busy=refuse, ready=start),
    SetPointsGiven: _row(give, releasing=ignore, failed=ignore, lost=ignore),
    FinishAsked: _row(finish, **_CLOSED, busy=refuse),
    StopAsked: _row(release, opening=release_unheard, releasing=ignore),
    StatusAsked: _row(ask_status, releasing=ignore, lost=ignore),
    ClearAsked: _row(clear, **_CLOSED, busy=refuse),
    CalibrationChosen: _row(calibrate),
}
"""The reaction to every event in every mode: to a frame by its type, to every other event by its class."""

_KINDS = {
    LoadAsked: MessageType.STIMULUS_BEGIN,
    FollowAsked: MessageType.FOLLOW,
    ArmAsked: MessageType.ARM,
    StartAsked: MessageType.START,
    FinishAsked: MessageType.FINISH,
    ClearAsked: MessageType.CLEAR_FAULTS,
}
_FRAMES = {
    int(kind): kind.name for kind in (MessageType.DATA, MessageType.STATUS, MessageType.ACK, MessageType.HELLO_ACK)
}


def row_of(event: RunEvent) -> str | type[RunEvent]:
    """Return the key of the row of ``TABLE`` for an event."""
    if not isinstance(event, FrameReceived):
        return type(event)
    if event.frame.version != wire.PROTOCOL_VERSION:
        return "a frame of another version"
    return _FRAMES.get(event.frame.type, "a frame of another type")


def step(state: RunState, event: RunEvent) -> tuple[RunState, tuple[RunAction, ...]]:
    """Return the next state, and the actions to carry out in this order.

    What the caller asks for and cannot have changes nothing but gives an answer with an error. A frame with a payload
    that cannot be read changes nothing but ``unusable``.

    Raises:
        RuntimeError: ``RequestAsked`` is for a request that has an event of its own.
    """
    after, out = shallow_copy(state), list[RunAction]()
    try:
        TABLE[row_of(event)][state.mode](after, event, out)
    except TissueIDError as error:
        return state, (GiveAnswer(error),)
    except ValueError as error:  # wrong length of a payload, or an unknown state
        kind = event.frame.type if isinstance(event, FrameReceived) else 0
        after = shallow_copy(state)
        after.unusable = state.unusable or kind == MessageType.DATA
        return after, (WriteLine(f"ignored a frame of type 0x{kind:02x}: {error}"),)
    return after, tuple(out)
