"""The search for what explains a gap: baseline, screening, refits of the likeliest, pairs by forward selection."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

from tissueid.gap.fitting import Fit, fit
from tissueid.gap.observed import Observed
from tissueid.gap.scoring import Candidate, judged
from tissueid.gap.screening import Screen, Signature, best_starts
from tissueid.gap.workers import Crew
from tissueid.twin.effect import Effect
from tissueid.twin.library import effect, library

T = TypeVar("T")
R = TypeVar("R")

SINGLES = 12
"""So many candidates are refitted, the best aligned ones; the others' signatures explain too little to win."""
LEAST_ALIGNMENT = 0.01
NEXT = 4
"""So many partners are refitted beside each leading candidate."""


@dataclass(frozen=True)
class Progress:
    """What is being done: ``done`` of ``total`` pieces of ``what``."""

    what: str
    done: int
    total: int


@dataclass(frozen=True)
class Task:
    """A fit to make: effects with the starting point of each, beginning at another fit."""

    observed: Observed
    names: tuple[str, ...]
    starts: tuple[int, ...]
    near: Fit

    def __str__(self) -> str:
        return " + ".join(self.names)


def refit(task: Task) -> Candidate:
    """Do one task; runs in a worker's process."""
    return judged(task.observed, fit(task.observed, [effect(name) for name in task.names], task.starts, near=task.near))


def screen(near: Fit, name: str) -> list[Signature]:
    """Signatures of an effect's starting points against what a fit leaves; runs in a worker's process."""
    return Screen(near).signatures(effect(name))


def applicable(observed: Observed, item: Effect) -> bool:
    """Whether what was recorded can tell an effect at all."""
    has = set(observed.channels)
    if not item.needs <= has | {"command"}:
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
            name for name, item in library().items() if (names is None or name in names) and applicable(observed, item)
        ]
        self._progress = progress
        self._cancelled = cancelled

    def baseline(self, known: Sequence[str] = ()) -> Candidate:
        """The baseline refitted; with ``known`` effects that a saved twin has already."""
        self._progress(Progress("baseline", 0, 1))
        effects = [effect(name) for name in known]
        found = judged(self._observed, fit(self._observed, effects, cancelled=self._cancelled))
        self._progress(Progress("baseline", 1, 1))
        return found

    def singles(self, baseline: Candidate) -> Found:
        """Every candidate alone."""
        signatures = self._screened(baseline.fit)
        worth = [item for item in best_starts(signatures) if item.alignment >= LEAST_ALIGNMENT][:SINGLES]
        tasks = [self._task(baseline, item) for item in worth]
        return Found(baseline, tuple(signatures), self._refitted("candidates", tasks))

    def partners(self, candidate: Candidate, count: int = NEXT) -> tuple[Candidate, ...]:
        """The candidate with one more effect each, best first."""
        signatures = [item for item in self._screened(candidate.fit) if item.effect not in candidate.effects]
        worth = [item for item in best_starts(signatures) if item.alignment >= LEAST_ALIGNMENT][:count]
        return self._refitted("pairs", [self._task(candidate, item) for item in worth])

    def _task(self, near: Candidate, item: Signature) -> Task:
        return Task(self._observed, (*near.effects, item.effect), (*(0 for _ in near.effects), item.start), near.fit)

    def _screened(self, near: Fit) -> list[Signature]:
        found = self._tell("screening", partial(screen, near), self._names)
        return [item for items in found for item in items]

    def _refitted(self, what: str, tasks: Sequence[Task]) -> tuple[Candidate, ...]:
        return tuple(sorted(self._tell(what, refit, tasks), key=lambda item: item.score))

    def _tell(self, what: str, work: Callable[[T], R], things: Sequence[T]) -> list[R]:
        count = 0

        def done(_: object) -> None:
            nonlocal count
            count += 1
            self._progress(Progress(what, count, len(things)))

        self._progress(Progress(what, 0, len(things)))
        return self._crew.do(work, things, self._cancelled, done)
