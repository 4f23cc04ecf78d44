"""Figures of several calibrations laid over the nominal ones: whence each is taken, and what is to be said of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np

from tissueid.calibration.file import Calibration
from tissueid.calibration.judging import State
from tissueid.calibration.plausible import BOUNDS, LAID_OVER
from tissueid.calibration.words import label_of
from tissueid.device import DeviceDescription

POSITION = ("position_gain", "position_offset_m")
"""The scale of the position."""
DISAGREE = 0.03
"""Static calibration and sweep find the same force constant within this, or it is said."""
NEEDED = ("coil_resistance_ohm", "force_constant_n_per_a", "current_offset_a")
"""Without these a static calibration does not turn readings into newtons."""
MOST_SHIFT_M = 0.1e-3
"""By so much may the position scale move under a sweep before its linear region is said to be off."""
BETWEEN = "; "
"""Stands between two warnings, and in none."""
NO_REGION = "the linear region is not known: run 'tissueid calibrate sweep'"


@dataclass(frozen=True)
class Used:
    """A calibration that may be used; ``words`` says why it is stale."""

    file: str
    calibration: Calibration
    state: State
    words: str

    @property
    def made(self) -> datetime:
        """When."""
        return self.calibration.made

    def differs(self, other: Calibration) -> bool:
        """Whether another would put other figures in force."""
        return self.calibration.quantities != other.quantities


def joined(warnings: Sequence[str]) -> str:
    """Warnings in one text, of which ``BETWEEN`` parts them again."""
    return BETWEEN.join(warning.replace(BETWEEN, ", ") for warning in warnings)


def number_of(known: Mapping[str, float | str], name: str | None, default: float) -> float:
    """A figure that is known; ``default`` where it is not, or is none."""
    value = default if name is None else known.get(name, default)
    return float(value) if isinstance(value, int | float) and np.isfinite(value) else default


def laid_over(
    nominal: DeviceDescription, statics: Sequence[Used], sweeps: Sequence[Used], warnings: list[str]
) -> DeviceDescription:
    """Figures of static calibrations, newest first, before those of a sweep, and all before the nominal ones."""
    if not statics and not sweeps:
        refused: dict[str, float | str] = {"state": "none", "verdict": "none", "warnings": joined(warnings)}
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
        known["warnings"] = joined(warnings)
    uncertainty = number_of(known, "calibration_relative_uncertainty", nominal.calibration_relative_uncertainty)
    return replace(
        nominal,
        coil_resistance_ohm=number_of(known, "coil_resistance_ohm", nominal.coil_resistance_ohm),
        coil_inductance_h=number_of(known, "coil_inductance_h", nominal.coil_inductance_h),
        force_constant_n_per_a=number_of(known, "force_constant_n_per_a", nominal.force_constant_n_per_a),
        moving_mass_kg=number_of(known, "moving_mass_kg", nominal.moving_mass_kg),
        bearing_damping_n_s_per_m=number_of(known, "bearing_damping_n_s_per_m", nominal.bearing_damping_n_s_per_m),
        amplifier_gain=number_of(known, "voltage_gain", nominal.amplifier_gain),
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


def _sources(statics: Sequence[Used]) -> dict[str, Used]:
    """Where each figure is taken from: the newest good calibration that holds it, else the newest stale one."""
    found: dict[str, Used] = {}
    for item in sorted(statics, key=lambda item: item.state == "stale"):
        for name in _figures(item.calibration):
            found.setdefault(name, item)
    return found


def _base(statics: Sequence[Used], found: Mapping[str, Used]) -> Used | None:
    """The static calibration that others only complete: the oldest of those that give what is needed for newtons."""
    giving = [found[name] for name in NEEDED if name in found]
    return min(giving, key=lambda item: item.made) if giving else next(iter(statics), None)


def _patchwork(base: Used, found: Mapping[str, Used]) -> list[str]:
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


def _disagreements(found: Mapping[str, Used], sweeps: Sequence[Used], known: Mapping[str, float | str]) -> list[str]:
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
    if dates[0] is not None and dates[0] != dates[1] and not any(name in made_under for name in POSITION):
        return float("nan")
    if dates[0] is not None and dates[0] == dates[1] and not any(name in made_under for name in POSITION):
        return 0.0
    ends = [number_of(known, f"linear_region_{end}_m", np.nan) for end in ("min", "max")]
    readings = np.array([end for end in ends if np.isfinite(end)])
    if not readings.size:
        return 0.0
    readings = readings * number_of(made_under, POSITION[0], 1.0) + number_of(made_under, POSITION[1], 0.0)
    now = (readings - number_of(known, POSITION[1], 0.0)) / number_of(known, POSITION[0], 1.0)
    before = (readings - number_of(made_under, POSITION[1], 0.0)) / number_of(made_under, POSITION[0], 1.0)
    return float(np.abs(now - before).max())
