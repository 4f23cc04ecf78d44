"""Recommendation of an engine: the simplest model that no other beats on held-out data.

Engines are compared by their free runs on the same held-out samples. A simpler model is rejected only for a lead that
is significant and relevant. AICc decides only between models of one family that held-out samples do not separate,
because it assumes independent residuals, which residuals of tissue at kilohertz sample rates are not; if it disagrees
with the recommendation, a doubt is added.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tissueid.errors import UnusableInputError
from tissueid.identification import recommendation_messages as messages
from tissueid.identification.base import Array, Family
from tissueid.identification.recommendation_messages import (
    ModelCandidate,
    ModelStanding,
    SufficientOption,
    VafDifference,
    difference,
)
from tissueid.identification.validation import vaf_percent
from tissueid.language import marked
from tissueid.messages import stored
from tissueid.records import Record

LEVEL = 0.05
"""Significance level (one-sided) of a lead."""

RELEVANT_REDUCTION = 0.05
"""Smallest share of the error variance that a lead must remove to count."""

RELEVANT_POINTS = 0.1
"""Smallest relevant lead, percentage points of VAF."""


@dataclass(frozen=True)
class Recommendation:
    """The recommended engine, with reasons and scores.

    ``judged_on`` describes the held-out samples. ``standings`` are all candidates: first the one that leads most others
    on their common held-out samples, then the others by the size of that lead. ``headline``, ``reasons``, ``doubts``
    and ``experiments`` (proposed measurements) are sentences.
    """

    engine: str
    family: Family
    second_order: bool
    judged_on: str
    headline: str
    reasons: tuple[str, ...]
    doubts: tuple[str, ...]
    experiments: tuple[str, ...]
    standings: tuple[ModelStanding, ...]
    choices: tuple[SufficientOption, ...] = field(default=())

    @property
    def sentences(self) -> tuple[str, ...]:
        """Headline, sufficient option values, and reasons."""
        return (self.headline, *map(messages.choice, self.choices), *self.reasons)

    def with_choice(self, option: str, trials: Sequence[tuple[float, Array]], held_out: Record) -> Recommendation:
        """Return a copy with an option chosen from held-out errors (n,) at several values; see :func:`sufficient`."""
        tried = tuple((value, _vaf(error, held_out)) for value, error in trials)
        chosen = SufficientOption(
            option, sufficient(trials, held_out), *(tuple(column) for column in zip(*tried, strict=True))
        )
        return replace(self, choices=(*self.choices, chosen))

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; ``messages`` holds code, template and values of each sentence."""
        return {
            "engine": self.engine,
            "family": str(self.family),
            "second_order": self.second_order,
            "judged_on": self.judged_on,
            "headline": self.headline,
            "reasons": list(self.reasons),
            "doubts": list(self.doubts),
            "experiments": list(self.experiments),
            "choices": {
                c.option: {"value": c.value, "tried": list(c.tried), "vaf_validation_percent": list(c.vaf_percent)}
                for c in self.choices
            },
            "standings": [
                {
                    "engine": s.engine,
                    "family": str(s.family),
                    "second_order": s.second_order,
                    "vaf_validation_percent": s.vaf_percent,
                    "behind_best_points": s.behind.points,
                    "behind_best_std_points": s.behind.std_points,
                    "p_value": s.behind.p_value,
                    "beaten": s.beaten,
                }
                for s in self.standings
            ],
            "messages": {
                "judged_on": stored(self.judged_on),
                "headline": stored(self.headline),
                "choices": [stored(messages.choice(c)) for c in self.choices],
                "reasons": [stored(text) for text in self.reasons],
                "doubts": [stored(text) for text in self.doubts],
                "experiments": [stored(text) for text in self.experiments],
            },
        }


def recommend(
    candidates: Sequence[ModelCandidate],
    held_out: Record,
    fitted: Record,
    *,
    judged_on: str = marked("the held-out part"),
    ceiling_percent: float | None = None,
) -> Recommendation:
    """Recommend the simplest model that is not beaten.

    Args:
        candidates: engines fitted to the same record.
        held_out: record on which they are judged, (n,); fitted outputs are NaN.
        fitted: the fitted part, to compare the ranges of the output.
        judged_on: description of ``held_out``.
        ceiling_percent: highest held-out VAF that a model can reach, from repeats; None without repeats.

    Raises:
        UnusableInputError: no candidate could be scored on held-out samples.
    """
    scored = [c for c in candidates if math.isfinite(_score(c, held_out))]
    if not scored:
        raise UnusableInputError(
            "recommendation.nothing_held_out",
            "no engine could be scored on held-out samples: hold out more of the record",
        )
    leads = {(a, b): _lead(a, b, held_out) for a in scored for b in scored}
    leader = max(scored, key=lambda c: (sum(leads[c, other].points > 0.0 for other in scored), _score(c, held_out)))
    unbeaten = _unbeaten(scored, leads) or [leader]
    choice = min(unbeaten, key=_simplicity)
    standings = {c: _standing(c, leads[leader, c], leads[choice, c], c not in unbeaten, held_out) for c in scored}
    chosen, best = standings[choice], standings[leader]
    ordered = [best, *sorted((s for s in standings.values() if s is not best), key=lambda s: s.behind.points)]
    basis = messages.Basis(chosen, tuple(ordered), held_out, fitted, ceiling_percent)
    return Recommendation(
        engine=chosen.engine,
        family=chosen.family,
        second_order=chosen.second_order,
        judged_on=judged_on,
        headline=messages.headline(basis),
        reasons=tuple(messages.reasons(basis)),
        doubts=tuple(messages.doubts(basis)),
        experiments=tuple(messages.experiments(basis)),
        standings=tuple(ordered),
    )


def beaten(lead: VafDifference, level: float = LEVEL) -> bool:
    """Return whether a lead is significant at ``level`` and relevant."""
    sure = lead.p_value is not None and lead.p_value < level
    return sure and lead.reduction > RELEVANT_REDUCTION and lead.points > RELEVANT_POINTS


def sufficient(trials: Sequence[tuple[float, Array]], held_out: Record) -> float:
    """Return the smallest value of an option whose held-out errors (n,) are not beaten by those of the best value.

    Raises:
        UnusableInputError: none of the trials could be scored.
    """
    scored = [(value, error) for value, error in trials if math.isfinite(_vaf(error, held_out))]
    if not scored:
        raise UnusableInputError(
            "recommendation.no_value", "no value of the option could be scored on held-out samples"
        )
    _, best = max(scored, key=lambda trial: _vaf(trial[1], held_out))
    rate = held_out.sample_rate_hz
    return min(v for v, error in scored if not beaten(difference(best, error, held_out.output, rate)))


def _lead(candidate: ModelCandidate, other: ModelCandidate, held_out: Record) -> VafDifference:
    measured = held_out.output if other.measured is None else other.measured
    return difference(candidate.error, other.error, measured, held_out.sample_rate_hz)


def _unbeaten(
    scored: Sequence[ModelCandidate], leads: Mapping[tuple[ModelCandidate, ModelCandidate], VafDifference]
) -> list[ModelCandidate]:
    """Return the candidates that no other beats and that lead every beaten candidate.

    The second condition excludes models with very large errors in one stretch: these errors also widen the standard
    error of the lead, so that the lead is not significant.
    """
    remaining = list(scored)
    out = [c for c in remaining if any(beaten(leads[other, c]) for other in scored)]
    while out:
        remaining = [c for c in remaining if c not in out]
        out = [c for c in remaining if any(leads[other, c].points > 0.0 for other in scored if other not in remaining)]
    return remaining


def _standing(
    candidate: ModelCandidate, behind: VafDifference, below: VafDifference, is_beaten: bool, held_out: Record
) -> ModelStanding:
    return ModelStanding(
        engine=candidate.engine,
        family=candidate.family,
        second_order=candidate.second_order,
        vaf_percent=_score(candidate, held_out),
        vaf_fitted_percent=candidate.vaf_percent,
        scheduled_percent=candidate.scheduled_percent,
        aicc=candidate.aicc,
        behind=behind,
        below=below,
        beaten=is_beaten,
    )


def _simplicity(candidate: ModelCandidate) -> tuple[int, bool, float]:
    """Return the sort key of candidates that are not beaten: simpler family first, then lower AICc."""
    aicc = math.inf if candidate.aicc is None or math.isnan(candidate.aicc) else candidate.aicc
    return candidate.family.rank, not candidate.second_order, aicc


def _score(candidate: ModelCandidate, held_out: Record) -> float:
    """Return the held-out VAF of a candidate, %."""
    if candidate.measured is None:
        return _vaf(candidate.error, held_out)
    return vaf_percent(candidate.measured, candidate.measured - candidate.error)


def _vaf(error: Array, held_out: Record) -> float:
    return vaf_percent(held_out.output, held_out.output - np.where(np.isfinite(error), error, np.nan))
