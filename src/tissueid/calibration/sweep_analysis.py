"""Analysis of a sweep: table by position, force constant along the stroke, linear region, problems."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tissueid.calibration.file import CalibratedQuantity, Calibration, utc_date
from tissueid.calibration.findings import quantity
from tissueid.calibration.flux import FluxFit, fit_flux
from tissueid.calibration.force_balance import BalanceFit, fit_balance
from tissueid.calibration.force_constant_profile import ForceConstant, LinearRegion, combine_profiles, linear_region
from tissueid.calibration.plans import Spring
from tissueid.calibration.scale_agreement import ELECTRICAL_STD, Agreement, compare
from tissueid.calibration.spline_basis import MIN_SPACING_M, SplineBasis
from tissueid.calibration.spring_points import SpringPoint, identify_point
from tissueid.calibration.status import IMPLAUSIBLE, first_implausible
from tissueid.calibration.sweep_test import SweepTest
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.messages import Quantity as ShownQuantity
from tissueid.records import Estimate

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
    resistances = np.array([found.value for found in result.flux.resistance_ohm])
    found = {
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
        found["position_over_stage"] = quantity(agreement.stage, "")
    return found


def _places(tests: Sequence[SweepTest]) -> list[float]:
    """Return the mean positions of tests in rising order, m; repeats at one position count once."""
    places: list[float] = []
    for test in tests:
        if not places or test.mean_position_m - places[-1] > _MIN_SPACING_M:
            places.append(test.mean_position_m)
    return places


def _with_relative_std(found: Estimate, share: float, relative_std: float) -> Estimate:
    value = share * found.value
    return Estimate(value, float(np.hypot(share * (found.std or 0.0), relative_std * value)))


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
        problems.append(result.agreement.words)
    others = {name: found for name, found in quantities_of(result).items() if name != "force_constant_n_per_a"}
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
