"""Scores of a model on a record: variance accounted for, information criteria, held-out simulation.

Samples that were not received are NaN and are never interpolated. An output sample is scored only if it and every input
sample that it depends on were received.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from scipy.special import stdtr

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Mask, Model
from tissueid.identification.correlation import Correlator, dependence_samples, long_run_covariance
from tissueid.identification.preparation import scored_samples
from tissueid.messages import Message
from tissueid.records import Record

_FEWEST = 8
"""Samples below which no significance is computed."""

_LEAST = 1e-12
"""Lower bound on the unexplained share of the variance in the t statistic."""


_LEAST_SHARE = 1e-2
_LEAST_SHARE_ALIKE = 1e-4
"""Least variance of a held-out output relative to the fitted one: if it looks like noise, and if it does not."""


def vaf_std_percent(measured: Array, error: Array, sample_rate_hz: float) -> float:
    """Return the standard deviation of a VAF (Eq. 3.13), percentage points, over similar records.

    ``measured`` and ``error`` have shape (n,) and hold no NaN.
    """
    return 100.0 * ratio_std((error - error.mean()) ** 2, (measured - measured.mean()) ** 2, sample_rate_hz)


def above_noise(measured: Array, fitted: Array | None = None) -> bool:
    """Return whether an output (n,), NaN where it is unknown, varies above its noise, so that it can be scored.

    It does if its variance is not far below that of the ``fitted`` output (m,) or, above a smaller share, if neighbours
    are more alike than noise is: their mean squared difference is 2 variances for white noise (von Neumann 1941).
    """
    known = np.isfinite(measured)
    variance = float(np.var(measured[known])) if known.sum() > 1 else 0.0
    if variance == 0.0:
        return False
    steps = np.diff(measured)
    alike = float(np.nanmean(steps**2)) < variance if np.isfinite(steps).any() else False
    if fitted is None or not np.isfinite(fitted).any():
        return alike
    share = variance / max(float(np.nanvar(fitted)), 1e-300)
    return share > (_LEAST_SHARE_ALIKE if alike else _LEAST_SHARE)


def unrelated_p_value(measured: Array, simulated: Array) -> float:
    """Return the one-sided p-value of a simulation against independent simulations; 1 for no fit.

    Both have shape (n,) and no NaN. Their correlation is tested by Student's t with the effective sample size that
    follows from both autocorrelations (Bartlett 1935).
    """
    n = measured.size
    if n < _FEWEST:
        return 1.0
    y, modelled = measured - measured.mean(), simulated - simulated.mean()
    lags = n // 4
    powers = [Correlator(values, lags).auto() for values in (y, modelled)]
    if not (powers[0][0] > 0.0 and powers[1][0] > 0.0):
        return 1.0
    related = (powers[0] / powers[0][0]) * (powers[1] / powers[1][0])  # (lags,)
    independent = n / max(1.0, 1.0 + 2.0 * float(related[1:].sum()))
    correlation = float(y @ modelled) / np.sqrt(float(y @ y) * float(modelled @ modelled))
    if independent <= 2.0 or correlation <= 0.0:
        return 1.0
    freedom = independent - 2.0
    return float(stdtr(freedom, -correlation * np.sqrt(freedom / max(1.0 - correlation**2, _LEAST))))


def ratio_std(power: Array, whole: Array, sample_rate_hz: float) -> float:
    """Return the standard deviation of the ratio of two mean powers, from (n,) each, by the delta method."""
    mean = float(np.mean(whole))
    if not mean > 0.0 or power.size < 2:
        return float("nan")
    ratio = float(np.mean(power)) / mean
    terms = (power - ratio * whole) / mean  # zero mean; its sum over n is the error of the ratio
    block = max(dependence_samples(power, sample_rate_hz), dependence_samples(whole, sample_rate_hz))
    return float(np.sqrt(long_run_covariance(terms[:, None], block)[0, 0])) / power.size


NO_SAMPLE = Message(
    "score.no_sample", "no sample is left to score: the part is shorter than the memory, or full of gaps"
)

AnyModel = TypeVar("AnyModel", bound=Model)


@dataclass(frozen=True)
class Score:
    """Score of a free-run simulation against the measured output.

    ``vaf_percent`` ignores a constant offset, as Eq. 3.13 does; ``nrmse_percent``, the root-mean-square error over
    the standard deviation of the measurement, does not. ``offset`` is the mean error, in the output's unit.
    """

    vaf_percent: float
    nrmse_percent: float
    offset: float
    n_samples: int


def vaf_percent(measured: Array, modelled: Array) -> float:
    """Return the variance accounted for, % (Eq. 3.13), over the samples where both arrays (n,) are finite.

    Negative if the error varies more than the measurement. NaN with fewer than two samples, or if the measurement is
    constant.
    """
    used = np.isfinite(measured) & np.isfinite(modelled)
    if used.sum() < 2:
        return float("nan")
    variance = float(np.var(measured[used]))
    if variance == 0.0:
        return float("nan")
    return 100.0 * (1.0 - float(np.var(measured[used] - modelled[used])) / variance)


def aic(residuals: Array, n_parameters: float) -> float:
    """Return Akaike's information criterion of Gaussian residuals (n,) (Eqs. 3.14-3.15); NaN are ignored."""
    finite = residuals[np.isfinite(residuals)]
    if finite.size == 0:
        return float("nan")
    rss = float(finite @ finite)
    if rss == 0.0:
        return float("-inf")
    return 2.0 * n_parameters + finite.size * (math.log(2.0 * math.pi * rss / finite.size) + 1.0)


def aicc(residuals: Array, n_parameters: float) -> float:
    """Return AIC with the second-order correction for few samples (Eq. 3.16); NaN if n <= k + 1."""
    n = int(np.isfinite(residuals).sum())
    if n <= n_parameters + 1:
        return float("nan")
    return aic(residuals, n_parameters) + 2.0 * n_parameters * (n_parameters + 1) / (n - n_parameters - 1)


def score(record: Record, simulated: Array, used: Mask) -> Score:
    """Score a simulation (n,) on the samples of a mask (n,).

    Raises:
        UnusableInputError: fewer than two samples can be scored.
    """
    used = used & np.isfinite(simulated)
    if used.sum() < 2:
        raise UnusableInputError(NO_SAMPLE)
    measured = record.output[used]
    error = measured - simulated[used]
    spread = float(np.std(measured))
    return Score(
        vaf_percent=vaf_percent(measured, simulated[used]),
        nrmse_percent=100.0 * float(np.sqrt(np.mean(error**2))) / spread if spread > 0.0 else float("nan"),
        offset=float(np.mean(error)),
        n_samples=int(used.sum()),
    )


def validate(model: Model, record: Record, part: slice | None = None) -> Score:
    """Score free-run simulation on held-out samples.

    The model is simulated from the start of the record's input. Only samples of ``part`` are scored (the whole record
    for None), without the memory after the start and after gaps.

    Raises:
        UnusableInputError: the sample rates differ, or no sample is left to score.
    """
    model.check_rate(record)
    return score(record, model.simulate(record.input), scored_samples(record, model.memory_samples, part))


def validated(model: AnyModel, record: Record, part: slice | None = None) -> AnyModel:
    """Return a copy of the model with the scores on held-out samples in its report.

    Raises:
        UnusableInputError: as :func:`validate`.
    """
    model.check_rate(record)
    used = scored_samples(record, model.memory_samples, part)
    simulated = model.simulate(record.input)
    held_out = score(record, simulated, used)
    scored = used & np.isfinite(simulated)
    measured = record.output[scored]
    p_value = unrelated_p_value(measured, simulated[scored])
    scheduled = model.simulate_scheduled(record)
    return model.with_validation(
        held_out.vaf_percent, p_value, None if scheduled is None else score(record, scheduled, used).vaf_percent
    )
