"""Status of a calibration: usable, stale, or rejected because of its device, verdict, quantities or date."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Literal

from tissueid.calibration.file import Calibration
from tissueid.calibration.labels import problems_of
from tissueid.calibration.plausibility import first_implausible
from tissueid.calibration.store import Stored
from tissueid.device import DeviceDescription
from tissueid.messages import Message, Verbatim

State = Literal["valid", "stale", "foreign", "failed", "implausible", "damaged"]
"""State of one calibration: ``valid`` and ``stale`` ones are used, the latter with a warning; others are rejected."""

_CLOCK_DAYS = 1.0
"""Largest clock lead of the calibrating computer, days."""


@dataclass(frozen=True)
class FileStatus:
    """State of a calibration file without reference to a device."""

    state: State
    words: str

    @property
    def usable(self) -> bool:
        """Whether the calibrated device would use it."""
        return self.state in ("valid", "stale")


def file_status(item: Stored, now: datetime) -> FileStatus:
    """Return the state of a calibration from readability, verdict and age alone."""
    calibration = item.calibration
    if calibration is None:
        return FileStatus("damaged", Message("calibration.damaged", "cannot be used: {problem}", problem=item.problem))
    state, reason = _state_by_age(calibration, now)
    if state == "valid":
        left = calibration.valid_days - calibration.age_days(now)
        return FileStatus(state, Message("calibration.days_left", "passed, valid for {days:.0f} more days", days=left))
    return FileStatus(state, reason)


def status_for_device(item: Stored, nominal: DeviceDescription, now: datetime) -> tuple[State, str]:
    """Return the state of a calibration for a device, and the reason; "" if valid."""
    calibration = item.calibration
    if calibration is None:
        return "damaged", item.problem
    if calibration.serial_number != nominal.serial_number:
        return "foreign", Message(
            "calibration.other_device",
            "it is of {found}, not of {expected}",
            found=Verbatim(calibration.serial_number),
            expected=Verbatim(nominal.serial_number),
        )
    if calibration.model != nominal.model:
        return "foreign", Message(
            "calibration.other_model",
            "it is of the model '{found}', not '{expected}'",
            found=Verbatim(calibration.model),
            expected=Verbatim(nominal.model),
        )
    if strange := first_implausible(calibration, nominal) if calibration.verdict == "passed" else "":
        return "implausible", strange
    return _state_by_age(calibration, now)


def _state_by_age(calibration: Calibration, now: datetime) -> tuple[State, str]:
    if calibration.verdict == "failed":
        if not calibration.problems:
            return "failed", Message("calibration.failed", "the calibration failed")
        return "failed", Message(
            "calibration.failed_because", "the calibration failed: {problem}", problem=problems_of(calibration)[0]
        )
    age = calibration.age_days(now)
    if age < -_CLOCK_DAYS:
        return "implausible", Message(
            "calibration.future",
            "it was made on {date}, which is in the future: check the clock",
            date=calibration.date[:10],
        )
    if age > calibration.valid_days:
        return "stale", Message(
            "calibration.stale",
            "it is {days:.0f} days old and was valid for {valid_days}: calibrate again",
            days=age,
            valid_days=calibration.valid_days,
        )
    return "valid", ""
