"""Calibration file of a sweep."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime

import numpy as np
from pydantic import ValidationError

from tissueid.calibration.file import Calibration, stored_messages, utc_date
from tissueid.calibration.findings import column
from tissueid.calibration.force_constant_profile import ForceConstant
from tissueid.calibration.labels import stored_text
from tissueid.calibration.sweep_analysis import SweepResult, quantities_of
from tissueid.errors import UnusableInputError
from tissueid.option_errors import validation_reason
from tissueid.records import Estimate
from tissueid.version import SOFTWARE

GRID_M = 0.5e-3
"""Spacing of the force constant in the file, m: linear interpolation is accurate to 0.1 %."""


def as_calibration(
    result: SweepResult,
    *,
    conditions: Mapping[str, float | str] | None = None,
    valid_days: int = 90,
    now: datetime | None = None,
) -> Calibration:
    """Return the calibration of a sweep.

    Args:
        result: of the analysis.
        conditions: further conditions of the measurement, by name.
        valid_days: validity, days.
        now: date of the calibration.

    Raises:
        UnusableInputError: a field, such as a condition, does not fit into a calibration file; names it.
    """
    device = result.device
    notes = (*(() if result.agreement.cause else (result.agreement.words,)), *result.remarks)[:50]
    made = {
        "spring_stiffness_n_per_m": result.spring.stiffness_n_per_m,
        "spring_relative_uncertainty": result.spring.relative_std,
        "spring_mass_kg": result.spring.mass_kg,
        "believed_force_constant_n_per_a": device.force_constant_n_per_a,
        "positions": float(len(result.points)),
        "repeats": float(len(result.runs)),
        **(conditions or {}),
        **{f"note_{number}": stored_text(note) for number, note in enumerate(notes, start=1)},
    }
    try:
        return Calibration(
            kind="sweep",
            model=device.model,
            serial_number=device.serial_number,
            firmware_version=device.firmware_version,
            date=utc_date(now or datetime.now(UTC)),
            valid_days=valid_days,
            software=SOFTWARE,
            conditions=made,
            verdict="passed" if result.passed else "failed",
            problems=tuple(map(stored_text, result.problems)),
            quantities=quantities_of(result),
            tables=_tables(result),
            messages=stored_messages((*result.problems, *notes)),
        )
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(str(part) for part in first["loc"][:2])
        raise UnusableInputError(
            "sweep.not_stored",
            "the sweep cannot be stored: field '{field}': {reason}",
            field=where[:80],
            reason=validation_reason(error),
        ) from error


def _tables(result: SweepResult) -> dict[str, dict[str, tuple[float, ...]]]:
    points = result.points
    places = np.array(result.positions_m)
    low, high = float(places.min()), float(places.max())
    grid = np.linspace(low, high, 1 + int(np.ceil((high - low) / GRID_M)))
    by_spring = ForceConstant(result.balance.basis, result.balance.coefficients, result.balance.covariance)
    by_flux = ForceConstant(result.flux.basis, result.flux.coefficients, result.flux.covariance)
    believed = result.device.force_constant_n_per_a * result.spring.stiffness_n_per_m
    by_point = [believed / point.stiffness_n_per_m.value for point in points]
    point_std = [
        value * (point.stiffness_n_per_m.std or 0.0) / point.stiffness_n_per_m.value
        for value, point in zip(by_point, points, strict=True)
    ]

    def estimates(name: str, stem: str, unit: str) -> dict[str, tuple[float, ...]]:
        found: list[Estimate] = [getattr(point, name) for point in points]
        return {
            f"{stem}_{unit}": column([one.value for one in found]),
            f"{stem}_std_{unit}": column([one.std or 0.0 for one in found]),
        }

    tables = {
        "force_constant": {
            "position_m": column(grid),
            "value_n_per_a": column(result.force_constant.at(grid)),
            "std_n_per_a": column(result.force_constant.std_at(grid)),
            "by_spring_n_per_a": column(by_spring.at(grid)),
            "by_spring_std_n_per_a": column(by_spring.std_at(grid)),
            "by_flux_n_per_a": column(by_flux.at(grid)),
            "by_flux_std_n_per_a": column(by_flux.std_at(grid)),
        },
        "sweep": {
            "position_m": column(places),
            "sweep": column([point.sweep for point in points]),
            "swing_m": column([point.swing_m for point in points]),
            "vaf_percent": column([point.vaf_percent for point in points]),
            "vaf_parametric_percent": column([point.vaf_parametric_percent for point in points]),
            **estimates("mass_kg", "mass", "kg"),
            **estimates("damping_n_s_per_m", "damping", "n_s_per_m"),
            **estimates("stiffness_n_per_m", "stiffness", "n_per_m"),
            "resistance_ohm": column([found.value for found in result.flux.resistance_ohm]),
            "force_constant_n_per_a": column(by_point),
            "force_constant_std_n_per_a": column(point_std),
        },
        "response": _responses(result),
    }
    if result.repeats:
        runs = result.repeats
        tables["repeats"] = {
            "run": column([run.runs[0] for run in runs]),
            "force_constant_n_per_a": column([run.region.plateau_n_per_a.value for run in runs]),
            "linear_region_min_m": column([run.region.min_m.value for run in runs]),
            "linear_region_max_m": column([run.region.max_m.value for run in runs]),
            "moving_mass_kg": column([run.moving_mass_kg.value for run in runs]),
            "bearing_damping_n_s_per_m": column([run.bearing_damping_n_s_per_m.value for run in runs]),
            "coil_inductance_h": column([run.flux.inductance_h.value for run in runs]),
        }
    return tables


def _responses(result: SweepResult) -> dict[str, tuple[float, ...]]:
    """Return the measured compliances of the first sweep as one table."""
    first = min(point.sweep for point in result.points)
    points = [point for point in result.points if point.sweep == first]
    return {
        "position_m": column(np.repeat([p.position_m for p in points], [p.frequency_hz.size for p in points])),
        "frequency_hz": column(np.concatenate([p.frequency_hz for p in points])),
        "compliance_m_per_n": column(np.concatenate([np.abs(p.response_m_per_n) for p in points])),
        "phase_rad": column(np.concatenate([np.unwrap(np.angle(p.response_m_per_n)) for p in points])),
    }
