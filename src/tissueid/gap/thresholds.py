"""All constants of the search and of the decision, with their units and how they were chosen.

Scores are in nats (see ``decision.score``). The thresholds of the decision were set on eighty scenarios of the first
simulated laboratory, those of pairs on 249 and some more (decisions 0025 and 0028), stricter ones also on parts of
another draw (decision 0026), the conditions on further members on sixty of each laboratory (decision 0040) and on
thirty on skin (decision 0046), the gain on forty of the second laboratory (decision 0061). docs/measured/gap.json
reports none of these draws for these thresholds, or says so. ``tools/fit_thresholds.py`` fits them to stored answers.

The limits of the search trade time for missed effects; decisions 0044 to 0061 compare them on scenarios of both
laboratories.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Thresholds:
    """Thresholds of the decisions."""

    least_score: float = 0.24
    """Score of the baseline below which there is no gap, nats."""
    at_the_floor: float = 0.12
    """Score below which a candidate explains the gap without further conditions, nats."""
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
    structural: float = 0.9
    """Closed share from which what a set leaves is taken as the structural error of its members, all of them right: the
    search replaces none, and a further member that can stand for the error in the form of another is not named."""
    stand_in_score: float = 2.0
    """Score without a member from which a set at the noise floor needs it whatever it can stand for, nats."""
    temperature: float = 0.06
    """Scale of score differences for probabilities, nats: smaller differences are no evidence."""
    temperature_share: float = 0.1
    """The same as a share of the best candidate's score, a measure of its model error."""
    complexity: float = 0.01
    """Penalty of each coordinate, nats."""
    most_counted: int = 5
    """Most coordinates of an effect that are penalised: overfitting by larger tables shows in held-out data. An effect
    with more can stand for an error in the form of any other; those of the environment, with their own rates, cannot.
    """
    alike_cosine: float = 0.97
    """Least cosine of surviving signatures that this data cannot separate, where the costs differ by less than
    ``alike_cost``."""
    alike_cost: float = 0.1
    """Difference of costs, nats, from which effects are separable."""


@dataclass(frozen=True)
class SearchLimits:
    """Limits of the search."""

    starts: int = 12
    """Starting points of single effects in each of two rounds, and effects that are tried with a set; best aligned
    first."""
    fits: int = 4
    """Candidates that are fitted further: of the starting points those fitted first, of the short fits those fitted to
    the end (twice as many in the second round), of the trials with a set those with a short fit."""
    beam: int = 2
    """Alternatives that are followed wherever sets branch: leading single effects, starts of an effect, the best
    aligned trials, sets that are fitted further, members that are replaced, sets whose removals are kept. Of single
    effects also those that cost least on the fitted samples."""
    restarts: int = 3
    """Rounds of restarts of the final set."""
    most_members: int = 6
    """Most effects of a set, in addition to those of the baseline."""
    trial_steps: int = 2
    """Optimiser steps of a trial. Far from its minimum a set with another effect can gain far more in a few steps than
    its alignment says."""
    short_steps: int = 6
    """Optimiser steps of a short fit, which every candidate gets; the best candidates get a full fit."""
    short_steps_of_many: int = 10
    """Optimiser steps of a short fit to several tests, whose minima are narrower."""
    steps_to_re_estimate: int = 20
    """Steps of a fit from which effects are re-estimated that the fit near it has as well."""
    steps_in_a_set: int = 30
    """Optimiser steps of a set with a member more, less, or another, or from another start: only the final set is
    fitted to the end."""
    steps_of_tracking: int = 40
    """Optimiser steps of a fit with an observer of the motion."""
    most_steps: int = 100
    """Optimiser steps of a full fit."""
    least_alignment: float = 0.02
    """Least alignment of a starting point that is fitted, a share of the squared residual."""
    second_start: float = 0.7
    """Least alignment of a second starting point of an effect, as a share of the first one's."""
    rival_alignment: float = 0.5
    """Least alignment of a close rival of an effect that explains the gap, as a share of the best alignment."""
    rival_score: float = 1.5
    """Largest score of a close rival after its short fit, nats."""
    growth: float = 0.03
    """Least decrease of the misfit by a further effect that is followed, nats."""
    nearly_all: float = 0.985
    """Closed share of a single effect above which the search ends."""
    large_remainder: float = 1.0
    """Score from which a set is completed with the effects of tissue that it lacks, nats."""
    clearly_needed: float = 1.5
    """Rise of the score by the removal of a member above which the search does not ask further whether it is needed,
    nats: with the others refitted to first order, on the fitted samples (fits raised the score then by at least 0.48),
    and after a short fit."""
    worth_a_round: float = 0.9
    """Cost relative to the last round below which another round of restarts follows."""


THRESHOLDS = Thresholds()
LIMITS = SearchLimits()
