"""From scores to words: is there a gap, does a candidate explain it, and how sure is that.

The thresholds were set with eighty scenarios of the simulated laboratory in view, those of pairs with 249 and some
more (decisions 0025 and 0028), where more is asked with the same and parts of another draw (decision 0026): none with
the one that docs/gap.md reports.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tissueid.gap.scoring import Candidate, score

Verdict = Literal["effect", "no_gap", "unexplained"]


@dataclass(frozen=True)
class Thresholds:
    """Where words change. Scores are in nats (see ``scoring.score``)."""

    least_gain: float = 0.06
    """A candidate must lower the score by this much before it is anything but chance."""
    least_score: float = 0.12
    """With less than this left by the baseline there is no gap."""
    at_the_floor: float = 0.12
    """A candidate that leaves less than this explains the gap: nothing is left to be explained."""
    explained_closed: float = 0.7
    """Otherwise, the share of the gap that a candidate must close on held-out data to explain it ..."""
    alone_closed: float = 0.5
    """... or this share, where no rival comes near that the data can tell from it: its form is not the recording's,
    but none other is like it."""
    alone_lead: float = 0.3
    """That a rival comes near: it costs less than this more, nats."""
    explained_share: float = 0.55
    """... and the share of the score that it may leave at most."""
    clear_share: float = 0.12
    """The share of the score that may be left where more is asked: of an effect whose law is exact, and where the
    stages' own evidence speaks for another stage."""
    pair_gain: float = 0.3
    """What a second effect must lower the score by, in nats ..."""
    pair_leaves: float = 0.36
    """... and the share of the gap left by the first one that it may leave at most, unless both leave no more than the
    floor."""
    nearly_all: float = 0.985
    """Where this share of the gap is closed no longer search is worth its time."""
    temperature: float = 0.06
    """Differences in score below this are no evidence for one rival against another ..."""
    temperature_share: float = 0.1
    """... nor below this share of what the best leaves: its form is that far from the recording's."""
    complexity: float = 0.01
    """What every further coordinate costs ..."""
    most_counted: int = 5
    """... up to so many of each effect: what tables of many values fit too much shows in held-out data."""


THRESHOLDS = Thresholds()


def cost(candidate: Candidate, thresholds: Thresholds = THRESHOLDS) -> float:
    """Score with what its coordinates cost; candidates are compared by it."""
    counted = sum(min(order, thresholds.most_counted) for order in candidate.orders)
    return candidate.score + thresholds.complexity * counted


def probabilities(
    baseline: Candidate,
    candidates: Sequence[Candidate],
    *,
    clearly: bool = False,
    thresholds: Thresholds = THRESHOLDS,
) -> list[float]:
    """How likely each candidate is the cause, given that one of them or an unlisted effect is.

    An unlisted effect stands among them with the cost at which the best candidate would just explain the gap; with
    ``clearly``, at which it would do so clearly (see ``explains``).
    """
    if not candidates:
        return []
    costs = np.array([cost(item, thresholds) for item in candidates])
    share = thresholds.clear_share if clearly else thresholds.explained_share
    unlisted = max(share * baseline.score, thresholds.least_score)
    temperature = thresholds.temperature + thresholds.temperature_share * float(min(costs.min(), unlisted))
    weights = np.exp(-(np.append(costs, unlisted) - min(costs.min(), unlisted)) / temperature)
    return [float(value) for value in weights[:-1] / weights.sum()]


def is_gap(baseline: Candidate, best: Candidate | None, thresholds: Thresholds = THRESHOLDS) -> bool:
    """Whether anything stands above the floor: much is left, or a candidate takes away more than chance would."""
    if baseline.score >= 2.0 * thresholds.least_score:
        return True
    gained = 0.0 if best is None else baseline.score - cost(best, thresholds)
    return baseline.score >= thresholds.least_score and gained >= thresholds.least_gain


def shows_in_the_check_alone(baseline: Candidate, thresholds: Thresholds = THRESHOLDS) -> bool:
    """Whether much stands above the floor on the samples of the check, whatever those of the choice show.

    What happens rarely may happen in no stretch by which a candidate could be chosen.
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
    """Whether a candidate explains the gap on held-out data.

    Args:
        baseline: without it.
        best: the candidate.
        closed: share of the gap that it closes.
        lead: by how much the next rival costs more, nats; 0 for more than one effect.
        clearly: ask that it leaves little: its law is exact, or other evidence speaks against it.
        thresholds: where words change.
    """
    if best.score <= thresholds.at_the_floor:
        return True
    if best.score > (thresholds.clear_share if clearly else thresholds.explained_share) * baseline.score:
        return False
    alone = lead >= thresholds.alone_lead and closed >= thresholds.alone_closed
    return alone or closed >= thresholds.explained_closed


def lead_of(best: Candidate, rivals: Sequence[Candidate], thresholds: Thresholds = THRESHOLDS) -> float:
    """By how much the next of the rivals costs more than the best, nats; infinite where there is none."""
    others = [cost(item, thresholds) for item in rivals if item.effects != best.effects]
    return min(others, default=np.inf) - cost(best, thresholds)


def better_pair(
    single: Candidate, pair: Candidate, closed: float, closed_by_pair: float, thresholds: Thresholds = THRESHOLDS
) -> bool:
    """Whether a second effect is worth naming.

    Args:
        single: the best single effect.
        pair: the best pair.
        closed: share of the gap that the single effect closes.
        closed_by_pair: share that the pair closes.
        thresholds: where words change.
    """
    if cost(single, thresholds) - cost(pair, thresholds) < thresholds.pair_gain:
        return False
    if pair.score <= thresholds.at_the_floor:
        return closed_by_pair >= closed
    return 1.0 - closed_by_pair <= thresholds.pair_leaves * (1.0 - closed)
