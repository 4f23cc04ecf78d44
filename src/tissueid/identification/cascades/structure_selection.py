"""Selection of the block structure that a record supports, and a test whether it is complete.

Every structure is scored by 4-fold cross-validation of its free run. Two structures are compared by the mean difference
of their squared errors on the same samples, with a standard error that accounts for autocorrelation. A structure is
reported by name only if nonlinear functions of its own signals do not explain its residual, because some structure fits
best even if the system has none of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft, linalg, stats

from tissueid.identification.base import Array
from tissueid.identification.cascades.blocks import (
    SPECIAL_CASES,
    STRUCTURES,
    Blocks,
    CascadeData,
    Signals,
    Structure,
    run,
    slopes,
)
from tissueid.identification.cascades.fit import FittedCascade, fit_linear, refine, solve_with_ridge
from tissueid.identification.impulse_response import dependence_samples, long_run_covariance
from tissueid.identification.validation import aicc
from tissueid.language import marked
from tissueid.messages import Listing, Message

_HIGHEST_DEGREE = 3
"""Highest degree of the products."""

_UNDETERMINED = 1e-9
"""Share of the largest eigenvalue below which a combination of products is linearly dependent."""


@dataclass(frozen=True)
class RemainderTest:
    """Share of a cascade's residual that products of its own signals explain, beyond the share expected for noise.

    ``share`` is relative to the residual variance; ``p_value`` is that of noise with the residual's autocorrelation.
    """

    share: float
    p_value: float


def remainder_test(blocks: Blocks, data: CascadeData) -> RemainderTest:
    """Test the residual of fitted blocks on the rows of the fit."""
    signals = run(blocks, data)
    error = data.measured - signals.output[data.rows]
    by_all = slopes(blocks, data, signals)
    gram = by_all @ by_all.T
    products = _products(signals, blocks, data)
    products -= solve_with_ridge(gram, by_all @ products.T).T @ by_all  # project out the derivatives of the model
    error = error - solve_with_ridge(gram, by_all @ error) @ by_all
    size = np.linalg.norm(products, axis=1)
    products /= np.where(size > 0.0, size, 1.0)[:, None]
    values, vectors = linalg.eigh(products @ products.T)
    kept = values > _UNDETERMINED * values[-1]
    products = (vectors[:, kept] / np.sqrt(values[kept])).T @ products  # orthonormal, (k, rows)
    score = products @ error
    n, k = data.rows.size, int(kept.sum())
    free = n - blocks.n_parameters
    if free <= 2 * k:
        return RemainderTest(0.0, 1.0)
    covariance = _covariance(products, error, data) * n / free
    statistic = float(score @ linalg.solve(covariance, score, assume_a="pos")) / k
    by_chance = float(np.trace(covariance))
    share = max(0.0, float(score @ score) - by_chance) / float(error @ error)
    return RemainderTest(share, float(stats.f.sf(statistic, k, free - k)))


def _covariance(products: Array, error: Array, data: CascadeData) -> Array:
    """Return the covariance (k, k) of sums of products (k, rows) with noise of the residual's autocovariance."""
    lags = dependence_samples(error, data.prepared.record.sample_rate_hz)
    if lags == 1:
        return np.asarray(products @ products.T * float(error @ error) / error.size)
    n = data.input.size
    length = fft.next_fast_len(2 * n, real=True)
    placed, indicator = np.zeros(n), np.zeros(n)
    placed[data.rows], indicator[data.rows] = error, 1.0
    pairs = fft.irfft(np.abs(fft.rfft(indicator, length)) ** 2, length)
    together = fft.irfft(np.abs(fft.rfft(placed, length)) ** 2, length)
    lag = np.minimum(np.arange(length), length - np.arange(length))
    weights = np.maximum(0.0, 1.0 - lag / lags)  # Bartlett's, which keep the covariance positive semidefinite
    power = np.maximum(fft.rfft(together / np.maximum(pairs, 1.0) * weights, length).real, 0.0)
    spread = np.zeros((products.shape[0], n))
    spread[:, data.rows] = products
    coloured = fft.irfft(fft.rfft(spread, length) * power, length)[:, :n]
    return np.asarray(coloured @ spread.T)


def _products(passing: Signals, blocks: Blocks, data: CascadeData) -> Array:
    """Return products (k, rows) of the input, the modelled output and its velocity, unfiltered and filtered by the last
    kernel.
    """
    output = passing.output
    signals = [data.input - data.rest, output - blocks.offset, np.gradient(output)]
    signals = [signal / (float(np.std(signal[data.rows])) or 1.0) for signal in signals]
    products = [
        np.prod([signals[k] for k in places], axis=0)
        for degree in range(1, _HIGHEST_DEGREE + 1)
        for places in combinations_with_replacement(range(len(signals)), degree)
    ]
    plain = np.array(products)  # (k, n)
    weights = blocks.first if blocks.second is None else blocks.second
    return np.concatenate([plain, data.bank.apply(weights, plain)])[:, data.rows]


NAMES: Mapping[Structure, str] = {
    "linear": marked("a linear system"),
    "wiener": marked("a Wiener system"),
    "hammerstein": marked("a Hammerstein system"),
    "lnl": marked("an LNL system"),
    "nln": marked("an NLN system"),
}
"""Names of the structures in findings."""

_ORDERS: Mapping[Structure, str] = {
    "linear": marked("one kernel"),
    "wiener": marked("linear dynamics and then a static curve"),
    "hammerstein": marked("a static curve and then linear dynamics"),
    "lnl": marked("a static curve between linear dynamics"),
    "nln": marked("linear dynamics between static curves"),
}

_AND = marked(" and ")

_FOLDS = 4
_FOLD_STEPS, _FOLD_TOLERANCE = 8, 1e-5

_SIGNIFICANT_STD = 2.33
"""Significance threshold of a lead, in standard errors: exceeded by chance with a probability of 1 %."""

_RELEVANT_SHARE = 2e-4
"""Smallest relevant lead, as a share of the output variance: curves of finite degree differ by less."""

_REJECTED_RATIO = 2.0
"""Ratio to the smallest squared error above which a structure is rejected regardless of significance."""

_LEAST_PERCENT = 10.0
"""Smallest held-out VAF, %, for which a structure is named."""

_SIGNIFICANCE_LEVEL = 0.01
"""Significance level of the residual test."""


@dataclass(frozen=True)
class StructureCandidate:
    """One structure: cross-validated VAF of its free run, and its difference from the best structure.

    ``behind`` is the excess of its mean squared error over that of the best structure, in standard errors, and
    ``lost_percent`` the same in percent of the output variance; ``alike`` is true if this is not significant.
    ``unexplained_percent`` is the share of its residual that products of its own signals explain, and
    ``unexplained_p_value`` the p-value of that share; both are None if not alike.
    """

    structure: Structure
    vaf_held_out_percent: float
    aicc: float
    behind: float
    lost_percent: float
    alike: bool
    unexplained_percent: float | None = None
    unexplained_p_value: float | None = None

    @property
    def complete(self) -> bool:
        """Whether its own signals explain no significant and relevant part of its residual."""
        if self.unexplained_p_value is None or self.unexplained_percent is None:
            return False
        worth = self.unexplained_percent * (1.0 - 0.01 * self.vaf_held_out_percent)
        return self.unexplained_p_value > _SIGNIFICANCE_LEVEL or worth < 100.0 * _RELEVANT_SHARE


@dataclass(frozen=True)
class StructureChoice:
    """The structure chosen from the candidates.

    ``alike`` are the structures that the record does not distinguish: not worse than the best, and complete. The chosen
    structure is the simplest of them. If there is none, the best is chosen and ``complete`` is False: the system has
    another structure. ``determined`` is True if no other structure of the same complexity is alike, and the chosen one
    explains a minimum share of the output and beats its special cases both by AICc and in cross-validation.
    """

    structure: Structure
    candidates: tuple[StructureCandidate, ...]
    alike: tuple[Structure, ...]
    determined: bool
    complete: bool

    @property
    def chosen(self) -> StructureCandidate:
        """The scores of the chosen structure."""
        return next(candidate for candidate in self.candidates if candidate.structure == self.structure)

    @property
    def confident(self) -> bool:
        """Whether the chosen structure may be reported by name."""
        return self.determined and self.complete


def choose(fits: Mapping[Structure, FittedCascade], data: CascadeData) -> StructureChoice:
    """Choose a structure by cross-validation.

    Args:
        found: the structures, each fitted to all rows of the data.
        data: the record.
    """
    folds = np.array_split(np.arange(data.rows.size), _FOLDS)
    refitted = {structure: _refitted(fitted, data, folds) for structure, fitted in fits.items()}
    errors = {structure: _held_out_errors(parts, data, folds) for structure, parts in refitted.items()}
    variance = float(np.var(data.measured))
    sizes = {structure: float(np.mean(error**2)) for structure, error in errors.items()}
    best = min(sizes, key=lambda structure: sizes[structure])
    rate = data.prepared.record.sample_rate_hz
    candidates = []
    for structure in STRUCTURES:
        if structure not in errors:
            continue
        lost = errors[structure] ** 2 - errors[best] ** 2
        behind, share = _lead_in_standard_errors(lost, rate), float(np.mean(lost)) / variance
        error = data.measured - run(fits[structure].blocks, data).output[data.rows]
        candidate = StructureCandidate(
            structure=structure,
            vaf_held_out_percent=100.0 * (1.0 - sizes[structure] / variance),
            aicc=aicc(error, fits[structure].blocks.n_parameters),
            behind=behind,
            lost_percent=100.0 * share,
            alike=share < _RELEVANT_SHARE
            or (behind < _SIGNIFICANT_STD and sizes[structure] < _REJECTED_RATIO * sizes[best]),
        )
        if candidate.alike:
            remainder = remainder_test(fits[structure].blocks, data)
            candidate = replace(
                candidate, unexplained_percent=100.0 * remainder.share, unexplained_p_value=remainder.p_value
            )
        candidates.append(candidate)
    alike = [candidate for candidate in candidates if candidate.alike and candidate.complete]
    simplest = [
        candidate
        for candidate in alike
        if not any(other.structure in SPECIAL_CASES[candidate.structure] for other in alike)
    ]
    leading = next(candidate for candidate in candidates if candidate.structure == best)
    chosen = max(simplest, key=lambda candidate: candidate.vaf_held_out_percent, default=leading)
    return StructureChoice(
        structure=chosen.structure,
        candidates=tuple(candidates),
        alike=tuple(candidate.structure for candidate in alike),
        determined=len(simplest) == 1
        and chosen.vaf_held_out_percent > _LEAST_PERCENT
        and not _special_cases_not_beaten(chosen, candidates),
        complete=bool(alike),
    )


def _special_cases_not_beaten(chosen: StructureCandidate, candidates: Iterable[StructureCandidate]) -> list[Structure]:
    """Return the special cases of a structure that it does not beat both in cross-validation and by AICc."""
    simpler = [candidate for candidate in candidates if candidate.structure in SPECIAL_CASES[chosen.structure]]
    return [
        candidate.structure
        for candidate in simpler
        if candidate.aicc <= chosen.aicc or candidate.vaf_held_out_percent >= chosen.vaf_held_out_percent
    ]


def structure_findings(choice: StructureChoice) -> tuple[str, ...]:
    """Return one sentence on the chosen structure, which is named only if the record determines it."""
    chosen = choice.chosen
    values: dict[str, Any] = {"name": NAMES[choice.structure], "percent": chosen.vaf_held_out_percent}
    if chosen.vaf_held_out_percent <= _LEAST_PERCENT:
        return (
            Message(
                "cascade.nothing_explained",
                "no block structure explains this record: {name} is the closest (held-out free run {percent:.1f} %)",
                **values,
            ),
        )
    if not choice.complete:
        return (
            Message(
                "cascade.none_complete",
                "none of the block structures: {name} is the closest (held-out free run {percent:.1f} %), but products "
                "of its own signals explain {left:.0f} % of its error",
                left=chosen.unexplained_percent or 0.0,
                **values,
            ),
        )
    if not choice.determined:
        level = [
            NAMES[structure]
            for structure in choice.alike
            if not any(other in SPECIAL_CASES[structure] for other in choice.alike)
        ]
        simpler = [NAMES[structure] for structure in _special_cases_not_beaten(chosen, choice.candidates)]
        return (
            Message(
                "cascade.undetermined",
                "the record does not distinguish {names} (held-out free run {percent:.1f} %)",
                names=Listing((*simpler, *level), _AND),
                percent=chosen.vaf_held_out_percent,
            ),
        )
    rivals = [candidate for candidate in choice.candidates if candidate.structure not in choice.alike]
    if not rivals:
        return (
            Message(
                "cascade.best",
                "{name}: no other block structure does better (held-out free run {percent:.1f} %)",
                **values,
            ),
        )
    near = max(rivals, key=lambda candidate: candidate.vaf_held_out_percent)
    return (
        Message(
            "cascade.determined",
            "{name}, {order} (held-out free run {percent:.1f} %; {rival} {other:.1f} %, {errors:.1f} standard errors "
            "behind)",
            order=_ORDERS[choice.structure],
            rival=NAMES[near.structure],
            other=near.vaf_held_out_percent,
            errors=near.behind,
            **values,
        ),
    )


def structure_warnings(choice: StructureChoice) -> tuple[str, ...]:
    """Return a warning if the residual of the chosen structure is not noise."""
    if choice.complete:
        return ()
    return (
        Message(
            "cascade.incomplete",
            "the error of the {structure} cascade is not noise: the system is none of the block structures; parameters "
            "that vary with depth would look like this",
            structure=choice.structure,
        ),
    )


def _refitted(fitted: FittedCascade, data: CascadeData, folds: list[NDArray[np.intp]]) -> list[Blocks]:
    """Return the blocks refitted without each fold."""
    answers = []
    for fold in folds:
        held_out = np.zeros(data.input.size, dtype=np.bool_)
        held_out[data.rows[fold]] = True
        others = data.without(held_out)
        if fitted.blocks.structure == "linear":
            answers.append(fit_linear(others).blocks)
        else:
            answers.append(refine(fitted.blocks, others, _FOLD_STEPS, _FOLD_TOLERANCE).blocks)
    return answers


def _held_out_errors(refitted: list[Blocks], data: CascadeData, folds: list[NDArray[np.intp]]) -> Array:
    """Return the errors (rows,) of the free run, for each fold by the blocks fitted without it."""
    errors = np.empty(data.rows.size)
    for fold, blocks in zip(folds, refitted, strict=True):
        errors[fold] = data.measured[fold] - run(blocks, data).output[data.rows[fold]]
    return errors


def _lead_in_standard_errors(gains: Array, sample_rate_hz: float) -> float:
    """Return the mean of autocorrelated gains (n,) in units of its standard error; 0 if all are equal."""
    spread = float(np.std(gains))
    if spread == 0.0:
        return 0.0
    centred = gains - gains.mean()
    variance = float(long_run_covariance(centred[:, None], dependence_samples(centred, sample_rate_hz))[0, 0])
    return float(gains.sum()) / float(np.sqrt(variance))
