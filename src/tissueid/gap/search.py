"""Search for the cause of a gap: baseline, screening, fits of the best candidates, pairs by forward selection."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal, TypeVar

from tissueid.gap.dataset import Dataset, Purpose
from tissueid.gap.decision import THRESHOLDS
from tissueid.gap.fitting import ESTIMATES, MOST_STEPS, Fit, fit, re_estimate
from tissueid.gap.outliers import with_robust_noise
from tissueid.gap.scoring import Candidate, score_candidate
from tissueid.gap.screening import Screen, Signature, best_aligned
from tissueid.gap.workers import Executor
from tissueid.twin.bus import MOST_EFFECTS
from tissueid.twin.catalogue import all_effects, effect
from tissueid.twin.effect import Effect, nested

T = TypeVar("T")
R = TypeVar("R")

SINGLES = 12
"""Largest number of starting points refitted, best-aligned first."""
LEAST_ALIGNMENT = 0.02
FIRST_STARTING_POINTS = 4
"""Starting points refitted first. Where one of them explains the gap, only close rivals follow."""
RIVAL_ALIGNMENT = 0.5
"""Least alignment of a close rival, as a share of the best alignment."""
RIVAL_SCORE = 1.5
"""Largest score of a close rival after its short fit, nats."""
SHORT_STEPS = 6
"""Optimiser steps of a short fit, which every candidate gets; the best candidates get a full fit."""
SHORT_STEPS_OF_MANY = 10
"""Optimiser steps of a short fit to several tests, whose minima are narrower."""
ESTIMATES_IN_A_SHORT_FIT = 1
"""Re-estimates of an effect from the record in a short fit; a full fit repeats them."""
FULL_FITS = 4
FULL_FITS_BY_COST = 2
"""Full fits of candidates with the least cost on the fitted samples, in addition to those with the best score."""
FURTHER = 12
FURTHER_FULL_FITS = 8
"""Starting points of the second round, and its full fits."""
PARTNERS = 4
"""Largest number of partners refitted with each top candidate."""
FULL_FITS_OF_PAIRS = 2
FURTHER_PARTNERS = 6
"""Most further partners refitted with each member of a pair with a large remaining gap."""


Work = Literal[
    "baseline",
    "screening",
    "likeliest candidates",
    "candidates",
    "leading candidates",
    "further starting points",
    "further candidates",
    "near relations",
    "pairs",
    "leading pairs",
    "members of the pair",
    "further pairs",
    "further leading pairs",
]
"""Steps of a search."""


@dataclass(frozen=True)
class SearchProgress:
    """Progress of a search: ``done`` of ``total`` items of the step ``what``."""

    what: Work
    done: int
    total: int


@dataclass(frozen=True)
class Task:
    """A fit to run: effects with their starting points, near another fit."""

    dataset: Dataset
    names: tuple[str, ...]
    starts: tuple[tuple[float, ...], ...]
    near: Fit
    most_steps: int

    def __str__(self) -> str:
        return " + ".join(self.names)


def refit(task: Task) -> Candidate:
    """Run one fit; called in a worker process."""
    effects = [effect(name) for name in task.names]
    found = fit(task.dataset, effects, task.starts, near=task.near, most_steps=task.most_steps)
    readings = ESTIMATES if task.most_steps == MOST_STEPS else ESTIMATES_IN_A_SHORT_FIT
    return score_candidate(re_estimate(found, task.most_steps, readings))


def screen(near: Fit, name: str) -> list[Signature]:
    """Return the signatures of an effect on the residual of a fit; called in a worker process."""
    return Screen(near).signatures(effect(name))


def applicable(dataset: Dataset, item: Effect) -> bool:
    """Return whether the recorded signals can identify an effect."""
    has = set(dataset.channels)
    if not item.needs <= has | {"command"}:
        return False
    if dataset.equivalent is not None and item.stage == "environment":
        return False
    if item.stage == "drive":
        return "voltage" in has
    if item.stage == "coil":
        return "current" in has
    return True


@dataclass(frozen=True)
class SearchResult:
    """The baseline, all signatures, and all refitted candidates, best first."""

    baseline: Candidate
    signatures: tuple[Signature, ...]
    candidates: tuple[Candidate, ...]

    @property
    def singles(self) -> list[Candidate]:
        """Candidates with one effect in addition to the baseline, best first."""
        return [item for item in self.candidates if len(set(item.effects) - set(self.baseline.effects)) == 1]


class Search:
    """A search on one session.

    Args:
        dataset: the tests.
        pool: the executor of the fits.
        names: effects to try; all applicable effects of the library where None.
        progress: callback for progress.
        cancelled: callback that returns True to stop with ``CancelledError``.
    """

    def __init__(
        self,
        dataset: Dataset,
        pool: Executor,
        names: Sequence[str] | None = None,
        progress: Callable[[SearchProgress], None] = lambda _: None,
        cancelled: Callable[[], bool] = lambda: False,
    ) -> None:
        self._dataset = dataset
        self._pool = pool
        self._names = [
            name
            for name, item in all_effects().items()
            if (names is None or name in names) and applicable(dataset, item)
        ]
        several = sum(bool(test.serving(Purpose.FIT).any()) for test in dataset.tests) > 1
        self._short_steps = SHORT_STEPS_OF_MANY if several else SHORT_STEPS
        self._progress = progress
        self._cancelled = cancelled

    def baseline(self, known: Sequence[str] = ()) -> Candidate:
        """Refit the baseline, with the ``known`` effects of a saved twin.

        From then on outliers are not part of the noise floor.
        """
        self._progress(SearchProgress("baseline", 0, 1))
        effects = [effect(name) for name in known]
        first = fit(self._dataset, effects, cancelled=self._cancelled)
        dataset = with_robust_noise(first)
        if dataset is not self._dataset:
            self._dataset = dataset
            first = fit(dataset, effects, cancelled=self._cancelled)
        found = score_candidate(first)
        self._progress(SearchProgress("baseline", 1, 1))
        return found

    def singles(self, baseline: Candidate) -> SearchResult:
        """Fit each candidate effect alone."""
        signatures = self._screened(baseline.fit)
        worth = best_aligned(signatures)[:SINGLES]
        short_fits = self._short_fits("likeliest candidates", baseline, worth[:FIRST_STARTING_POINTS])
        if short_fits and min(item.score for item in short_fits) <= THRESHOLDS.at_the_floor:
            # The gap is explained: only effects with a similar signature can be rivals.
            worth = [item for item in worth if item.alignment >= RIVAL_ALIGNMENT * worth[0].alignment]
        short_fits += self._short_fits("candidates", baseline, worth[FIRST_STARTING_POINTS:])
        candidates = self._full_fits("leading candidates", short_fits, FULL_FITS)
        return SearchResult(baseline, tuple(signatures), self._with_nested(baseline, candidates))

    def further(self, found: SearchResult) -> SearchResult:
        """Fit from more starting points, with more full fits.

        For a first round with a large remaining gap: a narrow minimum can have been missed.
        """
        tried = best_aligned(found.signatures)[:SINGLES]
        others = [item for item in found.signatures if all(item is not other for other in tried)]
        others.sort(key=lambda item: -item.alignment)
        short_fits = self._short_fits("further starting points", found.baseline, others[:FURTHER])
        on_the_way = [item for item in found.candidates if item.fit.steps == self._short_steps]
        finished = [item for item in found.candidates if item.fit.steps != self._short_steps]
        full_fits = self._full_fits("further candidates", [*short_fits, *on_the_way], FURTHER_FULL_FITS)
        candidates = _best_of_each([*finished, *full_fits])
        return SearchResult(found.baseline, found.signatures, self._with_nested(found.baseline, candidates))

    def _with_nested(self, baseline: Candidate, candidates: Sequence[Candidate]) -> tuple[Candidate, ...]:
        # The top candidate with one of its effects replaced by the special case or the general form of the effect.
        if not candidates:
            return ()
        leader = candidates[0]
        tasks = [
            self._task_with_partner(leader.fit, held, other)
            for held in leader.fit.parameters.effects
            for other in map(effect, self._names)
            if held.name not in baseline.effects and other.name not in leader.effects and nested(held, other)
        ]
        return _best_of_each([*candidates, *self._run_tasks("near relations", refit, tasks)])

    def _task_with_partner(self, near: Fit, held: Effect, other: Effect) -> Task:
        # Start at the fit: parameters of the same name have the same meaning in both effects.
        values = near.parameters.effect_values(near.theta, held, near.parameters.dataset.tests[0].number)
        led = {item.name: float(value) for item, value in zip(held.parameters, values, strict=True)}
        there = tuple(led.get(item.name, at) for item, at in zip(other.parameters, other.starts[0], strict=True))
        effects = [other if item is held else item for item in near.parameters.effects]
        starts = tuple(there if item is other else item.starts[0] for item in effects)
        return Task(self._dataset, tuple(item.name for item in effects), starts, near, MOST_STEPS)

    def pairs_with(self, baseline: Candidate, leaders: Sequence[Candidate]) -> tuple[Candidate, ...]:
        """Fit the top candidates with one more effect each, best first; effects of the baseline stay.

        A candidate with ``MOST_EFFECTS`` effects gets no more.
        """
        short_fits = [
            pair
            for leader in leaders
            if len(leader.effects) < MOST_EFFECTS
            for pair in self._short_fits("pairs", leader, self._likely_partners(leader)[:PARTNERS])
        ]
        return self._with_nested(baseline, self._full_fits("leading pairs", short_fits, FULL_FITS_OF_PAIRS))

    def further_pairs(self, baseline: Candidate, pair: Candidate, tried: Sequence[Candidate]) -> tuple[Candidate, ...]:
        """Fit more partners of each member of a pair with a large remaining gap: one member can be wrong.

        The pairs ``tried`` before are not fitted again; the result includes them, best first.
        """
        added = [name for name in pair.effects if name not in baseline.effects]
        alone = [
            Task(self._dataset, tuple(name for name in pair.effects if name != other), (), pair.fit, self._short_steps)
            for other in added
        ]
        known = {frozenset(item.effects) for item in tried}
        short_fits = []
        for member in self._run_tasks("members of the pair", refit, alone):
            likely = self._likely_partners(member)
            fresh = [item for item in likely if frozenset((*member.effects, item.effect)) not in known]
            short_fits += self._short_fits("further pairs", member, fresh[:FURTHER_PARTNERS])
        full_fits = self._full_fits("further leading pairs", short_fits, FULL_FITS_OF_PAIRS)
        return self._with_nested(baseline, _best_of_each([*tried, *full_fits]))

    def _likely_partners(self, leader: Candidate) -> list[Signature]:
        # Screen all starting points: alignment changes when another effect is in the model.
        return best_aligned(self._screened(leader.fit))

    def _short_fits(self, what: Work, near: Candidate, signatures: Sequence[Signature]) -> list[Candidate]:
        worth = [item for item in signatures if item.alignment >= LEAST_ALIGNMENT]
        before = [held.starts[0] for held in near.fit.parameters.effects]
        tasks = [
            Task(self._dataset, (*near.effects, item.effect), (*before, item.start), near.fit, self._short_steps)
            for item in worth
        ]
        return self._run_tasks(what, refit, tasks)

    def _full_fits(self, what: Work, short_fits: Sequence[Candidate], count: int) -> tuple[Candidate, ...]:
        ranked = _best_of_each(short_fits)
        if ranked and ranked[0].score <= THRESHOLDS.at_the_floor:
            count = sum(item.score <= RIVAL_SCORE for item in ranked[:count])
        fitting = sorted(ranked, key=lambda item: item.fit.cost)[: min(FULL_FITS_BY_COST, count)]
        going_on = [
            item
            for place, item in enumerate(ranked)
            if (place < count or any(item is other for other in fitting)) and item.fit.steps >= self._short_steps
        ]
        tasks = [Task(self._dataset, item.effects, (), item.fit, MOST_STEPS) for item in going_on]
        finished = self._run_tasks(what, refit, tasks)
        others = [item for item in ranked if all(item is not other for other in going_on)]
        return tuple(sorted((*finished, *others), key=lambda item: item.score))

    def _screened(self, near: Fit) -> list[Signature]:
        there = {item.name for item in near.parameters.effects}
        names = [name for name in self._names if name not in there]
        found = self._run_tasks("screening", partial(screen, near), names)
        return [item for items in found for item in items]

    def _run_tasks(self, what: Work, work: Callable[[T], R], things: Sequence[T]) -> list[R]:
        if not things:
            return []
        count = 0

        def done(_: object) -> None:
            nonlocal count
            count += 1
            self._progress(SearchProgress(what, count, len(things)))

        self._progress(SearchProgress(what, 0, len(things)))
        return self._pool.do(work, things, self._cancelled, done)


def _best_of_each(candidates: Sequence[Candidate]) -> tuple[Candidate, ...]:
    # The best fit of every set of effects, best first.
    best: dict[frozenset[str], Candidate] = {}
    for item in sorted(candidates, key=lambda item: item.score):
        best.setdefault(frozenset(item.effects), item)
    return tuple(best.values())
