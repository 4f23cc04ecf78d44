"""Which calibration is in force: the newest that can be believed lays its figures over the nominal ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

import numpy as np

from tissueid.calibration.file import Calibration
from tissueid.calibration.plausible import BOUNDS, LAID_OVER, implausible
from tissueid.calibration.store import Stored, calibration_folder, stored_calibrations
from tissueid.calibration.words import label_of
from tissueid.device import DeviceDescription
from tissueid.instrument import Correction, Instrument

State = Literal["valid", "stale", "foreign", "failed", "implausible", "damaged"]
"""Of one calibration: ``valid`` and ``stale`` ones are used, the latter with a warning; the others are refused."""

_CHANNELS = {
    "current": (None, "current_offset_a"),
    "voltage": (None, "voltage_offset_v"),
    "position": ("position_gain", "position_offset_m"),
    "temperature": (None, "temperature_offset_c"),
    "acceleration_x": ("acceleration_gain", "acceleration_offset_m_s2"),
}
"""What each recorded channel is corrected by. Gains of current and voltage are within force constant and resistance."""
_POSITION = ("position_gain", "position_offset_m")
_NOT_FOR_A_SWEEP = (
    "force_constant_n_per_a",
    "force_constant_n_per_a_std",
    "calibration_relative_uncertainty",
    "warnings",
)
"""What a sweep goes by only after it: it must not know the force constant that it looks for."""
_CLOCK_DAYS = 1.0
"""By so much may the clock of the computer that calibrated be ahead."""
DISAGREE = 0.03
"""Static calibration and sweep find the same force constant within this, or it is said."""
NEEDED = ("coil_resistance_ohm", "force_constant_n_per_a", "current_offset_a")
"""Without these a static calibration does not turn readings into newtons."""
MOST_SHIFT_M = 0.1e-3
"""By so much may the position scale move under a sweep before its linear region is said to be off."""
_BETWEEN = "; "
"""Stands between two warnings, and in none."""
NO_REGION = "the linear region is not known: run 'tissueid calibrate sweep'"
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
    kept = {name: value for name, value in known.calibration.items() if not name.endswith(_NOT_FOR_A_SWEEP)}
    if warnings := [line for line in warnings_of(known) if line != NO_REGION]:
        kept["warnings"] = _joined(warnings)
    device = replace(nominal, coil_resistance_ohm=known.coil_resistance_ohm, calibration=kept)
    instrument.use_calibration(device, corrections(device))
    return static_conditions(device)


def static_conditions(device: DeviceDescription) -> dict[str, float | str]:
    """Under which static calibration something is measured: its file, its date, its scale of the position."""
    known = device.calibration
    return {name: known[name] for name in ("static_file", "static_date", *_POSITION) if name in known}


def put_in_force(nominal: DeviceDescription, stored: Sequence[Stored], now: datetime) -> DeviceDescription:
    """The device with calibrated figures over the nominal ones; ``calibration`` says whose and since when.

    The newest sweep that can be used is; of static calibrations each figure is that of the newest that holds it, good
    ones before stale ones, so that one of a few steps does not undo a whole one. All that was refused on the way and is
    this device's own, and all that is older than the newest, is a warning. Where there is nothing at all, the device
    stays as it was.
    """
    used: dict[str, list[_Used]] = {"static": [], "sweep": []}
    warnings: list[str] = []
    refused = False
    for item in sorted(stored, key=lambda item: (item.made, item.path.name), reverse=True):
        state, reason = judged(item, nominal, now)
        calibration = item.calibration
        if state == "damaged":
            warnings.append(reason)
        if calibration is None or calibration.serial_number != nominal.serial_number:
            continue
        before = used[calibration.kind]
        if state in ("valid", "stale"):
            if before and before[0].made == calibration.made and before[0].differs(calibration):
                warnings.append(
                    f"{before[0].file} and {item.path.name} are of the same time and differ: the former is used; "
                    "take the wrong one away"
                )
            before.append(_Used(item.path.name, calibration, state, reason))
        elif not before:
            refused = refused or calibration.kind == "static"
            warnings.append(f"{item.path.name}: {reason}")
    found = _laid_over(nominal, used["static"], used["sweep"][:1], warnings)
    if refused and not used["static"] and used["sweep"]:
        found = replace(found, calibration=found.calibration | {"static_state": "refused"})
    return found


@dataclass(frozen=True)
class _Used:
    """A calibration that may be used; ``words`` says why it is stale."""

    file: str
    calibration: Calibration
    state: State
    words: str

    @property
    def made(self) -> datetime:
        return self.calibration.made

    def differs(self, other: Calibration) -> bool:
        """Whether another would put other figures in force."""
        return self.calibration.quantities != other.quantities


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
    """The calibration that a device carries, in a line: "calibrated 12 days ago, linear from 4.0 to 27.5 mm".

    Where only the sweep is in force it says so, and by what force is known then.
    """
    known = device.calibration
    dates = [str(known[name]) for name in ("static_date", "sweep_date") if known.get(name)]
    if not dates:
        return NOT_CALIBRATED
    days = (now or datetime.now(UTC)) - datetime.fromisoformat(min(dates))
    whole = max(0, round(days.total_seconds() / 86400.0))
    age = "today" if whole == 0 else "yesterday" if whole == 1 else f"{whole} days ago"
    words = f"calibrated {age}"
    if not known.get("static_date"):
        force = "nominal force" if "force_constant_n_per_a" not in known else "force by the sweep"
        static = "static calibration refused" if known.get("static_state") == "refused" else "no static calibration"
        words = f"{static}: {force}, sweep of {age}"
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
    nominal: DeviceDescription, statics: Sequence[_Used], sweeps: Sequence[_Used], warnings: list[str]
) -> DeviceDescription:
    """Figures of static calibrations, newest first, before those of a sweep, and all before the nominal ones."""
    if not statics and not sweeps:
        refused: dict[str, float | str] = {"state": "none", "verdict": "none", "warnings": _joined(warnings)}
        return replace(nominal, calibration=refused) if warnings else nominal
    known: dict[str, float | str] = {"state": "valid", "verdict": "passed"}
    found = _sources(statics)
    base = _base(statics, found)
    for item in sweeps:
        known |= {"sweep_file": item.file, "sweep_date": item.calibration.date}
        for name in _figures(item.calibration):
            found.setdefault(name, item)
    if base is not None:
        known |= {"static_file": base.file, "static_date": base.calibration.date}
        warnings += _patchwork(base, found)
    for item in (*([base] if base is not None else []), *sweeps):
        if item.state == "stale":
            known["state"] = "stale"
            warnings.append(f"{item.file}: {item.words}")
    for name, item in found.items():
        figure = item.calibration.quantities[name]
        known[name] = figure.value
        if name in LAID_OVER:
            known[f"nominal_{name}"] = getattr(nominal, name)
            if figure.std is not None:
                known[f"{name}_std"] = figure.std
    warnings += _disagreements(found, sweeps, known)
    if "linear_region_min_m" not in known:
        warnings.append(NO_REGION)
    if base is None:
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


def _figures(calibration: Calibration) -> tuple[str, ...]:
    """The figures of a calibration that are put in force."""
    return tuple(
        name
        for name in calibration.quantities
        if name in LAID_OVER or name in BOUNDS or name.startswith(("linear_region_", "stroke_m"))
    )


def _sources(statics: Sequence[_Used]) -> dict[str, _Used]:
    """Where each figure is taken from: the newest good calibration that holds it, else the newest stale one."""
    found: dict[str, _Used] = {}
    for item in sorted(statics, key=lambda item: item.state == "stale"):
        for name in _figures(item.calibration):
            found.setdefault(name, item)
    return found


def _base(statics: Sequence[_Used], found: Mapping[str, _Used]) -> _Used | None:
    """The static calibration that others only complete: the oldest of those that give what is needed for newtons."""
    giving = [found[name] for name in NEEDED if name in found]
    return min(giving, key=lambda item: item.made) if giving else next(iter(statics), None)


def _patchwork(base: _Used, found: Mapping[str, _Used]) -> list[str]:
    """What is to be said where static calibrations of a few steps stand beside each other."""
    lines = []
    files = {item.file: item for item in found.values() if item.calibration.kind == "static"}
    if len(files) > 1:
        newest = max(files.values(), key=lambda item: (item.made, item.file))
        for item in files.values():
            names = ", ".join(_label(name) for name, source in found.items() if source is item)
            if item is not newest:
                old = f", and {item.words}" if item.state == "stale" and item is not base else ""
                lines.append(f"{newest.file} does not hold all: {names} are those of {item.file}{old}")
    if missing := [_label(name) for name in NEEDED if name not in found]:
        lines.append(
            f"no static calibration holds {', '.join(missing)}: what the instrument says of itself is used; "
            "run 'tissueid calibrate static'"
        )
    return lines


def _label(name: str) -> str:
    label = label_of(name)
    return label[:1].lower() + label[1:]


def _disagreements(found: Mapping[str, _Used], sweeps: Sequence[_Used], known: Mapping[str, float | str]) -> list[str]:
    """Where a sweep does not agree with the static calibration in force, or was made under another one."""
    lines = []
    for item in sweeps:
        swept = item.calibration.quantities.get("force_constant_n_per_a")
        static = found.get("force_constant_n_per_a")
        if swept is not None and static is not None and static is not item:
            value = static.calibration.quantities["force_constant_n_per_a"].value
            if abs(swept.value / value - 1.0) > DISAGREE:
                lines.append(
                    f"static calibration and sweep disagree on the force constant: {value:.3f} and "
                    f"{swept.value:.3f} N/A; repeat both"
                )
        made_under = item.calibration.conditions
        off_m = _shift_m(made_under, known)
        if off_m > MOST_SHIFT_M:
            under = made_under.get("static_file", "no static calibration")
            lines.append(
                f"{item.file} was made under {under}, by whose scale positions differ by {1e3 * off_m:.2f} mm from "
                "those now: its linear region is off by as much; repeat the sweep"
            )
        elif not np.isfinite(off_m):
            lines.append(
                f"{item.file} was made under another static calibration ({made_under['static_file']}), and does not "
                "say by what scale: its linear region may be off; repeat the sweep"
            )
    return lines


def _shift_m(made_under: Mapping[str, float | str], known: Mapping[str, float | str]) -> float:
    """By how much the ends of a linear region lie elsewhere than when it was found, m; NaN where nobody knows."""
    dates = made_under.get("static_date"), known.get("static_date")
    if dates[0] is not None and dates[0] != dates[1] and not any(name in made_under for name in _POSITION):
        return float("nan")
    if dates[0] is not None and dates[0] == dates[1] and not any(name in made_under for name in _POSITION):
        return 0.0
    ends = [_number(known, f"linear_region_{end}_m", np.nan) for end in ("min", "max")]
    readings = np.array([end for end in ends if np.isfinite(end)])
    if not readings.size:
        return 0.0
    readings = readings * _number(made_under, _POSITION[0], 1.0) + _number(made_under, _POSITION[1], 0.0)
    now = (readings - _number(known, _POSITION[1], 0.0)) / _number(known, _POSITION[0], 1.0)
    before = (readings - _number(made_under, _POSITION[1], 0.0)) / _number(made_under, _POSITION[0], 1.0)
    return float(np.abs(now - before).max())
