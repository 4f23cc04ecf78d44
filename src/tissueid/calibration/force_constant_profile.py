"""Force constant along the stroke, combined from both halves of a sweep, and the linear region of the coil."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.calibration.flux import FluxFit
from tissueid.calibration.force_balance import BalanceFit
from tissueid.calibration.spline_basis import Array, SplineBasis
from tissueid.calibration.spring_points import SpringPoint
from tissueid.errors import UnusableInputError
from tissueid.records import Estimate

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
    found = _edges(values @ profile.coefficients, fine, middle)
    random = np.random.default_rng(0)
    draws = random.multivariate_normal(profile.coefficients, profile.covariance, _DRAWS, method="svd")
    spread = np.std([_edges(values @ draw, fine, middle) for draw in draws], axis=0)
    low, high, plateau = (Estimate(float(v), float(s)) for v, s in zip(found, spread, strict=True))
    return LinearRegion(low, high, bool(found[0] <= first), bool(found[1] >= last), plateau)


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
