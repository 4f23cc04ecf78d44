"""Diagnosis of one session: whether there is a gap, where it lies, its cause, and the closed share."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from tissueid.gap.closed_share import Budget, GapFigures, budget, ceiling, figures_of, removal_path
from tissueid.gap.dataset import Dataset
from tissueid.gap.decision import (
    Candidate,
    Grounds,
    Verdict,
    confirmed,
    cost,
    decide,
    is_gap,
    probabilities,
    score,
    shows_in_the_check_alone,
    tried,
)
from tissueid.gap.fit_tasks import Screen, cosine, effects_of
from tissueid.gap.fitting import residual_blocks
from tissueid.gap.localisation import Localisation, localise
from tissueid.gap.next_experiment import NextExperiment, next_experiment
from tissueid.gap.parameters import starts_of
from tissueid.gap.search import STEPS, Search, SearchProgress, SearchResult, SetSearch
from tissueid.gap.thresholds import THRESHOLDS
from tissueid.gap.workers import Executor
from tissueid.messages import Listing, Message
from tissueid.twin.catalogue import all_effects, effect
from tissueid.twin.effect import Effect, Stage

Job = Callable[[], Any]
RANKED = 10
"""Most candidates in the ranking."""
CERTAIN = 0.9
"""Probability from which no further test is proposed."""
_ELECTRICAL: frozenset[Stage] = frozenset({"drive", "coil"})
_MOVING: frozenset[Stage] = frozenset({"mechanics", "tissue", "environment"})
RARE = Message(
    "gap.only_in_check",
    "the gap shows only in the part of the data that is held out for the check: record a longer test, or repeat it",
)
NOT_CONFIRMED = Message(
    "gap.not_confirmed",
    "an explanation was found, but on the part of the data that is held out for the check it closes less than half of "
    "the gap: record a longer test, or repeat it",
)


@dataclass(frozen=True)
class Ranked:
    """One candidate of the ranking."""

    effect: str
    stage: Stage
    probability: float
    closed: float
    closed_ci: tuple[float, float]
    indistinguishable: tuple[str, ...]
    parameters: dict[str, float]


@dataclass(frozen=True)
class Diagnosis:
    """Result of a diagnosis. Where the verdict is ``no_gap``, ``where`` is neutral."""

    verdict: Verdict
    gap: GapFigures
    where: Localisation
    ranking: tuple[Ranked, ...]
    combination: tuple[str, ...]
    next_experiment: NextExperiment | None
    remarks: tuple[str, ...]
    seconds: float
    dataset: Dataset = field(repr=False)
    search_result: SearchResult = field(repr=False)
    best: Candidate | None = field(repr=False)
    """The accepted explanation or the best candidate; None where nothing was refitted."""
    ceiling: float = float("nan")
    """Share of the gap that a flexible regression closes on the same samples, or the best candidate if that is more."""
    conditional_odds: Mapping[str, tuple[tuple[str, float], ...]] = field(default_factory=dict)
    """For a named effect of a combination: the probability of each candidate in its place, given the other named
    effects, most probable first."""

    budget: Budget | None = None
    """Share of the gap that each named effect closes; None where nothing is named."""
    detection_limits: Mapping[str, DetectionLimit | None] = field(default_factory=dict)
    """Size from which each effect that is not named would have been named; None where no size would have been."""
    grounds: Grounds | None = field(default=None, repr=False)
    """Grounds of the decision, by which it can be taken again with other thresholds."""
    without: tuple[str, ...] = ()
    """Effects that were left out on request."""
    not_tried: tuple[str, ...] = ()
    """Steps of the search that the time limit left out."""

    def __post_init__(self) -> None:
        if self.verdict == "no_gap":
            object.__setattr__(self, "where", self.where.neutral())

    @property
    def at_fault(self) -> tuple[Stage, ...]:
        """Stages of the cause, that of ``where`` first.

        The stages of the named effects; without named effects the stage above its floor; none where there is no gap.
        """
        if self.verdict == "no_gap":
            return ()
        library = all_effects()
        stages = [library[name].stage for name in self.combination if name in library]
        if not stages:
            return (self.where.stage,) if self.where.above_floor else ()
        return tuple(dict.fromkeys(sorted(stages, key=lambda stage: stage != self.where.stage)))


def diagnose(
    dataset: Dataset,
    pool: Executor,
    *,
    accepted: Sequence[str] = (),
    candidates: Sequence[str] | None = None,
    without: Sequence[str] = (),
    seconds: float | None = None,
    progress: Callable[[SearchProgress], None] = lambda _: None,
    cancelled: Callable[[], bool] = lambda: False,
) -> Diagnosis:
    """Diagnose where and why a recording differs from the twin.

    Args:
        dataset: the tests.
        pool: the executor of the fits.
        accepted: effects of the accepted twin, which the baseline includes.
        candidates: effects to consider; all applicable effects where None.
        without: effects that are not tried.
        seconds: time after which the search begins no further step; None without a limit.
        progress: callback for progress.
        cancelled: callback that returns True to stop with ``CancelledError``.
    """
    began = time.monotonic()
    search = Search(dataset, pool, candidates, progress, cancelled, without, seconds)
    baseline = search.baseline(accepted)
    dataset = baseline.fit.parameters.dataset
    there_is = is_gap(baseline.score)
    result, best = SetSearch(search, baseline).run() if there_is else (SearchResult(baseline, (), ()), None)
    verdict: Verdict = "no_gap"
    jobs: list[Job] = [partial(localise, dataset, baseline), *([partial(ceiling, baseline)] if there_is else [])]
    places, *most = _together(pool, jobs, cancelled)
    ranking = _ranking(result, places)
    items = result.candidates
    grounds = Grounds(
        baseline.score,
        tuple(tried(baseline, item, needs_strict_fit(item, places, baseline.effects)) for item in items),
    )
    remarks = dataset.remarks
    if there_is:
        chosen = decide(grounds)
        verdict = "effect" if chosen else "unexplained"
        best = next((item for item in result.candidates if chosen == set(item.added_to(baseline))), best)
    elif shows_in_the_check_alone(baseline):
        # Against a twin rare events do not count.
        verdict = "no_gap" if dataset.unmodelled else "unexplained"
        remarks = (*remarks, RARE)
    figures = figures_of(baseline, best)
    if (
        verdict == "effect"
        and best is not None
        and not confirmed(score(baseline.checked_by), score(best.checked_by), figures.closed)
    ):
        verdict, remarks = "unexplained", (*remarks, NOT_CONFIRMED)
    named = best if verdict == "effect" else None
    path, smaller = ((), {}) if named is None else removal_path(named, baseline.effects, search.remove_from)
    names = search.names if search.in_time("detection limits") else []
    jobs = [partial(_limits, names, baseline, best or baseline)]
    if named is not None and score(named.checked_by) > THRESHOLDS.at_the_floor:
        jobs.append(partial(localise, dataset, named))
    limits, *remainder = _together(pool, jobs, cancelled)
    remains_in = next((item.stage for item in remainder if item.above_floor), None)
    if search.not_tried:
        steps = Listing(tuple(STEPS[what] for what in search.not_tried), "; ", "; ")
        late = Message("gap.not_tried", "not done within {seconds:.0f} s: {steps}", seconds=seconds, steps=steps)
        remarks = (*remarks, late)
    if without:
        effects = Listing(tuple(effect(name).title for name in without), "; ", "; ")
        remarks = (*remarks, Message("gap.left_out", "effects that were not tried: {effects}", effects=effects))
    shares = None if named is None else budget(baseline, path, smaller, remains_in)
    odds = {} if named is None else _conditional_odds(result, named, ranking, places)
    return Diagnosis(
        verdict,
        figures,
        _with_stage_of_cause(places, named, accepted),
        ranking,
        () if named is None else tuple(name for name in named.effects if name not in accepted),
        _next(dataset, result, ranking, verdict, odds),
        remarks,
        time.monotonic() - began,
        dataset,
        result,
        best,
        float(np.fmax(most[0], figures.closed)) if there_is else float("nan"),
        odds,
        shares,
        limits,
        grounds,
        tuple(without),
        tuple(search.not_tried),
    )


def _together(pool: Executor, jobs: Sequence[Job], cancelled: Callable[[], bool]) -> list[Any]:
    return pool.do(_call, jobs, cancelled, lambda _: None)


def _call(job: Job) -> Any:
    # Called in a worker process.
    return job()


def _limits(names: Sequence[str], baseline: Candidate, explanation: Candidate) -> dict[str, DetectionLimit | None]:
    limits = DetectionLimits(explanation, explanation.added_to(baseline))
    library = effects_of(explanation.fit.parameters.dataset)
    return {name: limits.of(library[name]) for name in names if name not in explanation.effects}


def _conditional_odds(
    result: SearchResult, best: Candidate, ranking: Sequence[Ranked], places: Localisation
) -> dict[str, tuple[tuple[str, float], ...]]:
    # A member keeps its probability of the ranking of single effects where no rival was refitted with the others.
    named = set(best.effects) - set(result.baseline.effects)
    if len(named) == 1:
        return {}
    clearly = needs_strict_fit(best, places, result.baseline.effects)
    odds = {}
    for name in named:
        others = set(best.effects) - {name}
        rivals = [
            item for item in result.candidates if others < set(item.effects) and len(item.effects) == len(others) + 1
        ]
        if len(rivals) < 2 and name in {item.effect for item in ranking[:1]}:
            continue
        shares = probabilities(result.baseline.score, [cost(item) for item in rivals], clearly=clearly)
        pairs = [(next(iter(set(item.effects) - others)), share) for item, share in zip(rivals, shares, strict=True)]
        odds[name] = tuple(sorted(pairs, key=lambda pair: -pair[1]))
    return odds


def _next(
    dataset: Dataset,
    result: SearchResult,
    ranking: Sequence[Ranked],
    verdict: Verdict,
    odds: Mapping[str, tuple[tuple[str, float], ...]],
) -> NextExperiment | None:
    # None where the result is certain: no gap, or causes with a clear lead.
    certain = bool(ranking) and ranking[0].probability >= CERTAIN
    if odds:
        certain = all(dict(rivals).get(name, 0.0) >= CERTAIN for name, rivals in odds.items())
    if verdict == "no_gap" or (verdict == "effect" and certain):
        return None
    singles = sorted(result.singles, key=cost)[:RANKED]
    return next_experiment(dataset, singles, [item.probability for item in ranking])


def needs_strict_fit(best: Candidate, places: Localisation, baseline_effects: Sequence[str]) -> bool:
    """Return whether a candidate must meet the stricter condition of an explanation.

    That is the case where every added effect has an exact law, and where the stages show that the current does not
    follow from voltage and motion although every added effect only moves the probe.
    """
    new = [effect(name) for name in best.effects if name not in baseline_effects]
    stages = {item.stage for item in new}
    blamed = {stage for stage, share in places.shares.items() if share > 0.0}
    only_moves = bool(blamed) and blamed <= _ELECTRICAL and stages <= _MOVING
    return only_moves or all(item.exact for item in new)


def _with_stage_of_cause(localisation: Localisation, best: Candidate | None, accepted: Sequence[str]) -> Localisation:
    # A named cause determines the stage more reliably than the evidence by stages.
    if best is None:
        return localisation
    stages = [effect(name).stage for name in best.effects if name not in accepted]
    return localisation if localisation.stage in stages else replace(localisation, stage=stages[0])


def _ranking(result: SearchResult, places: Localisation) -> tuple[Ranked, ...]:
    baseline = result.baseline
    singles = sorted(result.singles, key=cost)
    clearly = bool(singles) and needs_strict_fit(singles[0], places, baseline.effects)
    shares = probabilities(baseline.score, [cost(item) for item in singles], clearly=clearly)
    names = [name for item in singles for name in item.added_to(baseline)]
    # The part of the baseline's residuals that each candidate explains, after a refit of everything else.
    screen = Screen(baseline.fit)
    surviving = [screen.surviving(baseline.fit.residuals - item.fit.residuals) for item in singles]
    ranking = []
    for k, item in enumerate(singles[:RANKED]):
        alike = tuple(
            other
            for j, other in enumerate(names)
            if j != k
            and abs(cost(singles[j]) - cost(item)) < THRESHOLDS.alike_cost
            and cosine(surviving[k], surviving[j]) > THRESHOLDS.alike_cosine
        )
        figures, name = figures_of(baseline, item), names[k]
        stage, values = effect(name).stage, parameters_of(item, name)
        ranking.append(Ranked(name, stage, shares[k], figures.closed, figures.closed_ci, alike, values))
    return tuple(ranking)


def effect_in(candidate: Candidate, name: str) -> Effect:
    """Return an effect as a candidate has it, or as the library declares it where the candidate is without it."""
    return next((item for item in candidate.fit.parameters.effects if item.name == name), None) or effect(name)


def parameters_of(candidate: Candidate, name: str) -> dict[str, float]:
    """Return the fitted parameters of one effect that all tests share, SI."""
    chosen = effect_in(candidate, name)
    tests = candidate.fit.parameters.dataset.tests
    values = candidate.fit.parameters.effect_values(candidate.fit.theta, chosen, tests[0].number)
    return {
        parameter.name: float(value)
        for parameter, value in zip(chosen.parameters, values, strict=True)
        if not parameter.per_test
    }


TRIALS = 6
"""Simulations of an effect at most; the size follows from the last two by a power law."""
CLOSE = 0.1
"""Relative difference of the score at which the search for a size ends."""
LARGEST_FACTOR = 30.0
"""Largest change of the size from one trial to the next."""
LEAST_RISE = 0.05
"""Least rise of the score by a visible effect, nats, also where the baseline is close to a gap already."""


@dataclass(frozen=True)
class DetectionLimit:
    """Smallest size of an effect that would have been named: the value of one of its parameters, SI.

    Where the effect vanishes as its parameter grows, such as the mass of a frame, it is the largest value (``below``).
    """

    parameter: str
    value: float
    unit: str
    below: bool


class DetectionLimits:
    """Detection limits at a fit.

    Args:
        explanation: the fit that explains the session: the baseline without a gap, or the named set.
        named: effects that it adds to the baseline.
    """

    def __init__(self, explanation: Candidate, named: Sequence[str]) -> None:
        self._fit = explanation.fit
        self._screen = Screen(explanation.fit)
        self._blocks = [block for _, block in residual_blocks(explanation.fit)]
        self._left = [float(np.mean(explanation.fit.residuals[block] ** 2)) for block in self._blocks]
        self._tests = len(explanation.fit.parameters.dataset.tests)
        # A further member of a set needs its gain; a first effect a certain gap.
        self._wanted = THRESHOLDS.set_gain if named else max(THRESHOLDS.least_score - explanation.score, LEAST_RISE)

    def of(self, effect: Effect) -> DetectionLimit | None:
        """Return the limit of an effect; None where no size within its bounds would have been named, or where its size
        is estimated from the record."""
        start = starts_of(self._fit.parameters.dataset, effect, self._fit.predictions)[0]
        scaled = _scaled_parameters(effect, start)
        if not scaled:
            return None
        size, last = 1.0, None
        for _ in range(TRIALS):
            values = _at_size(effect, start, scaled, size)
            raised = self._raised(effect, values)
            if abs(raised - self._wanted) <= CLOSE * self._wanted:
                break
            # The score grows with the square of a small size.
            power = 2.0
            if last is not None and last[0] != size and raised > 0.0 < last[1]:
                power = min(max(math.log(raised / last[1]) / math.log(size / last[0]), 0.3), 4.0)
            last = (size, raised)
            factor = (self._wanted / raised) ** (1.0 / power) if raised > 0.0 else LARGEST_FACTOR
            size *= min(max(factor, 1.0 / LARGEST_FACTOR), LARGEST_FACTOR)
        else:
            if raised < self._wanted:
                return None
        if any(not effect.parameters[k].low <= values[k] <= effect.parameters[k].high for k in scaled):
            return None
        first, value = effect.parameters[scaled[0]], values[scaled[0]]
        assert first.neutral is not None
        return DetectionLimit(
            first.name,
            abs(value) if first.neutral == 0.0 else value,
            first.unit,
            below=first.neutral > value and first.neutral != 0.0,
        )

    def _raised(self, effect: Effect, values: tuple[float, ...]) -> float:
        # Half the logarithm of the error with and without the effect, as in ``decision.score``.
        change = self._screen.surviving_change(effect, values)
        added = [float(np.mean(change[block] ** 2)) for block in self._blocks]
        return sum(
            0.5 * math.log1p(more / max(remaining, 1.0)) for more, remaining in zip(added, self._left, strict=True)
        ) / max(self._tests, 1)


def _scaled_parameters(effect: Effect, start: Sequence[float]) -> list[int]:
    # The parameters that vanish with the effect: the first, or all where it vanishes with all of them only.
    scaled = [
        k
        for k, (parameter, value) in enumerate(zip(effect.parameters, start, strict=True))
        if parameter.neutral is not None and not parameter.fixed and value != parameter.neutral
    ]
    return scaled if effect.jointly else scaled[:1]


def _at_size(effect: Effect, start: Sequence[float], scaled: Sequence[int], size: float) -> tuple[float, ...]:
    values = list(start)
    for k in scaled:
        neutral = effect.parameters[k].neutral
        assert neutral is not None
        values[k] = start[k] / size if math.isinf(neutral) else neutral + size * (start[k] - neutral)
    return tuple(values)
