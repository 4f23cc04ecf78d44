"""From the tests of a sweep to what is kept of it: the table by position, the force constant, the linear region."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tissueid.calibration.coil import Spring
from tissueid.calibration.flux import FluxFit, fit_flux
from tissueid.calibration.force_balance import BalanceFit, fit_balance
from tissueid.calibration.force_profile import ForceConstant, LinearRegion, combined, linear_region
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
FARTHEST_FROM_NOMINAL = 0.20
SPRING_LOSS_N_S_PER_M = 0.1
"""Damping that a steel spring may have of its own; it cannot be told from the bearing's."""
_APART_M = 5e-4


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
    where the sweep was repeated, what each run by itself gives.
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

    Raises:
        UnusableInputError: too few positions, or they do not reach over the middle half of the stroke.
    """
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
    scale_std = (region.plateau_n_per_a.std or 0.0) / region.plateau_n_per_a.value
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
    runs = sorted({test.sweep for test in tests})
    repeats: tuple[SweepResult, ...] = ()
    if len(runs) > 1:
        repeats = tuple(
            analyse_sweep([test for test in tests if test.sweep == run], device, spring, electrical_std=electrical_std)
            for run in runs
        )
    return replace(result, problems=_problems(result), repeats=repeats)


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
    nominal = result.device.force_constant_n_per_a
    plateau = result.region.plateau_n_per_a.value
    if abs(plateau / nominal - 1.0) > FARTHEST_FROM_NOMINAL:
        problems.append(
            f"the force constant is {plateau:.2f} N/A and should be near {nominal:.2f} N/A: check the spring's "
            "stiffness and the channels' scales"
        )
    if result.region.width_m < LEAST_WIDTH_M:
        problems.append(
            f"the force constant keeps to its plateau over {1e3 * result.region.width_m:.1f} mm only; "
            f"{1e3 * LEAST_WIDTH_M:.0f} mm are needed"
        )
    if result.agreement.cause is not None:
        problems.append(result.agreement.words)
    return tuple(problems)
