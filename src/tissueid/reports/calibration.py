"""A dynamic sweep as a page: the coil by position, its force constant by each method, the linear region."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from tissueid.calibration.file import Calibration
from tissueid.calibration.words import label_of, notes_of, readable, verdict_of
from tissueid.errors import UnusableInputError
from tissueid.reports.calibration_panels import Columns, Region, sweep_panels
from tissueid.reports.stimulus_report import StimulusReport
from tissueid.reports.tables import Table
from tissueid.wording import fixed, named_value, number

_NEEDED = {
    "sweep": ("position_m", "vaf_percent", "mass_kg", "damping_n_s_per_m", "stiffness_n_per_m"),
    "force_constant": ("position_m", "value_n_per_a", "std_n_per_a"),
}
_THESIS = (
    ("VAF (%)", "vaf_percent", 1.0, 1, "95 to 98", "70 to 95"),
    ("M (g)", "mass_kg", 1e3, 0, "60 to 80", "60 to 100"),
    ("B (N·s/m)", "damping_n_s_per_m", 1.0, 2, "3 to 4", "5 to 50"),
    ("K (N/m)", "stiffness_n_per_m", 1.0, 0, "1000 to 1200", "100 to 7000"),
)
"""Label, column, scale and decimals of a parameter; instrument and skin in the thesis (Chen 2010, Table 2.1)."""
_REPEATED = (
    ("force_constant_n_per_a", 1.0, "N/A", 4),
    ("linear_region_min_m", 1e3, "mm", 3),
    ("linear_region_max_m", 1e3, "mm", 3),
    ("moving_mass_kg", 1e3, "g", 3),
    ("bearing_damping_n_s_per_m", 1.0, "N·s/m", 4),
    ("coil_inductance_h", 1e3, "mH", 4),
)


def sweep_report(calibration: Calibration) -> StimulusReport:
    """The report of a sweep, from what its file keeps.

    Raises:
        UnusableInputError: it is of another kind, or lacks the tables of a sweep.
    """
    if calibration.kind != "sweep":
        raise UnusableInputError(f"this is a {calibration.kind} calibration, not a sweep")
    for name, columns in _NEEDED.items():
        missing = [column for column in columns if not calibration.tables.get(name, {}).get(column)]
        if missing:
            raise UnusableInputError(f"the calibration lacks {missing[0]} in its table {name}: repeat the sweep")
    region = _region(calibration)
    tables = {
        name: {key: np.abs(values) if "_std_" in key else np.array(values) for key, values in columns.items()}
        for name, columns in calibration.tables.items()
    }
    return StimulusReport(
        title=f"Dynamic sweep of {calibration.model}, {calibration.serial_number}",
        facts=(
            ("Made", calibration.date.replace("T", " ").replace("Z", " UTC")),
            ("Good for", f"{calibration.valid_days} days"),
            ("Positions", number(float(len(tables["sweep"]["position_m"])))),
            ("Firmware", calibration.firmware_version or "not told"),
            ("Software", calibration.software),
        ),
        headline=f"Linear from {fixed(1e3 * region.min_m, 1)} to {fixed(1e3 * region.max_m, 1)} mm. "
        f"The calibration {verdict_of(calibration)}",
        level="good" if calibration.verdict == "passed" else "poor",
        concerns=calibration.problems + notes_of(calibration),
        summary=(
            "M, B and K are what the coil with the calibration spring seems to be to an instrument that takes its "
            "force constant to be the same everywhere: where the coil leaves its field all three rise together. Tests "
            "that leave the linear region are flagged.",
        ),
        tables=tuple(_tables(calibration, tables, region)),
        panels=tuple(sweep_panels(tables, region)),
    )


def _region(calibration: Calibration) -> Region:
    """Linear region and plateau.

    Raises:
        UnusableInputError: the calibration does not have them.
    """
    names = ("linear_region_min_m", "linear_region_max_m", "force_constant_n_per_a")
    for name in names:
        if name not in calibration.quantities:
            raise UnusableInputError(f"the calibration lacks {name}: repeat the sweep")
    believed = calibration.conditions.get("believed_force_constant_n_per_a")
    low, high, plateau = (calibration.quantities[name].value for name in names)
    return Region(low, high, plateau, believed if isinstance(believed, float) else None)


def _tables(calibration: Calibration, tables: dict[str, Columns], region: Region) -> Iterator[Table]:
    sweep = tables["sweep"]
    inside = (sweep["position_m"] >= region.min_m) & (sweep["position_m"] <= region.max_m)
    yield Table(
        "Beside the thesis",
        ("", "Here", "Thesis", "Skin"),
        tuple(
            (label, _span(scale * sweep[name][inside], digits), instrument, skin)
            for label, name, scale, digits, instrument, skin in _THESIS
        ),
        "Here: within the linear region. Thesis, and skin there: Chen 2010, Table 2.1. Mass and damping are of coil "
        "and spring together.",
    )
    rows = tuple(readable(name, found) for name, found in calibration.quantities.items())
    yield Table("What was found", ("Quantity", "Value", "Unit"), rows)
    yield _by_position(tables)
    if "repeats" in tables:
        yield _repeatability(tables["repeats"])
    told = {name: value for name, value in calibration.conditions.items() if not name.startswith("note_")}
    yield Table("Conditions", (), tuple(named_value(name, value) for name, value in told.items()))


def _span(values: NDArray[np.float64], digits: int) -> str:
    if not values.size:
        return "none"
    low, high = fixed(float(values.min()), digits), fixed(float(values.max()), digits)
    return low if low == high else f"{low} to {high}"


def _by_position(tables: dict[str, Columns]) -> Table:
    sweep, profile = tables["sweep"], tables["force_constant"]
    here = np.interp(sweep["position_m"], profile["position_m"], profile["value_n_per_a"])
    rows = []
    for row, position in enumerate(sweep["position_m"]):
        rows.append(
            (
                fixed(1e3 * position, 1),
                *(fixed(scale * sweep[name][row], max(1, digits)) for _, name, scale, digits, _, _ in _THESIS),
                fixed(here[row], 3),
            )
        )
    head = ("Position (mm)", *(label for label, *_ in _THESIS), "k (N/A)")
    return Table("By position", head, tuple(rows), "k is the force constant of all methods together.")


def _repeatability(columns: Columns) -> Table:
    rows = []
    for name, scale, unit, digits in _REPEATED:
        if name in columns and columns[name].size > 1:
            values = scale * columns[name]
            rows.append(
                (
                    label_of(name),
                    fixed(float(values.mean()), digits),
                    fixed(float(np.std(values, ddof=1)), digits),
                    fixed(float(np.ptp(values)), digits),
                    unit,
                )
            )
    head = ("Quantity", "Mean", "Standard deviation", "Range", "Unit")
    return Table(f"Repeatability over {columns['run'].size} sweeps", head, tuple(rows))
