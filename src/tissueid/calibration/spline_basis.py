"""Cubic B-splines along the stroke for the force constant of the coil, and least squares on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from tissueid.identification.correlation import dependence_samples, long_run_covariance

Array = NDArray[np.float64]

MIN_SPACING_M = 2.0e-3
"""Minimum spacing of knots, m: the magnetic field changes over about the width of the air gap."""
RIDGE = 1e-7
"""Weight of the smoothness penalty relative to the data; effective only where there are no data."""
_DEGREE = 3


@dataclass(frozen=True, eq=False)
class SplineBasis:
    """Cubic B-splines on equally spaced knots (k,), m, with fourfold ends."""

    knots: Array

    @classmethod
    def covering(cls, visited_m: Sequence[Array], spacing_m: float) -> SplineBasis:
        """Return the basis over all visited positions, m, with knots about ``spacing_m`` apart, at least
        ``MIN_SPACING_M``.
        """
        low = min(float(np.nanmin(part)) for part in visited_m)
        high = max(float(np.nanmax(part)) for part in visited_m)
        pieces = max(1, int(np.ceil((high - low) / max(spacing_m, MIN_SPACING_M) - 1e-9)))
        inner = np.linspace(low, high, pieces + 1)
        return cls(np.concatenate([[low] * _DEGREE, inner, [high] * _DEGREE]))

    @property
    def size(self) -> int:
        """Number of splines."""
        return self.knots.size - _DEGREE - 1

    @property
    def span_m(self) -> tuple[float, float]:
        """First and last position."""
        return float(self.knots[0]), float(self.knots[-1])

    def values(self, position_m: Array) -> Array:
        """Return each spline at positions (n,), shape (n, size); NaN stays NaN."""
        return self._of(position_m, BSpline(self.knots, np.eye(self.size), _DEGREE))

    def integrals(self, position_m: Array) -> Array:
        """Return the integral of each spline from the first knot, m, to positions (n,), shape (n, size)."""
        return self._of(position_m, BSpline(self.knots, np.eye(self.size), _DEGREE).antiderivative())

    def _of(self, position_m: Array, spline: BSpline) -> Array:
        low, high = self.span_m
        return np.asarray(spline(np.clip(position_m, low, high)), dtype=np.float64)

    def roughness(self) -> Array:
        """Return the matrix (size, size) of the sum of squared second differences of the coefficients."""
        differences = np.diff(np.eye(self.size), 2, axis=0)
        return np.asarray(differences.T @ differences, dtype=np.float64)


def solve_least_squares(
    design: Array, target: Array, basis: SplineBasis, instruments: Array | None = None
) -> tuple[Array, Array]:
    """Return the least-squares solution (p,) and the inverse of its normal matrix (p, p).

    Args:
        design: regressors (n, p); the first are the splines of the basis, which are regularised where there are no
            data.
        target: output (n,).
        basis: of the splines.
        instruments: noise-free regressors (n, p) as instrumental variables, which avoids attenuation bias.
    """
    clean = design if instruments is None else instruments
    gram = clean.T @ design
    gram[: basis.size, : basis.size] += RIDGE * np.mean(np.diag(gram)[: basis.size]) * basis.roughness()
    inverse = np.linalg.inv(gram)
    return np.asarray(inverse @ (clean.T @ target)), np.asarray(inverse.T)


def solution_covariance(influence: Array, residual: Array, rate: float) -> Array:
    """Return the covariance (p, p) of a solution from the influence (n, p) of its rows, for
    autocorrelated residuals.
    """
    return long_run_covariance(influence, dependence_samples(residual, rate))
