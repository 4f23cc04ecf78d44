"""Decisions from scores: whether there is a gap, whether a candidate explains it, and with which probability.

The thresholds were set on eighty scenarios of the simulated laboratory, those of pairs on 249 and some more (decisions
0025 and 0028), stricter ones also on parts of another draw (decision 0026). None of these is the draw that docs/gap.md
reports.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tissueid.gap.scoring import Candidate, misfit, score

Verdict = Literal["effect", "no_gap", "unexplained"]


@dataclass(frozen=True)
class Thresholds:
    """Thresholds of the decisions. Scores are in nats (see ``scoring.score``)."""

    least_gain: float = 0.06
    """Least decrease of the score by a candidate that is not chance."""
    least_score: float = 0.12
    """Score of the baseline below which there is no gap."""
    at_the_floor: float = 0.12
    """Score below which a candidate explains the gap without further conditions."""
    explained_closed: float = 0.7
    """Least closed share of the gap on held-out data of an explanation."""
    alone_closed: float = 0.5
    """Least closed share when the runner-up scores at least ``alone_lead`` nats worse."""
    alone_lead: float = 0.3
    """Lead over the runner-up for ``alone_closed``, nats."""
    explained_share: float = 0.55
    """Largest share of the baseline's score that an explanation leaves."""
    clear_share: float = 0.12
    """Largest share of the score that is left where more is required: for an effect with an exact law, and where the
    evidence by stages contradicts the candidate."""
    set_gain: float = 0.3
    """Least decrease of the score by a member of a set, nats."""
    set_leaves: float = 0.36
    """Largest share of the gap without a member that the set leaves, unless it is at the floor."""
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
    baseline: Candidate,
    candidates: Sequence[Candidate],
    *,
    clearly: bool = False,
    thresholds: Thresholds = THRESHOLDS,
) -> list[float]:
    """Return the probability that each candidate is the cause, given that one of them or an unknown effect is.

    An unknown effect has the cost at which the best candidate would just explain the gap; with ``clearly``, at which it
    would do so under the stricter condition (see ``explains``).
    """
    if not candidates:
        return []
    costs = np.array([cost(item, thresholds) for item in candidates])
    share = thresholds.clear_share if clearly else thresholds.explained_share
    unlisted = max(share * baseline.score, thresholds.least_score)
    temperature = thresholds.temperature + thresholds.temperature_share * float(min(costs.min(), unlisted))
    weights = np.exp(-(np.append(costs, unlisted) - min(costs.min(), unlisted)) / temperature)
    return [float(value) for value in weights[:-1] / weights.sum()]


def may_be_gap(baseline: Candidate, thresholds: Thresholds = THRESHOLDS) -> bool:
    """Return whether there can be a gap, whatever the candidates: False where the baseline leaves only noise."""
    return baseline.score >= thresholds.least_score


def is_gap(baseline: Candidate, best: Candidate | None, thresholds: Thresholds = THRESHOLDS) -> bool:
    """Return whether there is a gap: the baseline leaves much, or a candidate lowers the score by more than chance."""
    if baseline.score >= 2.0 * thresholds.least_score:
        return True
    gained = 0.0 if best is None else baseline.score - cost(best, thresholds)
    return baseline.score >= thresholds.least_score and gained >= thresholds.least_gain


def shows_in_the_check_alone(baseline: Candidate, thresholds: Thresholds = THRESHOLDS) -> bool:
    """Return whether there is a gap on the samples for the check only.

    A rare event can be absent from the samples for the choice.
    """
    return score(baseline.checked_by) >= 2.0 * thresholds.least_score


def explains(
    baseline: Candidate,
    best: Candidate,
    closed: float,
    lead: float,
    *,
    clearly: bool = False,
    thresholds: Thresholds = THRESHOLDS,
) -> bool:
    """Return whether a candidate explains the gap on held-out data.

    Args:
        baseline: the baseline without it.
        best: the candidate.
        closed: share of the gap that it closes.
        lead: cost of the runner-up minus its cost, nats; 0 for more than one effect.
        clearly: apply the stricter condition, for exact laws and contradicting evidence.
        thresholds: thresholds of the decision.
    """
    if best.score <= thresholds.at_the_floor:
        return True
    if best.score > (thresholds.clear_share if clearly else thresholds.explained_share) * baseline.score:
        return False
    alone = lead >= thresholds.alone_lead and closed >= thresholds.alone_closed
    return alone or closed >= thresholds.explained_closed


def lead_of(best: Candidate, rivals: Sequence[Candidate], thresholds: Thresholds = THRESHOLDS) -> float:
    """Return the cost of the runner-up minus that of the best, nats; infinite where there is none."""
    others = [cost(item, thresholds) for item in rivals if item.effects != best.effects]
    return min(others, default=np.inf) - cost(best, thresholds)


def grows(smaller: Candidate, larger: Candidate, thresholds: Thresholds = THRESHOLDS) -> bool:
    """Return whether a larger or other set is followed further in the search: more lenient than ``is_needed``."""
    return misfit(smaller) - misfit(larger) >= thresholds.growth or cost(smaller) - cost(larger) >= thresholds.set_gain


def is_needed(
    without: Candidate, found: Candidate, closed_without: float, closed: float, thresholds: Thresholds = THRESHOLDS
) -> bool:
    """Return whether a member of a set is named, by what its removal costs.

    Args:
        without: the set without the member, refitted.
        found: the set.
        closed_without: share of the gap that the set closes without the member.
        closed: share that it closes with the member.
        thresholds: thresholds of the decision.
    """
    if cost(without, thresholds) - cost(found, thresholds) < thresholds.set_gain:
        return False
    if found.score <= thresholds.at_the_floor:
        return closed >= closed_without
    return 1.0 - closed <= thresholds.set_leaves * (1.0 - closed_without)
