"""Candidates of a recommendation and their scores relative to each other on held-out samples."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import special

from tissueid.identification.base import Array
from tissueid.identification.correlation import dependence_samples, long_run_covariance
from tissueid.identification.model_family import Family

FEWEST = 50
"""Samples below which the spread of a difference is not estimated."""


@dataclass(frozen=True)
class VafDifference:
    """VAF of one model minus that of another on the same ``n_samples``, in percentage points.

    ``std_points`` accounts for autocorrelated errors; None with too few samples. ``p_value`` is the one-sided
    probability of such a lead if the two were equally accurate; None with too few samples. ``reduction`` is the lead as
    a share of the other's error variance.
    """

    points: float
    std_points: float | None
    p_value: float | None
    reduction: float
    n_samples: int


def difference(error: Array, other: Array, measured: Array, sample_rate_hz: float) -> VafDifference:
    """Compare two models by their squared errors, sample by sample (Diebold and Mariano 1995).

    ``error`` and ``other`` are measured minus simulated of the two, (n,); ``measured`` (n,) sets the scale. Samples
    with a NaN are left out. A constant offset does not count, as in Eq. 3.13. With fewer than two common samples, or a
    constant measurement, the result is NaN.
    """
    used = np.isfinite(error) & np.isfinite(other) & np.isfinite(measured)
    n = int(used.sum())
    variance = float(np.var(measured[used])) if n > 1 else 0.0
    if variance == 0.0:
        return VafDifference(float("nan"), None, None, float("nan"), n)
    ours, theirs = (np.square(e[used] - np.mean(e[used])) for e in (error, other))
    gain = 100.0 * (theirs - ours) / variance  # (n,) points of VAF
    points = float(np.mean(gain))
    left = float(np.mean(theirs))
    reduction = 1.0 - float(np.mean(ours)) / left if left > 0.0 else 0.0
    terms = gain - points
    if n < FEWEST or not np.any(terms):
        return VafDifference(points, None, None, reduction, n)
    covariance = long_run_covariance(terms[:, None], dependence_samples(terms, sample_rate_hz))
    std = math.sqrt(float(covariance[0, 0])) / n
    return VafDifference(points, std, float(special.ndtr(-points / std)), reduction, n)


@dataclass(frozen=True, eq=False)
class ModelCandidate:
    """An engine fitted to the record.

    ``error`` (n,) is measured minus free-run simulated output on the held-out record, NaN where it is not scored.
    ``parameters`` is the effective number of parameters. ``vaf_percent`` and ``aicc`` are scores on the fitted
    samples, ``scheduled_percent`` is the held-out VAF with the measured output as the schedule. ``second_order`` marks
    a linear model reduced to mass, damping and stiffness. ``measured`` (n,) is the output that the error is relative
    to; None for that of the held-out record.
    """

    engine: str
    family: Family
    error: Array
    parameters: float
    vaf_percent: float
    aicc: float | None = None
    scheduled_percent: float | None = None
    second_order: bool = False
    measured: Array | None = None


@dataclass(frozen=True)
class ModelStanding:
    """Scores of a :class:`ModelCandidate`, and their differences from other candidates on held-out samples.

    ``behind`` is the lead of the best candidate over this one, ``below`` the lead of the recommended one; ``beaten`` is
    true if any candidate has a significant and relevant lead over it.
    """

    engine: str
    family: Family
    second_order: bool
    vaf_percent: float
    vaf_fitted_percent: float
    scheduled_percent: float | None
    aicc: float | None
    behind: VafDifference
    below: VafDifference
    beaten: bool


@dataclass(frozen=True)
class SufficientOption:
    """An option of the recommended engine: the smallest value that scores as well as any value tried."""

    option: str
    value: float
    tried: tuple[float, ...]
    vaf_percent: tuple[float, ...]
