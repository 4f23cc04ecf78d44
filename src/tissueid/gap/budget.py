"""Gap budget: the share of the gap that each named effect closes, and what remains.

A share depends on the order in which effects are added. Two are given for each: when it is added in the order of the
waterfall, and when it alone is removed from the complete set. Both are measured on the samples for the check.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tissueid.gap.closed_share import FloatArray, closed_in_draws, draws_of, stretches, widened
from tissueid.gap.scoring import Candidate, closed, floor, gap, gap_left, quiet_tests
from tissueid.twin.catalogue import effect
from tissueid.twin.effect import Stage

Interval = tuple[float, float]


@dataclass(frozen=True)
class BudgetStep:
    """One effect of the waterfall: the gap with it, and its closed shares with 95 % intervals (NaN where unknown)."""

    effect: str
    stage: Stage
    gap_after: float
    added: float
    added_ci: Interval
    removed: float
    removed_ci: Interval


@dataclass(frozen=True)
class Budget:
    """The gap from the baseline to the noise floor, on the samples for the check.

    ``remains`` is the share that the set leaves, ``remains_in`` the stage that shows it; None where it is noise.
    """

    before: float
    after: float
    floor: float
    steps: tuple[BudgetStep, ...]
    remains: float
    remains_in: Stage | None


def removal_path(
    found: Candidate, known: Sequence[str], remove: Callable[[Candidate, Sequence[str]], Sequence[Candidate]]
) -> tuple[tuple[Candidate, ...], dict[str, Candidate]]:
    """Return nested sets from one effect to all, and the set without each effect.

    At each step the effect is removed whose removal widens the gap least, so that the first step of the waterfall is
    that of the most important effect.

    Args:
        found: the complete set.
        known: effects of the baseline, which stay.
        remove: refits a set without each of some effects.
    """
    quiet = quiet_tests(found.fit.parameters.dataset.tests)
    path: list[Candidate] = [found]
    without: dict[str, Candidate] = {}
    while len(names := [name for name in path[-1].effects if name not in known]) > 1:
        smaller = remove(path[-1], names)
        if not without:
            without = dict(zip(names, smaller, strict=True))
        path.append(min(smaller, key=lambda item: gap(item.checked_by, quiet)))
    return tuple(reversed(path)), without


def budget(
    baseline: Candidate, path: Sequence[Candidate], without: dict[str, Candidate], remains_in: Stage | None
) -> Budget:
    """Return the budget of nested sets, from the smallest to the complete one.

    Args:
        baseline: the baseline without effects.
        path: nested sets, each with one effect more.
        without: the complete set without each effect.
        remains_in: stage that shows what the complete set leaves.
    """
    complete = path[-1]
    quiet = quiet_tests(baseline.fit.parameters.dataset.tests)
    in_stretches = stretches(baseline)
    draws = draws_of(len(in_stretches))

    def share(item: Candidate) -> tuple[float, FloatArray]:
        if item is baseline:
            return 0.0, np.zeros(len(draws))
        before, after = gap(baseline.checked_by, quiet), gap(item.checked_by, quiet)
        drawn = closed_in_draws(in_stretches, stretches(item), draws, quiet)
        return closed(before, after, floor(baseline.checked_by, quiet)), drawn

    shares = {id(item): share(item) for item in (baseline, *path, *without.values())}

    def difference(more: Candidate, less: Candidate) -> tuple[float, Interval]:
        (middle, drawn), (from_there, drawn_there) = shares[id(more)], shares[id(less)]
        return middle - from_there, widened(middle - from_there, drawn - drawn_there, len(in_stretches))

    steps, before = [], baseline
    for item in path:
        name = next(name for name in item.effects if name not in before.effects)
        added, added_ci = difference(item, before)
        removed, removed_ci = difference(complete, without[name]) if name in without else (added, added_ci)
        left = gap_left(baseline.checked_by, item.checked_by, quiet)
        steps.append(BudgetStep(name, effect(name).stage, left, added, added_ci, removed, removed_ci))
        before = item
    return Budget(
        gap(baseline.checked_by, quiet),
        gap_left(baseline.checked_by, complete.checked_by, quiet),
        floor(baseline.checked_by, quiet),
        tuple(steps),
        1.0 - shares[id(complete)][0],
        remains_in,
    )
