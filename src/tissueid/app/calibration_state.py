"""What is known of an instrument's calibration, in one line for the person who is about to use it."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from tissueid.app.words import sentence
from tissueid.calibration.in_force import in_words, warnings_of
from tissueid.core_words import for_window
from tissueid.device import DeviceDescription
from tissueid.language import marked

UNKNOWN = marked("Calibration: not known yet")


@dataclass(frozen=True)
class CalibrationState:
    """``level`` is that of a colour: good, check, or none for what is not known. ``warnings`` may be many."""

    words: str = UNKNOWN
    level: str = ""
    warnings: tuple[str, ...] = ()


def calibration_state(device: DeviceDescription, now: datetime | None = None) -> CalibrationState:
    """The state of the calibration that a device goes by; ``now`` has a zone."""
    good = device.calibration.get("state") == "valid"
    warnings = tuple(sentence(for_window(line)) for line in warnings_of(device))
    # One line of the form holds it so.
    words = sentence(for_window(in_words(device, now))).removesuffix(".").replace("linear from", "linear")
    return CalibrationState(words, "good" if good else "check", warnings)
