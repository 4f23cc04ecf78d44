"""The search for what explains a gap: baseline, screening, refits of the likeliest, pairs by forward selection."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal, TypeVar

from tissueid.gap.decision import THRESHOLDS
from tissueid.gap.fitting import MOST_STEPS, READINGS, Fit, fit, read_again
from tissueid.gap.impulses import without_impulses_in_the_floor
from tissueid.gap.observed import Observed, Purpose
from tissueid.gap.scoring import Candidate, judged
from tissueid.gap.screening import Screen, Signature, contenders
from tissueid.gap.workers import Crew
from tissueid.twin.bus import MOST_EFFECTS
from tissueid.twin.catalogue import all_effects, effect
from tissueid.twin.effect import Effect, kin

T = TypeVar("T")
R = TypeVar("R")

SINGLES = 12
"""So many starting points are tried, the best aligned ones; the others' signatures explain too little to win."""
LEAST_ALIGNMENT = 0.02
FIRST = 4
"""So many of the starting points are tried first ..."""
RIVAL_ALIGNMENT = 0.5
"""... and where one of them explains all, only near rivals are tried: those aligned by this share of the best, ..."""
RIVAL_SCORE = 1.5
"""... and followed: those that leave no more than this, nats."""
HEAT = 6
"""Steps of the search that every candidate gets; the best of them go on to the end."""
HEAT_OF_MANY = 10
"""The same where several tests are fitted together: their valleys are narrower."""
READINGS_IN_A_HEAT = 1
"""So many times an effect that is read off the record is read again; where the search goes on, more often."""
FINAL = 4
FINAL_BY_FIT = 2
"""So many of the candidates that fit best go on as well, whatever they predict so far."""
FURTHER = 12
FURTHER_FINAL = 8
"""A second round tries so many more starting points and follows so many candidates to the end."""
PARTNERS = 4
"""So many partners of each leading candidate are tried."""
FINAL_PAIRS = 2
FURTHER_PARTNERS = 6
"""So many more partners of each member of a pair are tried where the pair leaves much."""


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
"""What a search is busy with."""


@dataclass(frozen=True)
class Progress:
    """What is being done: ``done`` of ``total`` pieces of ``what``."""

    what: Work
    done: int
    total: int


@dataclass(frozen=True)
class Task:
    """A fit to make: effects with the starting point of each, beginning at another fit."""

    observed: Observed
    names: tuple[str, ...]
    starts: tuple[tuple[float, ...], ...]
    near: Fit
    most_steps: int

    def __str__(self) -> str:
        return " + ".join(self.names)


def refit(task: Task) -> Candidate:
    """Do one task; runs in a worker's process."""
    effects = [effect(name) for name in task.names]
    found = fit(task.observed, effects, task.starts, near=task.near, most_steps=task.most_steps)
    readings = READINGS if task.most_steps == MOST_STEPS else READINGS_IN_A_HEAT
    return judged(read_again(found, task.most_steps, readings))


def screen(near: Fit, name: str) -> list[Signature]:
    """Signatures of an effect against what a fit leaves; runs in a worker's process."""
    return Screen(near).signatures(effect(name))


def applicable(observed: Observed, item: Effect) -> bool:
    """Whether what was recorded can tell an effect at all."""
    has = set(observed.channels)
    if not item.needs <= has | {"command"}:
        return False
    if observed.equivalent is not None and item.stage == "environment":
        return False
    if item.stage == "drive":
        return "voltage" in has
    if item.stage == "coil":
        return "current" in has
    return True


@dataclass(frozen=True)
class Found:
    """The baseline, every signature that was looked at, and every candidate that was refitted, best first."""

    baseline: Candidate
    signatures: tuple[Signature, ...]
    candidates: tuple[Candidate, ...]

    @property
    def singles(self) -> list[Candidate]:
        """Candidates with one effect more than the baseline, best first."""
        return [item for item in self.candidates if len(set(item.effects) - set(self.baseline.effects)) == 1]


class Search:
    """A search on one session.

    Args:
        observed: the tests.
        crew: who does the fits.
        names: candidates; all effects of the library that apply where None.
        progress: told what is being done.
        cancelled: asked now and then; True stops with ``Cancelled``.
    """

    def __init__(
        self,
        observed: Observed,
        crew: Crew,
        names: Sequence[str] | None = None,
        progress: Callable[[Progress], None] = lambda _: None,
        cancelled: Callable[[], bool] = lambda: False,
    ) -> None:
        self._observed = observed
        self._crew = crew
        self._names = [
            name
            for name, item in all_effects().items()
            if (names is None or name in names) and applicable(observed, item)
        ]
        several = sum(bool(test.serving(Purpose.FIT).any()) for test in observed.tests) > 1
        self._heat = HEAT_OF_MANY if several else HEAT
        self._progress = progress
        self._cancelled = cancelled

    def baseline(self, known: Sequence[str] = ()) -> Candidate:
        """The baseline refitted; with ``known`` effects that a saved twin has already.

        From then on noise that comes in impulses is no part of the floor.
        """
        self._progress(Progress("baseline", 0, 1))
        effects = [effect(name) for name in known]
        first = fit(self._observed, effects, cancelled=self._cancelled)
        observed = without_impulses_in_the_floor(first)
        if observed is not self._observed:
            self._observed = observed
            first = fit(observed, effects, cancelled=self._cancelled)
        found = judged(first)
        self._progress(Progress("baseline", 1, 1))
        return found

    def singles(self, baseline: Candidate) -> Found:
        """Every candidate alone."""
        signatures = self._screened(baseline.fit)
        worth = contenders(signatures)[:SINGLES]
        heats = self._heats("likeliest candidates", baseline, worth[:FIRST])
        if heats and min(item.score for item in heats) <= THRESHOLDS.at_the_floor:
            # Nothing is left: only what shows much the same can be a rival.
            worth = [item for item in worth if item.alignment >= RIVAL_ALIGNMENT * worth[0].alignment]
        heats += self._heats("candidates", baseline, worth[FIRST:])
        candidates = self._finals("leading candidates", heats, FINAL)
        return Found(baseline, tuple(signatures), self._with_kin(baseline, candidates))

    def further(self, found: Found) -> Found:
        """The same from more starting points, and with more of its candidates followed to the end.

        For where the best of the first round leaves much: a narrow valley may have been passed by.
        """
        tried = contenders(found.signatures)[:SINGLES]
        others = [item for item in found.signatures if all(item is not other for other in tried)]
        others.sort(key=lambda item: -item.alignment)
        heats = self._heats("further starting points", found.baseline, others[:FURTHER])
        on_the_way = [item for item in found.candidates if item.fit.steps == self._heat]
        finished = [item for item in found.candidates if item.fit.steps != self._heat]
        finals = self._finals("further candidates", [*heats, *on_the_way], FURTHER_FINAL)
        candidates = _best_of_each([*finished, *finals])
        return Found(found.baseline, found.signatures, self._with_kin(found.baseline, candidates))

    def _with_kin(self, baseline: Candidate, candidates: Sequence[Candidate]) -> tuple[Candidate, ...]:
        # The leader once more, each of its effects that has a special case or a general form replaced by that.
        if not candidates:
            return ()
        leader = candidates[0]
        tasks = [
            self._with_another(leader.fit, held, other)
            for held in leader.fit.parameters.effects
            for other in map(effect, self._names)
            if held.name not in baseline.effects and other.name not in leader.effects and kin(held, other)
        ]
        return _best_of_each([*candidates, *self._tell("near relations", refit, tasks)])

    def _with_another(self, near: Fit, held: Effect, other: Effect) -> Task:
        # Begins where the fit lies: parameters of the same name mean the same in both.
        values = near.parameters.effect_values(near.theta, held, near.parameters.observed.tests[0].number)
        led = {item.name: float(value) for item, value in zip(held.parameters, values, strict=True)}
        there = tuple(led.get(item.name, at) for item, at in zip(other.parameters, other.starts[0], strict=True))
        effects = [other if item is held else item for item in near.parameters.effects]
        starts = tuple(there if item is other else item.starts[0] for item in effects)
        return Task(self._observed, tuple(item.name for item in effects), starts, near, MOST_STEPS)

    def partners(self, baseline: Candidate, leaders: Sequence[Candidate]) -> tuple[Candidate, ...]:
        """The leading candidates with one more effect each, best first; none of the baseline's gives way to another.

        A leader that holds as many effects as the chain takes has none.
        """
        heats = [
            pair
            for leader in leaders
            if len(leader.effects) < MOST_EFFECTS
            for pair in self._heats("pairs", leader, self._likely_partners(leader)[:PARTNERS])
        ]
        return self._with_kin(baseline, self._finals("leading pairs", heats, FINAL_PAIRS))

    def further_partners(
        self, baseline: Candidate, pair: Candidate, tried: Sequence[Candidate]
    ) -> tuple[Candidate, ...]:
        """More partners of each member of a pair, for where it leaves much: one of the two may be the wrong one.

        Those ``tried`` already are not tried again; they are among the answer, best first.
        """
        added = [name for name in pair.effects if name not in baseline.effects]
        alone = [
            Task(self._observed, tuple(name for name in pair.effects if name != other), (), pair.fit, self._heat)
            for other in added
        ]
        known = {frozenset(item.effects) for item in tried}
        heats = []
        for member in self._tell("members of the pair", refit, alone):
            likely = self._likely_partners(member)
            fresh = [item for item in likely if frozenset((*member.effects, item.effect)) not in known]
            heats += self._heats("further pairs", member, fresh[:FURTHER_PARTNERS])
        finals = self._finals("further leading pairs", heats, FINAL_PAIRS)
        return self._with_kin(baseline, _best_of_each([*tried, *finals]))

    def _likely_partners(self, leader: Candidate) -> list[Signature]:
        # At all starting points: what showed best beside the baseline need not do so beside the leader.
        return contenders(self._screened(leader.fit))

    def _heats(self, what: Work, near: Candidate, signatures: Sequence[Signature]) -> list[Candidate]:
        worth = [item for item in signatures if item.alignment >= LEAST_ALIGNMENT]
        before = [held.starts[0] for held in near.fit.parameters.effects]
        tasks = [
            Task(self._observed, (*near.effects, item.effect), (*before, item.start), near.fit, self._heat)
            for item in worth
        ]
        return self._tell(what, refit, tasks)

    def _finals(self, what: Work, heats: Sequence[Candidate], count: int) -> tuple[Candidate, ...]:
        ranked = _best_of_each(heats)
        if ranked and ranked[0].score <= THRESHOLDS.at_the_floor:
            count = sum(item.score <= RIVAL_SCORE for item in ranked[:count])
        fitting = sorted(ranked, key=lambda item: item.fit.cost)[: min(FINAL_BY_FIT, count)]
        going_on = [
            item
            for place, item in enumerate(ranked)
            if (place < count or any(item is other for other in fitting)) and item.fit.steps >= self._heat
        ]
        tasks = [Task(self._observed, item.effects, (), item.fit, MOST_STEPS) for item in going_on]
        finished = self._tell(what, refit, tasks)
        others = [item for item in ranked if all(item is not other for other in going_on)]
        return tuple(sorted((*finished, *others), key=lambda item: item.score))

    def _screened(self, near: Fit) -> list[Signature]:
        there = {item.name for item in near.parameters.effects}
        names = [name for name in self._names if name not in there]
        found = self._tell("screening", partial(screen, near), names)
        return [item for items in found for item in items]

    def _tell(self, what: Work, work: Callable[[T], R], things: Sequence[T]) -> list[R]:
        if not things:
            return []
        count = 0

        def done(_: object) -> None:
            nonlocal count
            count += 1
            self._progress(Progress(what, count, len(things)))

        self._progress(Progress(what, 0, len(things)))
        return self._crew.do(work, things, self._cancelled, done)


def _best_of_each(candidates: Sequence[Candidate]) -> tuple[Candidate, ...]:
    # The best fit of every set of effects, best first.
    best: dict[frozenset[str], Candidate] = {}
    for item in sorted(candidates, key=lambda item: item.score):
        best.setdefault(frozenset(item.effects), item)
    return tuple(best.values())
