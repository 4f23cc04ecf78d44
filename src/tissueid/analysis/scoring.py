"""Models of one record scored on the samples that all of them can be held to, so that their figures can be compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np

from tissueid.analysis.fitting import Analysis
from tissueid.analysis.split import Split
from tissueid.identification.base import Array, FitReport, Mask, Model
from tissueid.identification.family import Family
from tissueid.identification.recommendation import Candidate
from tissueid.identification.second_order_fit import SecondOrderFit
from tissueid.identification.validation import aic, aicc, scored_samples, vaf_percent
from tissueid.identification.validation.vaf_spread import unrelated_p_value
from tissueid.records import Record

_SHARED = 0.5
"""A model that would leave the others less than this much of their samples is scored by itself."""

_SECOND_ORDER_PARAMETERS = 4
"""Mass, damping, stiffness and the offset."""


@dataclass(frozen=True, eq=False)
class Scored:
    """An analysis whose report holds the scores on shared samples.

    ``parameters`` counts the effective ones where the engine tells them. ``n_fitted`` counts the samples behind VAF
    and AICc; ``own_samples`` says that these are not the shared ones. ``error`` (n,) is that on the held-out record,
    NaN where it is not scored.
    """

    analysis: Analysis
    parameters: float
    n_fitted: int
    own_samples: bool
    error: Array


@runtime_checkable
class Reducible(Protocol):
    """A linear model with a second-order system behind it."""

    @property
    def input_mean(self) -> float:
        """Mean input, about which it works."""

    @property
    def output_mean(self) -> float:
        """Output at the mean input."""

    @property
    def second_order(self) -> SecondOrderFit:
        """The system."""


def effective_parameters(report: FitReport) -> float:
    """Parameters that a fit used: fewer than it has where a prior held them back."""
    return report.details.get("effective_parameters", float(report.n_parameters))


def scored(analyses: Sequence[Analysis], parts: Split) -> list[Scored]:
    """Score models that were fitted to one split, each on the samples that all of them can be held to."""
    unseen = parts.unseen
    simulated = [(a.model.simulate(parts.record.input), a.model.simulate(unseen.input)) for a in analyses]
    fitted, fitted_own = _shared(
        [
            scored_samples(parts.record, a.model.memory_samples, parts.fit_part) & np.isfinite(own)
            for a, (own, _) in zip(analyses, simulated, strict=True)
        ]
    )
    held_out, held_out_own = _shared(
        [
            scored_samples(unseen, a.model.memory_samples) & np.isfinite(other)
            for a, (_, other) in zip(analyses, simulated, strict=True)
        ]
    )
    found = []
    for k, analysis in enumerate(analyses):
        report, (own, other) = analysis.model.report, simulated[k]
        parameters = effective_parameters(report)
        residual = np.where(fitted[k], parts.record.output - own, np.nan)
        error = np.where(held_out[k], unseen.output - other, np.nan)
        scheduled = analysis.model.simulate_scheduled(parts.held_out_record)
        measured = unseen.output[held_out[k]]
        model = analysis.model.with_validation(
            vaf_percent(unseen.output, unseen.output - error),
            unrelated_p_value(measured, other[held_out[k]]),
            None if scheduled is None else vaf_percent(np.where(held_out[k], unseen.output, np.nan), scheduled),
        ).with_report(
            vaf_percent=vaf_percent(parts.record.output, parts.record.output - residual),
            aic=aic(residual, parameters),
            aicc=aicc(residual, parameters),
        )
        own_samples = fitted_own[k] or held_out_own[k]
        found.append(Scored(replace(analysis, model=model), parameters, int(fitted[k].sum()), own_samples, error))
    return found


def candidates(rows: Sequence[Scored], families: Sequence[Family], parts: Split) -> list[Candidate]:
    """What the recommendation chooses from: every model, and the mass, damping and stiffness behind a linear one."""
    found = [
        Candidate(
            engine=row.analysis.model.report.engine,
            family=family,
            error=row.error,
            parameters=row.parameters,
            vaf_percent=row.analysis.model.report.vaf_percent,
            aicc=row.analysis.model.report.aicc,
            scheduled_percent=row.analysis.model.report.vaf_scheduled_percent,
        )
        for row, family in zip(rows, families, strict=True)
    ]
    linear = [
        row
        for row, family in zip(rows, families, strict=True)
        if family is Family.LINEAR and isinstance(row.analysis.model, Reducible)
    ]
    best = max(linear, key=lambda row: row.analysis.model.report.vaf_percent, default=None)
    return found if best is None else [*found, _second_order(best, parts)]


def _second_order(row: Scored, parts: Split) -> Candidate:
    """The second-order system of a linear model as a candidate of its own."""
    model = row.analysis.model
    assert isinstance(model, Reducible)
    used = scored_samples(parts.record, model.memory_samples, parts.fit_part)
    residual = _second_order_error(model, parts.record, used)
    error = held_out_error(model, parts, second_order=True)
    return Candidate(
        engine=model.report.engine,
        family=Family.LINEAR,
        error=np.where(np.isfinite(row.error), error, np.nan),
        parameters=_SECOND_ORDER_PARAMETERS,
        vaf_percent=vaf_percent(parts.record.output, parts.record.output - residual),
        aicc=aicc(residual, _SECOND_ORDER_PARAMETERS),
        second_order=True,
    )


def held_out_error(model: Model, parts: Split, *, second_order: bool = False) -> Array:
    """Measured less free-run simulated output on the held-out record, (n,), NaN where the model is not scored.

    With ``second_order`` that of the second-order system behind a linear model.
    """
    unseen = parts.unseen
    used = scored_samples(unseen, model.memory_samples)
    if second_order and isinstance(model, Reducible):
        return _second_order_error(model, unseen, used)
    return np.where(used, unseen.output - model.simulate(unseen.input), np.nan)


def _second_order_error(model: Reducible, record: Record, used: Mask) -> Array:
    received = np.where(np.isfinite(record.input), record.input - model.input_mean, 0.0)
    return np.where(used, record.output - model.output_mean - model.second_order.simulate(received), np.nan)


def _shared(masks: Sequence[Mask]) -> tuple[list[Mask], list[bool]]:
    """The samples that all masks (n,) share, for each; and whether it keeps its own instead, as it leaves too few."""
    own = [False] * len(masks)
    while True:
        together = [k for k in range(len(masks)) if not own[k]]
        common = np.logical_and.reduce([masks[k] for k in together])
        if common.sum() >= _SHARED * max(masks[k].sum() for k in together):
            return [masks[k] if own[k] else common for k in range(len(masks))], own
        own[min(together, key=lambda k: int(masks[k].sum()))] = True
