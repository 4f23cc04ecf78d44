"""Status of a calibration: usable, stale, or refused for its device, its verdict, its quantities or its date."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Literal

from tissueid.calibration.file import Calibration
from tissueid.calibration.labels import problems_of
from tissueid.calibration.plausibility import implausible
from tissueid.calibration.store import Stored
from tissueid.device import DeviceDescription
from tissueid.messages import Message, Verbatim

State = Literal["valid", "stale", "foreign", "failed", "implausible", "damaged"]
"""State of one calibration: ``valid`` and ``stale`` ones are used, the latter with a warning; others are refused."""

_CLOCK_DAYS = 1.0
"""Largest lead of the clock of the computer that calibrated, days."""


@dataclass(frozen=True)
class Age:
    """State of a calibration as far as it is known without its device."""

    state: State
    words: str

    @property
    def usable(self) -> bool:
        """Whether its device would use the calibration."""
        return self.state in ("valid", "stale")


def age_of(item: Stored, now: datetime) -> Age:
    """Return the state of a calibration without its device: readability, verdict and age."""
    calibration = item.calibration
    if calibration is None:
        return Age("damaged", Message("calibration.damaged", "cannot be used: {problem}", problem=item.problem))
    state, reason = _state_by_age(calibration, now)
    if state == "valid":
        left = calibration.valid_days - calibration.age_days(now)
        return Age(state, Message("calibration.days_left", "passed, valid for {days:.0f} more days", days=left))
    return Age(state, reason)


def judged(item: Stored, nominal: DeviceDescription, now: datetime) -> tuple[State, str]:
    """Return the state of a calibration for a device, and the reason; "" where it is valid."""
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
    if strange := implausible(calibration, nominal) if calibration.verdict == "passed" else "":
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
