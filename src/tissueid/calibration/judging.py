"""Whether a calibration can be believed: whose it is, whether it passed, whether its figures can be, how old it is."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Literal

from tissueid.calibration.file import Calibration
from tissueid.calibration.plausible import implausible
from tissueid.calibration.store import Stored
from tissueid.device import DeviceDescription

State = Literal["valid", "stale", "foreign", "failed", "implausible", "damaged"]
"""Of one calibration: ``valid`` and ``stale`` ones are used, the latter with a warning; the others are refused."""

_CLOCK_DAYS = 1.0
"""By so much may the clock of the computer that calibrated be ahead."""


@dataclass(frozen=True)
class Age:
    """The state of a calibration as far as it can be told without its device."""

    state: State
    words: str

    @property
    def usable(self) -> bool:
        """Whether its device would use it."""
        return self.state in ("valid", "stale")


def age_of(item: Stored, now: datetime) -> Age:
    """The state of a calibration whose device is not there: whether it can be read, passed, and how old it is."""
    calibration = item.calibration
    if calibration is None:
        return Age("damaged", f"cannot be used: {item.problem}")
    state, reason = _passed_in_time(calibration, now)
    if state == "valid":
        left = calibration.valid_days - calibration.age_days(now)
        return Age(state, f"passed, good for {left:.0f} days more")
    return Age(state, reason)


def judged(item: Stored, nominal: DeviceDescription, now: datetime) -> tuple[State, str]:
    """The state of a calibration for a device, and the reason in words; "" where it is valid."""
    calibration = item.calibration
    if calibration is None:
        return "damaged", item.problem
    if calibration.serial_number != nominal.serial_number:
        return "foreign", f"it is of {calibration.serial_number}, not of {nominal.serial_number}"
    if calibration.model != nominal.model:
        return "foreign", f"it is of a {calibration.model!r}, not of a {nominal.model!r}"
    if strange := implausible(calibration, nominal) if calibration.verdict == "passed" else "":
        return "implausible", strange
    return _passed_in_time(calibration, now)


def _passed_in_time(calibration: Calibration, now: datetime) -> tuple[State, str]:
    if calibration.verdict == "failed":
        why = f": {calibration.problems[0]}" if calibration.problems else ""
        return "failed", f"the calibration failed{why}"
    age = calibration.age_days(now)
    if age < -_CLOCK_DAYS:
        return "implausible", f"it was made on {calibration.date[:10]}, which is in the future: check the clock"
    if age > calibration.valid_days:
        return "stale", f"it is {age:.0f} days old, and was good for {calibration.valid_days}: calibrate again"
    return "valid", ""
