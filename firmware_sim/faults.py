"""Fault injection in the device and on the line. Each kind is one entry of ``FAULT_KINDS``."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Annotated, Literal, Protocol, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from firmware_sim.firmware import Firmware
from firmware_sim.identity import Identity
from firmware_sim.line_faults import OTHER_VERSION, Direction, LineFaults, Pieces
from tissueid.wire import State

Seconds = Annotated[float, Field(ge=0, le=3600, allow_inf_nan=False)]

SAGGED_SUPPLY = 0.3
"""Supply voltage during a brown-out, relative to normal."""

FURTHEST_CLOCK = 0.1
"""Largest relative clock error."""


def _known(kind: str) -> str:
    if kind not in FAULT_KINDS:
        raise ValueError(f"no such fault; there are: {', '.join(FAULT_KINDS)}")
    return kind


class PlannedFault(BaseModel):
    """One planned fault, timed in seconds of the device's clock.

    Timed either from the first START (``after_start_s``), or from entering a state while a host is listening
    (``in_state``, ``after_s``): in the first such state that lasts long enough.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: Annotated[str, AfterValidator(_known)]
    after_start_s: Seconds | None = None
    in_state: Literal["idle", "loaded", "armed", "running"] | None = None
    after_s: Seconds = 0.0
    seconds: Seconds | None = None
    """Duration; by default that of its kind, which can be permanent."""
    share: Annotated[float, Field(gt=0, le=1)] | None = None
    """Share of frames, or bursts of bytes, affected by a line fault."""
    pieces: Pieces = "frames"
    direction: Direction = "both"
    channel: Literal["position", "current", "temperature"] = "position"
    """The stuck sensor."""
    clock_error: Annotated[float, Field(ge=-FURTHEST_CLOCK, le=FURTHEST_CLOCK)] = 0.02
    clock_drift_per_s: Annotated[float, Field(ge=-FURTHEST_CLOCK, le=FURTHEST_CLOCK)] = 0.0
    """Relative clock error at the start, and its increase per second."""

    @model_validator(mode="after")
    def _timed_once(self) -> Self:
        if (self.after_start_s is None) == (self.in_state is None):
            raise ValueError("give either after_start_s or in_state")
        return self


class Cable(Protocol):
    """The connection between host and device, which can be unplugged."""

    def unplug(self) -> None:
        """Unplug the cable."""

    def replug(self) -> None:
        """Plug the cable in again."""


@dataclass
class ActiveFault:
    """An active fault with the device and cable that it affects. ``undo`` ends it.

    ``identity`` is that of the device without faults.
    """

    fault: PlannedFault
    firmware: Firmware
    cable: Cable
    line: LineFaults
    identity: Identity
    now_s: float
    ends_s: float | None
    """End in device time."""
    undo: Callable[[], None] = lambda: None
    clock_error: float = 0.0
    clock_drift_per_s: float = 0.0


@dataclass(frozen=True)
class FaultKind:
    """A kind of fault: description, start, and default duration.

    ``seconds`` is None for a permanent fault, and 0 for a momentary one.
    """

    what: str
    begin: Callable[[ActiveFault], None]
    seconds: float | None = None
    share: float = 0.0


def _on_the_line(it: ActiveFault) -> None:
    share = FAULT_KINDS[it.fault.kind].share if it.fault.share is None else it.fault.share
    it.undo = it.line.begin(it.fault.kind, share, it.fault.pieces, it.fault.direction)


def _stall(it: ActiveFault) -> None:
    seconds = FAULT_KINDS["stall"].seconds if it.fault.seconds is None else it.fault.seconds
    it.firmware.stall(it.now_s + (seconds or 0.0))


def _brown_out(it: ActiveFault) -> None:
    bench = it.firmware.bench
    bench.supply_share = SAGGED_SUPPLY  # the firmware detects it
    it.undo = lambda: setattr(bench, "supply_share", 1.0)


def _stuck(it: ActiveFault) -> None:
    stuck, channel = it.firmware.bench.stuck, it.fault.channel
    stuck.add(channel)
    it.undo = lambda: stuck.discard(channel)


def _open_coil(it: ActiveFault) -> None:
    bench = it.firmware.bench
    bench.coil_open = True
    it.undo = lambda: setattr(bench, "coil_open", False)


def _drift(it: ActiveFault) -> None:
    it.clock_error, it.clock_drift_per_s = it.fault.clock_error, it.fault.clock_drift_per_s


def _other_version(it: ActiveFault) -> None:
    firmware, before = it.firmware, it.identity

    def restart_as(identity: Identity) -> None:
        firmware.identity = identity
        firmware.reboot()

    restart_as(replace(before, protocol_min=OTHER_VERSION, protocol_max=OTHER_VERSION))
    it.undo = lambda: restart_as(before)


def _unplug(it: ActiveFault) -> None:
    it.line.cut()
    it.cable.unplug()
    it.undo = it.cable.replug


def _button(it: ActiveFault) -> None:
    bench = it.firmware.bench
    bench.button = True
    it.undo = lambda: setattr(bench, "button", False)


FAULT_KINDS: dict[str, FaultKind] = {
    "bit_flips": FaultKind("one bit of a frame or burst is inverted", _on_the_line, 2.0, 0.02),
    "drops": FaultKind("frames or bursts of bytes are lost", _on_the_line, 2.0, 0.02),
    "duplicates": FaultKind("frames or bursts of bytes arrive twice", _on_the_line, 2.0, 0.1),
    "reordering": FaultKind("frames or bursts of bytes are overtaken by others", _on_the_line, 2.0, 0.05),
    "wrong_version_frames": FaultKind("frames of another protocol version are inserted", _on_the_line, 2.0, 0.1),
    "stall": FaultKind("the firmware hangs; its watchdog keeps running", _stall, 2.0),
    "reset": FaultKind("the device restarts", lambda it: it.firmware.reboot(), 0.0),
    "wrong_version": FaultKind("the device restarts with a firmware of another version", _other_version),
    "brown_out": FaultKind("the supply sags", _brown_out, 0.2),
    "stuck_sensor": FaultKind("the codes of one channel freeze", _stuck),
    "open_coil": FaultKind("the coil is disconnected", _open_coil),
    "drifting_clock": FaultKind("the device's clock is wrong, and drifts", _drift),
    "unplug": FaultKind("the cable is unplugged", _unplug),
    "replug": FaultKind("the cable is plugged in again", lambda it: it.cable.replug(), 0.0),
    "button": FaultKind("the button is pressed", _button),
}
"""All kinds of faults by name."""


class FaultInjector:
    """Injects faults into a firmware and its cable: planned ones at their time, others on request.

    Bytes pass through ``line`` in both directions; ``clock_rate`` is the relative speed of the device's clock. Device
    time is counted in samples, so that a plan has the same effect on any computer. ``active`` are the active faults,
    ``happened`` counts all.
    """

    def __init__(
        self, firmware: Firmware, cable: Cable, planned: Iterable[PlannedFault] = (), *, seed: int = 0
    ) -> None:
        self.line = LineFaults(seed)
        self.active: list[ActiveFault] = []
        self.happened = 0
        self._firmware, self._identity = firmware, firmware.identity
        self._cable = cable
        self.planned = sorted(planned, key=lambda fault: fault.after_start_s or fault.after_s)
        self._samples = 0
        self._first_start: int | None = None
        self._state: State | None = None
        self._entered = 0

    @property
    def clock_rate(self) -> float:
        """Device seconds per second."""
        error = sum(item.clock_error for item in self.active)
        return 1.0 + min(max(error, -FURTHEST_CLOCK), FURTHEST_CLOCK)

    def advance(self, samples: int, now_s: float) -> None:
        """Account for ``samples`` device samples; ``now_s`` is the clock of the watchdog."""
        self._samples += samples
        for item in self.active:
            item.clock_error += item.clock_drift_per_s * samples / self._firmware.sample_rate_hz
        for item in [item for item in self.active if item.ends_s is not None and item.ends_s <= self._seconds()]:
            self.end(item)
        self.start_due(now_s)

    def start_due(self, now_s: float) -> None:
        """Start faults that are due; must be called whenever the state of the firmware may have changed."""
        state = self._firmware.state if self._firmware.streaming else None
        if state is not self._state:
            self._state, self._entered = state, self._samples
        if self._first_start is None and self._firmware.state is State.RUNNING:
            self._first_start = self._samples
        for fault in [fault for fault in self.planned if self._due(fault)]:
            self.planned.remove(fault)
            self.begin(fault, now_s)

    def begin(self, fault: PlannedFault, now_s: float) -> ActiveFault:
        """Start a fault now, regardless of its timing."""
        kind = FAULT_KINDS[fault.kind]
        seconds = kind.seconds if fault.seconds is None else fault.seconds
        ends = None if seconds is None else self._seconds() + seconds
        it = ActiveFault(fault, self._firmware, self._cable, self.line, self._identity, now_s, ends)
        kind.begin(it)
        self.happened += 1
        self.active.append(it)
        return it

    def end(self, it: ActiveFault) -> None:
        """End an active fault."""
        self.active.remove(it)
        it.undo()

    def clear(self) -> None:
        """End all active faults and remove the planned ones."""
        self.planned.clear()
        self._firmware.stall(0.0)
        for it in self.active[::-1]:
            self.end(it)

    def _seconds(self) -> float:
        return self._samples / self._firmware.sample_rate_hz

    def _due(self, fault: PlannedFault) -> bool:
        if fault.in_state is not None:
            since, wait_s = self._entered, fault.after_s
            if self._state is None or self._state.name.lower() != fault.in_state:
                return False
        elif self._first_start is not None:
            since, wait_s = self._first_start, fault.after_start_s or 0.0
        else:
            return False
        return (self._samples - since) / self._firmware.sample_rate_hz >= wait_s
