"""Merging of several calibrations with the nominal values of a device: source of each quantity, and warnings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta

import numpy as np

from tissueid.calibration.file import Calibration
from tissueid.calibration.labels import label_of
from tissueid.calibration.status import BOUNDS, DEVICE_TOLERANCES, State
from tissueid.device import CALIBRATE_STATIC, CALIBRATE_SWEEP, DeviceDescription, warning_entries
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
    """Usable calibration; ``words`` is the reason why it is stale."""

    file: str
    calibration: Calibration
    state: State
    words: str

    @property
    def made(self) -> datetime:
        """Date of the calibration."""
        return self.calibration.made

    @property
    def valid_until(self) -> datetime:
        """When the next calibration is due."""
        return self.made + timedelta(days=self.calibration.valid_days)

    def differs(self, other: Calibration) -> bool:
        """Return whether another calibration has other quantities."""
        return self.calibration.quantities != other.quantities


def number_or_default(known: Mapping[str, float | str], name: str | None, default: float) -> float:
    """Return the finite number stored under a name, or ``default``."""
    value = default if name is None else known.get(name, default)
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
    known: dict[str, float | str] = {"state": "valid", "verdict": "passed"}
    found = _sources(statics)
    base = _main_calibration(statics, found)
    for item in sweeps:
        known |= {"sweep_file": item.file, "sweep_date": item.calibration.date}
        for name in _effective_quantities(item.calibration):
            found.setdefault(name, item)
        if (profile := _force_profile(item.calibration)) is not None:
            known[PROFILE] = profile
    if base is not None:
        known |= {"static_file": base.file, "static_date": base.calibration.date}
        warnings += _completion_warnings(base, found)
    used = [*([base] if base is not None else []), *sweeps]
    if used:
        known["valid_until"] = min(item.valid_until for item in used).strftime("%Y-%m-%d")
    for item in used:
        if item.state == "stale":
            known["state"] = "stale"
            warnings.append(file_warning(item.file, item.words))
    for name, item in found.items():
        figure = item.calibration.quantities[name]
        known[name] = figure.value
        if name in DEVICE_TOLERANCES:
            known[f"nominal_{name}"] = getattr(nominal, name)
            if figure.std is not None:
                known[f"{name}_std"] = figure.std
    warnings += _disagreement_warnings(found, sweeps, known)
    if "linear_region_min_m" not in known:
        warnings.append(NO_REGION)
    if base is None:
        warnings.append(
            Message("calibration.no_static", "there is no static calibration: run {action}", action=CALIBRATE_STATIC)
        )
    if warnings:
        known |= warning_entries(warnings)
    uncertainty = number_or_default(known, "calibration_relative_uncertainty", nominal.calibration_relative_uncertainty)
    return replace(
        nominal,
        coil_resistance_ohm=number_or_default(known, "coil_resistance_ohm", nominal.coil_resistance_ohm),
        coil_inductance_h=number_or_default(known, "coil_inductance_h", nominal.coil_inductance_h),
        force_constant_n_per_a=number_or_default(known, "force_constant_n_per_a", nominal.force_constant_n_per_a),
        moving_mass_kg=number_or_default(known, "moving_mass_kg", nominal.moving_mass_kg),
        bearing_damping_n_s_per_m=number_or_default(
            known, "bearing_damping_n_s_per_m", nominal.bearing_damping_n_s_per_m
        ),
        amplifier_gain=number_or_default(known, "voltage_gain", nominal.amplifier_gain),
        calibration_relative_uncertainty=uncertainty,
        calibration=known,
    )


def file_warning(file: str, words: str) -> Message:
    """Return a warning about a calibration file."""
    return Message("calibration.about", "{file}: {warning}", file=file, warning=words)


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
    found: dict[str, UsedCalibration] = {}
    for item in sorted(statics, key=lambda item: item.state == "stale"):
        for name in _effective_quantities(item.calibration):
            found.setdefault(name, item)
    return found


def _main_calibration(
    statics: Sequence[UsedCalibration], found: Mapping[str, UsedCalibration]
) -> UsedCalibration | None:
    """Return the main static calibration: the oldest source of a quantity in ``REQUIRED_QUANTITIES``."""
    giving = [found[name] for name in REQUIRED_QUANTITIES if name in found]
    return min(giving, key=lambda item: item.made) if giving else next(iter(statics), None)


def _completion_warnings(base: UsedCalibration, found: Mapping[str, UsedCalibration]) -> list[str]:
    """Return warnings about quantities that come from other static calibrations than the main one, or from none."""
    lines: list[str] = []
    files = {item.file: item for item in found.values() if item.calibration.kind == "static"}
    if len(files) > 1:
        newest = max(files.values(), key=lambda item: (item.made, item.file))
        for item in files.values():
            names = Listing(tuple(label_of(name) for name, source in found.items() if source is item))
            if item is newest:
                continue
            values = {"file": newest.file, "names": names, "other": item.file}
            if item.state == "stale" and item is not base:
                lines.append(
                    Message(
                        "calibration.completed_by_stale",
                        "{file} is not complete. Taken from {other}: {names}. Note that {reason}",
                        reason=item.words,
                        **values,
                    )
                )
            else:
                lines.append(
                    Message("calibration.completed", "{file} is not complete. Taken from {other}: {names}", **values)
                )
    if missing := [label_of(name) for name in REQUIRED_QUANTITIES if name not in found]:
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
    found: Mapping[str, UsedCalibration], sweeps: Sequence[UsedCalibration], known: Mapping[str, float | str]
) -> list[str]:
    """Return warnings about a sweep that disagrees with the active static calibration, or was made with another."""
    lines: list[str] = []
    for item in sweeps:
        swept = item.calibration.quantities.get("force_constant_n_per_a")
        static = found.get("force_constant_n_per_a")
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
        off_m = _shift_m(made_under, known)
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


def _shift_m(made_under: Mapping[str, float | str], known: Mapping[str, float | str]) -> float:
    """Return the shift of the ends of a linear region since the sweep, m; NaN if unknown."""
    dates = made_under.get("static_date"), known.get("static_date")
    if dates[0] is not None and dates[0] != dates[1] and not any(name in made_under for name in POSITION_QUANTITIES):
        return float("nan")
    if dates[0] is not None and dates[0] == dates[1] and not any(name in made_under for name in POSITION_QUANTITIES):
        return 0.0
    ends = [number_or_default(known, f"linear_region_{end}_m", np.nan) for end in ("min", "max")]
    readings = np.array([end for end in ends if np.isfinite(end)])
    if not readings.size:
        return 0.0
    readings = readings * number_or_default(made_under, POSITION_QUANTITIES[0], 1.0) + number_or_default(
        made_under, POSITION_QUANTITIES[1], 0.0
    )
    now = (readings - number_or_default(known, POSITION_QUANTITIES[1], 0.0)) / number_or_default(
        known, POSITION_QUANTITIES[0], 1.0
    )
    before = (readings - number_or_default(made_under, POSITION_QUANTITIES[1], 0.0)) / number_or_default(
        made_under, POSITION_QUANTITIES[0], 1.0
    )
    return float(np.abs(now - before).max())
