"""The force constant along the stroke: balance of static forces, its profile, agreement of the scales."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import special, stats

from tissueid.calibration.flux import Array, FluxFit, SplineBasis, solution_covariance, solve_least_squares
from tissueid.calibration.spring_points import SpringPoint, SweepTest
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.messages import Message, Quantity
from tissueid.records import Estimate

WINDOW_S = 2.5e-3
"""Standard deviation of the window, s: it passes 60 Hz, three times the resonance of the spring."""
_REACH = 6.0
"""Half width of the window, in standard deviations."""


@dataclass(frozen=True, eq=False)
class BalanceFit:
    """Result of the force balance, for a spring of exactly the given stiffness.

    ``coefficients`` (p,) of the basis are the force constant, N/A, with ``covariance`` (p, p).
    """

    basis: SplineBasis
    coefficients: Array
    covariance: Array
    mass_kg: Estimate
    damping_n_s_per_m: Estimate
    residual_n: float


def fit_balance(tests: Sequence[SweepTest], flux: FluxFit, stiffness_n_per_m: float) -> BalanceFit:
    """Fit the balance to all tests, with the currents of the electrical half.

    The measured current is a noisy regressor; the modelled current of the electrical equation is its instrumental
    variable, so that the noise causes no bias.
    """
    basis, rate = flux.basis, tests[0].sample_rate_hz
    size, every = basis.size, max(1, round(WINDOW_S * rate))
    window, slope, bend, held = _windows(rate)
    rows: list[tuple[Array, Array, Array]] = []
    for test, read, modelled in zip(tests, flux.mean_currents, flux.modelled_currents, strict=True):
        about = test.position - np.nanmean(test.position)
        splines = basis.values(0.5 * (test.position + np.concatenate([[np.nan], test.position[:-1]])))
        motion = np.stack([-_convolved(about, bend), -_convolved(about, slope)], axis=1)
        design, clean = (
            np.concatenate([np.stack([_convolved(c, held) for c in (splines * i[:, None]).T], axis=1), motion], axis=1)
            for i in (read, modelled)
        )
        target = stiffness_n_per_m * _convolved(about, window)
        whole = np.isfinite(design).all(axis=1) & np.isfinite(target) & np.isfinite(clean).all(axis=1)
        part = np.flatnonzero(whole)[::every]
        # Remove means: rest position of the spring and weight are offsets of each test.
        rows.append(tuple(a[part] - a[part].mean(axis=0) for a in (design, clean, target)))
    design, clean, target = (np.concatenate(parts) for parts in zip(*rows, strict=True))
    scale = np.sqrt(np.mean(design**2, axis=0))
    scale[:size] = 1.0
    solution, inverse = solve_least_squares(design / scale, target, basis, clean / scale)
    residual = target - (design / scale) @ solution
    influence = (clean / scale) @ inverse * residual[:, None]
    covariance = solution_covariance(influence, residual, rate / every) / np.outer(scale, scale)
    solution, std = solution / scale, np.sqrt(np.diag(covariance))
    # A delay of the force by the error of L / R changes damping by K times, and mass by B times that error.
    std[size:] = np.hypot(std[size:], flux.lag.noise_s * np.array([abs(solution[size + 1]), stiffness_n_per_m]))
    return BalanceFit(
        basis=basis,
        coefficients=solution[:size],
        covariance=covariance[:size, :size],
        mass_kg=Estimate(float(solution[size]), float(std[size])),
        damping_n_s_per_m=Estimate(float(solution[size + 1]), float(std[size + 1])),
        residual_n=float(np.std(residual)),
    )


def _windows(rate: float) -> tuple[Array, Array, Array, Array]:
    """Return the window, its first two derivatives, and its mean over the interval before each sample."""
    reach = int(np.ceil(_REACH * WINDOW_S * rate))
    time = np.arange(-reach, reach + 1) / rate
    window = np.exp(-0.5 * (time / WINDOW_S) ** 2) / (np.sqrt(2.0 * np.pi) * WINDOW_S * rate)
    slope = -time / WINDOW_S**2 * window
    bend = ((time / WINDOW_S) ** 2 - 1.0) / WINDOW_S**2 * window
    # A force held over the interval before sample m acts at n with the window between n - m and one sample more.
    held = 0.5 * (
        special.erf((time + 1.0 / rate) / (np.sqrt(2.0) * WINDOW_S)) - special.erf(time / (np.sqrt(2.0) * WINDOW_S))
    )
    return window, slope, bend, np.asarray(held)


def _convolved(values: Array, window: Array) -> Array:
    """Return values (n,) convolved with the window, shape (n - window + 1,); NaN where a value is missing."""
    return np.convolve(values, window, mode="valid")


LINEAR_SHARE = 0.05
"""Largest relative deviation of the force constant from its plateau in the linear region."""
MIN_VAF_PERCENT = 90.0
"""Minimum VAF at a position of the linear region; the thesis has 95 to 98 % (Table 2.1)."""
FINE_M = 5e-5
"""Spacing of the positions at which the edges of the region are searched, m."""
_DRAWS = 400
"""Number of random profiles for the standard deviations of the edges."""
_EDGE_M = 1e-4
"""Tolerance of the ends of the middle half of the stroke, m."""


@dataclass(frozen=True, eq=False)
class ForceConstant:
    """Force constant, N/A, as spline coefficients (p,) with their covariance (p, p)."""

    basis: SplineBasis
    coefficients: Array
    covariance: Array

    def at(self, position_m: Array) -> Array:
        """Return the force constant at positions (n,), N/A."""
        return np.asarray(self.basis.values(position_m) @ self.coefficients)

    def std_at(self, position_m: Array) -> Array:
        """Return the standard deviation at positions (n,), N/A."""
        values = self.basis.values(position_m)
        return np.asarray(np.sqrt(np.einsum("ij,jk,ik->i", values, self.covariance, values)))

    def with_scale(self, relative_std: float) -> ForceConstant:
        """Return the same profile with an additional relative standard deviation of its scale."""
        common = relative_std**2 * np.outer(self.coefficients, self.coefficients)
        return ForceConstant(self.basis, self.coefficients, self.covariance + common)


@dataclass(frozen=True)
class LinearRegion:
    """Range of measured positions with a force constant within 5 % of its plateau.

    ``open_below`` and ``open_above``: the sweep ends inside the region, which may extend further.
    """

    min_m: Estimate
    max_m: Estimate
    open_below: bool
    open_above: bool
    plateau_n_per_a: Estimate

    @property
    def width_m(self) -> float:
        """Width, m."""
        return self.max_m.value - self.min_m.value


def combine_profiles(flux: FluxFit, balance: BalanceFit, electrical_std: float, spring_std: float) -> ForceConstant:
    """Return the weighted mean of both profiles, by their noise and scale uncertainties.

    Args:
        flux: electrical half.
        balance: mechanical half.
        electrical_std: relative standard deviation of the ratio of voltage and velocity scales.
        spring_std: relative standard deviation of the spring stiffness.
    """
    electrical = ForceConstant(flux.basis, flux.coefficients, flux.covariance).with_scale(electrical_std)
    spring = ForceConstant(balance.basis, balance.coefficients, balance.covariance).with_scale(spring_std)
    gain = np.linalg.solve(spring.covariance + electrical.covariance, spring.covariance).T
    coefficients = spring.coefficients + gain @ (electrical.coefficients - spring.coefficients)
    covariance = spring.covariance - gain @ spring.covariance
    return ForceConstant(flux.basis, coefficients, 0.5 * (covariance + covariance.T))


def linear_region(profile: ForceConstant, points: Sequence[SpringPoint], stroke_m: float) -> LinearRegion:
    """Return the linear region about the plateau, which is the median over the middle half of the stroke.

    It contains only measured positions, from the middle outwards as long as a linear model explains the data.

    Raises:
        UnusableInputError: the sweep does not cover the middle half of the stroke, or is not linear there.
    """
    first, last = _measured(points, stroke_m)
    fine = np.linspace(first, last, 1 + round((last - first) / FINE_M))
    middle = (fine >= 0.25 * stroke_m - _EDGE_M) & (fine <= 0.75 * stroke_m + _EDGE_M)
    if first > 0.25 * stroke_m + 1e-3 or last < 0.75 * stroke_m - 1e-3:
        raise UnusableInputError(
            "sweep.too_short",
            "the sweep is usable only from {first:.1f} to {last:.1f} mm: it must cover the middle half of the "
            "stroke, "
            "{low:.0f} to {high:.0f} mm",
            first=1e3 * first,
            last=1e3 * last,
            low=250.0 * stroke_m,
            high=750.0 * stroke_m,
        )
    values = profile.basis.values(fine)  # (fine, p)
    fitted = _edges(values @ profile.coefficients, fine, middle)
    random = np.random.default_rng(0)
    draws = random.multivariate_normal(profile.coefficients, profile.covariance, _DRAWS, method="svd")
    spread = np.std([_edges(values @ draw, fine, middle) for draw in draws], axis=0)
    low, high, plateau = (Estimate(float(v), float(s)) for v, s in zip(fitted, spread, strict=True))
    return LinearRegion(low, high, bool(fitted[0] <= first), bool(fitted[1] >= last), plateau)


def _measured(points: Sequence[SpringPoint], stroke_m: float) -> tuple[float, float]:
    """Return first and last position, m, between which a linear model explains every position."""
    ordered = sorted(points, key=lambda point: point.position_m)
    places = np.array([point.position_m for point in ordered])
    sound = np.array([point.vaf_percent >= MIN_VAF_PERCENT for point in ordered])
    centre = int(np.argmin(np.abs(places - 0.5 * stroke_m)))
    if not sound[centre]:
        raise UnusableInputError(
            "sweep.nonlinear",
            "in the middle of the stroke a linear model explains only {percent:.0f} % of the motion: check that "
            "the "
            "spring is fixed at both ends and moves freely",
            percent=ordered[centre].vaf_percent,
        )
    bad = np.flatnonzero(~sound)
    below, above = bad[bad < centre], bad[bad > centre]
    return (
        float(places[below[-1] + 1 if below.size else 0]),
        float(places[above[0] - 1 if above.size else places.size - 1]),
    )


def _edges(value: Array, fine: Array, middle: NDArray[np.bool_]) -> tuple[float, float, float]:
    """Return first and last position within 5 % of the plateau, interpolated, and the plateau."""
    plateau = float(np.median(value[middle]))
    excess = np.abs(value / plateau - 1.0) - LINEAR_SHARE
    centre = int(np.argmin(np.abs(fine - 0.5 * (fine[middle][0] + fine[middle][-1]))))
    off = np.flatnonzero(excess > 0.0)
    below, above = off[off < centre], off[off > centre]
    low = float(fine[0]) if not below.size else _crossing(fine, excess, int(below[-1]))
    high = float(fine[-1]) if not above.size else _crossing(fine, excess, int(above[0]) - 1)
    return low, high, plateau


def _crossing(fine: Array, excess: Array, at: int) -> float:
    """Return the interpolated position at which the excess is zero between one sample and the next."""
    share = excess[at] / (excess[at] - excess[at + 1])
    return float(fine[at] + share * (fine[at + 1] - fine[at]))


ELECTRICAL_STD = 0.005
"""Default relative standard deviation of the ratio of voltage and position scales."""
_DISAGREEMENT_STD = 3.0
"""Standard deviations above which two values disagree."""
_SHAPE_P_VALUE = 1e-4
"""p-value below which two profiles differ in shape."""
_MIN_STAGES = 4
"""Minimum number of stage positions for a comparison with the position channel."""

Cause = Literal["current", "position", "voltage", "spring", "unknown"]


@dataclass(frozen=True)
class Agreement:
    """Ratio of the force constants by spring and by flux linkage, and further ratios that depend on the scales.

    ``resistance`` is measured over expected; ``stage`` is metres read per metre moved, None without a motorised stage.
    ``expected_std`` is the uncertainty of the first ratio from spring and channels. ``cause`` is None if they agree.
    ``same_shape`` is False if the two profiles differ by more than a factor.
    """

    ratio: Estimate
    expected_std: float
    resistance: Estimate
    stage: Estimate | None
    same_shape: bool
    cause: Cause | None

    @property
    def message(self) -> Message:
        """Result of the comparison in a sentence."""
        ratio = self.ratio.value - 1.0
        said = Message(
            "sweep.ratio.higher" if ratio >= 0.0 else "sweep.ratio.lower",
            _HIGHER if ratio >= 0.0 else _LOWER,
            difference=Quantity(100.0 * abs(ratio), "%", 2),
            uncertainty=Quantity(100.0 * self.expected_std, "%", 1),
        )
        if self.cause is not None:
            return Message(
                "sweep.scales", "{comparison}: they disagree. {cause}", comparison=said, cause=_CAUSES[self.cause]
            )
        if self.same_shape:
            return Message("sweep.agree", "{comparison}: they agree", comparison=said)
        return Message("sweep.shapes", "{comparison}, but their profiles along the stroke differ", comparison=said)


_HIGHER = marked(
    "The force constant by the spring is {difference} higher than by the flux linkage, with an uncertainty of spring "
    "and "
    "channels of ±{uncertainty}"
)
_LOWER = marked(
    "The force constant by the spring is {difference} lower than by the flux linkage, with an uncertainty of spring "
    "and "
    "channels of ±{uncertainty}"
)
_CAUSES: dict[Cause, Message] = {
    "current": Message(
        "sweep.cause.current",
        "The scale of the current channel is the most likely cause: the resistance is off by the same factor",
    ),
    "position": Message(
        "sweep.cause.position",
        "The scale of the position channel is the most likely cause: the stage shows the same",
    ),
    "voltage": Message(
        "sweep.cause.voltage",
        "The scale of the voltage channel is the most likely cause: the resistance is off in the other direction",
    ),
    "spring": Message(
        "sweep.cause.spring",
        "The stiffness of the spring, or the scale of the position channel, is the most likely cause: the resistance "
        "is "
        "right",
    ),
    "unknown": Message(
        "sweep.cause.unknown", "No single scale explains it: check the spring, its fixture and the channels"
    ),
}


def compare(
    flux: FluxFit,
    balance: BalanceFit,
    points: Sequence[SpringPoint],
    device: DeviceDescription,
    electrical_std: float,
    spring_std: float,
) -> Agreement:
    """Compare the two profiles, the resistance and the stage.

    Args:
        flux: electrical half.
        balance: mechanical half.
        points: identified positions.
        device: nominal figures.
        electrical_std: relative standard deviation of the scale of voltage over position.
        spring_std: relative standard deviation of the stiffness of the spring.
    """
    places = np.array(sorted({round(point.position_m, 4) for point in points}))
    at = flux.basis.values(places)
    by_flux, by_spring = at @ flux.coefficients, at @ balance.coefficients
    covariance = at @ (flux.covariance + balance.covariance) @ at.T
    weight = np.linalg.pinv(covariance, rcond=1e-8, hermitian=True)
    information = float(by_spring @ weight @ by_spring)
    share = float(by_spring @ weight @ by_flux) / information  # flux over spring
    difference = by_flux - share * by_spring
    freedom = int(np.linalg.matrix_rank(covariance, tol=1e-8 * float(np.linalg.norm(covariance, 2)))) - 1
    chance = float(stats.chi2.sf(difference @ weight @ difference, max(1, freedom)))
    ratio = Estimate(1.0 / share, float(1.0 / np.sqrt(information) / share**2))
    resistances = np.array([estimate.value for estimate in flux.resistance_ohm]) / device.coil_resistance_ohm
    resistance = Estimate(float(resistances.mean()), float(resistances.std(ddof=1)) if resistances.size > 1 else None)
    stage = _stage(points)
    expected = float(np.hypot(electrical_std, spring_std))
    off = abs(ratio.value - 1.0) > _DISAGREEMENT_STD * float(np.hypot(expected, ratio.std or 0.0))
    cause = _cause(ratio.value, resistance.value, stage) if off else None
    return Agreement(ratio, expected, resistance, stage, chance > _SHAPE_P_VALUE, cause)


def _stage(points: Sequence[SpringPoint]) -> Estimate | None:
    """Return metres read per metre of stage travel; None if the stage did not move."""
    moved = [(point.stage_m, point.rest_m) for point in points if np.isfinite(point.stage_m + point.rest_m)]
    if len({stage for stage, _ in moved}) < _MIN_STAGES:
        return None
    line = stats.linregress(*np.array(moved).T)
    return Estimate(float(line.slope), float(line.stderr))


def _cause(ratio: float, resistance: float, stage: Estimate | None) -> Cause:
    """Return the single scale error that explains all ratios best."""
    if min(ratio, resistance, 1.0 if stage is None else stage.value) <= 0.0:
        return "unknown"  # a channel is inverted, which no scale explains
    size = abs(np.log(ratio))
    marks: dict[Cause, tuple[float, float, float]] = {
        "current": (np.log(ratio), np.log(ratio), 0.0),
        "position": (np.log(ratio), 0.0, 0.5 * np.log(ratio)),
        "voltage": (np.log(ratio), -np.log(ratio), 0.0),
        "spring": (np.log(ratio), 0.0, 0.0),
    }
    if stage is None:
        del marks["position"]  # not distinguishable from the spring
    seen = np.array([np.log(ratio), np.log(resistance), 0.0 if stage is None else np.log(stage.value)])
    misses = {cause: float(np.linalg.norm(seen - np.array(mark))) for cause, mark in marks.items()}
    best = min(misses, key=lambda cause: misses[cause])
    return best if misses[best] < 0.35 * size else "unknown"
