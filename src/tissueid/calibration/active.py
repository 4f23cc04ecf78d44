"""The calibration in force: that of the file, the device and the built-in one, and what a test uses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from tissueid.calibration.file import Calibration
from tissueid.calibration.status import (
    BOUNDS,
    DEVICE_TOLERANCES,
    State,
    Stored,
    calibration_folder,
    label_of,
    status_for_device,
    stored_calibrations,
)
from tissueid.device import CALIBRATE_STATIC, CALIBRATE_SWEEP, DeviceDescription, warning_entries
from tissueid.instrument import Correction, Instrument
from tissueid.instrument.force_profile import PROFILE, profile_text
from tissueid.language import marked
from tissueid.messages import Listing, Message, Quantity

POSITION_QUANTITIES = ("position_gain", "position_offset_m")
"""Quantities of the position scale."""
MAX_DISAGREEMENT = 0.03
"""Relative difference between the force constants of static calibration and sweep above which a warning is given."""
REQUIRED_QUANTITIES = ("coil_resistance_ohm", "force_constant_n_per_a", "current_offset_a")
"""Quantities of a static calibration that are required for force in newtons."""
MAX_SHIFT_M = 0.1e-3
"""Largest change of the position scale after a sweep without a warning about its linear region, m."""
NO_REGION = Message("calibration.no_region", "the linear region is not known: run {action}", action=CALIBRATE_SWEEP)


@dataclass(frozen=True)
class UsedCalibration:
    """Usable calibration; ``reason`` says why it is stale."""

    file: str
    calibration: Calibration
    state: State
    reason: str

    @property
    def made(self) -> datetime:
        """Date of the calibration."""
        return self.calibration.made


def number_or_default(values: Mapping[str, float | str], name: str | None, default: float) -> float:
    """Return the finite number stored under a name, or ``default``."""
    value = default if name is None else values.get(name, default)
    return float(value) if isinstance(value, int | float) and np.isfinite(value) else default


def merge_calibrations(
    nominal: DeviceDescription,
    statics: Sequence[UsedCalibration],
    sweeps: Sequence[UsedCalibration],
    warnings: list[str],
) -> DeviceDescription:
    """Return the device description with values from static calibrations, else from a sweep, else nominal.

    Args:
        nominal: description by the device itself.
        statics: usable static calibrations, newest first.
        sweeps: the sweep to use, or none.
        warnings: list to which warnings are appended.
    """
    if not statics and not sweeps:
        refused: dict[str, float | str] = {"state": "none", "verdict": "none", **warning_entries(warnings)}
        return replace(nominal, calibration=refused) if warnings else nominal
    merged: dict[str, float | str] = {"state": "valid", "verdict": "passed"}
    sources = _sources(statics)
    # The main static calibration is the oldest source of a required quantity.
    giving = [sources[name] for name in REQUIRED_QUANTITIES if name in sources]
    base = min(giving, key=lambda item: item.made, default=next(iter(statics), None))
    for item in sweeps:
        merged |= {"sweep_file": item.file, "sweep_date": item.calibration.date}
        for name in _effective_quantities(item.calibration):
            sources.setdefault(name, item)
        if (profile := _force_profile(item.calibration)) is not None:
            merged[PROFILE] = profile
    if base is not None:
        merged |= {"static_file": base.file, "static_date": base.calibration.date}
        warnings += _completion_warnings(base, sources)
    used = [*([base] if base is not None else []), *sweeps]
    if used:
        due = min(item.made + timedelta(days=item.calibration.valid_days) for item in used)
        merged["valid_until"] = due.strftime("%Y-%m-%d")
    for item in used:
        if item.state == "stale":
            merged["state"] = "stale"
            warnings.append(file_warning(item.file, item.reason))
    for name, item in sources.items():
        figure = item.calibration.quantities[name]
        merged[name] = figure.value
        if name in DEVICE_TOLERANCES:
            merged[f"nominal_{name}"] = getattr(nominal, name)
            if figure.std is not None:
                merged[f"{name}_std"] = figure.std
    warnings += _disagreement_warnings(sources, sweeps, merged)
    if "linear_region_min_m" not in merged:
        warnings.append(NO_REGION)
    if base is None:
        warnings.append(
            Message("calibration.no_static", "there is no static calibration: run {action}", action=CALIBRATE_STATIC)
        )
    if warnings:
        merged |= warning_entries(warnings)
    uncertainty = number_or_default(
        merged, "calibration_relative_uncertainty", nominal.calibration_relative_uncertainty
    )
    return replace(
        nominal,
        coil_resistance_ohm=number_or_default(merged, "coil_resistance_ohm", nominal.coil_resistance_ohm),
        coil_inductance_h=number_or_default(merged, "coil_inductance_h", nominal.coil_inductance_h),
        force_constant_n_per_a=number_or_default(merged, "force_constant_n_per_a", nominal.force_constant_n_per_a),
        moving_mass_kg=number_or_default(merged, "moving_mass_kg", nominal.moving_mass_kg),
        bearing_damping_n_s_per_m=number_or_default(
            merged, "bearing_damping_n_s_per_m", nominal.bearing_damping_n_s_per_m
        ),
        amplifier_gain=number_or_default(merged, "voltage_gain", nominal.amplifier_gain),
        calibration_relative_uncertainty=uncertainty,
        calibration=merged,
    )


def file_warning(file: str, warning: str) -> Message:
    """Return a warning about a calibration file."""
    return Message("calibration.about", "{file}: {warning}", file=file, warning=warning)


def _effective_quantities(calibration: Calibration) -> tuple[str, ...]:
    """Return the names of the quantities of a calibration that are applied to the device."""
    return tuple(
        name
        for name in calibration.quantities
        if name in DEVICE_TOLERANCES or name in BOUNDS or name.startswith(("linear_region_", "stroke_m"))
    )


def _force_profile(calibration: Calibration) -> str | None:
    """Return the force constant of a sweep by position, relative to its plateau, as stored; None without one."""
    columns = calibration.tables.get("force_constant", {})
    plateau = calibration.quantities.get("force_constant_n_per_a")
    if plateau is None or not plateau.value > 0.0 or not {"position_m", "value_n_per_a"} <= columns.keys():
        return None
    return profile_text(np.array(columns["position_m"]), np.array(columns["value_n_per_a"]) / plateau.value)


def _sources(statics: Sequence[UsedCalibration]) -> dict[str, UsedCalibration]:
    """Return the source of each quantity: the newest valid calibration that contains it, else the newest stale one."""
    sources: dict[str, UsedCalibration] = {}
    for item in sorted(statics, key=lambda item: item.state == "stale"):
        for name in _effective_quantities(item.calibration):
            sources.setdefault(name, item)
    return sources


def _completion_warnings(base: UsedCalibration, sources: Mapping[str, UsedCalibration]) -> list[str]:
    """Return warnings about quantities that come from other static calibrations than the main one, or from none."""
    lines: list[str] = []
    files = {item.file: item for item in sources.values() if item.calibration.kind == "static"}
    if len(files) > 1:
        newest = max(files.values(), key=lambda item: (item.made, item.file))
        for item in files.values():
            names = Listing(tuple(label_of(name) for name, source in sources.items() if source is item))
            if item is newest:
                continue
            values = {"file": newest.file, "names": names, "other": item.file}
            if item.state == "stale" and item is not base:
                lines.append(
                    Message(
                        "calibration.completed_by_stale",
                        "{file} is not complete. Taken from {other}: {names}. Note that {reason}",
                        reason=item.reason,
                        **values,
                    )
                )
            else:
                lines.append(
                    Message("calibration.completed", "{file} is not complete. Taken from {other}: {names}", **values)
                )
    if missing := [label_of(name) for name in REQUIRED_QUANTITIES if name not in sources]:
        lines.append(
            Message(
                "calibration.nominal_used",
                "no static calibration contains: {names}. The nominal values of the instrument are used; run {action}",
                names=Listing(tuple(missing)),
                action=CALIBRATE_STATIC,
            )
        )
    return lines


def _disagreement_warnings(
    sources: Mapping[str, UsedCalibration], sweeps: Sequence[UsedCalibration], merged: Mapping[str, float | str]
) -> list[str]:
    """Return warnings about a sweep that disagrees with the active static calibration, or was made with another."""
    lines: list[str] = []
    for item in sweeps:
        swept = item.calibration.quantities.get("force_constant_n_per_a")
        static = sources.get("force_constant_n_per_a")
        if swept is not None and static is not None and static is not item:
            value = static.calibration.quantities["force_constant_n_per_a"].value
            if abs(swept.value / value - 1.0) > MAX_DISAGREEMENT:
                lines.append(
                    Message(
                        "calibration.disagree",
                        "static calibration and sweep disagree on the force constant: {static:.3f} and {sweep:.3f} N/A;"
                        " repeat both",
                        static=value,
                        sweep=swept.value,
                    )
                )
        made_under = item.calibration.conditions
        off_m = _shift_m(made_under, merged)
        if off_m > MAX_SHIFT_M:
            lines.append(
                Message(
                    "calibration.region_shifted",
                    "{file} was made under {static}, whose position scale differs by {shift} from the current one: its "
                    "linear region is shifted by as much; repeat the sweep",
                    file=item.file,
                    static=made_under.get("static_file", marked("no static calibration")),
                    shift=Quantity(1e3 * off_m, "mm", 2),
                )
            )
        elif not np.isfinite(off_m):
            lines.append(
                Message(
                    "calibration.region_unsure",
                    "{file} was made under another static calibration ({static}) and does not contain its position "
                    "scale: its linear region may be shifted; repeat the sweep",
                    file=item.file,
                    static=made_under["static_file"],
                )
            )
    return lines


def _shift_m(made_under: Mapping[str, float | str], active: Mapping[str, float | str]) -> float:
    """Return the shift of the ends of a linear region since the sweep, m; NaN if unknown."""
    date = made_under.get("static_date")
    if date is not None and not any(name in made_under for name in POSITION_QUANTITIES):
        return 0.0 if date == active.get("static_date") else float("nan")
    ends = [number_or_default(active, f"linear_region_{end}_m", np.nan) for end in ("min", "max")]
    readings = np.array([end for end in ends if np.isfinite(end)])
    if not readings.size:
        return 0.0
    (gain, offset), (gain_now, offset_now) = (
        [number_or_default(scale, name, default) for name, default in zip(POSITION_QUANTITIES, (1.0, 0.0), strict=True)]
        for scale in (made_under, active)
    )
    readings = readings * gain + offset
    return float(np.abs((readings - offset_now) / gain_now - (readings - offset) / gain).max())


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
    summary: str
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
    return ActiveCalibration(device, calibration_summary(device, now), device.calibration_warnings)


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
    calibrated = apply_calibrations(nominal, stored, now or datetime.now(UTC))
    kept = {name: value for name, value in calibrated.calibration.items() if not name.endswith(_EXCLUDED_FROM_SWEEP)}
    if warnings := [line for line in calibrated.calibration_warnings if line != NO_REGION]:
        kept |= warning_entries(warnings)
    device = replace(nominal, coil_resistance_ohm=calibrated.coil_resistance_ohm, calibration=kept)
    instrument.use_calibration(device, corrections(device))
    return static_conditions(device)


def static_conditions(device: DeviceDescription) -> dict[str, float | str]:
    """Return file, date and position scale of the static calibration in a device description."""
    calibration = device.calibration
    return {
        name: calibration[name] for name in ("static_file", "static_date", *POSITION_QUANTITIES) if name in calibration
    }


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
            if (
                before
                and before[0].made == calibration.made
                and before[0].calibration.quantities != calibration.quantities
            ):
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
    calibrated = merge_calibrations(nominal, used["static"], used["sweep"][:1], warnings)
    if refused and not used["static"] and used["sweep"]:
        calibrated = replace(calibrated, calibration=calibrated.calibration | {"static_state": "refused"})
    return calibrated


def corrections(device: DeviceDescription) -> dict[str, Correction]:
    """Return the correction of each recorded channel from the calibration in a device description."""
    calibration = device.calibration
    by_channel: dict[str, Correction] = {}
    for channel, (gain, offset) in _CHANNELS.items():
        correction = Correction(number_or_default(calibration, gain, 1.0), number_or_default(calibration, offset, 0.0))
        if correction != Correction():
            by_channel[channel] = correction
    return by_channel


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
    calibration = device.calibration
    dates = [str(calibration[name]) for name in ("static_date", "sweep_date") if calibration.get(name)]
    if not dates:
        return NOT_CALIBRATED
    summary = _force_source(device, _age(min(dates), now or datetime.now(UTC)))
    if calibration.get("state") == "stale":
        summary = Message("calibration.summary.stale", "calibration is stale: {words}", words=summary)
    low, high = calibration.get("linear_region_min_m"), calibration.get("linear_region_max_m")
    if isinstance(low, float) and isinstance(high, float):
        return Message(
            "calibration.summary.linear",
            "{words}, linear {low:.1f} to {high}",
            words=summary,
            low=1e3 * low,
            high=Quantity(1e3 * high, "mm", 1),
        )
    return Message("calibration.summary.no_region", "{words}, linear region not known", words=summary)


def _force_source(device: DeviceDescription, age: Message) -> Message:
    calibration = device.calibration
    if calibration.get("static_date"):
        return Message("calibration.summary.static", "calibrated {age}", age=age)
    if "force_constant_n_per_a" in calibration:
        force = Message("calibration.force.sweep", "force by the sweep")
    else:
        force = Message("calibration.force.nominal", "nominal force")
    if calibration.get("static_state") == "refused":
        return Message(
            "calibration.summary.refused", "static calibration refused: {force}, sweep of {age}", force=force, age=age
        )
    return Message("calibration.summary.sweep", "no static calibration: {force}, sweep of {age}", force=force, age=age)
