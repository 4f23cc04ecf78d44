"""Cubic B-splines along the stroke: how the force constant of the coil may run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

Array = NDArray[np.float64]

LEAST_SPACING_M = 2.0e-3
"""The field of a magnet does not change within less: its edge is as soft as the gap is wide."""
_DEGREE = 3


@dataclass(frozen=True, eq=False)
class SplineBasis:
    """Cubic B-splines on a row of knots, m, shape (k,), which rise in equal steps; both ends are fourfold."""

    knots: Array

    @classmethod
    def covering(cls, visited_m: Sequence[Array], spacing_m: float) -> SplineBasis:
        """The basis over all positions visited, m, knots ``spacing_m`` apart or little less, never too near."""
        low = min(float(np.nanmin(part)) for part in visited_m)
        high = max(float(np.nanmax(part)) for part in visited_m)
        pieces = max(1, int(np.ceil((high - low) / max(spacing_m, LEAST_SPACING_M) - 1e-9)))
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
        """Each spline at positions, shape (n,) to (n, size); NaN stays NaN."""
        return self._of(position_m, BSpline(self.knots, np.eye(self.size), _DEGREE))

    def integrals(self, position_m: Array) -> Array:
        """Each spline's integral from the first knot, m, shape (n,) to (n, size); NaN stays NaN."""
        return self._of(position_m, BSpline(self.knots, np.eye(self.size), _DEGREE).antiderivative())

    def _of(self, position_m: Array, spline: BSpline) -> Array:
        low, high = self.span_m
        return np.asarray(spline(np.clip(position_m, low, high)), dtype=np.float64)

    def roughness(self) -> Array:
        """Sum of squared second differences of the coefficients, shape (size, size): nil for a straight line."""
        differences = np.diff(np.eye(self.size), 2, axis=0)
        return np.asarray(differences.T @ differences, dtype=np.float64)
