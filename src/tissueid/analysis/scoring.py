"""Scores of several models of one record on the same samples, so that they can be compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np

from tissueid.analysis.fitting import Analysis
from tissueid.analysis.split import Split
from tissueid.identification.base import Array, Family, FitReport, Mask, Model
from tissueid.identification.preparation import scored_samples
from tissueid.identification.recommendation_messages import ModelCandidate
from tissueid.identification.second_order_fit import SecondOrderFit
from tissueid.identification.validation import aic, aicc, vaf_percent
from tissueid.identification.validation.scores import unrelated_p_value
from tissueid.records import Record

_SHARED = 0.5
"""Smallest share of the other models' samples that must remain. A model that leaves fewer is scored on its own."""

_SECOND_ORDER_PARAMETERS = 4
"""Number of parameters of the second-order model: mass, damping, stiffness and offset."""


@dataclass(frozen=True, eq=False)
class Scored:
    """An analysis whose report holds the scores on shared samples.

    ``parameters`` is the effective number of parameters where the engine reports it. ``residual`` (n,) is the error on
    the fitted record, from which VAF and AICc follow, and ``error`` (n,) that on the held-out record; NaN where it is
    not scored. ``own_samples`` is true where the scored samples are not the shared ones.
    """

    analysis: Analysis
    parameters: float
    own_samples: bool
    residual: Array
    error: Array

    @property
    def n_fitted(self) -> int:
        """Number of samples of VAF and AICc."""
        return int(np.isfinite(self.residual).sum())

    @property
    def aicc(self) -> float | None:
        """AICc; None where the model was scored on its own samples, as it cannot be compared."""
        return None if self.own_samples else self.analysis.model.report.aicc


@runtime_checkable
class Reducible(Protocol):
    """A linear model that also holds a second-order system."""

    @property
    def input_mean(self) -> float:
        """Mean input: the operating point."""

    @property
    def output_mean(self) -> float:
        """Output at the mean input."""

    @property
    def second_order(self) -> SecondOrderFit:
        """The second-order system fitted to the model's response."""


def effective_parameters(report: FitReport) -> float:
    """Return the effective number of parameters: below the number of parameters where a prior restricts them."""
    return report.details.get("effective_parameters", float(report.n_parameters))


def scored(analyses: Sequence[Analysis], parts: Split) -> list[Scored]:
    """Score models of one split, each on the samples that all of them can simulate."""
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
        model = analysis.model.with_validation(
            vaf_percent(unseen.output, unseen.output - error),
            unrelated_p_value(analysis.model, unseen, other, held_out[k]),
            None if scheduled is None else vaf_percent(np.where(held_out[k], unseen.output, np.nan), scheduled),
        ).with_report(
            vaf_percent=vaf_percent(parts.record.output, parts.record.output - residual),
            aic=aic(residual, parameters),
            aicc=aicc(residual, parameters),
        )
        model = model if parts.scorable else model.without_validation()
        own_samples = fitted_own[k] or held_out_own[k]
        found.append(Scored(replace(analysis, model=model), parameters, own_samples, residual, error))
    return found


def candidates(rows: Sequence[Scored], families: Sequence[Family], parts: Split) -> list[ModelCandidate]:
    """Return the candidates of a recommendation: every model, and the second-order system of the best linear one."""
    found = [
        ModelCandidate(
            engine=row.analysis.model.report.engine,
            family=family,
            error=row.error,
            parameters=row.parameters,
            vaf_percent=row.analysis.model.report.vaf_percent,
            aicc=row.aicc,
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


def _second_order(row: Scored, parts: Split) -> ModelCandidate:
    """Return the second-order system of a linear model as a separate candidate."""
    model = row.analysis.model
    assert isinstance(model, Reducible)
    residual = _second_order_error(model, parts.record, np.isfinite(row.residual))
    error = held_out_error(model, parts, second_order=True)
    return ModelCandidate(
        engine=model.report.engine,
        family=Family.LINEAR,
        error=np.where(np.isfinite(row.error), error, np.nan),
        parameters=_SECOND_ORDER_PARAMETERS,
        vaf_percent=vaf_percent(parts.record.output, parts.record.output - residual),
        aicc=None if row.own_samples else aicc(residual, _SECOND_ORDER_PARAMETERS),
        second_order=True,
    )


def held_out_error(model: Model, parts: Split, *, second_order: bool = False) -> Array:
    """Return measured minus free-run simulated output on the held-out record, (n,), NaN where it is not scored.

    ``second_order`` takes the second-order system of a linear model in place of the model.
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
    """Return for each mask (n,) the samples to score, and whether they are its own because it shares too few."""
    own = [False] * len(masks)
    while True:
        together = [k for k in range(len(masks)) if not own[k]]
        common = np.logical_and.reduce([masks[k] for k in together])
        if common.sum() >= _SHARED * max(masks[k].sum() for k in together):
            return [masks[k] if own[k] else common for k in range(len(masks))], own
        own[min(together, key=lambda k: int(masks[k].sum()))] = True


def scheduled_scores(analysis: Analysis) -> tuple[float | None, float | None]:
    """Return VAF (percent) and AICc of the run scheduled by the measured output, on the fitted samples."""
    model, record = analysis.model, analysis.record
    run = model.simulate_scheduled(record)
    if run is None:
        return None, None
    residual = (record.output - run)[analysis.fit_part]
    known = np.isfinite(residual)
    measured = record.output[analysis.fit_part][known]
    return vaf_percent(measured, measured - residual[known]), aicc(residual, model.report.n_parameters)
