"""Report of a dynamic sweep: the coil by position, its force constant by each method, the linear region."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from tissueid.analysis.curves.calibration_plots import Columns, Region
from tissueid.calibration.file import Calibration
from tissueid.calibration.labels import label_of, notes_of, problems_of, verdict_of
from tissueid.errors import UnusableInputError
from tissueid.formatting import fixed, number
from tissueid.language import _, marked
from tissueid.messages import Message, translated
from tissueid.reports.calibration_panels import sweep_panels
from tissueid.reports.calibration_static import calibration_facts, condition_rows, quantity_row
from tissueid.reports.stimulus_report import StimulusReport
from tissueid.reports.tables import Table

_NEEDED = {
    "sweep": ("position_m", "vaf_percent", "mass_kg", "damping_n_s_per_m", "stiffness_n_per_m"),
    "force_constant": ("position_m", "value_n_per_a", "std_n_per_a"),
}
_THESIS = (
    (marked("VAF (%)"), "vaf_percent", 1.0, 1, (95.0, 98.0), (70.0, 95.0)),
    ("M (g)", "mass_kg", 1e3, 0, (60.0, 80.0), (60.0, 100.0)),
    ("B (N·s/m)", "damping_n_s_per_m", 1.0, 2, (3.0, 4.0), (5.0, 50.0)),
    ("K (N/m)", "stiffness_n_per_m", 1.0, 0, (1000.0, 1200.0), (100.0, 7000.0)),
)
"""Label, column, scale and decimals of a parameter; its range for instrument and skin (Chen 2010, Table 2.1)."""
_REPEATED = (
    ("force_constant_n_per_a", 1.0, "N per A", 4),
    ("linear_region_min_m", 1e3, "mm", 3),
    ("linear_region_max_m", 1e3, "mm", 3),
    ("moving_mass_kg", 1e3, "g", 3),
    ("bearing_damping_n_s_per_m", 1.0, "N·s/m", 4),
    ("coil_inductance_h", 1e3, "mH", 4),
)


def sweep_report(calibration: Calibration) -> StimulusReport:
    """Return the report of a dynamic sweep.

    Raises:
        UnusableInputError: the calibration is of another kind, or lacks the tables of a sweep.
    """
    if calibration.kind != "sweep":
        raise UnusableInputError(
            "report.not_a_sweep", "this is not a dynamic sweep but a calibration of kind {kind}", kind=calibration.kind
        )
    for name, columns in _NEEDED.items():
        missing = [column for column in columns if not calibration.tables.get(name, {}).get(column)]
        if missing:
            raise _incomplete(f"{name}: {missing[0]}")
    region = _region(calibration)
    tables = {
        name: {key: np.abs(values) if "_std_" in key else np.array(values) for key, values in columns.items()}
        for name, columns in calibration.tables.items()
    }
    return StimulusReport(
        title=_("Dynamic sweep of {model}, {serial}").format(model=calibration.model, serial=calibration.serial_number),
        facts=(
            *calibration_facts(calibration),
            (_("Positions"), number(float(len(tables["sweep"]["position_m"])))),
        ),
        headline=translated(
            Message(
                "calibration.sweep.headline",
                "Linear from {low:.1f} to {high:.1f} mm. Calibration {verdict}",
                low=1e3 * region.min_m,
                high=1e3 * region.max_m,
                verdict=verdict_of(calibration),
            )
        ),
        level="good" if calibration.verdict == "passed" else "poor",
        concerns=tuple(translated(line) for line in problems_of(calibration) + notes_of(calibration)),
        summary=(
            _(
                "M, B and K of coil and calibration spring are computed with the same force constant at every "
                "position: where the coil leaves its magnetic field, all three rise together. Tests that leave the "
                "linear region are flagged."
            ),
        ),
        tables=tuple(_tables(calibration, tables, region)),
        panels=tuple(sweep_panels(tables, region)),
    )


def _incomplete(what: str) -> UnusableInputError:
    return UnusableInputError("report.sweep_incomplete", "the calibration lacks {what}: repeat the sweep", what=what)


def _region(calibration: Calibration) -> Region:
    """Return the linear region and its force constant.

    Raises:
        UnusableInputError: the calibration does not have them.
    """
    names = ("linear_region_min_m", "linear_region_max_m", "force_constant_n_per_a")
    for name in names:
        if name not in calibration.quantities:
            raise _incomplete(name)
    believed = calibration.conditions.get("believed_force_constant_n_per_a")
    low, high, plateau = (calibration.quantities[name].value for name in names)
    return Region(low, high, plateau, believed if isinstance(believed, float) else None)


def _tables(calibration: Calibration, tables: Mapping[str, Columns], region: Region) -> Iterator[Table]:
    sweep = tables["sweep"]
    inside = (sweep["position_m"] >= region.min_m) & (sweep["position_m"] <= region.max_m)
    yield Table(
        _("Comparison with the thesis"),
        ("", _("This instrument"), _("Thesis, instrument"), _("Thesis, skin")),
        tuple(
            (_(label), _span(scale * sweep[name][inside], digits), _range(instrument), _range(skin))
            for label, name, scale, digits, instrument, skin in _THESIS
        ),
        _(
            "This instrument: within the linear region; mass and damping are those of coil and spring together. "
            "Thesis: Chen 2010, Table 2.1."
        ),
    )
    rows = tuple(quantity_row(name, found) for name, found in calibration.quantities.items())
    yield Table(_("Results"), (_("Quantity"), _("Value"), _("Unit")), rows)
    yield _by_position(tables)
    if "repeats" in tables:
        yield _repeatability(tables["repeats"])
    yield Table(_("Conditions"), (), condition_rows(calibration))


def _range(ends: tuple[float, float]) -> str:
    return _("{low} to {high}").format(low=number(ends[0]), high=number(ends[1]))


def _span(values: NDArray[np.float64], digits: int) -> str:
    if not values.size:
        return _("none")
    low, high = fixed(float(values.min()), digits), fixed(float(values.max()), digits)
    return low if low == high else _("{low} to {high}").format(low=low, high=high)


def _by_position(tables: Mapping[str, Columns]) -> Table:
    sweep, profile = tables["sweep"], tables["force_constant"]
    here = np.interp(sweep["position_m"], profile["position_m"], profile["value_n_per_a"])
    rows = []
    for row, position in enumerate(sweep["position_m"]):
        rows.append(
            (
                fixed(1e3 * position, 1),
                *(fixed(scale * sweep[name][row], max(1, digits)) for _label, name, scale, digits, *_rest in _THESIS),
                fixed(here[row], 3),
            )
        )
    head = (_("Position (mm)"), *(_(label) for label, *_rest in _THESIS), f"k ({_('N per A')})")
    return Table(_("By position"), head, tuple(rows), _("k is the combined estimate of the force constant."))


def _repeatability(columns: Columns) -> Table:
    rows = []
    for name, scale, unit, digits in _REPEATED:
        if name in columns and columns[name].size > 1:
            values = scale * columns[name]
            rows.append(
                (
                    translated(label_of(name)),
                    fixed(float(values.mean()), digits),
                    fixed(float(np.std(values, ddof=1)), digits),
                    fixed(float(np.ptp(values)), digits),
                    _(unit),
                )
            )
    head = (_("Quantity"), _("Mean"), _("Standard deviation"), _("Peak to peak"), _("Unit"))
    return Table(_("Repeatability over {count} sweeps").format(count=columns["run"].size), head, tuple(rows))
