"""Scores of a model on a record: variance accounted for, information criteria, held-out simulation.

Samples that were not received are NaN and are never interpolated. An output sample is scored only if it and every input
sample that it depends on were received.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from typing import TypeVar

import numpy as np
from scipy.special import stdtr

from tissueid.errors import UnusableInputError
from tissueid.identification.base import SIGNIFICANT, Array, Mask, Model, vaf_percent
from tissueid.identification.impulse_response import Correlator, dependence_samples, long_run_covariance
from tissueid.identification.preparation import scored_samples
from tissueid.messages import Message
from tissueid.records import Record

_FEWEST = 8
"""Samples below which no significance is computed."""

_LEAST = 1e-12
"""Lower bound on the unexplained share of the variance in the t statistic."""

_FEW_INDEPENDENT = 30.0
"""Effective sample size below which the t test is confirmed by shifted inputs: a trend has too few of its own."""
_SHIFTS = 39
"""Number of shifted inputs: the smallest p-value that they can give is 1 / 40."""
_REPEATED = 0.9
"""Correlation of an input with its shifted self from which the shift repeats a periodic input and is not used."""

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
    finite = np.isfinite(measured)
    variance = float(np.var(measured[finite])) if finite.sum() > 1 else 0.0
    if variance == 0.0:
        return False
    steps = np.diff(measured)
    alike = float(np.nanmean(steps**2)) < variance if np.isfinite(steps).any() else False
    if fitted is None or not np.isfinite(fitted).any():
        return alike
    share = variance / max(float(np.nanvar(fitted)), 1e-300)
    return share > (_LEAST_SHARE_ALIKE if alike else _LEAST_SHARE)


def _related(measured: Array, simulated: Array) -> tuple[float, float]:
    """Return one-sided p-value and effective sample size of a simulation against independent ones; 1 for no fit.

    Both have shape (n,) and no NaN. Their correlation is tested by Student's t with the effective sample size that
    follows from both autocorrelations (Bartlett 1935).
    """
    n = measured.size
    if n < _FEWEST:
        return 1.0, 0.0
    y, modelled = measured - measured.mean(), simulated - simulated.mean()
    lags = n // 4
    powers = [Correlator(values, lags).auto() for values in (y, modelled)]
    if not (powers[0][0] > 0.0 and powers[1][0] > 0.0):
        return 1.0, 0.0
    related = (powers[0] / powers[0][0]) * (powers[1] / powers[1][0])  # (lags,)
    independent = n / max(1.0, 1.0 + 2.0 * float(related[1:].sum()))
    correlation = float(y @ modelled) / np.sqrt(float(y @ y) * float(modelled @ modelled))
    if independent <= 2.0 or correlation <= 0.0:
        return 1.0, independent
    freedom = independent - 2.0
    p_value = float(stdtr(freedom, -correlation * np.sqrt(freedom / max(1.0 - correlation**2, _LEAST))))
    return p_value, independent


def unrelated_p_value(model: Model, record: Record, simulated: Array, used: Mask) -> float:
    """Return the p-value of a free run (n,) on the samples of a mask (n,) against simulations unrelated to the output.

    Their correlation is tested with its effective sample size. Where that is small, as for a drift, the same model is
    also run with the input shifted in time, by 39 lags of at least a tenth of the record, and the larger of the two
    p-values is returned: what the model describes as well with another input does not come from the input. Lags that
    repeat a periodic input are not among them.
    """
    used = used & np.isfinite(simulated) & np.isfinite(record.output)
    measured = record.output[used]
    p_value, independent = _related(measured, simulated[used])
    if p_value > SIGNIFICANT or independent > _FEW_INDEPENDENT:
        return p_value
    least, n = vaf_percent(measured, simulated[used]), record.input.size
    lags = np.random.default_rng(_SHIFTS).integers(n // 10, n - n // 10, 10 * _SHIFTS)
    x = np.nan_to_num(record.input, nan=float(np.nanmean(record.input)))
    others = islice((lag for lag in lags if not _repeats(np.roll(x, lag)[used], x[used])), _SHIFTS)
    as_good = [vaf_percent(measured, model.simulate(np.roll(record.input, lag))[used]) >= least for lag in others]
    return max(p_value, (1 + sum(as_good)) / (1 + len(as_good)))


def _repeats(shifted: Array, x: Array) -> bool:
    """Return whether a shifted input (n,) is nearly the input (n,) again."""
    a, b = shifted - shifted.mean(), x - x.mean()
    return float(a @ b) > _REPEATED * float(np.sqrt((a @ a) * (b @ b)))


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
    p_value = unrelated_p_value(model, record, simulated, used)
    scheduled = model.simulate_scheduled(record)
    return model.with_validation(
        held_out.vaf_percent, p_value, None if scheduled is None else score(record, scheduled, used).vaf_percent
    )
