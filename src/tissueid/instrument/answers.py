"""What the firmware answers, in the words of this software: results, faults, and what it says of itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tissueid import wire
from tissueid.errors import FirmwareFaultError, InstrumentError, LimitError, TissueIDError
from tissueid.wire import Fault, MessageType, Result, State

_FAULT_WORDS = {
    Fault.WATCHDOG: "the computer was silent for too long: close other programs, then measure again",
    Fault.OVER_FORCE: "the force went beyond its limit: choose a weaker stimulus",
    Fault.STROKE: "the probe reached the end of its stroke: place it nearer to the middle",
    Fault.OVER_TEMPERATURE: "the coil is too hot: let it cool for some minutes",
    Fault.OVER_TIME: "the test lasted too long: choose a shorter stimulus",
    Fault.BUTTON: "the button was pressed: let go of it, then measure again",
    Fault.STARVED: "the computer fell behind with the stimulus: close other programs, then measure again",
    Fault.BROWN_OUT: "the supply voltage sagged: check the power supply and its plug",
    Fault.SENSOR: "the position sensor does not move as the force asks for: check its plug and cable",
    Fault.OPEN_COIL: "the coil's current does not follow the voltage: check the coil's plug and cable",
}

_RESULT_WORDS: dict[int, str] = {
    Result.BAD_STATE: "the instrument is not in a state for that: connect again",
    Result.BAD_ARGUMENT: "the instrument did not understand: update its firmware, or this software",
    Result.TOO_LARGE: "shorten it: the stimulus is longer than the instrument can hold",
    Result.CHECKSUM: "the stimulus arrived damaged: check the cable, and connect again",
    Result.BEYOND_LIMITS: "the stimulus or the limits go beyond what the instrument allows: choose gentler ones",
    Result.UNKNOWN: "the instrument's firmware is too old for that",
}

_TOO_OLD_FOR = {
    MessageType.FOLLOW: "for feedback stimuli",
    MessageType.SETPOINTS: "for feedback stimuli",
    MessageType.FINISH: "to end a test early",
}


def describe_faults(faults: Fault) -> str:
    """The latched faults in words, each with what to do about it, joined."""
    if not faults:
        return "no fault"
    known = [words for fault, words in _FAULT_WORDS.items() if fault & faults]
    if int(faults) & ~sum(int(fault) for fault in _FAULT_WORDS):
        known.append("a fault that this software does not know: update it")
    return "; ".join(known)


def refusal(kind: MessageType, result: int, detail: int) -> TissueIDError:
    """The error that a request's answer other than OK stands for."""
    if result == Result.FAULT_LATCHED:
        return FirmwareFaultError(f"the instrument refuses after a fault: {describe_faults(Fault(detail))}")
    if result == Result.UNKNOWN and kind in _TOO_OLD_FOR:
        return InstrumentError(f"the instrument's firmware is too old {_TOO_OLD_FOR[kind]}: update it")
    words = _RESULT_WORDS.get(result, f"the instrument answered {result}")
    if result == Result.BEYOND_LIMITS:
        return LimitError(f"{words} ({kind.name})")
    return InstrumentError(f"{words} ({kind.name})")


@dataclass(frozen=True)
class Status:
    """What the firmware last said of itself. An older one knows nothing of late blocks and held samples."""

    state: State
    faults: Fault
    boot_id: int
    dropped_frames: int
    refused_frames: int
    played_samples: int
    late_blocks: int = 0
    held_samples: int = 0


def read_status(payload: bytes) -> Status:
    """A STATUS message.

    Raises:
        PayloadError, ValueError: cut short, or a state that nobody knows.
    """
    fields, more = wire.unpack(wire.STATUS, payload, tail=True)
    counts: dict[str, Any] = {}
    if len(more) >= wire.STATUS_SETPOINTS.itemsize:
        counts, _ = wire.unpack(wire.STATUS_SETPOINTS, more, tail=True)
    del fields["streaming"]
    fields["state"], fields["faults"] = State(fields["state"]), Fault(fields["faults"])
    return Status(**fields, **counts)
