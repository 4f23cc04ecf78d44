"""Analysis of a sweep: table by position, force constant along the stroke, linear region, problems."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime

import numpy as np
from pydantic import ValidationError

from tissueid.calibration.file import CalibratedQuantity, Calibration, column, quantity, stored_messages, utc_date
from tissueid.calibration.flux import MIN_SPACING_M, FluxFit, SplineBasis, fit_flux
from tissueid.calibration.force_constant import (
    ELECTRICAL_STD,
    Agreement,
    BalanceFit,
    ForceConstant,
    LinearRegion,
    combine_profiles,
    compare,
    fit_balance,
    linear_region,
)
from tissueid.calibration.plans import Spring
from tissueid.calibration.spring_points import SpringPoint, SweepTest, identify_point
from tissueid.calibration.status import IMPLAUSIBLE, first_implausible, stored_text
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.messages import Quantity as ShownQuantity
from tissueid.plan_options import validation_reason
from tissueid.records import Estimate
from tissueid.version import SOFTWARE

MIN_POSITIONS = 5
"""Minimum number of positions of a sweep."""
MIN_WIDTH_M = 0.010
"""Minimum width of a linear region that is usable for tests on tissue, m."""
SPRING_LOSS_N_S_PER_M = 0.1
"""Possible damping of a steel spring, N s/m, which cannot be separated from that of the bearing."""
_MIN_SPACING_M = 5e-4
"""Minimum distance of two positions, m; closer tests are repeats at one position."""
_NAMES = {"model": marked("model"), "serial_number": marked("serial number")}
_POSITIVE = (
    "coil_resistance_ohm",
    "coil_inductance_h",
    "force_constant_n_per_a",
    "moving_mass_kg",
    "bearing_damping_n_s_per_m",
    "stroke_m",
)
"""Device properties with which the sweep is compared; all must be positive."""


@dataclass(frozen=True)
class SpringMass(Spring):
    """Mass of the calibration spring, a third of which moves with the coil."""

    mass_kg: float = 0.018
    mass_std_kg: float = 0.003

    @property
    def moving_kg(self) -> Estimate:
        """Part of the spring mass in the moving mass, kg."""
        return Estimate(self.mass_kg / 3.0, self.mass_std_kg / 3.0)


@dataclass(frozen=True, eq=False)
class SweepResult:
    """Result of a sweep.

    ``points`` are in the order of their positions. ``moving_mass_kg`` excludes the moving part of the spring.
    ``repeats`` has the result of each repeat alone, if sufficient for an analysis.
    """

    device: DeviceDescription
    spring: SpringMass
    points: tuple[SpringPoint, ...]
    flux: FluxFit
    balance: BalanceFit
    force_constant: ForceConstant
    region: LinearRegion
    agreement: Agreement
    moving_mass_kg: Estimate
    bearing_damping_n_s_per_m: Estimate
    problems: tuple[str, ...]
    remarks: tuple[str, ...]
    repeats: tuple[SweepResult, ...] = field(default=())

    @property
    def passed(self) -> bool:
        """Whether the sweep may be used."""
        return not self.problems

    @property
    def runs(self) -> tuple[int, ...]:
        """Numbers of the repeats, counted from 1."""
        return tuple(sorted({1 + point.sweep for point in self.points}))

    @property
    def positions_m(self) -> list[float]:
        """Measured positions, m."""
        return [point.position_m for point in self.points]


def analyse_sweep(
    tests: Sequence[SweepTest],
    device: DeviceDescription,
    spring: SpringMass | None = None,
    *,
    electrical_std: float = ELECTRICAL_STD,
    remarks: Sequence[str] = (),
) -> SweepResult:
    """Analyse the tests of a sweep and its repeats.

    Args:
        tests: at all positions, of all repeats.
        device: device of the sweep.
        spring: calibration spring; that of the device by default.
        electrical_std: relative standard deviation of the ratio of voltage and position scales.
        remarks: on the measurement, such as skipped positions. Repeats that are insufficient for an analysis of their
            own are added.

    Raises:
        UnusableInputError: too few positions, or not over the middle half of the stroke; different sample rates; an
            implausible device property; or tests that do not determine the coil.
    """
    _check(device)
    if len(rates := sorted({test.sample_rate_hz for test in tests})) > 1:
        raise UnusableInputError(
            "sweep.rates",
            "the tests were recorded at different sample rates, {lowest:g} to {highest:g} Hz: a sweep needs one rate",
            lowest=rates[0],
            highest=rates[-1],
        )
    try:
        return _analysed(tests, device, spring, electrical_std, remarks)
    except np.linalg.LinAlgError as error:
        raise UnusableInputError(
            "sweep.undetermined",
            "the tests do not determine the coil: check that the spring moves freely, and repeat the sweep",
        ) from error


def _analysed(
    tests: Sequence[SweepTest],
    device: DeviceDescription,
    spring: SpringMass | None,
    electrical_std: float,
    remarks: Sequence[str],
) -> SweepResult:
    spring = spring or SpringMass(device.calibration_spring_n_per_m, device.calibration_relative_uncertainty)
    tests = sorted(tests, key=lambda test: test.mean_position_m)
    places = _places(tests)
    if len(places) < MIN_POSITIONS:
        raise UnusableInputError(
            "sweep.too_few",
            "a sweep needs at least {least} positions, but {count} could be measured: read the notes on the "
            "others, "
            "and repeat the sweep",
            least=MIN_POSITIONS,
            count=len(places),
        )
    spacing = max(MIN_SPACING_M, float(np.median(np.diff(places))))
    basis = SplineBasis.covering([test.position for test in tests], spacing)
    flux = fit_flux(tests, basis)
    balance = fit_balance(tests, flux, spring.stiffness_n_per_m)
    points = tuple(
        identify_point(test, current, device) for test, current in zip(tests, flux.mean_currents, strict=True)
    )
    profile = combine_profiles(flux, balance, electrical_std, spring.relative_std)
    region = linear_region(profile, points, device.stroke_m)
    agreement = compare(flux, balance, points, device, electrical_std, spring.relative_std)
    # The balance assumes the exact spring stiffness; the combined force constant rescales mass and damping.
    within = np.linspace(region.min_m.value, region.max_m.value, 101)
    share = float(np.mean(profile.at(within)) / np.mean(basis.values(within) @ balance.coefficients))
    scale_std = (region.plateau_n_per_a.std or 0.0) / abs(region.plateau_n_per_a.value)
    mass = _with_relative_std(balance.mass_kg, share, scale_std)
    damping = _with_relative_std(balance.damping_n_s_per_m, share, scale_std)
    own = spring.moving_kg
    result = SweepResult(
        device=device,
        spring=spring,
        points=points,
        flux=flux,
        balance=balance,
        force_constant=profile,
        region=region,
        agreement=agreement,
        moving_mass_kg=Estimate(mass.value - own.value, float(np.hypot(mass.std or 0.0, own.std or 0.0))),
        bearing_damping_n_s_per_m=replace(damping, std=float(np.hypot(damping.std or 0.0, SPRING_LOSS_N_S_PER_M))),
        problems=(),
        remarks=tuple(remarks),
    )
    repeats, weak = _repeats(tests, device, spring, electrical_std)
    return replace(result, problems=_problems(result), repeats=repeats, remarks=(*remarks, *weak))


def _check(device: DeviceDescription) -> None:
    """Raise for a device whose sweep could not be analysed or stored.

    Raises:
        UnusableInputError: names the invalid property.
    """
    for name in ("model", "serial_number"):
        text = getattr(device, name)
        if not (0 < len(text) <= 200 and text.isprintable()):
            raise UnusableInputError(
                "sweep.device_name",
                "the {name} of the instrument is '{text}': it must be a line of 1 to 200 characters",
                name=_NAMES[name],
                text=text[:40],
            )
    for what in (device, _nominal(device)):
        for name in _POSITIVE:
            value = getattr(what, name)
            if not (np.isfinite(value) and value > 0.0):
                raise UnusableInputError(
                    "sweep.device_figure",
                    "by the description of the instrument its {name} is {value:g}, which is impossible",
                    name=name,
                    value=value,
                )


def _nominal(device: DeviceDescription) -> DeviceDescription:
    """Return the device with its nominal instead of calibrated values."""

    def nominal(name: str) -> float:
        value = device.calibration.get(f"nominal_{name}", getattr(device, name))
        return float(value) if isinstance(value, float | int) else float("nan")

    return replace(
        device,
        coil_resistance_ohm=nominal("coil_resistance_ohm"),
        coil_inductance_h=nominal("coil_inductance_h"),
        force_constant_n_per_a=nominal("force_constant_n_per_a"),
        moving_mass_kg=nominal("moving_mass_kg"),
        bearing_damping_n_s_per_m=nominal("bearing_damping_n_s_per_m"),
    )


def _repeats(
    tests: Sequence[SweepTest], device: DeviceDescription, spring: SpringMass, electrical_std: float
) -> tuple[tuple[SweepResult, ...], tuple[str, ...]]:
    """Return the result of each repeat alone, and remarks on insufficient repeats."""
    results, weak = [], []
    runs = sorted({test.sweep for test in tests})
    for run in runs if len(runs) > 1 else ():
        try:
            own = [test for test in tests if test.sweep == run]
            results.append(analyse_sweep(own, device, spring, electrical_std=electrical_std))
        except UnusableInputError as error:
            weak.append(
                Message(
                    "sweep.weak_run",
                    "repeat {run} is insufficient for an analysis of its own and only counts together with the others: "
                    "{reason}",
                    run=run + 1,
                    reason=error.message,
                )
            )
    return tuple(results), tuple(weak)


def quantities_of(result: SweepResult) -> dict[str, CalibratedQuantity]:
    """Return the quantities of a sweep as stored in its calibration."""
    region, agreement = result.region, result.agreement
    resistances = np.array([estimate.value for estimate in result.flux.resistance_ohm])
    quantities = {
        "force_constant_n_per_a": quantity(region.plateau_n_per_a, "N/A"),
        "linear_region_min_m": quantity(region.min_m, "m"),
        "linear_region_max_m": quantity(region.max_m, "m"),
        "moving_mass_kg": quantity(result.moving_mass_kg, "kg"),
        "bearing_damping_n_s_per_m": quantity(result.bearing_damping_n_s_per_m, "N s/m"),
        "coil_inductance_h": quantity(result.flux.inductance_h, "H"),
        "resistance_in_the_sweep_ohm": quantity(float(resistances.mean()), "ohm", float(resistances.std())),
        "spring_over_flux": quantity(agreement.ratio, ""),
        "least_vaf_percent": quantity(min(point.vaf_percent for point in result.points), "%"),
        "noise_current_a": quantity(result.flux.noise_a, "A"),
    }
    if agreement.stage is not None:
        quantities["position_over_stage"] = quantity(agreement.stage, "")
    return quantities


def _places(tests: Sequence[SweepTest]) -> list[float]:
    """Return the mean positions of tests in rising order, m; repeats at one position count once."""
    places: list[float] = []
    for test in tests:
        if not places or test.mean_position_m - places[-1] > _MIN_SPACING_M:
            places.append(test.mean_position_m)
    return places


def _with_relative_std(estimate: Estimate, share: float, relative_std: float) -> Estimate:
    value = share * estimate.value
    return Estimate(value, float(np.hypot(share * (estimate.std or 0.0), relative_std * value)))


def _problems(result: SweepResult) -> tuple[str, ...]:
    """Return the reasons for rejecting the sweep."""
    problems: list[str] = []
    nominal = _nominal(result.device).force_constant_n_per_a
    plateau = result.region.plateau_n_per_a.value
    if abs(plateau / nominal - 1.0) > IMPLAUSIBLE:
        problems.append(
            Message(
                "sweep.force_constant",
                "the force constant is {value:.2f} N/A but should be near {nominal:.2f} N/A: check the stiffness of "
                "the "
                "spring and the scales of the channels",
                value=plateau,
                nominal=nominal,
            )
        )
    if result.region.width_m < MIN_WIDTH_M:
        problems.append(
            Message(
                "sweep.narrow",
                "the linear region is only {width} wide; at least {least} are needed",
                width=ShownQuantity(1e3 * result.region.width_m, "mm", 1),
                least=ShownQuantity(1e3 * MIN_WIDTH_M, "mm"),
            )
        )
    share = result.agreement.resistance.value
    if abs(share - 1.0) > IMPLAUSIBLE:
        expected = result.device.coil_resistance_ohm
        problems.append(
            Message(
                "sweep.resistance",
                "the resistance is {value:.1f} Ω but should be near {nominal:.1f} Ω: check the coil and the scales of "
                "current and voltage",
                value=share * expected,
                nominal=expected,
            )
        )
    stage = result.agreement.stage
    if stage is not None and abs(stage.value - 1.0) > IMPLAUSIBLE:
        problems.append(
            Message(
                "sweep.stage",
                "the position changes by {reading:.2f} mm per millimetre of stage travel: check the directions and "
                "scales "
                "of stage and sensor",
                reading=stage.value,
            )
        )
    if result.agreement.cause is not None:
        problems.append(result.agreement.message)
    others = {
        name: calibrated for name, calibrated in quantities_of(result).items() if name != "force_constant_n_per_a"
    }
    if strange := first_implausible(_quantities_only(result.device, others), _nominal(result.device)):
        problems.append(
            Message(
                "sweep.implausible",
                "{reason}: check the spring, its mass and the description of the instrument",
                reason=strange,
            )
        )
    return tuple(problems)


def _quantities_only(device: DeviceDescription, quantities: dict[str, CalibratedQuantity]) -> Calibration:
    """Return a calibration with quantities only, for the plausibility check."""
    return Calibration(
        kind="sweep",
        model=device.model,
        serial_number=device.serial_number,
        date=utc_date(),
        software="",
        verdict="passed",
        quantities=quantities,
    )


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
    notes = (*(() if result.agreement.cause else (result.agreement.message,)), *result.remarks)[:50]
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
        fitted: list[Estimate] = [getattr(point, name) for point in points]
        return {
            f"{stem}_{unit}": column([estimate.value for estimate in fitted]),
            f"{stem}_std_{unit}": column([estimate.std or 0.0 for estimate in fitted]),
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
            "resistance_ohm": column([estimate.value for estimate in result.flux.resistance_ohm]),
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
