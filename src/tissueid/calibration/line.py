"""A straight line through points some of which may be wrong: found robustly, said which, and fitted to the others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from tissueid.errors import UnusableInputError
from tissueid.records import Estimate

FAR = 5.0
"""Points this many times further from the line than the others, or than their noise, are wrong."""
_NORMAL = 1.4826
"""From the median of absolute deviations to a standard deviation."""


@dataclass(frozen=True, eq=False)
class Line:
    """y = intercept + slope x. ``residuals``, shape (n,), and ``outliers``, shape (n,), are of all points."""

    slope: Estimate
    intercept: Estimate
    residuals: NDArray[np.float64]
    outliers: NDArray[np.bool_]

    @property
    def scatter(self) -> float:
        """Standard deviation of the points that were fitted about the line."""
        return float(np.std(self.residuals[~self.outliers]))

    @property
    def worst(self) -> float:
        """The largest distance of a fitted point from the line."""
        return float(np.abs(self.residuals[~self.outliers]).max())

    def at(self, x: float) -> float:
        """The line at one place."""
        return self.intercept.value + self.slope.value * x


def straight_line(x: NDArray[np.float64], y: NDArray[np.float64], noise: float = 0.0) -> Line:
    """Fit a line to points (x, y), shape (n,) each; ``noise`` is the standard deviation that y has anyhow.

    The median of all slopes (Theil 1950, Sen 1968) finds the line that most points agree on; least squares through
    those that lie near it gives the figures and their deviations. Points far off are told in ``outliers``. Up to a
    quarter of the points may be wrong.

    Raises:
        UnusableInputError: fewer than three points, or all at one x.
    """
    if x.size < 3 or float(np.ptp(x)) == 0.0:
        raise UnusableInputError("a line needs three points that are not all at one place")
    slope, intercept, *_ = stats.theilslopes(y, x)
    away = np.abs(y - intercept - slope * x)
    scale = max(noise, _NORMAL * float(np.median(away)), 1e-12 * float(np.abs(y).max()))
    outliers = away > FAR * scale
    if np.ptp(x[~outliers]) == 0.0 or np.count_nonzero(~outliers) < 3:
        raise UnusableInputError("the points agree on no line")
    line = stats.linregress(x[~outliers], y[~outliers])
    return Line(
        slope=Estimate(float(line.slope), float(line.stderr)),
        intercept=Estimate(float(line.intercept), float(line.intercept_stderr)),
        residuals=y - line.intercept - line.slope * x,
        outliers=outliers,
    )
