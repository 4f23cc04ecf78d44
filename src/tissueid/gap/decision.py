"""Scores of a twin on held-out data, and the decisions from them.

Errors by channel and test give the score, the gap and the closed share of the gap. From these follow whether there is a
gap, whether a candidate explains it, and with which probability. The constants of the decisions are in ``thresholds``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tissueid.gap.dataset import DatasetTest, Purpose
from tissueid.gap.fitting import Fit, residual_blocks
from tissueid.gap.thresholds import LIMITS, THRESHOLDS, Thresholds
from tissueid.twin.catalogue import effect
from tissueid.twin.effect import Effect

FloatArray = NDArray[np.float64]

GAP_CHANNELS = ("current", "position", "voltage")
"""Channels of the gap; the voltage counts where the command is known."""
LEAST_RATIO = 1.0
"""Least ratio of error to noise variance: smaller errors count as noise."""
RARE_BLOCKS = 0.2
"""Share of the blocks, those with the largest error, that do not count against an accepted twin. The error that it left
in its own session rests on one or two events where it is rare, such as lift-off, and says little about the next ones.
"""


@dataclass(frozen=True)
class ChannelError:
    """Error of one channel in one test on the samples of one purpose.

    ``square`` is the mean squared error (SI squared), ``noise`` the sensor noise (std, SI), ``spread`` the standard
    deviation of the recorded signal over the whole test, ``samples`` the number of samples. ``irreducible`` (std, SI)
    is the part that an effect leaves however well it is known, such as rounding, or that a saved twin is known to
    leave. ``frequent`` is the mean squared error without rare events, where those do not count.
    """

    test: int
    channel: str
    square: float
    noise: float
    spread: float
    samples: int
    irreducible: float = 0.0
    frequent: float | None = None

    @property
    def ratio(self) -> float:
        """Mean squared error over the variance of noise and irreducible error, at least 1."""
        square = self.square if self.frequent is None else self.frequent
        return max(square / (self.noise**2 + self.irreducible**2), LEAST_RATIO)


def errors(fitted: Fit, *purposes: Purpose, tests: Sequence[DatasetTest] | None = None) -> list[ChannelError]:
    """Return the errors by test and channel on the samples of any of the purposes, where there are such samples.

    ``tests`` replaces the fit's tests by the same tests with other purposes.
    """
    channel_errors = []
    dataset = fitted.parameters.dataset
    for test, predicted in zip(dataset.tests if tests is None else tests, fitted.predictions, strict=True):
        irreducible = fitted.parameters.irreducible(fitted.theta, test.number)
        chosen = np.isin(test.purpose, purposes)
        for name in dataset.channels:
            mask = chosen & np.isfinite(test.signals[name])
            if not mask.any():
                continue
            error = np.clip(np.nan_to_num(predicted[name][mask], nan=1e6) - test.signals[name][mask], -1e6, 1e6)
            channel_errors.append(
                ChannelError(
                    test.number,
                    name,
                    float(np.mean(error**2)),
                    dataset.noise[name],
                    float(np.nanstd(test.signals[name])),
                    int(mask.sum()),
                    irreducible.get(name, 0.0),
                    without_rare_events(error, np.flatnonzero(mask)) if dataset.unmodelled else None,
                )
            )
    return channel_errors


def without_rare_events(error: FloatArray, samples: NDArray[np.intp]) -> float:
    """Return the mean squared error without the blocks of largest error, ``RARE_BLOCKS`` of them and at least one of
    several.

    Args:
        error: errors, SI, shape (n,).
        samples: their places in the test, ascending, shape (n,); a block ends where a place is left out.
    """
    begins = np.flatnonzero(np.diff(samples, prepend=samples[0] - 2) > 1)
    sums, sizes = np.add.reduceat(error**2, begins), np.diff(begins, append=error.size)
    left_out = max(int(RARE_BLOCKS * begins.size), min(begins.size - 1, 1))
    kept = np.argsort(sums / sizes)[: begins.size - left_out]
    return float(sums[kept].sum() / sizes[kept].sum())


def score(channel_errors: Sequence[ChannelError]) -> float:
    """Return half the logarithm of error over noise variance, summed over channels and averaged over tests, nats.

    0 where only noise is left. The score is scale-free: halving the error of a channel lowers it by 0.69 at any level,
    so that a weak trace in one channel counts next to a large error in another.
    """
    tests = {item.test for item in channel_errors}
    return float(sum(0.5 * np.log(item.ratio) for item in channel_errors)) / max(len(tests), 1)


def fitted_score(fitted: Fit, residuals: FloatArray) -> float:
    """Return the score of residuals on the fitted samples, shape as ``Fit.residuals``."""
    blocks = residual_blocks(fitted)
    tests = len(blocks) / len(fitted.parameters.dataset.channels)
    squares = (float(np.mean(residuals[block] ** 2)) for _, block in blocks)
    return float(sum(0.5 * np.log(max(square, LEAST_RATIO)) for square in squares)) / max(tests, 1.0)


def gap(channel_errors: Sequence[ChannelError], quiet: Sequence[int] = ()) -> float:
    """Return the normalised root-mean-square error: error over the standard deviation of the recorded signal.

    Squares and variances are pooled over the tests of a channel; channels have equal weight. ``quiet`` tests have no
    signal to normalise by and are left out.
    """
    return _pooled(channel_errors, quiet, lambda item: item.square)


def floor(channel_errors: Sequence[ChannelError], quiet: Sequence[int] = ()) -> float:
    """Return the gap that sensor noise and irreducible errors alone cause."""
    return _pooled(channel_errors, quiet, lambda item: item.noise**2 + item.irreducible**2)


def gap_left(before: Sequence[ChannelError], after: Sequence[ChannelError], quiet: Sequence[int] = ()) -> float:
    """Return the gap that an explanation leaves: at least the floor, as smaller errors count as noise."""
    return max(gap(after, quiet), min(floor(before, quiet), gap(before, quiet)))


def _pooled(channel_errors: Sequence[ChannelError], quiet: Sequence[int], square) -> float:  # type: ignore[no-untyped-def]
    shares = []
    for name in GAP_CHANNELS:
        of_channel = [
            item for item in channel_errors if item.channel == name and item.test not in quiet and item.spread > 0.0
        ]
        if of_channel:
            error = sum(square(item) * item.samples for item in of_channel)
            shares.append(error / sum(item.spread**2 * item.samples for item in of_channel))
    return float(np.sqrt(np.mean(shares))) if shares else float("nan")


def closed(before: float, after: float, least: float) -> float:
    """Return the closed share of a gap: 1 - sqrt((after^2 - floor^2) / (before^2 - floor^2)), negative where it grew.

    NaN where there was no gap above the floor.
    """
    room = before**2 - least**2
    if not room > 0.0:
        return float("nan")
    return 1.0 - float(np.sqrt(max(after**2 - least**2, 0.0) / room))


@dataclass(frozen=True)
class Candidate:
    """A refitted baseline with added effects, and its errors on held-out data."""

    effects: tuple[str, ...]
    fit: Fit
    chosen_by: tuple[ChannelError, ...]
    """Errors on the samples for the choice."""
    checked_by: tuple[ChannelError, ...]
    """Errors on the samples for the check."""

    @property
    def score(self) -> float:
        """Score on the samples for the choice; smaller is better."""
        return score(self.chosen_by)

    def added_to(self, baseline: Candidate) -> list[str]:
        """Return the effects that the baseline does not have."""
        return [name for name in self.effects if name not in baseline.effects]

    def closed(self, baseline: Candidate) -> float:
        """Return the share of the baseline's gap that is closed on the samples for the check."""
        return _closed_share(self.quiet, baseline.checked_by, self.checked_by)

    def predicted_closed(self, baseline: Candidate) -> float:
        """Return the closed share on the samples for the choice, which is stated before the check."""
        return _closed_share(self.quiet, baseline.chosen_by, self.chosen_by)

    @property
    def quiet(self) -> tuple[int, ...]:
        """Numbers of the tests without a stimulus, which have no signal to normalise by."""
        return quiet_tests(self.fit.parameters.dataset.tests)

    @property
    def orders(self) -> tuple[int, ...]:
        """Number of fitted parameters of each effect."""
        return tuple(effect.order for effect in self.fit.parameters.effects)


def _closed_share(quiet: Sequence[int], before: Sequence[ChannelError], after: Sequence[ChannelError]) -> float:
    return closed(gap(before, quiet), gap(after, quiet), floor(before, quiet))


def misfit(candidate: Candidate) -> float:
    """Return half the logarithm of the mean squared error in noise deviations on the samples for the choice, nats.

    It pools the channels as the fit does. Far from the noise floor, where a fit trades an error of one channel for that
    of another, a further effect of a set always lowers it; the score (see ``score``) can rise.
    """
    channel_errors = candidate.chosen_by
    return 0.5 * float(
        np.log(sum(item.ratio * item.samples for item in channel_errors) / sum(item.samples for item in channel_errors))
    )


def score_candidate(fitted: Fit) -> Candidate:
    """Return a fit with its errors on held-out data."""
    return Candidate(
        tuple(effect.name for effect in fitted.parameters.effects),
        fitted,
        tuple(errors(fitted, Purpose.CHOICE)),
        tuple(errors(fitted, Purpose.CHECK)),
    )


def quiet_tests(tests: Sequence[DatasetTest]) -> tuple[int, ...]:
    """Return the numbers of the tests without a stimulus."""
    return tuple(test.number for test in tests if test.quiet)


Verdict = Literal["effect", "no_gap", "unexplained"]


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


def tried(baseline: Candidate, item: Candidate, strict: bool = False) -> Tried:
    """Return a fitted set as the decision needs it.

    What an effect leaves on the samples for the choice however well it is known, such as rounding, counts as closed.
    """
    quiet = baseline.quiet
    least = floor(baseline.chosen_by, quiet)
    own = floor(item.chosen_by, quiet) ** 2 - least**2
    after = math.sqrt(max(gap(item.chosen_by, quiet) ** 2 - own, 0.0))
    share = closed(gap(baseline.chosen_by, quiet), after, least)
    return Tried(tuple(item.added_to(baseline)), item.score, cost(item), share, strict)


@dataclass(frozen=True)
class Grounds:
    """All that a decision depends on, so that it can be taken again with other thresholds.

    ``baseline`` is the score of the baseline, ``tried`` holds every set of effects that was fitted.
    """

    baseline: float
    tried: tuple[Tried, ...]

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Grounds:
        """Return grounds from the values of ``dataclasses.asdict`` or their JSON."""
        tried = tuple(Tried(**(item | {"effects": tuple(item["effects"])})) for item in values["tried"])
        return cls(float(values["baseline"]), tried)


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


def confirmed(baseline: float, explanation: float, closed: float, thresholds: Thresholds = THRESHOLDS) -> bool:
    """Return whether the samples for the check, which no fit and no choice has used, confirm an explanation.

    They do not where it closes less of the gap than an explanation must, and leaves too much of the score for one that
    explains the gap whatever share of it is closed.

    Args:
        baseline: score of the baseline on the check.
        explanation: score of the explanation on the check.
        closed: share of the gap that it closes on the check; NaN where there is none.
        thresholds: thresholds of the decision.
    """
    return explanation <= _most_left(baseline, thresholds, clearly=True) or not closed < thresholds.explained_closed


def grows(smaller: Candidate, larger: Candidate) -> bool:
    """Return whether a larger or other set is followed further in the search: more lenient than ``is_needed``."""
    return misfit(smaller) - misfit(larger) >= LIMITS.growth or cost(smaller) - cost(larger) >= THRESHOLDS.set_gain


def is_needed(without: Tried, complete: Tried, thresholds: Thresholds = THRESHOLDS) -> bool:
    """Return whether members of a set are named, by what their removal costs; ``without`` is the set without them."""
    if not contributes(without, complete, thresholds):
        return False
    if (
        all(member.in_living_tissue for member in _added(without, complete))
        or complete.score <= thresholds.at_the_floor
    ):
        return complete.closed >= without.closed
    of_score = thresholds.set_leaves_score * without.score
    return complete.score <= of_score or 1.0 - complete.closed <= thresholds.set_leaves * (1.0 - without.closed)


def contributes(without: Tried, complete: Tried, thresholds: Thresholds = THRESHOLDS) -> bool:
    """Return whether members of a set stay in it during a search, in which others can still be missing."""
    if without.cost - complete.cost < thresholds.set_gain:
        return False
    if complete.score <= thresholds.at_the_floor and without.score >= thresholds.stand_in_score:
        return True
    others = [effect(name) for name in without.effects]
    with_tissue = any(other.in_living_tissue for other in others)
    return without.closed < thresholds.structural or not all(
        any(can_stand_for(member, other) for other in others) and not (with_tissue and member.in_living_tissue)
        for member in _added(without, complete)
    )


def _added(without: Tried, complete: Tried) -> list[Effect]:
    return [effect(name) for name in complete.effects if name not in without.effects]


def can_stand_for(stand_in: Effect, other: Effect) -> bool:
    """Return whether an effect can stand for an error in the form of another.

    It can where both act in the same stage, where one is easily mistaken for the other, and where it has more than
    ``most_counted`` parameters, such as a curve along the stroke.
    """
    flexible = stand_in.order > THRESHOLDS.most_counted and stand_in.stage != "environment"
    return (
        flexible
        or stand_in.stage == other.stage
        or stand_in.name in other.mistaken_for
        or other.name in stand_in.mistaken_for
    )
