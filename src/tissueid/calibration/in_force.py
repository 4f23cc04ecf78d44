"""Which calibration is in force: the newest that can be believed lays its figures over the nominal ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

import numpy as np

from tissueid.calibration.file import Calibration
from tissueid.calibration.store import Stored, calibration_folder, stored_calibrations
from tissueid.device import DeviceDescription
from tissueid.instrument import Correction, Instrument

State = Literal["valid", "stale", "foreign", "failed", "implausible", "damaged"]
"""Of one calibration: ``valid`` and ``stale`` ones are used, the latter with a warning; the others are refused."""

IMPLAUSIBLE = 0.20
"""Relative distance from the nominal figure beyond which a calibrated one is not believed."""
_LAID_OVER = {
    "coil_resistance_ohm": IMPLAUSIBLE,
    "force_constant_n_per_a": IMPLAUSIBLE,
    "moving_mass_kg": IMPLAUSIBLE,
    "coil_inductance_h": 0.5,
    "bearing_damping_n_s_per_m": 0.5,
}
"""Figures of the device that a calibration measures, and how far each may be from the nominal one."""
_BOUNDS = {
    "current_offset_a": (-0.3, 0.3),
    "voltage_offset_v": (-1.0, 1.0),
    "voltage_gain": (0.8, 1.2),
    "position_gain": (0.8, 1.2),
    "position_offset_m": (-3e-3, 3e-3),
    "temperature_offset_c": (-10.0, 10.0),
    "acceleration_gain": (0.8, 1.2),
    "acceleration_offset_m_s2": (-2.0, 2.0),
    "calibration_relative_uncertainty": (0.0, 0.5),
}
_CHANNELS = {
    "current": (None, "current_offset_a"),
    "voltage": (None, "voltage_offset_v"),
    "position": ("position_gain", "position_offset_m"),
    "temperature": (None, "temperature_offset_c"),
    "acceleration_x": ("acceleration_gain", "acceleration_offset_m_s2"),
}
"""What each recorded channel is corrected by. Gains of current and voltage are within force constant and resistance."""
_CLOCK_DAYS = 1.0
"""By so much may the clock of the computer that calibrated be ahead."""
DISAGREE = 0.03
"""Static calibration and sweep find the same force constant within this, or it is said."""
_BETWEEN = "; "
"""Stands between two warnings, and in none."""
NOT_CALIBRATED = "not calibrated: the nominal figures are used"


@dataclass(frozen=True)
class InForce:
    """What an instrument goes by: its figures, and in words what was made of the calibrations there are."""

    device: DeviceDescription
    words: str
    warnings: tuple[str, ...]

    @property
    def state(self) -> str:
        """``valid``, ``stale`` or ``none``."""
        return str(self.device.calibration.get("state", "none"))


def calibrated(
    instrument: Instrument, folder: Path | None = None, *, wanted: bool = True, now: datetime | None = None
) -> InForce:
    """Put the newest calibrations of an instrument in force, from a folder (``calibration_folder``).

    With ``wanted`` false, or where there is none, the nominal figures are.

    Raises:
        UnusableInputError: the folder cannot be read.
        InstrumentError: a test is running.
    """
    now = now or datetime.now(UTC)
    stored = stored_calibrations(calibration_folder(folder)) if wanted else ()
    device = put_in_force(instrument.nominal, stored, now)
    instrument.use_calibration(device, corrections(device))
    return InForce(device, in_words(device, now), warnings_of(device))


def go_by_static(
    instrument: Instrument, folder: Path | None = None, now: datetime | None = None
) -> dict[str, float | str]:
    """Correct what is read by the static calibration in force; a sweep from before is out of force meanwhile.

    For a sweep, which must not go by what one before it found. Returns which calibration that is, as conditions of what
    is measured; nothing where there is none.

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
    known = put_in_force(nominal, stored, now or datetime.now(UTC))
    instrument.use_calibration(replace(nominal, coil_resistance_ohm=known.coil_resistance_ohm), corrections(known))
    return {name: known.calibration[name] for name in ("static_file", "static_date") if name in known.calibration}


def put_in_force(nominal: DeviceDescription, stored: Sequence[Stored], now: datetime) -> DeviceDescription:
    """The device with calibrated figures over the nominal ones; ``calibration`` says whose and since when.

    Newest first, the first static calibration and the first sweep that can be used are. All that was refused on the way
    and is this device's own is a warning. Where there is nothing at all, the device stays as it was.
    """
    chosen: dict[str, Stored] = {}
    warnings: list[str] = []
    for item in sorted(stored, key=lambda item: item.made, reverse=True):
        state, reason = judged(item, nominal, now)
        if state == "damaged":
            warnings.append(reason)
        if item.calibration is None or item.calibration.serial_number != nominal.serial_number:
            continue
        if item.calibration.kind in chosen:
            continue
        if state in ("valid", "stale"):
            chosen[item.calibration.kind] = item
        if state != "valid":
            warnings.append(f"{item.path.name}: {reason}")
    return _laid_over(nominal, chosen.get("static"), chosen.get("sweep"), warnings, now)


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


def implausible(calibration: Calibration, nominal: DeviceDescription) -> str:
    """What cannot be true of a calibration of this device, in words; "" where nothing is."""
    for name, most in _LAID_OVER.items():
        if (found := calibration.quantities.get(name)) is not None:
            usual = getattr(nominal, name)
            if abs(found.value / usual - 1.0) > most:
                return f"{name} is {found.value:.4g}, more than {100 * most:.0f} % from the nominal {usual:.4g}"
    for name, (least, most) in _BOUNDS.items():
        if (found := calibration.quantities.get(name)) is not None and not least <= found.value <= most:
            return f"{name} is {found.value:.4g}, which is not between {least:g} and {most:g}"
    for kind in ("linear_region", "stroke"):
        low, high = (calibration.quantities.get(f"{kind}_{end}_m") for end in ("min", "max"))
        if low is None or high is None:
            continue
        if not -2e-3 <= low.value < high.value <= nominal.stroke_m + 2e-3:
            return (
                f"{kind.replace('_', ' ')} from {1e3 * low.value:.1f} to {1e3 * high.value:.1f} mm is not on the stroke"
            )
    return ""


def corrections(device: DeviceDescription) -> dict[str, Correction]:
    """By what the recorded channels are corrected under the calibration that a device carries."""
    known = device.calibration
    found: dict[str, Correction] = {}
    for channel, (gain, offset) in _CHANNELS.items():
        correction = Correction(_number(known, gain, 1.0), _number(known, offset, 0.0))
        if correction != Correction():
            found[channel] = correction
    return found


def warnings_of(device: DeviceDescription) -> tuple[str, ...]:
    """What is to be said of the calibration that a device carries."""
    return tuple(line for line in str(device.calibration.get("warnings", "")).split(_BETWEEN) if line)


def in_words(device: DeviceDescription, now: datetime | None = None) -> str:
    """The calibration that a device carries, in a line: "calibrated 12 days ago, linear from 4.0 to 27.5 mm"."""
    known = device.calibration
    dates = [str(known[name]) for name in ("static_date", "sweep_date") if known.get(name)]
    if not dates:
        return NOT_CALIBRATED
    days = (now or datetime.now(UTC)) - datetime.fromisoformat(min(dates))
    whole = max(0, round(days.total_seconds() / 86400.0))
    age = "today" if whole == 0 else "yesterday" if whole == 1 else f"{whole} days ago"
    words = f"calibrated {age}"
    if known.get("state") == "stale":
        words = f"calibration is stale: {words}"
    low, high = known.get("linear_region_min_m"), known.get("linear_region_max_m")
    if isinstance(low, float) and isinstance(high, float):
        return f"{words}, linear from {1e3 * low:.1f} to {1e3 * high:.1f} mm"
    return f"{words}, linear region not known"


def _joined(warnings: Sequence[str]) -> str:
    return _BETWEEN.join(warning.replace(_BETWEEN, ", ") for warning in warnings)


def _number(known: Mapping[str, float | str], name: str | None, default: float) -> float:
    value = default if name is None else known.get(name, default)
    return float(value) if isinstance(value, int | float) and np.isfinite(value) else default


def _laid_over(
    nominal: DeviceDescription, static: Stored | None, sweep: Stored | None, warnings: list[str], now: datetime
) -> DeviceDescription:
    """Figures of a static calibration before those of a sweep, and both before the nominal ones."""
    used = [item for item in (sweep, static) if item is not None and item.calibration is not None]
    if not used:
        refused: dict[str, float | str] = {"state": "none", "verdict": "none", "warnings": _joined(warnings)}
        return replace(nominal, calibration=refused) if warnings else nominal
    stale = any(judged(item, nominal, now)[0] == "stale" for item in used)
    known: dict[str, float | str] = {"state": "stale" if stale else "valid", "verdict": "passed"}
    constants: dict[str, float] = {}
    for item in used:
        calibration = item.calibration
        assert calibration is not None
        known |= {f"{calibration.kind}_file": item.path.name, f"{calibration.kind}_date": calibration.date}
        for name, found in calibration.quantities.items():
            if name in _LAID_OVER:
                known[name] = found.value
                known[f"nominal_{name}"] = getattr(nominal, name)
                if found.std is not None:
                    known[f"{name}_std"] = found.std
                if name == "force_constant_n_per_a":
                    constants[calibration.kind] = found.value
            elif name in _BOUNDS or name.startswith(("linear_region_", "stroke_m")):
                known[name] = found.value
    if len(constants) == 2 and abs(constants["sweep"] / constants["static"] - 1.0) > DISAGREE:
        warnings.append(
            f"static calibration and sweep disagree on the force constant: {constants['static']:.3f} and "
            f"{constants['sweep']:.3f} N/A; repeat both"
        )
    if "linear_region_min_m" not in known:
        warnings.append("the linear region is not known: run 'tissueid calibrate sweep'")
    if static is None:
        warnings.append("there is no static calibration: run 'tissueid calibrate static'")
    if warnings:
        known["warnings"] = _joined(warnings)
    uncertainty = _number(known, "calibration_relative_uncertainty", nominal.calibration_relative_uncertainty)
    return replace(
        nominal,
        coil_resistance_ohm=_number(known, "coil_resistance_ohm", nominal.coil_resistance_ohm),
        coil_inductance_h=_number(known, "coil_inductance_h", nominal.coil_inductance_h),
        force_constant_n_per_a=_number(known, "force_constant_n_per_a", nominal.force_constant_n_per_a),
        moving_mass_kg=_number(known, "moving_mass_kg", nominal.moving_mass_kg),
        bearing_damping_n_s_per_m=_number(known, "bearing_damping_n_s_per_m", nominal.bearing_damping_n_s_per_m),
        amplifier_gain=_number(known, "voltage_gain", nominal.amplifier_gain),
        calibration_relative_uncertainty=uncertainty,
        calibration=known,
    )
