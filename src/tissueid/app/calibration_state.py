"""State of an instrument's calibration in one line."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from tissueid.app.words import sentence
from tissueid.calibration.active import calibration_summary, warnings_of
from tissueid.device import DeviceDescription
from tissueid.language import marked
from tissueid.messages import translated

UNKNOWN = marked("Calibration: not known yet")


@dataclass(frozen=True)
class CalibrationState:
    """State in one line, ``level`` of its colour ("good", "check", or "" if not known), and ``warnings``."""

    words: str = UNKNOWN
    level: str = ""
    warnings: tuple[str, ...] = ()


def calibration_state(device: DeviceDescription, now: datetime | None = None) -> CalibrationState:
    """Return the state of a device's calibration; ``now`` is timezone-aware."""
    good = device.calibration.get("state") == "valid"
    warnings = tuple(sentence(translated(line)) for line in warnings_of(device))
    words = sentence(translated(calibration_summary(device, now))).removesuffix(".")
    return CalibrationState(words, "good" if good else "check", warnings)
