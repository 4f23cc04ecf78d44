"""The diagnosis of one session: verdict, where, which, how far."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import stats

from tissueid.gap.ceiling import ceiling
from tissueid.gap.decision import (
    THRESHOLDS,
    Verdict,
    better_pair,
    cost,
    explains,
    is_gap,
    lead_of,
    probabilities,
    shows_in_the_check_alone,
)
from tissueid.gap.next_experiment import NextExperiment, next_experiment
from tissueid.gap.observed import Observed, Purpose
from tissueid.gap.scoring import Candidate, ChannelError, closed, errors, floor, gap, quiet_tests
from tissueid.gap.screening import Screen, cosine
from tissueid.gap.search import Found, Progress, Search
from tissueid.gap.where import Where, where
from tissueid.gap.workers import Crew
from tissueid.twin.catalogue import all_effects, effect
from tissueid.twin.effect import Stage, kin

RANKED = 10
"""So many candidates are listed."""
ALIKE = 0.97
"""Surviving signatures with a cosine above this are one to this data, where the scores differ little as well."""
ALIKE_SCORE = 0.10
RESAMPLES = 400
CERTAIN = 0.9
"""From this probability on a cause needs no further test."""
_ELECTRICAL: frozenset[Stage] = frozenset({"drive", "coil"})
_MOVING: frozenset[Stage] = frozenset({"mechanics", "tissue", "environment"})
RARE = "the gap shows in stretches that serve the check alone: record a longer test, or repeat it"
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
class Diagnosis:
    """What the diagnosis of a session found. Where the verdict is ``no_gap``, ``where`` is neutral."""

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
    ceiling: float = float("nan")
    """Share of the gap that something flexible closes on the same samples, or the best candidate if that is more."""
    beside: Mapping[str, tuple[tuple[str, float], ...]] = field(default_factory=dict)
    """For a named effect that the ranking of single effects does not judge: the probability of each candidate for its
    place beside the other named effects, likeliest first."""

    def __post_init__(self) -> None:
        if self.verdict == "no_gap":
            object.__setattr__(self, "where", self.where.neutral())

    @property
    def at_fault(self) -> tuple[Stage, ...]:
        """Stages that the verdict blames, the one of ``where`` first.

        Those of the named effects; without any the stage that stands above its floor; none where there is no gap.
        """
        if self.verdict == "no_gap":
            return ()
        known = all_effects()
        stages = [known[name].stage for name in self.combination if name in known]
        if not stages:
            return (self.where.stage,) if self.where.above_floor else ()
        return tuple(dict.fromkeys(sorted(stages, key=lambda stage: stage != self.where.stage)))


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
    observed = baseline.fit.parameters.observed
    found = search.singles(baseline)
    best = min(found.candidates, key=cost, default=None)
    if best is not None and is_gap(baseline, best) and not _settled(baseline, best):
        found = search.further(found)
        best = min(found.candidates, key=cost)
    there_is = is_gap(baseline, best)
    if there_is and best is not None:
        found, best = _with_partners(search, found, best)
    figures = figures_of(observed, baseline, best if there_is else None)
    verdict: Verdict = "no_gap"
    places = where(observed, baseline)
    ranking = _ranking(observed, found, places)
    remarks = observed.remarks
    if there_is:
        verdict = "effect" if best is not None and _explained(found, best, figures, ranking, places) else "unexplained"
    elif shows_in_the_check_alone(baseline):
        verdict, remarks = "unexplained", (*remarks, RARE)
    named = best if verdict == "effect" else None
    return Diagnosis(
        verdict,
        figures,
        _blamed(places, named, known),
        ranking,
        () if named is None else tuple(name for name in named.effects if name not in known),
        _next(observed, found, ranking, places, verdict),
        remarks,
        time.monotonic() - began,
        observed,
        found,
        best,
        _ceiling(baseline, figures) if there_is else float("nan"),
        {} if named is None else _beside(found, named, ranking, places),
    )


def _beside(
    found: Found, best: Candidate, ranking: Sequence[Ranked], places: Where
) -> dict[str, tuple[tuple[str, float], ...]]:
    # The likeliest single effect keeps the odds of the ranking: not all its rivals were refitted beside the others.
    named = set(best.effects) - set(found.baseline.effects)
    if len(named) == 1:
        return {}
    clearly = more_is_asked(best, places, found.baseline.effects)
    odds = {}
    for name in named - {item.effect for item in ranking[:1]}:
        others = set(best.effects) - {name}
        rivals = [
            item for item in found.candidates if others < set(item.effects) and len(item.effects) == len(others) + 1
        ]
        shares = probabilities(found.baseline, rivals, clearly=clearly)
        pairs = [(next(iter(set(item.effects) - others)), share) for item, share in zip(rivals, shares, strict=True)]
        odds[name] = tuple(sorted(pairs, key=lambda pair: -pair[1]))
    return odds


def _ceiling(baseline: Candidate, figures: GapFigures) -> float:
    flexible = ceiling(baseline)
    return float(np.nanmax([flexible, figures.closed])) if np.isfinite([flexible, figures.closed]).any() else flexible


def _next(
    observed: Observed, found: Found, ranking: Sequence[Ranked], places: Where, verdict: Verdict
) -> NextExperiment | None:
    # None where nothing is in doubt: no gap, or one cause that stands clear of its rivals.
    if verdict == "no_gap" or (verdict == "effect" and ranking and ranking[0].probability >= CERTAIN):
        return None
    singles = found.singles
    return next_experiment(observed, singles, _probabilities(found, singles, places))


def _probabilities(found: Found, singles: Sequence[Candidate], places: Where) -> list[float]:
    best = min(singles, key=cost, default=None)
    clearly = best is not None and more_is_asked(best, places, found.baseline.effects)
    return probabilities(found.baseline, singles, clearly=clearly)


def more_is_asked(best: Candidate, places: Where, known: Sequence[str]) -> bool:
    """Whether a candidate has to leave little before it counts as the explanation.

    So it is where every effect that it adds to the ``known`` ones is exact; and where the stages by themselves show
    that the current is not what voltage and motion make, but none of the effects does anything but move the probe.
    """
    added = [effect(name) for name in best.effects if name not in known]
    stages = {item.stage for item in added}
    blamed = {stage for stage, share in places.shares.items() if share > 0.0}
    only_moves = bool(blamed) and blamed <= _ELECTRICAL and stages <= _MOVING
    return only_moves or all(item.exact for item in added)


def _explained(found: Found, best: Candidate, figures: GapFigures, ranking: Sequence[Ranked], places: Where) -> bool:
    lead = 0.0
    if any(item is best for item in found.singles):
        # What this data cannot tell from it is named beside it, and is no rival.
        alike = {name for item in ranking if item.effect in best.effects for name in item.indistinguishable}
        lead = lead_of(best, [item for item in found.singles if not alike & set(item.effects)])
    clearly = more_is_asked(best, places, found.baseline.effects)
    return explains(found.baseline, best, figures.announced, lead, clearly=clearly)


def _blamed(found: Where, best: Candidate | None, known: Sequence[str]) -> Where:
    # A cause that is found says more about its stage than the evidence by stages alone.
    if best is None:
        return found
    stages = [effect(name).stage for name in best.effects if name not in known]
    return found if found.stage in stages else replace(found, stage=stages[0])


def _settled(baseline: Candidate, best: Candidate) -> bool:
    # Nothing is left that would be worth a longer search.
    return best.score <= THRESHOLDS.at_the_floor or announced(baseline, best) >= THRESHOLDS.nearly_all


def _with_partners(search: Search, found: Found, best: Candidate) -> tuple[Found, Candidate]:
    # A second effect beside the best ones, where enough is left for one; no third is looked for.
    baseline = found.baseline
    if cost(best) <= THRESHOLDS.pair_gain:
        return found, best
    pairs = search.partners(baseline, _leaders(found))
    better = _better(baseline, best, pairs)
    if better is not None and not _settled(baseline, better):
        pairs = search.further_partners(baseline, better, pairs)
        better = _better(baseline, best, pairs)
    candidates = tuple(sorted({item.effects: item for item in (*found.candidates, *pairs)}.values(), key=cost))
    return Found(baseline, found.signatures, candidates), better or best


def _leaders(found: Found) -> list[Candidate]:
    # Of near relations only the first: their partners are the same, and a pair's relations are tried after it.
    leaders: list[Candidate] = []
    for item in sorted(found.candidates, key=cost):
        if not any(kin(effect(item.effects[-1]), effect(other.effects[-1])) for other in leaders):
            leaders.append(item)
    return leaders[:LEADERS]


def _better(baseline: Candidate, best: Candidate, pairs: Sequence[Candidate]) -> Candidate | None:
    # The best of the pairs, if its second effect is worth naming.
    pair = min(pairs, key=cost, default=None)
    if pair is None or not better_pair(best, pair, announced(baseline, best), announced(baseline, pair)):
        return None
    return pair


def figures_of(observed: Observed, baseline: Candidate, best: Candidate | None) -> GapFigures:
    """The gap before and after, with the interval of what was closed by resampling stretches of the check."""
    quiet = quiet_tests(observed.tests)
    before, least = gap(baseline.checked_by, quiet), floor(baseline.checked_by, quiet)
    after = before if best is None else gap(best.checked_by, quiet)
    shut = closed(before, after, least)
    promised, interval = float("nan"), (float("nan"), float("nan"))
    if best is not None:
        promised = announced(baseline, best)
        interval = closed_interval(observed, baseline, best)
    return GapFigures(before, after, least, shut, interval, promised)


def announced(baseline: Candidate, best: Candidate) -> float:
    """Share of the gap closed on the samples of the choice: what is announced before the check."""
    quiet = quiet_tests(baseline.fit.parameters.observed.tests)
    return closed(gap(baseline.chosen_by, quiet), gap(best.chosen_by, quiet), floor(baseline.chosen_by, quiet))


def closed_interval(observed: Observed, baseline: Candidate, best: Candidate) -> tuple[float, float]:
    """95 % interval of the closed share: the stretches of the check, drawn again with replacement, and widened."""
    stretches = list(zip(_stretches(baseline), _stretches(best), strict=True))
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
    middle = closed(gap(baseline.checked_by, quiet), gap(best.checked_by, quiet), floor(baseline.checked_by, quiet))
    return widened(middle, known, len(stretches))


def widened(middle: float, drawn: np.ndarray, count: int) -> tuple[float, float]:
    """95 % interval about a closed share from what ``count`` stretches gave when drawn again, shape (draws,).

    A test has four or five stretches; drawn again they spread too little, by the factor that parts the deviation of so
    few from Student's t.
    """
    low, high = np.quantile(drawn, [0.025, 0.975])
    wider = float(stats.t.ppf(0.975, count - 1) / stats.norm.ppf(0.975) * np.sqrt(count / (count - 1)))
    return middle - wider * max(middle - float(low), 0.0), min(middle + wider * max(float(high) - middle, 0.0), 1.0)


def _stretches(candidate: Candidate) -> list[list[ChannelError]]:
    # Errors of every connected stretch of the check.
    found = []
    tests = candidate.fit.parameters.observed.tests
    for k, test in enumerate(tests):
        serving = test.serving(Purpose.CHECK)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], serving.astype(np.int8), [0]])))
        for first, end in zip(edges[::2], edges[1::2], strict=True):
            alone = [replace(other, purpose=np.zeros_like(other.purpose)) for other in tests]
            alone[k].purpose[first:end] = Purpose.CHECK
            found.append(errors(candidate.fit, Purpose.CHECK, tests=alone))
    return found


def _ranking(observed: Observed, found: Found, places: Where) -> tuple[Ranked, ...]:
    known = set(found.baseline.effects)
    singles = sorted(found.singles, key=cost)
    shares = _probabilities(found, singles, places)
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
