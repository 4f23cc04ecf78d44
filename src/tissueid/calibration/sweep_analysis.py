"""From the tests of a sweep to what is kept of it: the table by position, the force constant, the linear region."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tissueid.calibration.coil import Spring
from tissueid.calibration.file import Calibration, Quantity, utc_date
from tissueid.calibration.findings import quantity
from tissueid.calibration.flux import FluxFit, fit_flux
from tissueid.calibration.force_balance import BalanceFit, fit_balance
from tissueid.calibration.force_profile import ForceConstant, LinearRegion, combined, linear_region
from tissueid.calibration.plausible import IMPLAUSIBLE, implausible
from tissueid.calibration.scales import ELECTRICAL_STD, Agreement, compare
from tissueid.calibration.spline_basis import LEAST_SPACING_M, SplineBasis
from tissueid.calibration.spring_points import SpringPoint, identify_point
from tissueid.calibration.sweep_test import SweepTest
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.records import Estimate

LEAST_POSITIONS = 5
LEAST_WIDTH_M = 0.010
"""A linear region that is narrower than this is not one to test tissue in."""
SPRING_LOSS_N_S_PER_M = 0.1
"""Damping that a steel spring may have of its own; it cannot be told from the bearing's."""
_APART_M = 5e-4
_POSITIVE = (
    "coil_resistance_ohm",
    "coil_inductance_h",
    "force_constant_n_per_a",
    "moving_mass_kg",
    "bearing_damping_n_s_per_m",
    "stroke_m",
)
"""Figures of a device that the sweep's own are held against."""


@dataclass(frozen=True)
class SweptSpring(Spring):
    """The calibration spring with its mass, of which a third moves with the coil."""

    mass_kg: float = 0.018
    mass_std_kg: float = 0.003

    @property
    def moving_kg(self) -> Estimate:
        """What it adds to the moving mass."""
        return Estimate(self.mass_kg / 3.0, self.mass_std_kg / 3.0)


@dataclass(frozen=True, eq=False)
class SweepResult:
    """All that a sweep says.

    ``points`` are in the order of their positions. ``moving_mass_kg`` is without the spring's share; ``repeats`` has,
    where the sweep was repeated, what each run by itself gives, of those that are enough by themselves.
    """

    device: DeviceDescription
    spring: SweptSpring
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
        """Whether it may be put in force."""
        return not self.problems

    @property
    def runs(self) -> tuple[int, ...]:
        """Which repeats it is made of, counted from 1."""
        return tuple(sorted({1 + point.sweep for point in self.points}))

    @property
    def positions_m(self) -> list[float]:
        """Where it was measured."""
        return [point.position_m for point in self.points]


def analyse_sweep(
    tests: Sequence[SweepTest],
    device: DeviceDescription,
    spring: SweptSpring | None = None,
    *,
    electrical_std: float = ELECTRICAL_STD,
    remarks: Sequence[str] = (),
) -> SweepResult:
    """Analyse the tests of a sweep, or of several of the same.

    ``electrical_std`` is the relative deviation of the scale of voltage over position; ``remarks`` are what happened
    on the way, such as a position that was left out.

    A repeat that is too little by itself counts with the others, and is said among the remarks.

    Raises:
        UnusableInputError: too few positions, or they do not reach over the middle half of the stroke; tests at
            different rates; a device that says what cannot be; or tests that do not tell what the coil is.
    """
    _check(device)
    if len(rates := sorted({test.sample_rate_hz for test in tests})) > 1:
        raise UnusableInputError(
            f"the tests were recorded at {rates[0]:g} to {rates[-1]:g} samples a second: a sweep has one rate"
        )
    try:
        return _analysed(tests, device, spring, electrical_std, remarks)
    except np.linalg.LinAlgError as error:
        raise UnusableInputError(
            "the tests do not tell what the coil is: see that the spring runs free, and repeat the sweep"
        ) from error


def _analysed(
    tests: Sequence[SweepTest],
    device: DeviceDescription,
    spring: SweptSpring | None,
    electrical_std: float,
    remarks: Sequence[str],
) -> SweepResult:
    spring = spring or SweptSpring(device.calibration_spring_n_per_m, device.calibration_relative_uncertainty)
    tests = sorted(tests, key=lambda test: test.mean_position_m)
    places = _places(tests)
    if len(places) < LEAST_POSITIONS:
        raise UnusableInputError(
            f"a sweep needs {LEAST_POSITIONS} positions or more, and {len(places)} could be measured: see what kept "
            "the others from it, and repeat the sweep"
        )
    spacing = max(LEAST_SPACING_M, float(np.median(np.diff(places))))
    basis = SplineBasis.covering([test.position for test in tests], spacing)
    flux = fit_flux(tests, basis)
    balance = fit_balance(tests, flux, spring.stiffness_n_per_m)
    points = tuple(
        identify_point(test, current, device) for test, current in zip(tests, flux.mean_currents, strict=True)
    )
    profile = combined(flux, balance, electrical_std, spring.relative_std)
    region = linear_region(profile, points, device.stroke_m)
    agreement = compare(flux, balance, points, device, electrical_std, spring.relative_std)
    # The balance holds for a spring of exactly that stiffness; what is known better moves mass and damping alike.
    within = np.linspace(region.min_m.value, region.max_m.value, 101)
    share = float(np.mean(profile.at(within)) / np.mean(basis.values(within) @ balance.coefficients))
    scale_std = (region.plateau_n_per_a.std or 0.0) / abs(region.plateau_n_per_a.value)
    mass = _scaled(balance.mass_kg, share, scale_std)
    damping = _scaled(balance.damping_n_s_per_m, share, scale_std)
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
    """Refuse a device that a sweep cannot be held against, or whose calibration could not be kept.

    Raises:
        UnusableInputError: says what is wrong with it.
    """
    for name in ("model", "serial_number"):
        text = getattr(device, name)
        if not (0 < len(text) <= 200 and text.isprintable()):
            raise UnusableInputError(
                f"the instrument's {name.replace('_', ' ')} is {text[:40]!r}: it must be a line of 1 to 200 characters"
            )
    for what in (device, _nominal(device)):
        for name in _POSITIVE:
            value = getattr(what, name)
            if not (np.isfinite(value) and value > 0.0):
                raise UnusableInputError(f"the instrument says that its {name} is {value:g}: that cannot be")


def _nominal(device: DeviceDescription) -> DeviceDescription:
    """What the device says of itself, where calibrated figures were laid over it."""

    def told(name: str) -> float:
        value = device.calibration.get(f"nominal_{name}", getattr(device, name))
        return float(value) if isinstance(value, float | int) else float("nan")

    return replace(
        device,
        coil_resistance_ohm=told("coil_resistance_ohm"),
        coil_inductance_h=told("coil_inductance_h"),
        force_constant_n_per_a=told("force_constant_n_per_a"),
        moving_mass_kg=told("moving_mass_kg"),
        bearing_damping_n_s_per_m=told("bearing_damping_n_s_per_m"),
    )


def _repeats(
    tests: Sequence[SweepTest], device: DeviceDescription, spring: SweptSpring, electrical_std: float
) -> tuple[tuple[SweepResult, ...], tuple[str, ...]]:
    """What each of several runs gives by itself, and why others give nothing."""
    results, weak = [], []
    runs = sorted({test.sweep for test in tests})
    for run in runs if len(runs) > 1 else ():
        try:
            own = [test for test in tests if test.sweep == run]
            results.append(analyse_sweep(own, device, spring, electrical_std=electrical_std))
        except UnusableInputError as error:
            weak.append(f"run {run + 1} is too little by itself, and counts with the others only: {error}")
    return tuple(results), tuple(weak)


def quantities_of(result: SweepResult) -> dict[str, Quantity]:
    """The single figures of a sweep, as its calibration keeps them."""
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
    """Mean positions, rising, those of repeats once."""
    places: list[float] = []
    for test in tests:
        if not places or test.mean_position_m - places[-1] > _APART_M:
            places.append(test.mean_position_m)
    return places


def _scaled(found: Estimate, share: float, relative_std: float) -> Estimate:
    value = share * found.value
    return Estimate(value, float(np.hypot(share * (found.std or 0.0), relative_std * value)))


def _problems(result: SweepResult) -> tuple[str, ...]:
    """Why it must not be put in force, in words."""
    problems = []
    nominal = _nominal(result.device).force_constant_n_per_a
    plateau = result.region.plateau_n_per_a.value
    if abs(plateau / nominal - 1.0) > IMPLAUSIBLE:
        problems.append(
            f"the force constant is {plateau:.2f} N/A and should be near {nominal:.2f} N/A: check the spring's "
            "stiffness and the channels' scales"
        )
    if result.region.width_m < LEAST_WIDTH_M:
        problems.append(
            f"the force constant keeps to its plateau over {1e3 * result.region.width_m:.1f} mm only; "
            f"{1e3 * LEAST_WIDTH_M:.0f} mm are needed"
        )
    share = result.agreement.resistance.value
    if abs(share - 1.0) > IMPLAUSIBLE:
        expected = result.device.coil_resistance_ohm
        problems.append(
            f"the resistance is {share * expected:.1f} ohm and should be near {expected:.1f} ohm: check the coil and "
            "the scales of current and voltage"
        )
    stage = result.agreement.stage
    if stage is not None and abs(stage.value - 1.0) > IMPLAUSIBLE:
        problems.append(
            f"for each millimetre that the stage moves, the position reads {stage.value:.2f} mm: see that stage and "
            "sensor go the same way round, and check their scales"
        )
    if result.agreement.cause is not None:
        problems.append(result.agreement.words)
    others = {name: found for name, found in quantities_of(result).items() if name != "force_constant_n_per_a"}
    if strange := implausible(_draft(result.device, others), _nominal(result.device)):
        problems.append(f"{strange}: check the spring, its mass and what the instrument says of itself")
    return tuple(problems)


def _draft(device: DeviceDescription, quantities: dict[str, Quantity]) -> Calibration:
    """A calibration of nothing but figures, to be asked for their plausibility."""
    return Calibration(
        kind="sweep",
        model=device.model,
        serial_number=device.serial_number,
        date=utc_date(),
        software="",
        verdict="passed",
        quantities=quantities,
    )
