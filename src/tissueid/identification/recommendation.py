"""Which description a record supports: the simplest one that no other beats on samples that were not fitted.

Every engine is judged by its free run on the same held-out samples. A simpler description is given up only for a
lead that chance does not explain and that matters. AICc decides between descriptions of one family that the held-out
samples do not tell apart, and is told where it disagrees; it does not decide more, because it takes residuals for
independent, which those of tissue at kilohertz rates are not.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tissueid.errors import UnusableInputError
from tissueid.identification import recommendation_words as words
from tissueid.identification.base import Array
from tissueid.identification.family import Family
from tissueid.identification.validation import vaf_percent
from tissueid.identification.validation.paired import Difference, difference
from tissueid.records import Record

LEVEL = 0.05
"""A lead that chance gives more often than this (one-sided) does not count."""

RELEVANT = 0.05
"""Nor does one that takes away less than this share of the error variance, such as what fewer parameters save."""

WORTH_POINTS = 0.1
"""Nor one of fewer percentage points of VAF: where two models account for nearly all, the simpler one is enough."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """An engine fitted to the record.

    ``error`` (n,) is measured less free-run simulated output on the held-out record, NaN where it is not scored.
    ``parameters`` counts the effective ones. ``vaf_percent`` and ``aicc`` are those of the fitted samples,
    ``scheduled_percent`` is the held-out VAF with the measured output as the schedule. ``second_order`` marks a linear
    model reduced to mass, damping and stiffness.
    """

    engine: str
    family: Family
    error: Array
    parameters: float
    vaf_percent: float
    aicc: float | None = None
    scheduled_percent: float | None = None
    second_order: bool = False


@dataclass(frozen=True)
class Standing:
    """A candidate among the others, with its scores as in :class:`Candidate` and on the held-out samples.

    ``behind`` is the lead of the best candidate on it, ``below`` that of the recommended one; ``beaten`` says whether
    any candidate has a lead on it that counts.
    """

    engine: str
    family: Family
    second_order: bool
    vaf_percent: float
    vaf_fitted_percent: float
    scheduled_percent: float | None
    aicc: float | None
    behind: Difference
    below: Difference
    beaten: bool


@dataclass(frozen=True)
class Choice:
    """An option of the recommended engine: the smallest value that does as well as any that was tried."""

    option: str
    value: float
    tried: tuple[float, ...]
    vaf_percent: tuple[float, ...]


@dataclass(frozen=True)
class Recommendation:
    """The description that the record supports, in words and numbers.

    ``judged_on`` names the samples that decided. ``standings`` are all candidates: first the one that leads most others
    on the held-out samples that both are judged on, then the others by how far it leads them. ``headline`` is one
    sentence; ``reasons``, ``doubts`` and ``experiments`` (what to measure to know more) are sentences too.
    """

    engine: str
    family: Family
    second_order: bool
    judged_on: str
    headline: str
    reasons: tuple[str, ...]
    doubts: tuple[str, ...]
    experiments: tuple[str, ...]
    standings: tuple[Standing, ...]
    choices: tuple[Choice, ...] = field(default=())

    @property
    def sentences(self) -> tuple[str, ...]:
        """Headline, what was found of the options, and reasons."""
        return (self.headline, *map(words.choice, self.choices), *self.reasons)

    def with_choice(self, option: str, trials: Sequence[tuple[float, Array]], held_out: Record) -> Recommendation:
        """The same with an option chosen from held-out errors (n,) at several values; see :func:`sufficient`."""
        tried = tuple((value, _vaf(error, held_out)) for value, error in trials)
        found = Choice(option, sufficient(trials, held_out), *(tuple(column) for column in zip(*tried, strict=True)))
        return replace(self, choices=(*self.choices, found))

    def as_dict(self) -> dict[str, Any]:
        """Everything as plain values, fit for JSON."""
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
        }


def recommend(
    candidates: Sequence[Candidate],
    held_out: Record,
    fitted: Record,
    *,
    judged_on: str = "the held-out part",
    ceiling_percent: float | None = None,
) -> Recommendation:
    """Recommend the simplest description that is not beaten.

    Args:
        candidates: engines that were fitted to one and the same record.
        held_out: what they are judged on, (n,); outputs that were fitted are NaN.
        fitted: the part that was fitted, for what the two parts have in common.
        judged_on: what ``held_out`` is, in words.
        ceiling_percent: highest held-out VAF that anyone could reach, from repeats; None when there are none.

    Raises:
        UnusableInputError: no candidate could be scored on held-out samples.
    """
    scored = [c for c in candidates if math.isfinite(_vaf(c.error, held_out))]
    if not scored:
        raise UnusableInputError(
            "no engine could be scored on samples that were not fitted: hold out more of the record"
        )
    leads = {(a, b): _lead(a, b, held_out) for a in scored for b in scored}
    leader = max(scored, key=lambda c: (sum(leads[c, other].points > 0.0 for other in scored), _vaf(c.error, held_out)))
    unbeaten = _unbeaten(scored, leads) or [leader]
    choice = min(unbeaten, key=_simplicity)
    standings = {c: _standing(c, leads[leader, c], leads[choice, c], c not in unbeaten, held_out) for c in scored}
    chosen, best = standings[choice], standings[leader]
    ordered = [best, *sorted((s for s in standings.values() if s is not best), key=lambda s: s.behind.points)]
    told = words.Told(chosen, tuple(ordered), held_out, fitted, ceiling_percent)
    return Recommendation(
        engine=chosen.engine,
        family=chosen.family,
        second_order=chosen.second_order,
        judged_on=judged_on,
        headline=words.headline(told),
        reasons=tuple(words.reasons(told)),
        doubts=tuple(words.doubts(told)),
        experiments=tuple(words.experiments(told)),
        standings=tuple(ordered),
    )


def beaten(lead: Difference, level: float = LEVEL) -> bool:
    """Whether a lead is one that chance does not explain and that matters."""
    sure = lead.p_value is not None and lead.p_value < level
    return sure and lead.reduction > RELEVANT and lead.points > WORTH_POINTS


def sufficient(trials: Sequence[tuple[float, Array]], held_out: Record) -> float:
    """The smallest value of an option whose held-out errors (n,) no other value's beat.

    Raises:
        UnusableInputError: none of the trials could be scored.
    """
    scored = [(value, error) for value, error in trials if math.isfinite(_vaf(error, held_out))]
    if not scored:
        raise UnusableInputError("no value of the option could be scored on samples that were not fitted")
    _, best = max(scored, key=lambda trial: _vaf(trial[1], held_out))
    rate = held_out.sample_rate_hz
    return min(v for v, error in scored if not beaten(difference(best, error, held_out.output, rate)))


def _lead(candidate: Candidate, other: Candidate, held_out: Record) -> Difference:
    return difference(candidate.error, other.error, held_out.output, held_out.sample_rate_hz)


def _unbeaten(scored: Sequence[Candidate], leads: Mapping[tuple[Candidate, Candidate], Difference]) -> list[Candidate]:
    """Those on which nobody has a lead that counts, and who lead everyone on whom somebody has.

    Without the second condition a model that errs wildly in one stretch would be let through: the wilder the errors,
    the wider the chance that the lead on them is measured by.
    """
    left = list(scored)
    out = [c for c in left if any(beaten(leads[other, c]) for other in scored)]
    while out:
        left = [c for c in left if c not in out]
        out = [c for c in left if any(leads[other, c].points > 0.0 for other in scored if other not in left)]
    return left


def _standing(
    candidate: Candidate, behind: Difference, below: Difference, is_beaten: bool, held_out: Record
) -> Standing:
    return Standing(
        engine=candidate.engine,
        family=candidate.family,
        second_order=candidate.second_order,
        vaf_percent=_vaf(candidate.error, held_out),
        vaf_fitted_percent=candidate.vaf_percent,
        scheduled_percent=candidate.scheduled_percent,
        aicc=candidate.aicc,
        behind=behind,
        below=below,
        beaten=is_beaten,
    )


def _simplicity(candidate: Candidate) -> tuple[int, bool, float]:
    """What is preferred among those that are not beaten, least first; of equals the one with the better score."""
    aicc = math.inf if candidate.aicc is None or math.isnan(candidate.aicc) else candidate.aicc
    return candidate.family.rank, not candidate.second_order, aicc


def _vaf(error: Array, held_out: Record) -> float:
    return vaf_percent(held_out.output, held_out.output - np.where(np.isfinite(error), error, np.nan))
