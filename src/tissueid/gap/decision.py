"""Decisions from scores: whether there is a gap, whether a candidate explains it, and with which probability.

The thresholds were set on eighty scenarios of the first simulated laboratory, those of pairs on 249 and some more
(decisions 0025 and 0028), stricter ones also on parts of another draw (decision 0026), the conditions on further
members on sixty of each laboratory (decision 0040) and on thirty on skin (decision 0046), the gain on forty of the
second laboratory (decision 0061). docs/measured/gap.json reports none of these draws for these thresholds, or says so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from tissueid.gap.scoring import Candidate, misfit, score
from tissueid.twin.catalogue import effect
from tissueid.twin.effect import Effect

Verdict = Literal["effect", "no_gap", "unexplained"]
FLEXIBLE = 5
"""Number of fitted parameters above which an effect can stand for an error in the form of any other; those of the
environment, with their own rates, cannot."""


@dataclass(frozen=True)
class Thresholds:
    """Thresholds of the decisions. Scores are in nats (see ``scoring.score``)."""

    least_score: float = 0.24
    """Score of the baseline below which there is no gap."""
    at_the_floor: float = 0.12
    """Score below which a candidate explains the gap without further conditions."""
    explained_closed: float = 0.5
    """Least closed share of the gap on held-out data of an explanation."""
    explained_share: float = 0.55
    """Largest share of the baseline's score that an explanation leaves, unless it lowers it by ``explained_gain``."""
    explained_gain: float = 3.0
    """Decrease of the score, nats, that is enough however large a share is left: where the noise is small, the
    structural error of the right effect is many times the noise."""
    clear_share: float = 0.12
    """Largest share of the score that is left by a candidate that explains the gap whatever share of it is closed:
    rounding can leave most of it. More is not enough for an effect with an exact law, and where the evidence by stages
    contradicts the candidate."""
    set_gain: float = 0.3
    """Least decrease of the score by a member of a set, nats."""
    set_leaves: float = 0.36
    """Largest share of the gap without a member that the set leaves, unless it is at the floor or the member is an
    effect of living tissue, which are expected together."""
    set_leaves_score: float = 0.45
    """Largest share of the score without a member that the set leaves, sufficient in place of ``set_leaves``: hum or
    rounding changes the score more than the gap."""
    stand_in_closed: float = 0.9
    """Closed share of a set from which a further member is not named that can stand for the error in the form of one of
    its members."""
    stand_in_score: float = 2.0
    """Score without a member from which a set at the noise floor needs it whatever it can stand for, nats."""
    structural: float = 0.9
    """Closed share from which what a set leaves is taken as the structural error of its members, all of them right."""
    growth: float = 0.03
    """Least decrease of the misfit by a further effect that is followed, nats."""
    nearly_all: float = 0.985
    """Closed share above which the search ends."""
    temperature: float = 0.06
    """Scale of score differences for probabilities, nats: smaller differences are no evidence."""
    temperature_share: float = 0.1
    """The same as a share of the best candidate's score, a measure of its model error."""
    complexity: float = 0.01
    """Penalty of each coordinate, nats."""
    most_counted: int = 5
    """Most coordinates of an effect that are penalised: overfitting by larger tables shows in held-out data."""


THRESHOLDS = Thresholds()


def cost(candidate: Candidate, thresholds: Thresholds = THRESHOLDS) -> float:
    """Return the score with the penalty of the coordinates, by which candidates are compared."""
    counted = sum(min(order, thresholds.most_counted) for order in candidate.orders)
    return candidate.score + thresholds.complexity * counted


def probabilities(
    baseline: float, costs: Sequence[float], *, clearly: bool = False, thresholds: Thresholds = THRESHOLDS
) -> list[float]:
    """Return the probability that each candidate is the cause, given that one of them or an unknown effect is.

    An unknown effect has the cost at which the best candidate would just explain the gap; with ``clearly``, at which it
    would do so under the stricter condition (see ``explains``).

    Args:
        baseline: score of the baseline.
        costs: costs of the candidates.
        clearly: whether the best candidate must meet the stricter condition.
        thresholds: thresholds of the decision.
    """
    if not costs:
        return []
    unlisted = _most_left(baseline, thresholds, clearly=clearly)
    least = min(*costs, unlisted)
    temperature = thresholds.temperature + thresholds.temperature_share * least
    weights = np.exp(-(np.array([*costs, unlisted]) - least) / temperature)
    return [float(value) for value in weights[:-1] / weights.sum()]


def is_gap(baseline: float, thresholds: Thresholds = THRESHOLDS) -> bool:
    """Return whether there is a gap, by the score of the baseline."""
    return baseline >= thresholds.least_score


def shows_in_the_check_alone(baseline: Candidate, thresholds: Thresholds = THRESHOLDS) -> bool:
    """Return whether there is a gap on the samples for the check only.

    A rare event can be absent from the samples for the choice.
    """
    return is_gap(score(baseline.checked_by), thresholds)


@dataclass(frozen=True)
class Tried:
    """A fitted candidate as far as a decision needs it.

    ``effects`` are those in addition to the baseline, ``closed`` the share of the gap that they close; score, cost and
    share are those on the samples for the choice. ``strict`` candidates must meet the stricter condition: exact laws,
    and those that the evidence by stages contradicts.
    """

    effects: tuple[str, ...]
    score: float
    cost: float
    closed: float
    strict: bool


@dataclass(frozen=True)
class Grounds:
    """All that a decision depends on, so that it can be taken again with other thresholds.

    ``baseline`` is the score of the baseline, ``tried`` holds every set of effects that was fitted.
    """

    baseline: float
    tried: tuple[Tried, ...]

    @classmethod
    def from_dict(cls, found: Mapping[str, Any]) -> Grounds:
        """Return grounds from the values of ``dataclasses.asdict`` or their JSON."""
        tried = tuple(Tried(**(item | {"effects": tuple(item["effects"])})) for item in found["tried"])
        return cls(float(found["baseline"]), tried)


def decide(grounds: Grounds, thresholds: Thresholds = THRESHOLDS) -> frozenset[str]:
    """Return the effects that explain the gap on held-out data; empty where there is no gap or none explains it.

    They are those of the set of least cost, without its members that are not needed.
    """
    if not grounds.tried or not is_gap(grounds.baseline, thresholds):
        return frozenset()
    by_set = {frozenset(item.effects): item for item in grounds.tried}
    singles = [item for item in grounds.tried if len(item.effects) == 1]
    final = min(grounds.tried, key=lambda item: item.cost)
    while len(final.effects) > 1:
        smaller = [by_set.get(frozenset(final.effects) - {name}) for name in final.effects]
        needless = [item for item in smaller if item is not None and not is_needed(item, final, thresholds)]
        if not needless:
            break
        final = min(needless, key=lambda item: item.cost)
    single = min(singles, key=lambda item: item.cost, default=None)
    if len(final.effects) > 1 and single is not None and not is_needed(single, final, thresholds):
        final = single
    return frozenset(final.effects) if explains(grounds.baseline, final, thresholds) else frozenset()


def explains(baseline: float, best: Tried, thresholds: Thresholds = THRESHOLDS) -> bool:
    """Return whether a candidate explains the gap on held-out data; ``baseline`` is the score of the baseline."""
    if best.score <= _most_left(baseline, thresholds, clearly=True):
        return True
    if best.strict or best.score > _most_left(baseline, thresholds):
        return False
    return best.closed >= thresholds.explained_closed


def _most_left(baseline: float, thresholds: Thresholds, *, clearly: bool = False) -> float:
    # Largest score that an explanation leaves, with ``clearly`` one that needs no closed share.
    if clearly:
        return max(thresholds.at_the_floor, thresholds.clear_share * baseline)
    return max(thresholds.at_the_floor, thresholds.explained_share * baseline, baseline - thresholds.explained_gain)


def confirmed(baseline: float, left: float, closed: float, thresholds: Thresholds = THRESHOLDS) -> bool:
    """Return whether the samples for the check, which no fit and no choice has used, confirm an explanation.

    They do not where it closes less of the gap than an explanation must, and leaves too much of the score for one that
    explains the gap whatever share of it is closed.

    Args:
        baseline: score of the baseline on the check.
        left: score of the explanation on the check.
        closed: share of the gap that it closes on the check; NaN where there is none.
        thresholds: thresholds of the decision.
    """
    return left <= _most_left(baseline, thresholds, clearly=True) or not closed < thresholds.explained_closed


def grows(smaller: Candidate, larger: Candidate, thresholds: Thresholds = THRESHOLDS) -> bool:
    """Return whether a larger or other set is followed further in the search: more lenient than ``is_needed``."""
    return misfit(smaller) - misfit(larger) >= thresholds.growth or cost(smaller) - cost(larger) >= thresholds.set_gain


def is_needed(without: Tried, found: Tried, thresholds: Thresholds = THRESHOLDS) -> bool:
    """Return whether members of a set are named, by what their removal costs; ``without`` is the set without them."""
    if not contributes(without, found, thresholds):
        return False
    if all(one.in_living_tissue for one in _added(without, found)) or found.score <= thresholds.at_the_floor:
        return found.closed >= without.closed
    of_score = thresholds.set_leaves_score * without.score
    return found.score <= of_score or 1.0 - found.closed <= thresholds.set_leaves * (1.0 - without.closed)


def contributes(without: Tried, found: Tried, thresholds: Thresholds = THRESHOLDS) -> bool:
    """Return whether members of a set stay in it during a search, in which others can still be missing."""
    if without.cost - found.cost < thresholds.set_gain:
        return False
    if found.score <= thresholds.at_the_floor and without.score >= thresholds.stand_in_score:
        return True
    others = [effect(name) for name in without.effects]
    with_tissue = any(other.in_living_tissue for other in others)
    return without.closed < thresholds.stand_in_closed or not all(
        any(can_stand_for(one, other) for other in others) and not (with_tissue and one.in_living_tissue)
        for one in _added(without, found)
    )


def _added(without: Tried, found: Tried) -> list[Effect]:
    return [effect(name) for name in found.effects if name not in without.effects]


def can_stand_for(one: Effect, other: Effect) -> bool:
    """Return whether an effect can stand for an error in the form of another.

    It can where both act in the same stage, where one is easily mistaken for the other, and where it has more than
    ``FLEXIBLE`` parameters, such as a curve along the stroke.
    """
    flexible = one.order > FLEXIBLE and one.stage != "environment"
    return flexible or one.stage == other.stage or one.name in other.mistaken_for or other.name in one.mistaken_for
