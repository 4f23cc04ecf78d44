"""Active calibration of an instrument: the newest usable calibration replaces the nominal values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from tissueid.calibration.layers import (
    NO_REGION,
    POSITION_QUANTITIES,
    UsedCalibration,
    file_warning,
    merge_calibrations,
    number_or_default,
)
from tissueid.calibration.status import status_for_device
from tissueid.calibration.store import Stored, calibration_folder, stored_calibrations
from tissueid.device import DeviceDescription, warning_entries
from tissueid.instrument import Correction, Instrument
from tissueid.messages import Message, Quantity

_CHANNELS = {
    "current": (None, "current_offset_a"),
    "voltage": (None, "voltage_offset_v"),
    "position": ("position_gain", "position_offset_m"),
    "temperature": (None, "temperature_offset_c"),
    "acceleration_x": ("acceleration_gain", "acceleration_offset_m_s2"),
}
"""Quantities for gain and offset of each recorded channel. Force constant and resistance include the gains of current
and voltage.
"""
_EXCLUDED_FROM_SWEEP = (
    "force_constant_n_per_a",
    "force_constant_n_per_a_std",
    "calibration_relative_uncertainty",
    "warnings",
    "warning_messages",
)
"""Quantities that are not applied during a sweep, because the sweep measures the force constant independently."""
NOT_CALIBRATED = Message("calibration.none", "not calibrated: the nominal figures are used")


@dataclass(frozen=True)
class ActiveCalibration:
    """Active calibration: the calibrated device description, a summary and warnings."""

    device: DeviceDescription
    words: str
    warnings: tuple[str, ...]

    @property
    def state(self) -> str:
        """``valid``, ``stale`` or ``none``."""
        return str(self.device.calibration.get("state", "none"))


def activate_calibration(
    instrument: Instrument, folder: Path | None = None, *, wanted: bool = True, now: datetime | None = None
) -> ActiveCalibration:
    """Activate the newest calibrations of an instrument from a folder (``calibration_folder``).

    With ``wanted`` false, or without any calibration, the nominal values are used.

    Raises:
        UnusableInputError: the folder cannot be read.
        InstrumentError: a test is running.
    """
    now = now or datetime.now(UTC)
    stored = stored_calibrations(calibration_folder(folder)) if wanted else ()
    device = apply_calibrations(instrument.nominal, stored, now)
    instrument.use_calibration(device, corrections(device))
    return ActiveCalibration(device, calibration_summary(device, now), warnings_of(device))


def use_static_calibration(
    instrument: Instrument, folder: Path | None = None, now: datetime | None = None
) -> dict[str, float | str]:
    """Activate only the static calibration, for a sweep, which must not depend on an earlier sweep.

    Returns:
        File, date and position scale of that calibration, as conditions of the sweep; empty without one.

    Raises:
        UnusableInputError: the folder cannot be read.
        InstrumentError: a test is running.
    """
    nominal = instrument.nominal
    stored = [
        item
        for item in stored_calibrations(calibration_folder(folder))
        if item.calibration is not None and item.calibration.kind == "static"
    ]
    known = apply_calibrations(nominal, stored, now or datetime.now(UTC))
    kept = {name: value for name, value in known.calibration.items() if not name.endswith(_EXCLUDED_FROM_SWEEP)}
    if warnings := [line for line in warnings_of(known) if line != NO_REGION]:
        kept |= warning_entries(warnings)
    device = replace(nominal, coil_resistance_ohm=known.coil_resistance_ohm, calibration=kept)
    instrument.use_calibration(device, corrections(device))
    return static_conditions(device)


def static_conditions(device: DeviceDescription) -> dict[str, float | str]:
    """Return file, date and position scale of the static calibration in a device description."""
    known = device.calibration
    return {name: known[name] for name in ("static_file", "static_date", *POSITION_QUANTITIES) if name in known}


def apply_calibrations(nominal: DeviceDescription, stored: Sequence[Stored], now: datetime) -> DeviceDescription:
    """Return the device description with calibrated values; ``calibration`` holds files, dates and warnings.

    Uses the newest usable sweep. Each quantity of static calibrations is taken from the newest calibration that
    contains it, valid before stale, so that a partial calibration does not discard a complete one. Rejected
    calibrations of this device give a warning. Without any calibration the device is returned unchanged.
    """
    used: dict[str, list[UsedCalibration]] = {"static": [], "sweep": []}
    warnings: list[str] = []
    refused = False
    for item in sorted(stored, key=lambda item: (item.made, item.path.name), reverse=True):
        state, reason = status_for_device(item, nominal, now)
        calibration = item.calibration
        if state == "damaged":
            warnings.append(reason)
        if calibration is None or calibration.serial_number != nominal.serial_number:
            continue
        before = used[calibration.kind]
        if state in ("valid", "stale"):
            if before and before[0].made == calibration.made and before[0].differs(calibration):
                warnings.append(
                    Message(
                        "calibration.same_time",
                        "{used} and {other} have the same date and differ: {used} is used; remove the wrong one",
                        used=before[0].file,
                        other=item.path.name,
                    )
                )
            before.append(UsedCalibration(item.path.name, calibration, state, reason))
        elif not before:
            refused = refused or calibration.kind == "static"
            warnings.append(file_warning(item.path.name, reason))
    found = merge_calibrations(nominal, used["static"], used["sweep"][:1], warnings)
    if refused and not used["static"] and used["sweep"]:
        found = replace(found, calibration=found.calibration | {"static_state": "refused"})
    return found


def corrections(device: DeviceDescription) -> dict[str, Correction]:
    """Return the correction of each recorded channel from the calibration in a device description."""
    known = device.calibration
    found: dict[str, Correction] = {}
    for channel, (gain, offset) in _CHANNELS.items():
        correction = Correction(number_or_default(known, gain, 1.0), number_or_default(known, offset, 0.0))
        if correction != Correction():
            found[channel] = correction
    return found


def warnings_of(device: DeviceDescription) -> tuple[str, ...]:
    """Return the warnings about the calibration in a device description."""
    return device.calibration_warnings


def _age(date: str, now: datetime) -> Message:
    try:
        made = datetime.fromisoformat(date)
        days = now - (made if made.tzinfo else made.replace(tzinfo=UTC))
    except (ValueError, OverflowError):
        return Message("age.unknown", "an unknown time ago")
    whole = max(0, round(days.total_seconds() / 86400.0))
    if whole < 2:
        return Message("age.yesterday", "yesterday") if whole else Message("age.today", "today")
    return Message("age.days", "{days} days ago", days=whole)


def calibration_summary(device: DeviceDescription, now: datetime | None = None) -> Message:
    """Return a summary of the calibration in a device description.

    Example: "calibrated 12 days ago, linear 4.0 to 27.5 mm". With only a sweep active, the summary names the
    source of the force constant.
    """
    known = device.calibration
    dates = [str(known[name]) for name in ("static_date", "sweep_date") if known.get(name)]
    if not dates:
        return NOT_CALIBRATED
    words = _force_source(device, _age(min(dates), now or datetime.now(UTC)))
    if known.get("state") == "stale":
        words = Message("calibration.summary.stale", "calibration is stale: {words}", words=words)
    low, high = known.get("linear_region_min_m"), known.get("linear_region_max_m")
    if isinstance(low, float) and isinstance(high, float):
        return Message(
            "calibration.summary.linear",
            "{words}, linear {low:.1f} to {high}",
            words=words,
            low=1e3 * low,
            high=Quantity(1e3 * high, "mm", 1),
        )
    return Message("calibration.summary.no_region", "{words}, linear region not known", words=words)


def _force_source(device: DeviceDescription, age: Message) -> Message:
    known = device.calibration
    if known.get("static_date"):
        return Message("calibration.summary.static", "calibrated {age}", age=age)
    if "force_constant_n_per_a" in known:
        force = Message("calibration.force.sweep", "force by the sweep")
    else:
        force = Message("calibration.force.nominal", "nominal force")
    if known.get("static_state") == "refused":
        return Message(
            "calibration.summary.refused", "static calibration refused: {force}, sweep of {age}", force=force, age=age
        )
    return Message("calibration.summary.sweep", "no static calibration: {force}, sweep of {age}", force=force, age=age)
