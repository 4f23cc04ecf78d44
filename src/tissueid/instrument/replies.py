"""Replies of the firmware, and their absence, as errors: faults, refusals, lost links. The STATUS message."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import tissueid.wire as wire
from tissueid.errors import (
    FirmwareFaultError,
    InstrumentError,
    LimitError,
    LinkLostError,
    ProtocolVersionError,
    TissueIDError,
)
from tissueid.messages import Message, joined
from tissueid.wire import Fault, MessageType, Result, State


@dataclass(frozen=True)
class FaultText:
    """What a latched fault means (``condition``) and what to do about it (``remedy``)."""

    condition: Message
    remedy: Message

    @property
    def message(self) -> Message:
        """Condition and remedy as one text, with the code of the condition."""
        return Message(self.condition.code, "{condition}: {remedy}", condition=self.condition, remedy=self.remedy)


FAULT_TEXTS = {
    Fault.WATCHDOG: FaultText(
        Message("fault.watchdog", "the computer was silent for too long"),
        Message("remedy.close_programs", "close other programs, then measure again"),
    ),
    Fault.OVER_FORCE: FaultText(
        Message("fault.over_force", "the force exceeded its limit"),
        Message("remedy.weaker_stimulus", "choose a weaker stimulus"),
    ),
    Fault.STROKE: FaultText(
        Message("fault.stroke", "the probe reached the end of its stroke"),
        Message("remedy.place_in_middle", "place it nearer to the middle"),
    ),
    Fault.OVER_TEMPERATURE: FaultText(
        Message("fault.over_temperature", "the coil is too hot"),
        Message("remedy.let_cool", "let it cool for some minutes"),
    ),
    Fault.OVER_TIME: FaultText(
        Message("fault.over_time", "the test lasted too long"),
        Message("remedy.shorter_stimulus", "choose a shorter stimulus"),
    ),
    Fault.BUTTON: FaultText(
        Message("fault.button", "the button was pressed"),
        Message("remedy.release_button", "release it, then measure again"),
    ),
    Fault.STARVED: FaultText(
        Message("fault.starved", "the computer sent the stimulus too late"),
        Message("remedy.close_programs", "close other programs, then measure again"),
    ),
    Fault.BROWN_OUT: FaultText(
        Message("fault.brown_out", "the supply voltage dropped"),
        Message("remedy.check_supply", "check the power supply and its plug"),
    ),
    Fault.SENSOR: FaultText(
        Message("fault.sensor", "the position reading does not follow the force"),
        Message("remedy.check_sensor", "check the plug and cable of the position sensor"),
    ),
    Fault.OPEN_COIL: FaultText(
        Message("fault.open_coil", "the coil current does not follow the voltage"),
        Message("remedy.check_coil", "check the plug and cable of the coil"),
    ),
}
"""The texts of each fault, in the order in which several are shown."""

_UNKNOWN_FAULT = Message("fault.unknown", "a fault that this software does not know: update the software")
_REFUSALS: dict[int, Message] = {
    Result.BAD_STATE: Message(
        "refused.state", "the instrument is not in the right state for that: connect again ({request})"
    ),
    Result.BAD_ARGUMENT: Message(
        "refused.argument", "the instrument did not understand: update its firmware, or this software ({request})"
    ),
    Result.TOO_LARGE: Message(
        "refused.too_large", "the stimulus is longer than the instrument can hold: shorten it ({request})"
    ),
    Result.CHECKSUM: Message(
        "refused.checksum", "the stimulus arrived damaged: check the cable, and connect again ({request})"
    ),
    Result.BEYOND_LIMITS: Message(
        "refused.beyond_limits",
        "the stimulus or its limits exceed what the instrument allows: choose lower ones ({request})",
    ),
    Result.UNKNOWN: Message("refused.unknown", "the instrument's firmware is too old for that ({request})"),
}
"""The error by result, without the name of the request."""


def describe_faults(faults: Fault) -> Message:
    """Return the latched faults as one text, each with its remedy; "no fault" where none is latched."""
    texts = [text.message for fault, text in FAULT_TEXTS.items() if fault & faults]
    if int(faults) & ~sum(int(fault) for fault in FAULT_TEXTS):
        texts.append(_UNKNOWN_FAULT)
    if len(texts) > 1:
        return joined(texts, "; ")
    return texts[0] if texts else Message("fault.none", "no fault")


def released_by_faults(faults: Fault) -> FirmwareFaultError:
    """Return the error for a run that the firmware ended because of these faults."""
    message = Message("instrument.released", "the instrument released the coil: {why}", why=describe_faults(faults))
    return FirmwareFaultError(message, int(faults))


def refusal(kind: MessageType, result: int, detail: int) -> TissueIDError:
    """Return the error for a request whose result is not OK."""
    request = kind.name
    if result == Result.FAULT_LATCHED:
        return FirmwareFaultError(
            Message(
                "refused.fault",
                "the instrument refuses because of a fault: {why}",
                why=describe_faults(Fault(detail)),
                request=request,
            ),
            detail,
        )
    if result == Result.UNKNOWN and kind in (MessageType.FOLLOW, MessageType.SETPOINTS):
        return InstrumentError(
            "firmware.no_feedback", "the instrument's firmware is too old for feedback stimuli: update it"
        )
    if result == Result.UNKNOWN and kind is MessageType.FINISH:
        return InstrumentError(
            "firmware.no_finish", "the instrument's firmware is too old to end a test early: update it"
        )
    if result not in _REFUSALS:
        return InstrumentError(
            "refused.other", "the instrument refused {request}: it answered {result}", result=result, request=request
        )
    message = Message(_REFUSALS[result].code, _REFUSALS[result].template, request=request)
    return LimitError(message) if result == Result.BEYOND_LIMITS else InstrumentError(message)


STOPPED = Message("instrument.stopped", "the instrument stopped the test by itself; the coil is free: measure again")
RESTARTED = Message("instrument.restarted", "the instrument restarted by itself; the coil is free. Connect again")
CONTRADICTION = Message(
    "instrument.contradiction",
    "the instrument contradicts itself about which samples it played: connect again, or update its firmware",
)


def overdue(seconds: float) -> InstrumentError:
    """Return the error for a run that did not end within ``seconds``."""
    return InstrumentError(
        "instrument.overdue",
        "the test did not end within {seconds:.1f} s as it should: connect again, and measure again",
        seconds=seconds,
    )


def end_unseen(missing: int) -> InstrumentError:
    """Return the error for a run whose last ``missing`` samples were lost."""
    return InstrumentError(
        "instrument.end_unseen",
        "the last {missing} samples of the test never arrived, and it is unknown whether they were played: "
        "check the cable, then measure again",
        missing=missing,
    )


def version_changed(version: int) -> ProtocolVersionError:
    """Return the error for a device that changed to another version of the protocol."""
    return ProtocolVersionError(
        "link.version_changed",
        "the instrument changed to protocol {version} during operation; this software speaks {own}. Connect again",
        version=version,
        own=wire.PROTOCOL_VERSION,
    )


def long_gap(missing: int) -> LinkLostError:
    """Return the error for ``missing`` samples at once."""
    return LinkLostError(
        Message(
            "link.gap",
            "{missing} samples are missing at once; the connection is not reliable: check the cable, and connect again",
            missing=missing,
        )
    )


def silent(port: str, seconds: float, *, unusable: bool) -> LinkLostError:
    """Return the error for a link without samples, or only with ``unusable`` ones."""
    values = {"port": port, "seconds": round(seconds, 1)}
    if unusable:
        message = Message(
            "link.unusable",
            "{port} sent no usable samples for {seconds:g} s. Check the cable and the power, and connect again",
            **values,
        )
    else:
        message = Message(
            "link.silent",
            "{port} went silent for {seconds:g} s. Check the cable and the power, and connect again",
            **values,
        )
    return LinkLostError(message)


def no_answer(port: str, kind: MessageType) -> LinkLostError:
    """Return the error for a request that is not answered."""
    return LinkLostError(
        Message(
            "link.no_answer",
            "{port} does not answer {request}; check the cable and the power",
            port=port,
            request=kind.name,
        )
    )


def release_unconfirmed(port: str, why: str) -> LinkLostError:
    """Return the error for a STOP that is not answered."""
    return LinkLostError(
        Message(
            "link.release_unconfirmed",
            "{port} did not confirm the release of the coil; its watchdog releases it: {why}. Connect again",
            port=port,
            why=why,
        )
    )


def watched(error: LinkLostError, watchdog_s: float) -> LinkLostError:
    """Return the error of a lost link with the timeout of the watchdog of the device."""
    return LinkLostError(
        Message(
            "link.lost_with_watchdog",
            "{why}. The instrument's own watchdog releases the coil within {seconds:g} s",
            why=error.message,
            seconds=watchdog_s,
        ),
        watchdog_s,
    )


@dataclass(frozen=True)
class Status:
    """A STATUS message. ``late_blocks`` and ``held_samples`` stay 0 where the firmware is too old to report them."""

    state: State
    faults: Fault
    boot_id: int
    dropped_frames: int
    refused_frames: int
    played_samples: int
    late_blocks: int = 0
    held_samples: int = 0


def parse_status(payload: bytes) -> Status:
    """Parse the payload of a STATUS message.

    Raises:
        PayloadError, ValueError: the payload is too short, or its state is unknown.
    """
    fields, more = wire.unpack(wire.STATUS, payload, tail=True)
    counts: dict[str, Any] = {}
    if len(more) >= wire.STATUS_SETPOINTS.itemsize:
        counts, _ = wire.unpack(wire.STATUS_SETPOINTS, more, tail=True)
    del fields["streaming"]
    fields["state"], fields["faults"] = State(fields["state"]), Fault(fields["faults"])
    return Status(**fields, **counts)
