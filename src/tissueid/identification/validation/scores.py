"""Scores of a model against a record: variance accounted for, information criteria, held-out simulation.

Samples that were not received are NaN and are never filled in. An output sample counts only when it was received
and every input sample that it depends on was received too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Mask, Model
from tissueid.identification.validation.vaf_spread import unrelated_p_value
from tissueid.records import Record

AnyModel = TypeVar("AnyModel", bound=Model)


@dataclass(frozen=True)
class Score:
    """How well a free-run simulation met the measured output.

    ``vaf_percent`` ignores a constant offset, as Eq. 3.13 does; ``nrmse_percent``, the root-mean-square error over
    the standard deviation of the measurement, does not. ``offset`` is the mean error, in the output's unit.
    """

    vaf_percent: float
    nrmse_percent: float
    offset: float
    n_samples: int


def vaf_percent(measured: Array, modelled: Array) -> float:
    """Variance accounted for, in percent (Eq. 3.13), over the samples where both arrays of shape (n,) are finite.

    Negative when the model errs by more than the measurement varies. NaN when fewer than two samples are left or
    the measurement does not vary.
    """
    used = np.isfinite(measured) & np.isfinite(modelled)
    if used.sum() < 2:
        return float("nan")
    variance = float(np.var(measured[used]))
    if variance == 0.0:
        return float("nan")
    return 100.0 * (1.0 - float(np.var(measured[used] - modelled[used])) / variance)


def aic(residuals: Array, n_parameters: float) -> float:
    """Akaike's information criterion of Gaussian residuals of shape (n,) (Eqs. 3.14-3.15); NaN are left out."""
    finite = residuals[np.isfinite(residuals)]
    if finite.size == 0:
        return float("nan")
    rss = float(finite @ finite)
    if rss == 0.0:
        return float("-inf")
    return 2.0 * n_parameters + finite.size * (math.log(2.0 * math.pi * rss / finite.size) + 1.0)


def aicc(residuals: Array, n_parameters: float) -> float:
    """AIC with the second-order correction for few samples (Eq. 3.16); NaN when n <= k + 1."""
    n = int(np.isfinite(residuals).sum())
    if n <= n_parameters + 1:
        return float("nan")
    return aic(residuals, n_parameters) + 2.0 * n_parameters * (n_parameters + 1) / (n - n_parameters - 1)


def complete_windows(finite: Mask, length: int) -> Mask:
    """True at each sample whose window of ``length`` samples, ending there, lies in the array and is all True.

    Shape (n,) in and out. With ``finite`` the mask of received inputs, these are the outputs that a model with
    that memory can be held to.
    """
    missing = np.concatenate([[0], np.cumsum(~finite)])  # (n + 1,)
    complete = np.zeros(finite.size, dtype=np.bool_)
    if finite.size >= length:
        complete[length - 1 :] = missing[length:] == missing[:-length]
    return complete


def finite_runs(finite: Mask) -> NDArray[np.intp]:
    """First sample and end of each run of True, shape (runs, 2)."""
    steps = np.diff(np.concatenate([[0], finite.astype(np.int8), [0]]))
    return np.flatnonzero(steps).reshape(-1, 2)


def part_mask(n: int, part: slice | None) -> Mask:
    """Boolean mask, shape (n,), of a contiguous part of a record; all True for None.

    Raises:
        UnusableInputError: the part has a step or holds no sample.
    """
    mask = np.ones(n, dtype=np.bool_)
    if part is not None:
        if part.step not in (None, 1):
            raise UnusableInputError(f"a part of a record must be contiguous, not every {part.step} samples")
        mask[:] = False
        mask[part] = True
    if not mask.any():
        raise UnusableInputError("the chosen part of the record holds no samples")
    return mask


def scored_samples(record: Record, memory_samples: int, part: slice | None = None) -> Mask:
    """Mask, shape (n,), of the outputs in ``part`` that a model of this memory can be held to."""
    return (
        part_mask(len(record), part)
        & np.isfinite(record.output)
        & complete_windows(np.isfinite(record.input), memory_samples)
    )


def score(record: Record, simulated: Array, used: Mask) -> Score:
    """Score a simulation, shape (n,), on the samples of a mask.

    Raises:
        UnusableInputError: fewer than two samples can be scored.
    """
    used = used & np.isfinite(simulated)
    if used.sum() < 2:
        raise UnusableInputError("no sample is left to score: the part is shorter than the memory, or full of gaps")
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

    The model is run from the start of the record's input and sees nothing else; only the samples of ``part``
    (all of the record when None, as for another test) are scored, less the memory after the start and after gaps.

    Raises:
        UnusableInputError: the sample rates differ, or no sample is left to score.
    """
    model.check_rate(record)
    return score(record, model.simulate(record.input), scored_samples(record, model.memory_samples, part))


def validated(model: AnyModel, record: Record, part: slice | None = None) -> AnyModel:
    """Return the model with its report's validation figures filled in from held-out samples.

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
