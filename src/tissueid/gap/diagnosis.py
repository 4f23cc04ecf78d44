"""Diagnosis of one session: whether there is a gap, where it lies, its cause, and the closed share."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import stats

from tissueid.gap.ceiling import ceiling
from tissueid.gap.dataset import Dataset, Purpose
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
from tissueid.gap.localisation import Localisation, localise
from tissueid.gap.next_experiment import NextExperiment, next_experiment
from tissueid.gap.scoring import Candidate, ChannelError, closed, errors, floor, gap, quiet_tests
from tissueid.gap.screening import Screen, cosine
from tissueid.gap.search import Search, SearchProgress, SearchResult
from tissueid.gap.workers import Executor
from tissueid.messages import Message
from tissueid.twin.catalogue import all_effects, effect
from tissueid.twin.effect import Stage, nested

RANKED = 10
"""Most candidates in the ranking."""
ALIKE = 0.97
"""Least cosine of surviving signatures that this data cannot separate, where the scores differ little as well."""
ALIKE_SCORE = 0.10
RESAMPLES = 400
CERTAIN = 0.9
"""Probability from which no further test is proposed."""
_ELECTRICAL: frozenset[Stage] = frozenset({"drive", "coil"})
_MOVING: frozenset[Stage] = frozenset({"mechanics", "tissue", "environment"})
RARE = Message(
    "gap.only_in_check",
    "the gap shows only in the part of the data that is held out for the check: record a longer test, or repeat it",
)
TOP_CANDIDATES = 2
"""Number of top single effects that are tried with a second effect."""


@dataclass(frozen=True)
class GapFigures:
    """The gap on the samples for the check. ``closed_ci`` is the 95 % interval (NaN where there is no gap to close)."""

    before: float
    after: float
    floor: float
    closed: float
    closed_ci: tuple[float, float]
    predicted_closed: float
    """Closed share on the samples for the choice, which the check verifies."""


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
    found: SearchResult = field(repr=False)
    best: Candidate | None = field(repr=False)
    """The accepted explanation or the best candidate; None where nothing was refitted."""
    ceiling: float = float("nan")
    """Share of the gap that a flexible regression closes on the same samples, or the best candidate if that is more."""
    conditional_odds: Mapping[str, tuple[tuple[str, float], ...]] = field(default_factory=dict)
    """For a named effect of a combination: the probability of each candidate in its place, given the other named
    effects, most probable first."""

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
        known = all_effects()
        stages = [known[name].stage for name in self.combination if name in known]
        if not stages:
            return (self.where.stage,) if self.where.above_floor else ()
        return tuple(dict.fromkeys(sorted(stages, key=lambda stage: stage != self.where.stage)))


def diagnose(
    dataset: Dataset,
    pool: Executor,
    *,
    known: Sequence[str] = (),
    candidates: Sequence[str] | None = None,
    progress: Callable[[SearchProgress], None] = lambda _: None,
    cancelled: Callable[[], bool] = lambda: False,
) -> Diagnosis:
    """Diagnose where and why a recording differs from the twin.

    Args:
        dataset: the tests.
        pool: the executor of the fits.
        known: effects that the baseline already includes.
        candidates: effects to consider; all applicable effects where None.
        progress: callback for progress.
        cancelled: callback that returns True to stop with ``CancelledError``.
    """
    began = time.monotonic()
    search = Search(dataset, pool, candidates, progress, cancelled)
    baseline = search.baseline(known)
    dataset = baseline.fit.parameters.dataset
    found = search.singles(baseline)
    best = min(found.candidates, key=cost, default=None)
    if best is not None and is_gap(baseline, best) and not _settled(baseline, best):
        found = search.further(found)
        best = min(found.candidates, key=cost)
    there_is = is_gap(baseline, best)
    if there_is and best is not None:
        found, best = _with_pairs(search, found, best)
    figures = figures_of(dataset, baseline, best if there_is else None)
    verdict: Verdict = "no_gap"
    places = localise(dataset, baseline)
    ranking = _ranking(dataset, found, places)
    remarks = dataset.remarks
    if there_is:
        verdict = "effect" if best is not None and _explained(found, best, figures, ranking, places) else "unexplained"
    elif shows_in_the_check_alone(baseline):
        verdict, remarks = "unexplained", (*remarks, RARE)
    named = best if verdict == "effect" else None
    return Diagnosis(
        verdict,
        figures,
        _with_stage_of_cause(places, named, known),
        ranking,
        () if named is None else tuple(name for name in named.effects if name not in known),
        _next(dataset, found, ranking, places, verdict),
        remarks,
        time.monotonic() - began,
        dataset,
        found,
        best,
        _ceiling(baseline, figures) if there_is else float("nan"),
        {} if named is None else _conditional_odds(found, named, ranking, places),
    )


def _conditional_odds(
    found: SearchResult, best: Candidate, ranking: Sequence[Ranked], places: Localisation
) -> dict[str, tuple[tuple[str, float], ...]]:
    # The top single effect keeps its probability of the ranking: not all its rivals were refitted with the others.
    named = set(best.effects) - set(found.baseline.effects)
    if len(named) == 1:
        return {}
    clearly = needs_strict_fit(best, places, found.baseline.effects)
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
    dataset: Dataset, found: SearchResult, ranking: Sequence[Ranked], places: Localisation, verdict: Verdict
) -> NextExperiment | None:
    # None where the result is certain: no gap, or one cause with a clear lead.
    if verdict == "no_gap" or (verdict == "effect" and ranking and ranking[0].probability >= CERTAIN):
        return None
    singles = found.singles
    return next_experiment(dataset, singles, _probabilities(found, singles, places))


def _probabilities(found: SearchResult, singles: Sequence[Candidate], places: Localisation) -> list[float]:
    best = min(singles, key=cost, default=None)
    clearly = best is not None and needs_strict_fit(best, places, found.baseline.effects)
    return probabilities(found.baseline, singles, clearly=clearly)


def needs_strict_fit(best: Candidate, places: Localisation, known: Sequence[str]) -> bool:
    """Return whether a candidate must meet the stricter condition of an explanation.

    That is the case where every added effect has an exact law, and where the stages show that the current does not
    follow from voltage and motion although every added effect only moves the probe.
    """
    added = [effect(name) for name in best.effects if name not in known]
    stages = {item.stage for item in added}
    blamed = {stage for stage, share in places.shares.items() if share > 0.0}
    only_moves = bool(blamed) and blamed <= _ELECTRICAL and stages <= _MOVING
    return only_moves or all(item.exact for item in added)


def _explained(
    found: SearchResult, best: Candidate, figures: GapFigures, ranking: Sequence[Ranked], places: Localisation
) -> bool:
    lead = 0.0
    if any(item is best for item in found.singles):
        # Effects that this data cannot separate are listed with the cause and are not rivals.
        alike = {name for item in ranking if item.effect in best.effects for name in item.indistinguishable}
        lead = lead_of(best, [item for item in found.singles if not alike & set(item.effects)])
    clearly = needs_strict_fit(best, places, found.baseline.effects)
    return explains(found.baseline, best, figures.predicted_closed, lead, clearly=clearly)


def _with_stage_of_cause(found: Localisation, best: Candidate | None, known: Sequence[str]) -> Localisation:
    # A named cause determines the stage more reliably than the evidence by stages.
    if best is None:
        return found
    stages = [effect(name).stage for name in best.effects if name not in known]
    return found if found.stage in stages else replace(found, stage=stages[0])


def _settled(baseline: Candidate, best: Candidate) -> bool:
    # The residual does not justify a longer search.
    return best.score <= THRESHOLDS.at_the_floor or predicted_closed(baseline, best) >= THRESHOLDS.nearly_all


def _with_pairs(search: Search, found: SearchResult, best: Candidate) -> tuple[SearchResult, Candidate]:
    # Pairs of a top candidate and a second effect, where enough is left; there are no triples.
    baseline = found.baseline
    if cost(best) <= THRESHOLDS.pair_gain:
        return found, best
    pairs = search.pairs_with(baseline, _top_candidates(found))
    better = _better(baseline, best, pairs)
    if better is not None and not _settled(baseline, better):
        pairs = search.further_pairs(baseline, better, pairs)
        better = _better(baseline, best, pairs)
    candidates = tuple(sorted({item.effects: item for item in (*found.candidates, *pairs)}.values(), key=cost))
    return SearchResult(baseline, found.signatures, candidates), better or best


def _top_candidates(found: SearchResult) -> list[Candidate]:
    # Of nested effects only the better one: both have the same partners, and nested effects of a pair are tried later.
    leaders: list[Candidate] = []
    for item in sorted(found.candidates, key=cost):
        if not any(nested(effect(item.effects[-1]), effect(other.effects[-1])) for other in leaders):
            leaders.append(item)
    return leaders[:TOP_CANDIDATES]


def _better(baseline: Candidate, best: Candidate, pairs: Sequence[Candidate]) -> Candidate | None:
    # The best pair, if its second effect is worth naming.
    pair = min(pairs, key=cost, default=None)
    if pair is None or not better_pair(best, pair, predicted_closed(baseline, best), predicted_closed(baseline, pair)):
        return None
    return pair


def figures_of(dataset: Dataset, baseline: Candidate, best: Candidate | None) -> GapFigures:
    """Return the gap before and after, with a bootstrap interval of the closed share over blocks of the check."""
    quiet = quiet_tests(dataset.tests)
    before, least = gap(baseline.checked_by, quiet), floor(baseline.checked_by, quiet)
    after = before if best is None else gap(best.checked_by, quiet)
    shut = closed(before, after, least)
    promised, interval = float("nan"), (float("nan"), float("nan"))
    if best is not None:
        promised = predicted_closed(baseline, best)
        interval = closed_interval(dataset, baseline, best)
    return GapFigures(before, after, least, shut, interval, promised)


def predicted_closed(baseline: Candidate, best: Candidate) -> float:
    """Return the closed share on the samples for the choice, which is stated before the check."""
    quiet = quiet_tests(baseline.fit.parameters.dataset.tests)
    return closed(gap(baseline.chosen_by, quiet), gap(best.chosen_by, quiet), floor(baseline.chosen_by, quiet))


def closed_interval(dataset: Dataset, baseline: Candidate, best: Candidate) -> tuple[float, float]:
    """Return the 95 % interval of the closed share by a widened bootstrap over the blocks of the check."""
    stretches = list(zip(_stretches(baseline), _stretches(best), strict=True))
    if len(stretches) < 2:
        return float("nan"), float("nan")
    quiet = quiet_tests(dataset.tests)
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
    """Return the 95 % interval around a closed share from bootstrap draws over ``count`` blocks, shape (draws,).

    A test has four or five blocks. A bootstrap of so few has too small a spread; it is widened by the factor between
    the normal distribution and Student's t.
    """
    low, high = np.quantile(drawn, [0.025, 0.975])
    wider = float(stats.t.ppf(0.975, count - 1) / stats.norm.ppf(0.975) * np.sqrt(count / (count - 1)))
    return middle - wider * max(middle - float(low), 0.0), min(middle + wider * max(float(high) - middle, 0.0), 1.0)


def _stretches(candidate: Candidate) -> list[list[ChannelError]]:
    # Errors of every connected block of the check.
    found = []
    tests = candidate.fit.parameters.dataset.tests
    for k, test in enumerate(tests):
        serving = test.serving(Purpose.CHECK)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], serving.astype(np.int8), [0]])))
        for first, end in zip(edges[::2], edges[1::2], strict=True):
            alone = [replace(other, purpose=np.zeros_like(other.purpose)) for other in tests]
            alone[k].purpose[first:end] = Purpose.CHECK
            found.append(errors(candidate.fit, Purpose.CHECK, tests=alone))
    return found


def _ranking(dataset: Dataset, found: SearchResult, places: Localisation) -> tuple[Ranked, ...]:
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
        figures = figures_of(dataset, found.baseline, item)
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


def _surviving(found: SearchResult, singles: Sequence[Candidate]) -> list[np.ndarray]:
    # The part of the baseline's residuals that each refitted candidate explains, after a refit of everything else.
    screen = Screen(found.baseline.fit)
    return [screen.surviving(found.baseline.fit.residuals - item.fit.residuals) for item in singles]


def parameters_of(candidate: Candidate, name: str) -> dict[str, float]:
    """Return the fitted parameters of one effect that all tests share, SI."""
    chosen = effect(name)
    tests = candidate.fit.parameters.dataset.tests
    values = candidate.fit.parameters.effect_values(candidate.fit.theta, chosen, tests[0].number)
    return {
        parameter.name: float(value)
        for parameter, value in zip(chosen.parameters, values, strict=True)
        if not parameter.per_test
    }
