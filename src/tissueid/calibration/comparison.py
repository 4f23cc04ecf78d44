"""Calibrations side by side: what differs between two sweeps, along the stroke and in figures, and trends over dates.

Two deviations are held apart. The noise of a sweep is what its repeats would scatter by; its uncertainty holds the
scales of spring and electronics as well, which two sweeps with the same spring on the same instrument have alike. A
difference beyond the noise is likely real there, even where it is within the uncertainty.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tissueid.calibration.file import Calibration, Quantity
from tissueid.calibration.words import label_of
from tissueid.errors import UnusableInputError
from tissueid.records import Estimate
from tissueid.wording import fixed

Array = NDArray[np.float64]
Verdict = Literal["noise", "uncertainty", "beyond", "unknown"]
"""Of a difference: within the noise, beyond it but within the uncertainty, beyond both, or nothing is known of it."""

DEVIATIONS = 2.0
"""A difference of so many standard deviations is one: by chance it is seen once in twenty times."""
COMPARED = (
    "force_constant_n_per_a",
    "moving_mass_kg",
    "bearing_damping_n_s_per_m",
    "coil_inductance_h",
    "resistance_in_the_sweep_ohm",
    "linear_region_min_m",
    "linear_region_max_m",
    "spring_over_flux",
    "least_vaf_percent",
)
"""Figures of a sweep that are compared, in this order."""
PLACES = ("linear_region_min_m", "linear_region_max_m", "least_vaf_percent")
"""Figures whose difference is read as it is, not as a share."""
_ALONG = {
    "force_constant": ("force_constant", "value_n_per_a", "std_n_per_a"),
    "mass": ("sweep", "mass_kg", "mass_std_kg"),
    "damping": ("sweep", "damping_n_s_per_m", "damping_std_n_s_per_m"),
    "stiffness": ("sweep", "stiffness_n_per_m", "stiffness_std_n_per_m"),
    "vaf": ("sweep", "vaf_percent", ""),
}
ALONG = tuple(_ALONG)
"""What a sweep has along the stroke."""
_RESIDUALS = (
    ("electrical", "voltage_v", "residual_a", "Current off the line of voltage", "V", "A"),
    ("force", "current_a", "residual_m", "Position off the line of current", "A", "m"),
    ("position", "position_m", "residual_m", "Reading off the line of position", "m", "m"),
)
_GREATEST = 1e9
"""No figure of an instrument is greater; what a file says beyond is not shown."""
_GRID = 101
_YEAR_S = 365.25 * 86400.0
LEAST_TREND = 3
"""So many dates make a trend."""


@dataclass(frozen=True, eq=False)
class Profile:
    """Something along the stroke: positions (n,), m, rising; values (n,), SI; their deviations (n,), or None."""

    position_m: Array
    value: Array
    std: Array | None

    def at(self, position_m: Array) -> Array:
        """Values at positions (k,), by straight lines; NaN beyond the ends."""
        return np.asarray(np.interp(position_m, self.position_m, self.value, np.nan, np.nan), np.float64)


@dataclass(frozen=True)
class Difference:
    """One figure of two calibrations. ``absolute`` is now less before; ``relative`` that over before, NaN for places.

    ``noise`` and ``uncertainty`` are standard deviations of ``absolute``; None where they are not known.
    """

    name: str
    before: Quantity
    now: Quantity
    noise: float | None
    uncertainty: float | None

    @property
    def absolute(self) -> float:
        """By how much it is more now, SI."""
        return self.now.value - self.before.value

    @property
    def relative(self) -> float:
        """By which share it is more now."""
        if self.name in PLACES or self.before.value == 0.0:
            return math.nan
        return self.absolute / abs(self.before.value)

    @property
    def verdict(self) -> Verdict:
        """What the difference is worth."""
        size = abs(self.absolute)
        if self.noise is not None and size <= DEVIATIONS * self.noise:
            return "noise"
        if self.uncertainty is None:
            return "unknown"
        return "uncertainty" if size <= DEVIATIONS * self.uncertainty else "beyond"


@dataclass(frozen=True, eq=False)
class Comparison:
    """Two sweeps, the earlier one first.

    ``profile`` is the mean relative difference of the force constant over the ``common_m`` linear region, and
    ``largest`` the largest, at ``largest_at_m``; NaN where the regions do not overlap.
    """

    before: Calibration
    now: Calibration
    differences: tuple[Difference, ...]
    common_m: tuple[float, float] | None
    profile: float
    largest: float
    largest_at_m: float
    remarks: tuple[str, ...]

    @property
    def words(self) -> str:
        """The drift of the force constant in a sentence."""
        found = next((item for item in self.differences if item.name == "force_constant_n_per_a"), None)
        if found is None:
            return "One of the two sweeps holds no force constant."
        return drift_in_words(found, self.before.date[:10])


def drift_in_words(found: Difference, date: str) -> str:
    """One difference in a sentence: how much, since when, and whether that is more than what is not known."""
    label = label_of(found.name)
    if math.isnan(found.relative):
        scale, unit = (1e3, "mm") if found.before.unit == "m" else (1.0, found.before.unit)
        size = f"{fixed(scale * abs(found.absolute), 2)} {unit}"
        known = None if found.uncertainty is None else f"{fixed(scale * DEVIATIONS * found.uncertainty, 2)} {unit}"
        more, less = "further", "nearer"
        if found.before.unit != "m":
            more, less = "more", "less"
    else:
        share = None if found.uncertainty is None else DEVIATIONS * found.uncertainty / abs(found.before.value)
        alike = share is not None and fixed(100.0 * abs(found.relative), 1) == fixed(100.0 * share, 1)
        size = f"{fixed(100.0 * abs(found.relative), 2 if alike else 1)} %"
        known = None if share is None else f"{fixed(100.0 * share, 2 if alike else 1)} %"
        more, less = "higher", "lower"
    said = {
        "noise": "within the noise of the two",
        "uncertainty": f"within the uncertainty of ±{known}",
        "beyond": f"beyond the uncertainty of ±{known}",
        "unknown": "and no uncertainty is known",
    }[found.verdict]
    if not any(digit in size for digit in "123456789"):
        return f"{label} the same as on {date}."
    return f"{label} {size} {more if found.absolute > 0 else less} than on {date}, {said}."


def along(calibration: Calibration, name: str) -> Profile | None:
    """Something along the stroke, of ``ALONG``; None where the calibration does not hold it."""
    table, values, stds = _ALONG[name]
    columns = calibration.tables.get(table, {})
    if not columns.get("position_m") or values not in columns:
        return None
    place, value = np.array(columns["position_m"]), np.array(columns[values])
    std = np.abs(np.array(columns[stds])) if stds in columns else None
    kept = (np.abs(place) < _GREATEST) & (np.abs(value) < _GREATEST)
    order = np.flatnonzero(kept)[np.argsort(place[kept], kind="stable")]
    if order.size < 2:
        return None
    return Profile(place[order], value[order], None if std is None else np.minimum(std[order], _GREATEST))


def linear_region(calibration: Calibration) -> tuple[float, float] | None:
    """Where the coil is linear, m; None where the calibration does not say."""
    low, high = (calibration.quantities.get(f"linear_region_{end}_m") for end in ("min", "max"))
    if low is None or high is None or not -1.0 < low.value < high.value < 1.0:
        return None
    return low.value, high.value


def compare_sweeps(first: Calibration, second: Calibration) -> Comparison:
    """What differs between two sweeps, whichever of them is the earlier.

    Raises:
        UnusableInputError: one of them is no sweep.
    """
    if {first.kind, second.kind} != {"sweep"}:
        raise UnusableInputError("only sweeps are compared along the stroke: choose two sweeps")
    before, now = sorted((first, second), key=lambda item: item.made)
    found = tuple(
        _difference(name, before, now)
        for name in COMPARED
        if name in before.quantities and name in now.quantities and _readable(before, now, name)
    )
    common, mean, largest, where = _along_difference(before, now)
    return Comparison(before, now, found, common, mean, largest, where, tuple(_remarks(before, now)))


def _readable(before: Calibration, now: Calibration, name: str) -> bool:
    return max(abs(before.quantities[name].value), abs(now.quantities[name].value)) < _GREATEST


def _difference(name: str, before: Calibration, now: Calibration) -> Difference:
    one, other = before.quantities[name], now.quantities[name]
    uncertainty = None if one.std is None or other.std is None else math.hypot(one.std, other.std)
    return Difference(name, one, other, _noise(name, before, now), uncertainty)


def _noise(name: str, before: Calibration, now: Calibration) -> float | None:
    """By how much the difference of two sweeps of the same coil would scatter, as far as they tell."""
    own = [_own_noise(name, calibration) for calibration in (before, now)]
    return None if own[0] is None or own[1] is None else math.hypot(own[0], own[1])


def _own_noise(name: str, calibration: Calibration) -> float | None:
    """From repeats of the sweep where there are some, or from what each position says of itself."""
    runs = [run for run in calibration.tables.get("repeats", {}).get(name, ()) if abs(run) < _GREATEST]
    if len(runs) > 1:
        return float(np.std(runs, ddof=1) / math.sqrt(len(runs)))
    if name != "force_constant_n_per_a":
        return None
    columns = calibration.tables.get("sweep", {})
    stds = np.array(columns.get("force_constant_std_n_per_a", ()))
    places = np.array(columns.get("position_m", ()))
    region = linear_region(calibration)
    if region is not None and places.size == stds.size:
        stds = stds[(places >= region[0]) & (places <= region[1])]
    stds = stds[np.abs(stds) < _GREATEST]
    return float(np.linalg.norm(stds) / stds.size) if stds.size and np.any(stds > 0.0) else None


def _along_difference(before: Calibration, now: Calibration) -> tuple[tuple[float, float] | None, float, float, float]:
    """Where both are linear, and by which share the force constant differs there: mean, largest, and where that is."""
    nothing = (None, math.nan, math.nan, math.nan)
    regions = linear_region(before), linear_region(now)
    one, other = along(before, "force_constant"), along(now, "force_constant")
    if regions[0] is None or regions[1] is None:
        return nothing
    common = max(regions[0][0], regions[1][0]), min(regions[0][1], regions[1][1])
    if common[0] >= common[1]:
        return nothing
    if one is None or other is None:
        return common, math.nan, math.nan, math.nan
    grid = np.linspace(*common, _GRID)
    base, share = one.at(grid), other.at(grid)
    good = np.isfinite(base) & np.isfinite(share) & (np.abs(base) > 0.0)
    if not good.any():
        return common, math.nan, math.nan, math.nan
    with np.errstate(over="ignore"):
        grid, share = grid[good], share[good] / base[good] - 1.0
    worst = int(np.argmax(np.abs(share)))
    return common, float(share.mean()), float(share[worst]), float(grid[worst])


def _remarks(before: Calibration, now: Calibration) -> list[str]:
    """What keeps the two from being of one kind."""
    lines = []
    if (before.serial_number, before.model) != (now.serial_number, now.model):
        lines.append(f"They are of two instruments, {before.serial_number} and {now.serial_number}.")
    springs = [calibration.conditions.get("spring_stiffness_n_per_m") for calibration in (before, now)]
    if springs[0] != springs[1]:
        lines.append("Different springs were used: their uncertainties are in every difference.")
    if any(calibration.verdict == "failed" for calibration in (before, now)):
        lines.append("At least one of them failed.")
    return lines


@dataclass(frozen=True, eq=False)
class Residuals:
    """What lies off a line of a static calibration: ``x`` (n,) and ``y`` (n,), SI with their units."""

    label: str
    x: Array
    y: Array
    x_unit: str
    y_unit: str


def residuals(calibration: Calibration) -> tuple[Residuals, ...]:
    """The residuals that a static calibration keeps; those of tables that are not as they should be are left out."""
    found = []
    for table, across, off, label, x_unit, y_unit in _RESIDUALS:
        columns = calibration.tables.get(table, {})
        x, y = np.array(columns.get(across, ())), np.array(columns.get(off, ()))
        if x.size and x.size == y.size:
            kept = (np.abs(x) < _GREATEST) & (np.abs(y) < _GREATEST)
            found.append(Residuals(label, x[kept], y[kept], x_unit, y_unit))
    return tuple(found)


@dataclass(frozen=True, eq=False)
class Trend:
    """A figure over dates, oldest first. ``per_year`` is its slope; None where the dates are too few or as good as one.

    ``std`` is NaN where a calibration does not say.
    """

    name: str
    unit: str
    dates: tuple[datetime, ...]
    value: Array
    std: Array
    per_year: Estimate | None

    @property
    def words(self) -> str:
        """The trend in a sentence."""
        label = label_of(self.name)
        if self.per_year is None:
            return f"{label}: {LEAST_TREND} calibrations of different days make a trend."
        mean = float(np.mean(self.value))
        slope, std = self.per_year.value, self.per_year.std or 0.0
        scale, unit = (100.0 / abs(mean), "%") if mean else (1.0, self.unit)
        size = f"{fixed(scale * abs(slope), 1)} ± {fixed(scale * std, 1)} {unit} a year"
        if abs(slope) <= DEVIATIONS * std or not any(digit in fixed(scale * abs(slope), 1) for digit in "123456789"):
            return f"{label}: no trend ({'+' if slope > 0 else '−'}{size})."
        return f"{label}: {'rises' if slope > 0 else 'falls'} by {size}."


def trend(calibrations: Sequence[Calibration], name: str) -> Trend:
    """A figure of several calibrations over their dates, with a straight line by least squares.

    Raises:
        UnusableInputError: none of them holds it.
    """
    held = [item for item in calibrations if name in item.quantities and abs(item.quantities[name].value) < _GREATEST]
    if not held:
        raise UnusableInputError(f"no calibration holds {name}")
    held.sort(key=lambda item: item.made)
    value = np.array([item.quantities[name].value for item in held])
    stds = [item.quantities[name].std for item in held]
    return Trend(
        name,
        held[-1].quantities[name].unit,
        tuple(item.made for item in held),
        value,
        np.array([math.nan if std is None else std for std in stds]),
        _slope(held, value),
    )


def _slope(held: Sequence[Calibration], value: Array) -> Estimate | None:
    years = np.array([(item.made - held[0].made).total_seconds() / _YEAR_S for item in held])
    if len({item.date[:10] for item in held}) < LEAST_TREND:
        return None
    centred = years - years.mean()
    spread = float(centred @ centred)
    slope = float(centred @ value) / spread
    off = value - value.mean() - slope * centred
    return Estimate(slope, math.sqrt(float(off @ off) / (value.size - 2) / spread))
