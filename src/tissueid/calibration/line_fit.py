"""Robust straight-line fit with outlier rejection."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from tissueid.errors import UnusableInputError
from tissueid.messages import Message
from tissueid.records import Estimate

OUTLIER_RATIO = 5.0
"""Distance from the line, in robust standard deviations of all points, beyond which a point is an outlier."""
_NORMAL = 1.4826
"""Ratio of the standard deviation to the median absolute deviation of a normal distribution."""


@dataclass(frozen=True, eq=False)
class Line:
    """y = intercept + slope x, with residuals (n,) and outlier flags (n,) of all points."""

    slope: Estimate
    intercept: Estimate
    residuals: NDArray[np.float64]
    outliers: NDArray[np.bool_]

    @property
    def scatter(self) -> float:
        """Standard deviation of the inliers about the line."""
        return float(np.std(self.residuals[~self.outliers]))

    @property
    def worst(self) -> float:
        """Largest deviation of an inlier from the line."""
        return float(np.abs(self.residuals[~self.outliers]).max())

    def at(self, x: float) -> float:
        """Return the value of the line at ``x``."""
        return self.intercept.value + self.slope.value * x


def straight_line(x: NDArray[np.float64], y: NDArray[np.float64], noise: float = 0.0) -> Line:
    """Fit a line to points (x, y), shape (n,) each; ``noise`` is the known standard deviation of y.

    The Theil-Sen estimator (Theil 1950, Sen 1968) identifies the inliers; least squares through them gives slope,
    intercept and their standard deviations. Up to a quarter of the points may be outliers.

    Raises:
        UnusableInputError: fewer than three points, or all at one x.
    """
    if x.size < 3 or float(np.ptp(x)) == 0.0:
        raise UnusableInputError(
            Message("line.points", "a line needs at least three points that are not all at one position")
        )
    slope, intercept, *_ = stats.theilslopes(y, x)
    away = np.abs(y - intercept - slope * x)
    scale = max(noise, _NORMAL * float(np.median(away)), 1e-12 * float(np.abs(y).max()))
    outliers = away > OUTLIER_RATIO * scale
    if np.ptp(x[~outliers]) == 0.0 or np.count_nonzero(~outliers) < 3:
        raise UnusableInputError(Message("line.none", "the points do not lie on a line"))
    line = stats.linregress(x[~outliers], y[~outliers])
    return Line(
        slope=Estimate(float(line.slope), float(line.stderr)),
        intercept=Estimate(float(line.intercept), float(line.intercept_stderr)),
        residuals=y - line.intercept - line.slope * x,
        outliers=outliers,
    )
