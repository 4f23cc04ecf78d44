"""Least squares on the splines of a basis, with deviations that hold where residuals depend on their neighbours."""

from __future__ import annotations

import numpy as np

from tissueid.calibration.spline_basis import Array, SplineBasis
from tissueid.identification.dependence import dependence_samples, long_run_covariance

RIDGE = 1e-7
"""Weight of smoothness relative to that of the data: decides where no data is, and nowhere else."""


def solved(design: Array, target: Array, basis: SplineBasis, instruments: Array | None = None) -> tuple[Array, Array]:
    """Least squares of a target (n,) on columns (n, p), the first of them those of a basis, and its inverse (p, p).

    The splines are held smooth where there is no data. ``instruments`` (n, p) are the columns without their noise:
    with them that noise does not draw the solution towards nil.
    """
    clean = design if instruments is None else instruments
    gram = clean.T @ design
    gram[: basis.size, : basis.size] += RIDGE * np.mean(np.diag(gram)[: basis.size]) * basis.roughness()
    inverse = np.linalg.inv(gram)
    return np.asarray(inverse @ (clean.T @ target)), np.asarray(inverse.T)


def covariance_of(influence: Array, residual: Array, rate: float) -> Array:
    """Covariance (p, p) of a solution from the influence of each row on it (n, p), neighbours' dependence included."""
    return long_run_covariance(influence, dependence_samples(residual, rate))
