"""Confidence bands of the curves of a dynamic parameter nonlinearity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tissueid.identification.base import Array
from tissueid.identification.correlation import dependence_samples, long_run_covariance
from tissueid.identification.depth_profile import DepthProfile
from tissueid.identification.dpn.curves import LogCurves
from tissueid.identification.dpn.fit import PRIOR, DpnData, FittedDpn, prior_weights
from tissueid.records import Estimate

NORMAL_95 = 1.959964
PROFILE_ROWS = 41
_CENTRAL = 0.98
"""Share of the samples within the positions of a profile; there are few samples outside."""


@dataclass(frozen=True, eq=False)
class CurveBand:
    """A curve at k positions with its pointwise 95 % band; all of shape (k,), in the unit of the curve."""

    position: Array
    value: Array
    std: Array
    low: Array
    high: Array


@dataclass(frozen=True, eq=False)
class EstimatedCurves:
    """Fitted curves with the covariance (p, p) of their coefficients, and the positions (m,) of the fitted samples.

    ``speed`` (m,) is the simulated speed at those samples, m/s. The covariance is NaN if it is unknown.
    """

    curves: LogCurves
    covariance: Array
    position: Array
    speed: Array

    def mass(self, position: Array | float) -> CurveBand:
        """Return M(y) at positions (k,), kg."""
        position = _as_positions(position)
        return self._band("mass", self.curves.masses(position), position)

    def damping(self, position: Array | float, direction: int = 0) -> CurveBand:
        """Return B(y) at positions (k,), N s/m, for fast indentation (1) or retraction (-1), or their mean (0)."""
        position = _as_positions(position)
        curves = self.curves
        basis = curves.basis(position, max(curves.damping.size, curves.direction.size))
        slopes = np.zeros((position.size, curves.theta.size))
        slopes[:, curves.places["damping"]] = basis[:, : curves.damping.size]
        slopes[:, curves.places["direction"]] = direction * basis[:, : curves.direction.size]
        turned = basis[:, : curves.direction.size] @ curves.direction
        return self._logarithmic(curves.dampings(position) * np.exp(direction * turned), slopes, position)

    def stiffness(self, position: Array | float) -> CurveBand:
        """Return the tangent stiffness dF/dy at positions (k,), N/m, as a small-signal test there would measure it."""
        position = _as_positions(position)
        return self._band("stiffness", self.curves.stiffnesses(position), position)

    def force(self, position: Array | float) -> CurveBand:
        """Return F(y) at positions (k,), N."""
        position = _as_positions(position)
        slopes = self.curves.force_slopes(position)
        std = self._std(slopes)
        value = self.curves.forces(position)
        return CurveBand(position, value, std, value - NORMAL_95 * std, value + NORMAL_95 * std)

    def secant(self, position: Array | float, surface: float) -> CurveBand:
        """Return K(y) of Eq. 3.33 at positions (k,), N/m: force divided by the depth below a known surface (m).

        NaN at the surface and above it; negative for adhesive tissue that pulls the probe in.
        """
        position = _as_positions(position)
        depth = np.where(position > surface, position - surface, np.nan)
        force = self.force(position)
        return CurveBand(position, force.value / depth, force.std / depth, force.low / depth, force.high / depth)

    def growth(self, name: str, position: float) -> Estimate:
        """Return the derivative of the logarithm of a curve with respect to position, 1/m: A1 to A3 of Chen 2010,
        C.1.4, if D = 0.
        """
        series = getattr(self.curves, name)
        slopes = np.zeros((1, self.curves.theta.size))
        slopes[:, self.curves.places[name]] = self.curves.growths(np.array([position]), series.size)
        return _estimate(float(slopes[0] @ self.curves.theta), float(self._std(slopes)[0]))

    def changes(self, low: float, high: float) -> tuple[Array, Array]:
        """Return the changes (3,) of log M, log B, log K from ``low`` to ``high``, and their covariance (3, 3)."""
        slopes = self._log_slopes(np.array([high])) - self._log_slopes(np.array([low]))  # (3, 1, p)
        rows = slopes[:, 0]
        return rows @ self.curves.theta, rows @ self.covariance @ rows.T

    def log_covariance(self, position: float) -> Array:
        """Return the covariance (3, 3) of log M, log B and log K at a position, m."""
        rows = self._log_slopes(np.array([position]))[:, 0]
        return np.asarray(rows @ self.covariance @ rows.T, dtype=np.float64)

    def combined_std(self, position: float, powers: tuple[float, float, float]) -> float:
        """Return the standard deviation of the logarithm of a product of powers of M, B and K at a position."""
        slopes = np.array(powers) @ self._log_slopes(np.array([position]))[:, 0]
        return float(self._std(slopes[None, :])[0])

    def _log_slopes(self, position: Array) -> Array:
        """Return the derivatives of log M, log B and log K at positions (k,) with respect to the coefficients, shape
        (3, k, p).
        """
        slopes = np.zeros((3, position.size, self.curves.theta.size))
        for place, name in enumerate(("mass", "damping", "stiffness")):
            series = getattr(self.curves, name)
            slopes[place][:, self.curves.places[name]] = self.curves.basis(position, series.size)
        return slopes

    def central(self) -> tuple[float, float]:
        """Return the positions between which the central 98 % of the samples lie, m."""
        low, high = np.quantile(self.position, [0.5 - _CENTRAL / 2.0, 0.5 + _CENTRAL / 2.0])
        return float(low), float(high)

    def profile(self) -> DepthProfile:
        """Return the curves at equal steps over the central 98 % of the visited positions, for each direction if they
        differ.

        The support of a row is the number of samples nearest to it that move in its direction.
        """
        low, high = self.central()
        position = np.linspace(low, high, PROFILE_ROWS)
        half = 0.5 * (high - low) / (PROFILE_ROWS - 1)
        edges = np.concatenate([position - half, [high + half]])
        mass, stiffness = self.mass(position), self.stiffness(position)
        parts = []
        for way in (1, -1) if self.curves.direction.size else (0,):
            moving = self.position[np.sign(self.speed) == way] if way else self.position
            parts.append((way, self.damping(position, way), np.histogram(moving, edges)[0]))
        times = len(parts)
        return DepthProfile(
            position=np.tile(position, times),
            low=np.tile(position - half, times),
            high=np.tile(position + half, times),
            direction=np.repeat(np.array([way for way, _, _ in parts]), PROFILE_ROWS),
            mass=np.tile(mass.value, times),
            mass_std=np.tile(mass.std, times),
            damping=np.concatenate([damping.value for _, damping, _ in parts]),
            damping_std=np.concatenate([damping.std for _, damping, _ in parts]),
            stiffness=np.tile(stiffness.value, times),
            stiffness_std=np.tile(stiffness.std, times),
            support=np.concatenate([support for _, _, support in parts]),
        )

    def _band(self, name: str, value: Array, position: Array) -> CurveBand:
        series = getattr(self.curves, name)
        slopes = np.zeros((position.size, self.curves.theta.size))
        slopes[:, self.curves.places[name]] = self.curves.basis(position, series.size)
        return self._logarithmic(value, slopes, position)

    def _logarithmic(self, value: Array, slopes: Array, position: Array) -> CurveBand:
        """Return the band of a positive curve from the derivatives (k, p) of its logarithm."""
        std = self._std(slopes)
        factor = np.exp(np.minimum(NORMAL_95 * std, 300.0))
        return CurveBand(position, value, value * std, value / factor, value * factor)

    def _std(self, slopes: Array) -> Array:
        variance = np.einsum("ij,jk,ik->i", slopes, self.covariance, slopes)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)), dtype=np.float64)


def _as_positions(position: Array | float) -> Array:
    return np.atleast_1d(np.asarray(position, dtype=np.float64))


def coefficient_covariance(data: DpnData, fitted: FittedDpn) -> Array:
    """Return the covariance (p, p) of the coefficients; NaN if the fit did not converge.

    Sandwich estimate for a model that need not be complete (White 1982), with autocorrelated errors and the weak prior.
    """
    here = fitted.evaluation
    n, p = here.slopes.shape
    if not fitted.converged or n <= p:
        return np.full((p, p), np.nan)
    weights = prior_weights(fitted.curves, here.rss, n)
    size = np.sqrt(np.sum(here.slopes**2, axis=0) + weights)
    size[size == 0.0] = 1.0
    directions = here.slopes / size
    inverse = np.linalg.pinv(directions.T @ directions + np.diag(weights / size**2), rcond=1e-14, hermitian=True)
    influence = (directions @ inverse) * here.error_projected[:, None]
    block = dependence_samples(here.error_projected, data.rate)
    held = inverse * (weights / size * PRIOR)
    covariance = long_run_covariance(influence, block) * n / (n - p) + held @ held.T
    return np.asarray(covariance / np.outer(size, size), dtype=np.float64)


def _estimate(value: float, std: float) -> Estimate:
    return Estimate(value, std if np.isfinite(std) else None)
