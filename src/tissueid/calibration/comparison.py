"""Comparison of calibrations: differences of two sweeps, residuals of a static calibration, trends over dates.

Two standard deviations are distinguished. The noise of a sweep is the scatter of its repeats; its uncertainty includes
the scales of spring and electronics, which are common to sweeps with the same spring on the same instrument. There a
difference beyond the noise is likely real, even within the uncertainty.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tissueid.calibration.file import CalibratedQuantity, Calibration
from tissueid.calibration.status import label_of
from tissueid.errors import UnusableInputError
from tissueid.formatting import clean, fixed
from tissueid.language import marked
from tissueid.messages import Message, Verbatim
from tissueid.messages import Quantity as ShownQuantity
from tissueid.records import Estimate

Array = NDArray[np.float64]
Verdict = Literal["noise", "uncertainty", "beyond", "unknown"]
"""Significance of a difference: within the noise, within the uncertainty, beyond both, or uncertainty unknown."""

SIGNIFICANT_STD = 2.0
"""Standard deviations of a significant difference: a false positive rate of 5 %."""
COMPARED_QUANTITIES = (
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
"""Quantities of a sweep that are compared, in order of display."""
ABSOLUTE_QUANTITIES = ("linear_region_min_m", "linear_region_max_m", "least_vaf_percent")
"""Quantities whose difference is reported as absolute instead of relative."""
_PROFILES = {
    "force_constant": ("force_constant", "value_n_per_a", "std_n_per_a"),
    "mass": ("sweep", "mass_kg", "mass_std_kg"),
    "damping": ("sweep", "damping_n_s_per_m", "damping_std_n_s_per_m"),
    "stiffness": ("sweep", "stiffness_n_per_m", "stiffness_std_n_per_m"),
    "vaf": ("sweep", "vaf_percent", ""),
}
"""Profiles of a sweep along the stroke: table, column of values, column of standard deviations."""
_RESIDUALS = (
    ("electrical", ("voltage_v", marked("Voltage"), "V"), ("current_a", marked("Current"), "A"), "residual_a",
     marked("Residual of current over voltage")),
    ("force", ("current_a", marked("Current"), "A"), ("position_m", marked("Position reading"), "m"), "residual_m",
     marked("Residual of position over current")),
    ("position", ("position_m", marked("Known position"), "m"), ("reading_m", marked("Reading"), "m"), "residual_m",
     marked("Residual of the position reading")),
)  # fmt: skip
"""Lines of a static calibration: table; column, quantity and unit of abscissa and ordinate; column of the residuals."""
_MAX_VALUE = 1e9
"""Largest value that is displayed, SI; files may contain anything."""
_GRID = 101
"""Number of positions at which two profiles are compared."""
_YEAR_S = 365.25 * 86400.0
MIN_TREND_DATES = 3
"""Minimum number of dates for a trend."""


@dataclass(frozen=True, eq=False)
class Profile:
    """A profile along the stroke: positions (n,), m, rising; values (n,), SI; standard deviations (n,) or None."""

    position_m: Array
    value: Array
    std: Array | None

    def at(self, position_m: Array) -> Array:
        """Return interpolated values at positions (k,), m; NaN beyond the ends."""
        return np.asarray(np.interp(position_m, self.position_m, self.value, np.nan, np.nan), np.float64)


@dataclass(frozen=True)
class CalibrationDifference:
    """Difference of one quantity. ``noise`` and ``uncertainty`` are standard deviations of ``absolute``, or None."""

    name: str
    before: CalibratedQuantity
    now: CalibratedQuantity
    noise: float | None
    uncertainty: float | None

    @property
    def absolute(self) -> float:
        """Current minus earlier value, SI."""
        return self.now.value - self.before.value

    @property
    def relative(self) -> float:
        """Difference relative to the earlier value; NaN for ``ABSOLUTE_QUANTITIES``."""
        if self.name in ABSOLUTE_QUANTITIES or self.before.value == 0.0:
            return math.nan
        return self.absolute / abs(self.before.value)

    @property
    def verdict(self) -> Verdict:
        """Significance of the difference."""
        size = abs(self.absolute)
        if self.noise is not None and size <= SIGNIFICANT_STD * self.noise:
            return "noise"
        if self.uncertainty is None:
            return "unknown"
        return "uncertainty" if size <= SIGNIFICANT_STD * self.uncertainty else "beyond"


@dataclass(frozen=True, eq=False)
class CalibrationComparison:
    """Comparison of two sweeps, the earlier one first.

    ``profile`` is the mean relative difference of the force constant over the common linear region ``common_m``,
    ``largest`` the largest, at ``largest_at_m``; NaN without overlap of the regions.
    """

    before: Calibration
    now: Calibration
    differences: tuple[CalibrationDifference, ...]
    common_m: tuple[float, float] | None
    profile: float
    largest: float
    largest_at_m: float
    remarks: tuple[str, ...]

    @property
    def message(self) -> Message:
        """Change of the force constant as a sentence."""
        difference = next((item for item in self.differences if item.name == "force_constant_n_per_a"), None)
        if difference is None:
            return Message("drift.no_force_constant", "One of the two sweeps contains no force constant.")
        return drift_text(difference, self.before.date[:10])


def drift_text(difference: CalibrationDifference, date: str) -> Message:
    """Return a difference as a sentence: its size, the earlier date, and its significance."""
    if math.isnan(difference.relative):
        scale, unit = (1e3, "mm") if difference.before.unit == "m" else (1.0, difference.before.unit)
        size, decimals = scale * abs(difference.absolute), 2
        threshold = None if difference.uncertainty is None else scale * SIGNIFICANT_STD * difference.uncertainty
    else:
        size, unit = 100.0 * abs(difference.relative), "%"
        threshold = (
            None
            if difference.uncertainty is None
            else 100.0 * SIGNIFICANT_STD * difference.uncertainty / abs(difference.before.value)
        )
        decimals = 2 if threshold is not None and fixed(size, 1) == fixed(threshold, 1) else 1
    label = label_of(difference.name)
    if not any(digit in fixed(size, decimals) for digit in "123456789"):
        return Message("drift.none", "{quantity}: the same as on {date}.", quantity=label, date=date)
    limit = ShownQuantity(math.nan if threshold is None else threshold, unit, decimals)
    values = {
        "quantity": label,
        "difference": ShownQuantity(size, unit, decimals),
        "date": date,
        "significance": _significance(difference.verdict, limit),
    }
    if difference.absolute > 0:
        return Message("drift.higher", "{quantity}: {difference} higher than on {date}, {significance}.", **values)
    return Message("drift.lower", "{quantity}: {difference} lower than on {date}, {significance}.", **values)


def _significance(verdict: Verdict, uncertainty: ShownQuantity) -> Message:
    if verdict == "noise":
        return Message("drift.noise", "within the noise of both")
    if verdict == "uncertainty":
        return Message("drift.uncertainty", "within the uncertainty of ±{uncertainty}", uncertainty=uncertainty)
    if verdict == "beyond":
        return Message("drift.beyond", "beyond the uncertainty of ±{uncertainty}", uncertainty=uncertainty)
    return Message("drift.unknown", "with unknown uncertainty")


def profile_of(calibration: Calibration, name: str) -> Profile | None:
    """Return one of the profiles in ``_PROFILES``; None if the calibration does not contain it."""
    table, values, stds = _PROFILES[name]
    columns = calibration.tables.get(table, {})
    if not columns.get("position_m") or values not in columns:
        return None
    position, value = np.array(columns["position_m"]), np.array(columns[values])
    std = np.abs(np.array(columns[stds])) if stds in columns else None
    kept = (np.abs(position) < _MAX_VALUE) & (np.abs(value) < _MAX_VALUE)
    order = np.flatnonzero(kept)[np.argsort(position[kept], kind="stable")]
    if order.size < 2:
        return None
    return Profile(position[order], value[order], None if std is None else np.minimum(std[order], _MAX_VALUE))


def linear_region(calibration: Calibration) -> tuple[float, float] | None:
    """Return the linear region, m; None if the calibration does not contain one."""
    low, high = (calibration.quantities.get(f"linear_region_{end}_m") for end in ("min", "max"))
    if low is None or high is None or not -1.0 < low.value < high.value < 1.0:
        return None
    return low.value, high.value


def compare_sweeps(first: Calibration, second: Calibration) -> CalibrationComparison:
    """Compare two sweeps, in either order.

    Raises:
        UnusableInputError: one of them is not a sweep.
    """
    if {first.kind, second.kind} != {"sweep"}:
        raise UnusableInputError("drift.not_sweeps", "only sweeps can be compared along the stroke: choose two sweeps")
    before, now = sorted((first, second), key=lambda item: item.made)
    differences = []
    for name in COMPARED_QUANTITIES:
        was, is_now = before.quantities.get(name), now.quantities.get(name)
        if was is not None and is_now is not None and max(abs(was.value), abs(is_now.value)) < _MAX_VALUE:
            noise = _joint_std(_calibration_noise(name, before), _calibration_noise(name, now))
            differences.append(CalibrationDifference(name, was, is_now, noise, _joint_std(was.std, is_now.std)))
    common, mean, largest, where = _profile_difference(before, now)
    remarks = tuple(_remarks(before, now))
    return CalibrationComparison(before, now, tuple(differences), common, mean, largest, where, remarks)


def _joint_std(first: float | None, second: float | None) -> float | None:
    """Return the standard deviation of a difference from those of both values; None if one is unknown."""
    return None if first is None or second is None else math.hypot(first, second)


def _calibration_noise(name: str, calibration: Calibration) -> float | None:
    """Return the standard deviation due to noise, from the repeats of a sweep, or else from that at each position."""
    runs = [run for run in calibration.tables.get("repeats", {}).get(name, ()) if abs(run) < _MAX_VALUE]
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
    stds = stds[np.abs(stds) < _MAX_VALUE]
    return float(np.linalg.norm(stds) / stds.size) if stds.size and np.any(stds > 0.0) else None


def _profile_difference(
    before: Calibration, now: Calibration
) -> tuple[tuple[float, float] | None, float, float, float]:
    """Return the common linear region, and mean, maximum and its position of the relative difference of force
    constants.
    """
    nothing = (None, math.nan, math.nan, math.nan)
    regions = linear_region(before), linear_region(now)
    profile_before, profile_now = profile_of(before, "force_constant"), profile_of(now, "force_constant")
    if regions[0] is None or regions[1] is None:
        return nothing
    common = max(regions[0][0], regions[1][0]), min(regions[0][1], regions[1][1])
    if common[0] >= common[1]:
        return nothing
    if profile_before is None or profile_now is None:
        return common, math.nan, math.nan, math.nan
    grid = np.linspace(*common, _GRID)
    base, share = profile_before.at(grid), profile_now.at(grid)
    good = np.isfinite(base) & np.isfinite(share) & (np.abs(base) > 0.0)
    if not good.any():
        return common, math.nan, math.nan, math.nan
    with np.errstate(over="ignore"):
        grid, share = grid[good], share[good] / base[good] - 1.0
    worst = int(np.argmax(np.abs(share)))
    return common, float(share.mean()), float(share[worst]), float(grid[worst])


def _remarks(before: Calibration, now: Calibration) -> list[Message]:
    """Return remarks on the comparability of two sweeps."""
    lines = []
    if (before.serial_number, before.model) != (now.serial_number, now.model):
        lines.append(
            Message(
                "drift.instruments",
                "The sweeps are of two instruments, {one} and {other}.",
                one=Verbatim(clean(before.serial_number)),
                other=Verbatim(clean(now.serial_number)),
            )
        )
    springs = [calibration.conditions.get("spring_stiffness_n_per_m") for calibration in (before, now)]
    if springs[0] != springs[1]:
        lines.append(
            Message("drift.springs", "Different springs were used: every difference includes their uncertainties.")
        )
    if any(calibration.verdict == "failed" for calibration in (before, now)):
        lines.append(Message("drift.failed", "At least one of the sweeps failed."))
    return lines


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of a line of a static calibration: ``x`` (n,) and ``y`` (n,), SI with their units.

    ``reading`` (n,) is what the line was fitted to, None where the file does not contain it. ``outlier`` (n,) marks
    readings that were not used. ``quantities`` are the names of ``x`` and ``reading``, ``table`` is that of the file.
    """

    label: str
    x: Array
    y: Array
    x_unit: str
    y_unit: str
    quantities: tuple[str, str] = ("", "")
    reading: Array | None = None
    outlier: NDArray[np.bool_] | None = None
    table: str = ""


def residuals(calibration: Calibration) -> tuple[Residuals, ...]:
    """Return the residuals in a static calibration; malformed tables are left out."""
    result = []
    for table, (across, x_name, x_unit), (along, y_name, y_unit), off, label in _RESIDUALS:
        columns = calibration.tables.get(table, {})
        x, y = np.array(columns.get(across, ())), np.array(columns.get(off, ()))
        if not x.size or x.size != y.size:
            continue
        kept = (np.abs(x) < _MAX_VALUE) & (np.abs(y) < _MAX_VALUE)
        reading, outlier = np.array(columns.get(along, ())), np.array(columns.get("outlier", ())) > 0.0
        result.append(
            Residuals(
                label,
                x[kept],
                y[kept],
                x_unit,
                y_unit,
                (x_name, y_name),
                reading[kept] if reading.size == x.size else None,
                outlier[kept] if outlier.size == x.size else None,
                table,
            )
        )
    return tuple(result)


@dataclass(frozen=True, eq=False)
class Trend:
    """A quantity over dates, oldest first. ``per_year`` is its slope; None with too few different dates.

    ``std`` is NaN where a calibration does not contain it.
    """

    name: str
    unit: str
    dates: tuple[datetime, ...]
    value: Array
    std: Array
    per_year: Estimate | None

    @property
    def message(self) -> Message:
        """Trend in a sentence."""
        label = label_of(self.name)
        if self.per_year is None:
            return Message(
                "trend.too_few",
                "{quantity}: a trend needs calibrations of at least {least} different days.",
                quantity=label,
                least=MIN_TREND_DATES,
            )
        mean = float(np.mean(self.value))
        slope, std = self.per_year.value, self.per_year.std or 0.0
        scale, unit = (100.0 / abs(mean), "%") if mean else (1.0, self.unit)
        values: dict[str, str | ShownQuantity] = {"quantity": label, "std": ShownQuantity(scale * std, unit, 1)}
        if abs(slope) <= SIGNIFICANT_STD * std or not any(
            digit in fixed(scale * abs(slope), 1) for digit in "123456789"
        ):
            return Message(
                "trend.none", "{quantity}: no trend ({slope:.1f} ± {std} per year).", slope=scale * slope, **values
            )
        if slope > 0.0:
            return Message(
                "trend.rises", "{quantity}: rises by {slope:.1f} ± {std} per year.", slope=scale * slope, **values
            )
        return Message(
            "trend.falls", "{quantity}: falls by {slope:.1f} ± {std} per year.", slope=-scale * slope, **values
        )


def trend(calibrations: Sequence[Calibration], name: str) -> Trend:
    """Return the values of a quantity in several calibrations over their dates, with a least-squares slope.

    Raises:
        UnusableInputError: no calibration contains the quantity.
    """
    containing = [
        item for item in calibrations if name in item.quantities and abs(item.quantities[name].value) < _MAX_VALUE
    ]
    if not containing:
        raise UnusableInputError("trend.no_quantity", "no calibration contains {quantity}", quantity=label_of(name))
    containing.sort(key=lambda item: item.made)
    value = np.array([item.quantities[name].value for item in containing])
    stds = [item.quantities[name].std for item in containing]
    return Trend(
        name,
        containing[-1].quantities[name].unit,
        tuple(item.made for item in containing),
        value,
        np.array([math.nan if std is None else std for std in stds]),
        _slope(containing, value),
    )


def _slope(containing: Sequence[Calibration], value: Array) -> Estimate | None:
    years = np.array([(item.made - containing[0].made).total_seconds() / _YEAR_S for item in containing])
    if len({item.date[:10] for item in containing}) < MIN_TREND_DATES:
        return None
    centred = years - years.mean()
    spread = float(centred @ centred)
    slope = float(centred @ value) / spread
    off = value - value.mean() - slope * centred
    return Estimate(slope, math.sqrt(float(off @ off) / (value.size - 2) / spread))
