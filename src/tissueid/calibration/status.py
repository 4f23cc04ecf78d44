"""Status of a calibration (usable, stale or rejected), and plausibility of its quantities."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Literal

from tissueid.calibration.file import Calibration
from tissueid.calibration.labels import label_of, problems_of
from tissueid.calibration.store import Stored
from tissueid.device import DeviceDescription
from tissueid.language import marked
from tissueid.messages import Message, Quantity, Verbatim

IMPLAUSIBLE = 0.20
"""Relative deviation from the nominal value above which a calibrated value is rejected."""
DEVICE_TOLERANCES = {
    "coil_resistance_ohm": IMPLAUSIBLE,
    "force_constant_n_per_a": IMPLAUSIBLE,
    "moving_mass_kg": IMPLAUSIBLE,
    "coil_inductance_h": 0.5,
    "bearing_damping_n_s_per_m": 0.5,
}
"""Calibrated device properties and the largest relative deviation of each from its nominal value."""
BOUNDS = {
    "current_offset_a": (-0.3, 0.3),
    "voltage_offset_v": (-1.0, 1.0),
    "voltage_gain": (1.0 - IMPLAUSIBLE, 1.0 + IMPLAUSIBLE),
    "position_gain": (1.0 - IMPLAUSIBLE, 1.0 + IMPLAUSIBLE),
    "position_offset_m": (-3e-3, 3e-3),
    "temperature_offset_c": (-10.0, 10.0),
    "acceleration_gain": (1.0 - IMPLAUSIBLE, 1.0 + IMPLAUSIBLE),
    "acceleration_offset_m_s2": (-2.0, 2.0),
    "calibration_relative_uncertainty": (0.0, 0.5),
}
"""Lower and upper bound of every other quantity that is applied, SI."""
_STROKE_MARGIN_M = 2e-3
"""Largest distance of an end of the stroke, or of the linear region, outside the nominal stroke, m."""
_RANGES = {"linear_region": marked("linear region"), "stroke": marked("stroke")}


def first_implausible(calibration: Calibration, nominal: DeviceDescription) -> str:
    """Return the first implausible quantity of a calibration of this device as a message; "" without one."""
    for name, tolerance in DEVICE_TOLERANCES.items():
        if (found := calibration.quantities.get(name)) is not None:
            usual = getattr(nominal, name)
            if not abs(found.value - usual) <= tolerance * abs(usual):  # false for a nominal NaN
                return Message(
                    "calibration.implausible.nominal",
                    "{label} is {value:.4g}, more than {percent:.0f} % from the nominal {nominal:.4g}",
                    label=label_of(name),
                    name=name,
                    value=found.value,
                    percent=100.0 * tolerance,
                    nominal=usual,
                )
    for name, (least, most) in BOUNDS.items():
        if (found := calibration.quantities.get(name)) is not None and not least <= found.value <= most:
            return Message(
                "calibration.implausible.bounds",
                "{label} is {value:.4g}, which is not between {least:g} and {most:g}",
                label=label_of(name),
                name=name,
                value=found.value,
                least=least,
                most=most,
            )
    for kind, label in _RANGES.items():
        ends = [calibration.quantities.get(f"{kind}_{end}_m") for end in ("min", "max")]
        found_m = [end.value for end in ends if end is not None]
        on_stroke = all(-_STROKE_MARGIN_M <= end_m <= nominal.stroke_m + _STROKE_MARGIN_M for end_m in found_m)
        if len(found_m) == 2 and not (on_stroke and found_m[0] < found_m[1]):
            low, high = (Quantity(1e3 * end_m, "mm", 1) for end_m in found_m)
            return Message(
                "calibration.implausible.range",
                "the {range} from {low} to {high} is not on the stroke",
                range=label,
                low=low,
                high=high,
            )
        if not on_stroke:
            return Message(
                "calibration.implausible.end",
                "an end of the {range}, {end}, is not on the stroke",
                range=label,
                end=Quantity(1e3 * found_m[0], "mm", 1),
            )
    return ""


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
            "it belongs to {found}, not to {expected}",
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
