"""Search for the cause of a gap: baseline, screening, fits of the best candidates, pairs by forward selection."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, TypeVar

from tissueid.gap.dataset import Dataset, Purpose
from tissueid.gap.decision import Candidate, contributes, cost, fitted_score, grows, misfit, score_candidate, tried
from tissueid.gap.fit_tasks import (
    Signature,
    Task,
    acts_on_machine,
    best_aligned,
    best_starts,
    effects_of,
    from_twin,
    on_found_surface,
    other_minima,
    refit,
    screen,
)
from tissueid.gap.fitting import Fit, fit, residuals_without
from tissueid.gap.machine_family import with_best_family
from tissueid.gap.noise import rests, with_robust_noise
from tissueid.gap.thresholds import LIMITS, THRESHOLDS
from tissueid.gap.workers import Executor
from tissueid.language import marked
from tissueid.twin.bus import MOST_EFFECTS
from tissueid.twin.catalogue import effect
from tissueid.twin.effect import Effect, nested

T = TypeVar("T")
R = TypeVar("R")

SCREENING_TASKS = 8
"""Tasks of a screening: each prepares the fit once for its effects."""
SLOWLY = (300.0, 100.0, 30.0)
WEAK_STARTS: tuple[tuple[int, tuple[float, ...], bool], ...] = (
    (0, SLOWLY, True),
    (1, (100.0,), True),
    (1, SLOWLY, False),
)
"""Starts of a set: which weak start of each effect, bandwidths of the observers with which its fits begin, one after
the other (rad/s), and whether effects that were fitted before keep their values; otherwise the surface is the one that
was found.

The error of a free run has many minima where several effects are far from their values; tracked, it has few. Which way
leads to the least one differs from session to session.
"""
Work = Literal[
    "baseline",
    "screening",
    "likeliest candidates",
    "candidates",
    "leading candidates",
    "further starting points",
    "further candidates",
    "near relations",
    "tissue",
    "additions",
    "leading additions",
    "removals",
    "replacements",
    "leading replacements",
    "detection limits",
]
"""Steps of a search."""
STEPS: Mapping[Work, str] = {
    "baseline": marked("Fitting the baseline twin"),
    "screening": marked("Screening all known effects"),
    "likeliest candidates": marked("Fitting the likeliest effects"),
    "candidates": marked("Fitting the other effects"),
    "leading candidates": marked("Fitting the leading effects to the end"),
    "further starting points": marked("Fitting from further starting points"),
    "further candidates": marked("Fitting further effects to the end"),
    "near relations": marked("Fitting near relations of what leads"),
    "tissue": marked("Fitting the effects of living tissue together"),
    "additions": marked("Fitting sets with one more effect"),
    "leading additions": marked("Fitting the leading sets to the end"),
    "removals": marked("Removing each effect in turn"),
    "replacements": marked("Fitting other effects in place of each"),
    "leading replacements": marked("Fitting the leading replacements to the end"),
    "detection limits": marked("Computing the sizes from which effects would be named"),
}
"""Text of each step of the search."""
_ALWAYS: frozenset[Work] = frozenset({"baseline", "screening", "likeliest candidates", "removals"})
"""Steps that are made after the time limit as well: without them nothing could be named."""


@dataclass(frozen=True)
class SearchProgress:
    """Progress of a search: ``done`` of ``total`` items of the step ``what``."""

    what: Work
    done: int
    total: int


def _by_alignment(signatures: Sequence[Signature]) -> list[Signature]:
    return sorted(signatures, key=lambda item: -item.alignment)


def applicable(dataset: Dataset, item: Effect) -> bool:
    """Return whether the recorded signals can identify an effect."""
    if dataset.equivalent is not None:
        return acts_on_machine(dataset, item)
    has = set(dataset.channels)
    if not item.needs <= has | {"command"}:
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


@dataclass
class _Removals:
    """Sets without one effect of ``complete``, by the effect, and those of them with more steps than a short fit."""

    complete: Candidate
    smaller: dict[str, Candidate]
    fitted_further: set[str]


class Search:
    """A search on one session.

    Args:
        dataset: the tests.
        pool: the executor of the fits.
        names: effects to try; all applicable effects of the library where None.
        progress: callback for progress.
        cancelled: callback that returns True to stop with ``CancelledError``.
        without: effects that are not tried.
        seconds: time after which no further step begins; None without a limit.
    """

    def __init__(
        self,
        dataset: Dataset,
        pool: Executor,
        names: Sequence[str] | None = None,
        progress: Callable[[SearchProgress], None] = lambda _: None,
        cancelled: Callable[[], bool] = lambda: False,
        without: Sequence[str] = (),
        seconds: float | None = None,
    ) -> None:
        self.not_tried: list[Work] = []
        """Steps that the time limit left out."""
        self._deadline = math.inf if seconds is None else time.monotonic() + seconds
        self._dataset = dataset
        self._pool = pool
        self._without = without
        self._wanted = names
        several = sum(bool(test.serving(Purpose.FIT).any()) for test in dataset.tests) > 1
        self._short_steps = LIMITS.short_steps_of_many if several else LIMITS.short_steps
        self._progress = progress
        self._cancelled = cancelled
        self._accepted: tuple[str, ...] = ()
        self._baseline: Fit | None = None
        self._with_tissue: set[frozenset[str]] = set()
        self._from_baseline: set[frozenset[str]] = set()
        self._removed: list[_Removals] = []
        self._starts: dict[str, tuple[tuple[float, ...], ...]] = {}

    @property
    def dataset(self) -> Dataset:
        """The tests, from the baseline on without outliers in the noise floor."""
        return self._dataset

    def baseline(self, accepted: Sequence[str] = ()) -> Candidate:
        """Refit the baseline, with the ``accepted`` effects of a saved twin.

        From then on outliers are not part of the noise floor.
        """
        self._progress(SearchProgress("baseline", 0, 1))
        self._dataset = with_best_family(self._dataset)
        self._accepted = tuple(accepted)
        effects = [effects_of(self._dataset)[name] for name in accepted]
        first = fit(self._dataset, effects, cancelled=self._cancelled)
        dataset = with_robust_noise(first)
        if dataset is not self._dataset:
            self._dataset = dataset
            first = fit(dataset, effects, cancelled=self._cancelled)
        self._baseline = first
        candidate = score_candidate(first)
        self._progress(SearchProgress("baseline", 1, 1))
        return candidate

    @property
    def names(self) -> list[str]:
        """Effects to try, in the order of the library."""
        still = rests(self._dataset)
        return [
            name
            for name, item in effects_of(self._dataset).items()
            if (self._wanted is None or name in self._wanted)
            and name not in self._without
            and applicable(self._dataset, item)
            and not (still and item.at_rest)
        ]

    def singles(self, baseline: Candidate) -> SearchResult:
        """Fit each candidate effect alone."""
        signatures = self._screened(baseline.fit)
        for name in self.names:
            of_effect = _by_alignment([item for item in signatures if item.effect == name])
            self._starts[name] = tuple(item.start for item in of_effect[: LIMITS.beam])
        worth = best_aligned(signatures)[: LIMITS.starts]
        short_fits = self._short_fits("likeliest candidates", baseline, worth[: LIMITS.fits])
        if short_fits and min(item.score for item in short_fits) <= THRESHOLDS.at_the_floor:
            # The gap is explained: only effects with a similar signature can be rivals.
            worth = [item for item in worth if item.alignment >= LIMITS.rival_alignment * worth[0].alignment]
        short_fits += self._short_fits("candidates", baseline, worth[LIMITS.fits :])
        candidates = self._full_fits("leading candidates", short_fits, LIMITS.fits, best_aligned_too=True)
        return SearchResult(baseline, tuple(signatures), self._with_nested(baseline, candidates))

    def further(self, result: SearchResult) -> SearchResult:
        """Fit from more starting points, with more full fits.

        For a first round with a large remaining gap: a narrow minimum can have been missed.
        """
        tried = best_aligned(result.signatures)[: LIMITS.starts]
        others = [item for item in result.signatures if all(item is not other for other in tried)]
        short_fits = self._short_fits(
            "further starting points", result.baseline, _by_alignment(others)[: LIMITS.starts]
        )
        on_the_way = [item for item in result.candidates if item.fit.steps == self._short_steps]
        finished = [item for item in result.candidates if item.fit.steps != self._short_steps]
        full_fits = self._full_fits("further candidates", [*short_fits, *on_the_way], 2 * LIMITS.fits)
        candidates = _best_of_each([*finished, *full_fits])
        return SearchResult(result.baseline, result.signatures, self._with_nested(result.baseline, candidates))

    def _with_nested(self, baseline: Candidate, candidates: Sequence[Candidate]) -> tuple[Candidate, ...]:
        # The top candidate with one of its effects replaced by the special case or the general form of the effect.
        if not candidates:
            return ()
        leader = candidates[0]
        tasks = [
            self._task_with_partner(leader.fit, held, other)
            for held in leader.fit.parameters.effects
            for other in map(effects_of(self._dataset).__getitem__, self.names)
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
        return Task(self._dataset, tuple(item.name for item in effects), starts, near, LIMITS.most_steps)

    def tissue_set(self, near: Candidate) -> tuple[Candidate, ...]:
        """Fit a set together with all effects of living tissue that it lacks, from the first weak starts.

        None where there is nothing to fit.

        There is nothing to fit where that fit has all of them, where an accepted twin has some, or where this was done
        before.

        Living tissue shows several at once, and each conceals the others: together they have a wide minimum that adding
        one after the other misses.
        """
        if all(test.fixture != "tissue" for test in self._dataset.tests) or self._dataset.equivalent is not None:
            return ()
        if any(effect(name).in_living_tissue for name in self._accepted):
            return ()
        missing = [effect(name) for name in self.names if name not in near.effects]
        chosen = [item for item in missing if item.in_living_tissue][: MOST_EFFECTS - len(near.effects)]
        names = (*near.effects, *(item.name for item in chosen))
        if not chosen or len(names) < 2 or frozenset(names) in self._with_tissue:
            return ()
        self._with_tissue.add(frozenset(names))
        if near.effects == self._accepted:
            self._from_baseline.add(frozenset(names))
        tasks = self._from_weak_starts(near, names)[: LIMITS.beam]
        return tuple(sorted(self._run_tasks("tissue", refit, tasks), key=_fitted_cost)[:1])

    def tissue_set_again(self, near: Candidate, candidate: Candidate) -> Candidate:
        """Fit a set that ``tissue_set`` found near a candidate from the other weak starts too, where its fits lowered
        the misfit and leave enough for another member. Return the better fit."""
        if not grows(near, candidate) or candidate.score <= THRESHOLDS.set_gain:
            return candidate
        tasks = self._from_weak_starts(near, candidate.effects)[LIMITS.beam :]
        return min((candidate, *self._run_tasks("tissue", refit, tasks)), key=_fitted_cost)

    def _from_weak_starts(self, near: Candidate, names: Sequence[str]) -> list[Task]:
        library, tasks = effects_of(self._dataset), []
        for k, bandwidths, keeps in WEAK_STARTS:
            begin = near.fit if keeps or self._baseline is None else on_found_surface(self._baseline)
            held = {item.name: item.starts[0] for item in begin.parameters.effects}
            starts = tuple(held.get(name) or library[name].weak_starts[k] for name in names)
            tasks.append(Task(self._dataset, tuple(names), starts, begin, LIMITS.steps_in_a_set, bandwidths))
        return tasks

    def add_to(self, leaders: Sequence[Candidate]) -> tuple[Candidate, ...]:
        """Fit the leaders with one more effect each, best first; a leader with ``MOST_EFFECTS`` effects has no room."""
        short_fits = [
            larger
            for leader in leaders
            if len(leader.effects) < MOST_EFFECTS
            for larger in self._with_partner("additions", leader)
        ]
        return self._full_fits("leading additions", short_fits, LIMITS.beam, LIMITS.steps_in_a_set)

    def perhaps_needless(self, candidate: Candidate, names: Sequence[str]) -> list[str]:
        """Return those of ``names`` that a linear refit does not show to be clearly needed."""
        before = fitted_score(candidate.fit, candidate.fit.residuals)
        return [
            name
            for name in names
            if fitted_score(candidate.fit, residuals_without(candidate.fit, name)) - before < LIMITS.clearly_needed
        ]

    def remove_from(self, candidate: Candidate, names: Sequence[str], *, briefly: bool = False) -> list[Candidate]:
        """Refit a set without each of ``names``, in their order; those that cost least are fitted further, unless
        ``briefly`` and their short fit shows that the member is clearly needed."""
        done = next((item for item in self._removed if item.complete is candidate), None) or _Removals(
            candidate, {}, set()
        )
        self._removed = [*(item for item in self._removed if item is not done), done][-LIMITS.beam :]
        new = [name for name in names if name not in done.smaller]
        short_fits = self._run_tasks("removals", refit, [self._smaller(candidate, (name,)) for name in new])
        done.smaller.update(zip(new, short_fits, strict=True))
        least = sorted(names, key=lambda name: done.smaller[name].fit.cost)[: LIMITS.beam]
        if briefly:
            least = [name for name in least if done.smaller[name].score - candidate.score < LIMITS.clearly_needed]
        further = [name for name in least if name not in done.fitted_further]
        tasks = self._continued([done.smaller[name] for name in further], LIMITS.steps_in_a_set)
        done.smaller.update(zip(further, self._run_tasks("removals", refit, tasks), strict=True))
        done.fitted_further.update(further)
        return [done.smaller[name] for name in names]

    def remove_all_from(self, candidate: Candidate, names: Sequence[str]) -> list[Candidate]:
        """Refit a set without all of ``names``."""
        task = replace(self._smaller(candidate, names), most_steps=LIMITS.steps_in_a_set)
        return self._run_tasks("removals", refit, [task])

    def _continued(self, items: Sequence[Candidate], most_steps: int) -> list[Task]:
        return [Task(self._dataset, item.effects, (), item.fit, most_steps) for item in items]

    def _smaller(self, candidate: Candidate, names: Sequence[str]) -> Task:
        kept = tuple(name for name in candidate.effects if name not in names)
        return Task(self._dataset, kept, (), candidate.fit, self._short_steps)

    def polish(self, baseline: Candidate, candidate: Candidate) -> Candidate:
        """Fit a set from weak starts and from other starts of each member, and the best of these fits to the end.

        A set has many minima: where one member is at a wrong one, the others compensate for it. Where less is left than
        the least gain of a needed member, no other start can change what is named.
        """
        best = candidate
        if candidate.score > THRESHOLDS.set_gain and self.in_time("replacements"):
            done = frozenset(candidate.effects) in self._from_baseline
            tasks = [] if done else self._from_weak_starts(baseline, candidate.effects)
            best = self._restarted(
                baseline, min((candidate, *self._run_tasks("replacements", refit, tasks)), key=_fitted_cost)
            )
        to_the_end = self._continued([best], LIMITS.most_steps)
        return min((best, *self._run_tasks("leading additions", refit, to_the_end)), key=_fitted_cost)

    def _restarted(self, baseline: Candidate, best: Candidate) -> Candidate:
        for _ in range(LIMITS.restarts):
            added = [name for name in best.effects if name not in baseline.effects]
            restarts = [
                Task(self._dataset, (*without.effects, name), (*held, start), without.fit, self._short_steps)
                for name, without in zip(added, self.remove_from(best, added), strict=True)
                for held in [[kept.starts[0] for kept in without.fit.parameters.effects]]
                for start in best_starts(without.fit, name)
            ]
            restarts += [
                Task(self._dataset, best.effects, (), near, self._short_steps) for near in other_minima(best.fit)
            ]
            short_fits = sorted(self._run_tasks("replacements", refit, restarts), key=_fitted_cost)
            tasks = self._continued(short_fits[: LIMITS.beam], LIMITS.steps_in_a_set)
            better = min((best, *self._run_tasks("leading replacements", refit, tasks)), key=_fitted_cost)
            if better.fit.cost > LIMITS.worth_a_round * best.fit.cost:
                return better
            best = better
        return best

    def replace_in(self, candidate: Candidate, smaller: Sequence[Candidate]) -> tuple[Candidate, ...]:
        """Fit rivals in the place of the member that each of the ``smaller`` sets lacks, best first."""
        short_fits = [
            item for without in smaller for item in self._with_partner("replacements", without, candidate.effects)
        ]
        return self._full_fits("leading replacements", short_fits, LIMITS.beam, LIMITS.steps_in_a_set)

    def nested_with(self, baseline: Candidate, candidate: Candidate) -> Candidate:
        """Return the set, or a better one with a special case or the general form of a member in its place."""
        return min(self._with_nested(baseline, [candidate]), key=misfit)

    def _with_partner(self, what: Work, near: Candidate, excluded: Sequence[str] = ()) -> list[Candidate]:
        # Short fits of a set with another effect. Its alignment changes when another effect is in the model.
        if not self.in_time(what):
            return []
        likely = best_aligned(self._screened(near.fit), most_starts=1)
        tried = [item for item in likely if item.effect not in excluded][: LIMITS.starts]
        trials = self._short_fits(what, near, tried, LIMITS.trial_steps)
        chosen = trials[: LIMITS.beam]
        chosen += sorted(trials[LIMITS.beam :], key=_fitted_cost)[: LIMITS.fits - len(chosen)]
        return self._run_tasks(what, refit, self._continued(chosen, self._short_steps))

    def _short_fits(
        self, what: Work, near: Candidate, signatures: Sequence[Signature], most_steps: int | None = None
    ) -> list[Candidate]:
        worth = [item for item in signatures if item.alignment >= LIMITS.least_alignment]
        before = [held.starts[0] for held in near.fit.parameters.effects]
        begin = from_twin(near.fit) if near.effects == self._accepted else near.fit
        steps = most_steps or self._short_steps
        tasks = [
            Task(self._dataset, (*near.effects, item.effect), (*before, item.start), begin, steps) for item in worth
        ]
        return self._run_tasks(what, refit, tasks)

    def _full_fits(
        self,
        what: Work,
        short_fits: Sequence[Candidate],
        count: int,
        most_steps: int = LIMITS.most_steps,
        best_aligned_too: bool = False,
    ) -> tuple[Candidate, ...]:
        ranked = _best_of_each(short_fits)
        if ranked and ranked[0].score <= THRESHOLDS.at_the_floor:
            count = sum(item.score <= LIMITS.rival_score for item in ranked[:count])
        fitting = sorted(ranked, key=lambda item: item.fit.cost)[: min(LIMITS.beam, count)]
        going_on = [item for rank, item in enumerate(ranked) if rank < count or any(item is other for other in fitting)]
        if best_aligned_too and all(item is not other for item in short_fits[:1] for other in going_on):
            # A narrow minimum is reached in many steps, and a short fit towards it can leave more than others.
            going_on += short_fits[:1]
        going_on = [item for item in going_on if item.fit.steps >= self._short_steps]
        finished = self._run_tasks(what, refit, self._continued(going_on, most_steps)) or going_on
        others = [item for item in ranked if all(item is not other for other in going_on)]
        return tuple(sorted((*finished, *others), key=lambda item: item.score))

    def _screened(self, near: Fit) -> list[Signature]:
        there = {item.name for item in near.parameters.effects}
        items = [(name, self._starts.get(name, ())) for name in self.names if name not in there]
        parts = [items[k::SCREENING_TASKS] for k in range(min(SCREENING_TASKS, len(items)))]
        signatures = self._run_tasks("screening", partial(screen, near), parts)
        return [item for items in signatures for item in items]

    def in_time(self, what: Work) -> bool:
        """Return whether a step may begin; ``not_tried`` keeps those that may not."""
        if what in _ALWAYS or time.monotonic() < self._deadline:
            return True
        self.not_tried += [what] if what not in self.not_tried else []
        return False

    def _run_tasks(self, what: Work, work: Callable[[T], R], things: Sequence[T]) -> list[R]:
        # Without results where there is nothing to do, or no time for it.
        if not things or not self.in_time(what):
            return []
        count = 0

        def done(_: object) -> None:
            nonlocal count
            count += 1
            self._progress(SearchProgress(what, count, len(things)))

        self._progress(SearchProgress(what, 0, len(things)))
        return self._pool.do(work, things, self._cancelled, done)


def _fitted_cost(candidate: Candidate) -> float:
    return candidate.fit.cost


def _best_of_each(candidates: Sequence[Candidate]) -> tuple[Candidate, ...]:
    # The best fit of every set of effects, best first.
    best: dict[frozenset[str], Candidate] = {}
    for item in sorted(candidates, key=lambda item: item.score):
        best.setdefault(frozenset(item.effects), item)
    return tuple(best.values())


class SetSearch:
    """The search for the set of effects that explains a gap: single effects, those of tissue, then forward-backward
    selection. It holds the best fit of every set.
    """

    def __init__(self, search: Search, baseline: Candidate) -> None:
        self._search, self._baseline = search, baseline
        self._fitted: dict[frozenset[str], Candidate] = {}

    def run(self) -> tuple[SearchResult, Candidate | None]:
        """Return everything that was fitted, and the best set of effects; None where no effect applies."""
        search, baseline = self._search, self._baseline
        result = search.singles(baseline)
        best = min(result.candidates, key=cost, default=None)
        if best is None:
            return result, None
        together: tuple[Candidate, ...] = ()
        if not self._settled(best):
            together = search.tissue_set(baseline)
            if together and self._closed(together[0]) < THRESHOLDS.structural:
                # An effect of the instrument can conceal those of the tissue.
                together = (min((*together, *search.tissue_set(_leaders(result)[0])), key=misfit),)
            together = tuple(search.tissue_set_again(baseline, item) for item in together)
            if not together or not grows(_leaders(result)[0], together[0]):
                result = search.further(result)
                best = min(result.candidates, key=cost)
        if cost(best) <= THRESHOLDS.set_gain or (baseline.effects and self._settled(best)):
            return result, best
        top = self._best_set(result, together)
        best = top if len(top.added_to(baseline)) > 1 else best
        return SearchResult(baseline, result.signatures, tuple(sorted(self._fitted.values(), key=cost))), best

    def _best_set(self, result: SearchResult, together: Sequence[Candidate]) -> Candidate:
        # It starts from the effects of the tissue ``together`` or from the best single effects, whichever leaves less.
        search, baseline = self._search, self._baseline
        self._fitted = {frozenset(item.effects): item for item in result.candidates}
        leaders = _leaders(result)
        for item in self._kept(together):
            if grows(leaders[0], item):
                leaders = [self._without_needless(item)]
        top = self._grown(leaders)
        if len(names := top.added_to(baseline)) > 1 and self._closed(top) < THRESHOLDS.structural:
            # A member can be wrong, most likely one whose removal costs little: try others in its place.
            smaller = sorted(self._kept(search.remove_from(top, names)), key=cost)[: LIMITS.beam]
            other = min(self._kept(search.replace_in(top, smaller)), key=misfit, default=None)
            if other is not None and grows(top, other):
                top = self._grown([search.nested_with(baseline, other)])
        while len(top.added_to(baseline)) > 1:
            (polished,) = self._kept([search.polish(baseline, top)])
            gained, top = misfit(top) - misfit(polished), polished
            if gained < THRESHOLDS.set_gain:
                break
            # At another minimum others can show.
            larger = self._grown([top])
            if set(larger.effects) == set(top.effects):
                break
            top = larger
        if len(names := top.added_to(baseline)) > 1:
            # The decision compares the set with those without each member.
            self._kept(search.remove_from(top, names))
        return top

    def _kept(self, items: Sequence[Candidate]) -> Sequence[Candidate]:
        for item in items:
            held = self._fitted.get(frozenset(item.effects))
            if held is None or misfit(item) < misfit(held):
                self._fitted[frozenset(item.effects)] = item
        return items

    def _closed(self, item: Candidate) -> float:
        return tried(self._baseline, item).closed

    def _settled(self, best: Candidate) -> bool:
        # The residual does not justify a longer search. Against a twin, whose effects are accepted, one new effect is
        # expected, and what it leaves is its structural error.
        enough = THRESHOLDS.structural if self._baseline.effects else LIMITS.nearly_all
        return best.score <= THRESHOLDS.at_the_floor or self._closed(best) >= enough

    def _grown(self, leaders: Sequence[Candidate]) -> Candidate:
        # Add to the leaders while the misfit falls and more is left than a needed member must gain, then remove what is
        # not needed.
        top = leaders[0]
        while len(top.added_to(self._baseline)) < LIMITS.most_members and top.score > THRESHOLDS.set_gain:
            grown = min(self._kept(self._search.add_to(leaders)), key=misfit, default=None)
            if grown is None or not grows(top, grown):
                break
            top = self._with_all_of_tissue(self._search.nested_with(self._baseline, grown))
            leaders = [top]
        return self._without_needless(top)

    def _with_all_of_tissue(self, top: Candidate) -> Candidate:
        # A set with some effects of tissue can conceal the others, as single effects do: fit them all together with the
        # other members.
        names, search = top.added_to(self._baseline), self._search
        in_tissue = [name for name in names if effect(name).in_living_tissue]
        if not in_tissue or len(in_tissue) == len(names) or top.score <= LIMITS.large_remainder:
            return top
        whole = self._kept([search.tissue_set_again(top, item) for item in search.tissue_set(top)])
        best = min(whole, key=misfit, default=top)
        return self._without_needless(best) if grows(top, best) else top

    def _without_needless(self, top: Candidate) -> Candidate:
        # Remove all members that contribute nothing, then one at a time the least needed.
        search, baseline = self._search, self._baseline
        while len(names := top.added_to(baseline)) > 1:
            names = search.perhaps_needless(top, names)
            smaller = self._kept(search.remove_from(top, names, briefly=True))
            idle = [name for name, without in zip(names, smaller, strict=True) if not grows(without, top)]
            if len(idle) > 1:
                without = self._kept(search.remove_all_from(top, idle))[0]
                if not grows(without, top):
                    top = without
                    continue
            least = min(smaller, key=cost, default=None)
            if least is None or contributes(tried(baseline, least), tried(baseline, top)):
                break
            top = least
        return top


def _leaders(result: SearchResult) -> list[Candidate]:
    # Of nested effects only the better one: both have the same partners, and nested effects of a set are tried later.
    leaders: list[Candidate] = []
    for item in (min(result.candidates, key=misfit), *sorted(result.candidates, key=cost)):
        if all(
            item is not other and not nested(effect(item.effects[-1]), effect(other.effects[-1])) for other in leaders
        ):
            leaders.append(item)
    return leaders[: LIMITS.beam]
