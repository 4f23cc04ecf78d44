"""State and figures of an instrument's calibration as text."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from tissueid.app.words import sentence
from tissueid.calibration.active import calibration_summary, warnings_of
from tissueid.calibration.file import CalibratedQuantity
from tissueid.calibration.status import readable
from tissueid.device import DeviceDescription
from tissueid.formatting import plus_minus
from tissueid.language import marked
from tissueid.messages import translated
from tissueid.records import Estimate
from tissueid.units import shown

UNKNOWN = marked("Calibration: not known yet")


@dataclass(frozen=True)
class CalibrationState:
    """State in one line, ``level`` of its colour ("good", "check", or "" if not known), and ``warnings``.

    ``until`` is the date of the next calibration, "" if it is not known.
    """

    words: str = UNKNOWN
    level: str = ""
    warnings: tuple[str, ...] = ()
    until: str = ""


def calibration_state(device: DeviceDescription, now: datetime | None = None) -> CalibrationState:
    """Return the state of a device's calibration; ``now`` is timezone-aware."""
    good = device.calibration.get("state") == "valid"
    warnings = tuple(sentence(translated(line)) for line in warnings_of(device))
    words = sentence(translated(calibration_summary(device, now))).removesuffix(".")
    until = str(device.calibration.get("valid_until", ""))
    return CalibrationState(words, "good" if good else "check", warnings, until)


def figure_of(name: str, found: CalibratedQuantity) -> tuple[str, str, str]:
    """Return label, value with its deviation, and unit."""
    label, value, unit = readable(name, found)
    label = translated(label)
    said, factor = shown(unit)
    if factor == 1.0:
        return label, value, said
    # What is converted is shown without a prefix, and that is how a calibration keeps it.
    return label, plus_minus(Estimate(found.value, found.std)), said
