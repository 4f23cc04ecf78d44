"""The diagnosis of one session: verdict, where, which, how far."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tissueid.gap.decision import Verdict, better_pair, cost, explains, is_gap, probabilities
from tissueid.gap.observed import Observed, Purpose
from tissueid.gap.scoring import Candidate, closed, errors, floor, gap, quiet_tests
from tissueid.gap.screening import Screen, cosine
from tissueid.gap.search import Found, Progress, Search
from tissueid.gap.where import Where, where
from tissueid.gap.workers import Crew
from tissueid.twin.effect import Stage
from tissueid.twin.library import effect

RANKED = 10
"""So many candidates are listed."""
ALIKE = 0.97
"""Surviving signatures with a cosine above this are one to this data, where the scores differ little as well."""
ALIKE_SCORE = 0.10
RESAMPLES = 400
LEADERS = 2
"""So many of the best single effects are tried with a partner."""


@dataclass(frozen=True)
class GapFigures:
    """The gap on the samples of the check; ``closed_ci`` holds 95 % (NaN where there is no gap to close)."""

    before: float
    after: float
    floor: float
    closed: float
    closed_ci: tuple[float, float]
    announced: float
    """What was closed on the samples by which the candidate was chosen: the figure that the check is there to check."""


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
class NextExperiment:
    """The test that would separate the leading rivals best, and why."""

    kind: str
    why: str
    separates: tuple[str, ...]


@dataclass(frozen=True)
class Diagnosis:
    """What the diagnosis of a session found."""

    verdict: Verdict
    gap: GapFigures
    where: Where
    ranking: tuple[Ranked, ...]
    combination: tuple[str, ...]
    next_experiment: NextExperiment | None
    remarks: tuple[str, ...]
    seconds: float
    observed: Observed = field(repr=False)
    found: Found = field(repr=False)
    best: Candidate | None = field(repr=False)
    """The accepted explanation, or the best attempt at one; None where nothing was refitted."""


def diagnose(
    observed: Observed,
    crew: Crew,
    *,
    known: Sequence[str] = (),
    candidates: Sequence[str] | None = None,
    progress: Callable[[Progress], None] = lambda _: None,
    cancelled: Callable[[], bool] = lambda: False,
) -> Diagnosis:
    """Find out where and why a recording differs from the twin.

    Args:
        observed: the tests.
        crew: who does the fits.
        known: effects that the baseline has already.
        candidates: effects to consider; all that apply where None.
        progress: told what is being done.
        cancelled: asked now and then; True stops with ``workers.Cancelled``.
    """
    began = time.monotonic()
    search = Search(observed, crew, candidates, progress, cancelled)
    baseline = search.baseline(known)
    found = search.singles(baseline)
    best = min(found.candidates, key=cost, default=None)
    there_is = is_gap(baseline, best)
    if there_is and best is not None:
        found, best = _with_partners(search, found, best)
    figures = figures_of(observed, baseline, best if there_is else None)
    verdict: Verdict = "no_gap"
    if there_is:
        verdict = "effect" if best is not None and explains(baseline, best, figures.announced) else "unexplained"
    return Diagnosis(
        verdict,
        figures,
        where(observed, baseline),
        _ranking(observed, found),
        tuple(name for name in best.effects if name not in known) if verdict == "effect" and best is not None else (),
        None,
        observed.remarks,
        time.monotonic() - began,
        observed,
        found,
        best,
    )


def _with_partners(search: Search, found: Found, best: Candidate) -> tuple[Found, Candidate]:
    # A second effect, beside the best ones; and with a third the search ends, for lack of evidence.
    leaders = sorted(found.candidates, key=cost)[:LEADERS]
    if best.score < 2 * 0.08:
        return found, best
    pairs = [pair for leader in leaders for pair in search.partners(leader)]
    candidates = tuple(sorted({item.effects: item for item in (*found.candidates, *pairs)}.values(), key=cost))
    pair = min(pairs, key=cost, default=None)
    if pair is not None and better_pair(best, pair):
        best = pair
    return Found(found.baseline, found.signatures, candidates), best


def figures_of(observed: Observed, baseline: Candidate, best: Candidate | None) -> GapFigures:
    """The gap before and after, with the interval of what was closed by resampling stretches of the check."""
    quiet = quiet_tests(observed.tests)
    before, least = gap(baseline.checked_by, quiet), floor(baseline.checked_by, quiet)
    after = before if best is None else gap(best.checked_by, quiet)
    shut = closed(before, after, least)
    announced, interval = float("nan"), (float("nan"), float("nan"))
    if best is not None:
        announced = closed(
            gap(baseline.chosen_by, quiet), gap(best.chosen_by, quiet), floor(baseline.chosen_by, quiet)
        )
        interval = closed_interval(observed, baseline, best)
    return GapFigures(before, after, least, shut, interval, announced)


def closed_interval(observed: Observed, baseline: Candidate, best: Candidate) -> tuple[float, float]:
    """95 % interval of the closed share: the stretches of the check, drawn again with replacement."""
    stretches = [
        (one, other)
        for one, other in zip(_stretches(observed, baseline), _stretches(observed, best), strict=True)
    ]
    if len(stretches) < 2:
        return float("nan"), float("nan")
    quiet = quiet_tests(observed.tests)
    random = np.random.default_rng(0)
    drawn = []
    for _ in range(RESAMPLES):
        chosen = random.integers(len(stretches), size=len(stretches))
        before = [item for k in chosen for item in stretches[k][0]]
        after = [item for k in chosen for item in stretches[k][1]]
        drawn.append(closed(gap(before, quiet), gap(after, quiet), floor(before, quiet)))
    known = np.array(drawn)[np.isfinite(drawn)]
    if known.size < RESAMPLES // 2:
        return float("nan"), float("nan")
    low, high = np.quantile(known, [0.025, 0.975])
    return float(low), float(high)


def _stretches(observed: Observed, candidate: Candidate) -> list[list[Any]]:
    # Errors of every connected stretch of the check.
    found = []
    for test, predicted in zip(observed.tests, candidate.fit.predictions, strict=True):
        serving = test.serving(Purpose.CHECK)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], serving.astype(np.int8), [0]])))
        for first, end in zip(edges[::2], edges[1::2], strict=True):
            purpose = np.zeros_like(test.purpose)
            purpose[first:end] = Purpose.CHECK
            alone = _with_purpose(observed, test.number, purpose)
            found.append(errors(alone, [predicted], Purpose.CHECK))
    return found


def _with_purpose(observed: Observed, number: int, purpose: np.ndarray) -> Observed:
    test = next(item for item in observed.tests if item.number == number)
    return replace(observed, tests=(replace(test, purpose=purpose),))


def _ranking(observed: Observed, found: Found) -> tuple[Ranked, ...]:
    known = set(found.baseline.effects)
    singles = [item for item in found.candidates if len(set(item.effects) - known) == 1]
    singles.sort(key=cost)
    shares = probabilities(found.baseline, singles)
    surviving = _surviving(found, singles)
    ranking = []
    for k, item in enumerate(singles[:RANKED]):
        name = next(name for name in item.effects if name not in known)
        alike = tuple(
            other
            for j, other in enumerate(_names(singles, known))
            if j != k
            and abs(cost(singles[j]) - cost(item)) < ALIKE_SCORE
            and cosine(surviving[k], surviving[j]) > ALIKE
        )
        figures = figures_of(observed, found.baseline, item)
        ranking.append(
            Ranked(
                name,
                effect(name).stage,
                shares[k],
                figures.closed,
                figures.closed_ci,
                alike,
                parameters_of(item, name),
            )
        )
    return tuple(ranking)


def _names(singles: Sequence[Candidate], known: set[str]) -> list[str]:
    return [next(name for name in item.effects if name not in known) for item in singles]


def _surviving(found: Found, singles: Sequence[Candidate]) -> list[np.ndarray]:
    # What each refitted candidate took away from the baseline's residuals, after everything else was refitted.
    screen = Screen(found.baseline.fit)
    return [screen.surviving(found.baseline.fit.residuals - item.fit.residuals) for item in singles]


def parameters_of(candidate: Candidate, name: str) -> dict[str, float]:
    """Fitted parameters of one effect, SI, those that all tests share."""
    chosen = effect(name)
    tests = candidate.fit.parameters.observed.tests
    values = candidate.fit.parameters.effect_values(candidate.fit.theta, chosen, tests[0].number)
    return {
        parameter.name: float(value)
        for parameter, value in zip(chosen.parameters, values, strict=True)
        if not parameter.per_test
    }
