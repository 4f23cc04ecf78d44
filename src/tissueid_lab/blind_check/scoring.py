"""Scores of a blind check, whose labels are opened after the diagnosis.

Rates have Wilson intervals (Wilson, J. Am. Stat. Assoc. 22 (1927) 209-212).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import binomtest

from tissueid.language import marked

SURVIVES = 1.2
"""Least ratio of the gap to the floor on held-out data of a gap that survives the refit."""
SURE = 0.9
CALIBRATION_BINS = 10
CALIBRATION_DRAWS = 1000
"""Draws of answers that are right with exactly the stated probability."""
_CONTROLS = ("permuted_labels_top1", "always_friction_top1", "in_sample_top1")
"""JSON keys of the controls, in the order of the score."""
PERMUTATIONS = 20
"""Number of permutations of the labels in the control for chance."""


def survives(before: float | None, floor: float) -> bool:
    """Return whether the gap ``before``, after the refit of the baseline, is well above the noise floor."""
    return before is not None and before > SURVIVES * floor


@dataclass(frozen=True)
class Label:
    """The truth of a scenario: effects by name with their stages, and whether the library includes each.

    In scenarios on skin, ``hidden`` are those of the effects that the preset does not have, and ``preset`` its name.
    """

    effects: tuple[str, ...]
    stages: tuple[str, ...]
    listed: tuple[bool, ...]
    full: bool
    hidden: tuple[str, ...] = ()
    preset: str = ""


@dataclass(frozen=True)
class Answered:
    """The answer to a scenario (JSON of ``gap diagnose``) with its label. ``oracle`` is the gap of the refitted true
    form, where known."""

    name: str
    label: Label
    answer: dict[str, Any]
    oracle: float | None = None

    @property
    def verdict(self) -> str:
        """Verdict of the diagnosis."""
        return str(self.answer["verdict"])

    @property
    def ranking(self) -> list[dict[str, Any]]:
        """Candidates, best first."""
        return list(self.answer["ranking"])

    @property
    def named(self) -> set[str]:
        """Effects named as the cause."""
        return set(self.answer["combination"])

    @property
    def probability(self) -> float:
        """Probability of the top candidate."""
        return float(self.ranking[0]["probability"]) if self.ranking else 0.0

    @property
    def survives(self) -> bool:
        """Whether the gap survives the refit of the baseline."""
        return survives(self._gap["before"], self._gap["floor"])

    @property
    def all_survive(self) -> bool:
        """Whether the gap of each effect alone survives the refit; as ``survives`` where not known."""
        return self.survives and all(self.answer.get("survive_alone") or ())

    @property
    def stage(self) -> str:
        """Stage in which the diagnosis places the gap."""
        return str(self.answer["where"]["stage"])

    @property
    def failed(self) -> bool:
        """Whether an effect is named that is not there."""
        return not self.named <= set(self.label.effects)

    @property
    def single(self) -> bool:
        """Whether there is one effect, which the library includes and whose gap survives the refit."""
        return len(self.label.effects) == 1 and self.label.listed[0] and self.survives

    @property
    def rank(self) -> int:
        """Rank of the first true effect in the ranking, from 0; beyond any rank where it is not there."""
        names = [item["effect"] for item in self.ranking]
        return names.index(self.label.effects[0]) if self.label.effects[0] in names else len(names) + 10

    @property
    def closed(self) -> float | None:
        """Closed share on the samples for the check."""
        return _number(self._gap["closed"])

    @property
    def predicted_closed(self) -> float | None:
        """Closed share that was predicted before the check."""
        return _number(self._gap["announced"])

    @property
    def best_closed(self) -> float | None:
        """Share closed by the refitted true model."""
        before, floor = self._gap["before"], self._gap["floor"]
        if self.oracle is None or not before**2 > floor**2:
            return None
        return float(1.0 - np.sqrt(max(self.oracle**2 - floor**2, 0.0) / (before**2 - floor**2)))

    @property
    def _gap(self) -> dict[str, Any]:
        return dict(self.answer["gap"])


def _number(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else float(value)


class _Judged:
    """A figure that may have a target."""

    what: str
    cases: int
    target: float | None
    at_least: bool
    value: float

    @property
    def reached(self) -> bool | None:
        """Whether the target was reached; None without a target or without cases."""
        if self.target is None or not self.cases:
            return None
        return self.value >= self.target if self.at_least else self.value <= self.target


@dataclass(frozen=True)
class Rate(_Judged):
    """A share of cases with its 95 % Wilson interval; NaN where there were none."""

    what: str
    hits: int
    cases: int
    target: float
    at_least: bool = True

    @property
    def share(self) -> float:
        """Hits divided by cases."""
        return self.hits / self.cases if self.cases else float("nan")

    value = share

    @property
    def interval(self) -> tuple[float, float]:
        """95 % Wilson interval."""
        if not self.cases:
            return float("nan"), float("nan")
        bounds = binomtest(self.hits, self.cases).proportion_ci(method="wilson")
        return float(bounds.low), float(bounds.high)


@dataclass(frozen=True)
class Measured(_Judged):
    """A score that is not a share of cases."""

    what: str
    value: float
    cases: int
    target: float | None = None
    at_least: bool = True


@dataclass(frozen=True)
class Targets:
    """Targets for one kind of session."""

    top1: float
    alike: float
    top3: float
    stage: float
    closed_median: float
    closed_tenth: float
    predicted_closed: float
    unexplained: float
    wrong_and_sure: float
    false_alarm: float
    pairs: float


SINGLE = Targets(0.75, 0.90, 0.95, 0.90, 0.95, 0.80, 0.05, 0.80, 0.03, 0.01, 0.75)
FULL = Targets(0.90, 0.95, 0.98, 0.97, 0.98, 0.90, 0.03, 0.90, 0.01, 0.01, 0.90)


PAIRS = marked("pairs: F1 of the named set")
TAKEN_OUT = marked("true effect removed from the library: unexplained")


@dataclass(frozen=True)
class BlindScore:
    """Scores of the diagnosis for one kind of session."""

    rates: tuple[Rate, ...]
    figures: tuple[Measured, ...]
    confusion: dict[str, dict[str, int]]
    """Counts of named effect by true effect, for single effects whose gap survives the refit."""
    risk_coverage: tuple[tuple[float, float], ...]
    """Share of answered cases and share of wrong names among them, for decreasing least probability."""
    failures: tuple[str, ...]
    controls: tuple[Measured, ...] = ()
    """The first rate by chance, for a constant answer, and for a search without held-out data."""


def score_of(cases: Sequence[Answered], targets: Targets, taken_out: Sequence[Answered] = ()) -> BlindScore:
    """Score answers against labels.

    Args:
        cases: answers with labels.
        targets: targets for this kind of session.
        taken_out: answers to some cases with the true effect removed from the library.
    """
    single = [case for case in cases if case.single]
    none = [case for case in cases if not case.label.effects]
    above = [case for case in cases if case.label.effects and case.survives]
    unknown = [case for case in above if not all(case.label.listed)]
    pairs = [case for case in above if len(case.label.effects) > 1 and all(case.label.listed)]
    rates = [
        rate(marked("top-1"), single, lambda case: case.rank == 0, targets.top1),
        rate(marked("top-1 including inseparable effects"), single, _alike, targets.alike),
        rate(marked("top-3"), single, lambda case: case.rank < 3, targets.top3),
        rate(marked("stage"), [*single, *unknown], _right_stage, targets.stage),
        rate(marked("unknown effect: unexplained"), unknown, unexplained, targets.unexplained),
        rate(marked("known effect: unexplained"), single, unexplained, 0.05, at_least=False),
        rate(marked("wrong name at 90 % or more"), above, _wrong_and_sure, targets.wrong_and_sure, at_least=False),
        rate(marked("the leading name alone"), above, _wrong_leader_and_sure, targets.wrong_and_sure, at_least=False),
        rate(marked("false alarms without effect"), none, has_gap, targets.false_alarm, at_least=False),
        rate(marked("gap missed"), single, lambda case: not has_gap(case), 0.05, at_least=False),
    ]
    if taken_out:
        abstained = [case for case in taken_out if unexplained(case)]
        rates.append(rate(TAKEN_OUT, taken_out, unexplained, targets.unexplained))
        rates.append(rate(marked("of these the right stage"), abstained, _right_stage, targets.stage))
    return BlindScore(
        tuple(rates),
        (*_figures(single, targets), *_pair_scores(pairs, targets)),
        _confusion(single),
        _risk_coverage(single),
        tuple(failure for case in cases if (failure := _failure(case))),
        _controls(cases),
    )


def rate(
    what: str, cases: Sequence[Answered], hit: Callable[[Answered], bool], target: float, at_least: bool = True
) -> Rate:
    """Return the share of cases for which ``hit`` holds."""
    return Rate(what, sum(map(hit, cases)), len(cases), target, at_least)


def mean(values: Sequence[float] | Sequence[bool] | np.ndarray) -> float:
    """Return the mean of values, shape (n,); NaN without any."""
    return float(np.mean(values)) if len(values) else float("nan")


def quantile(values: Sequence[float], share: float) -> float:
    """Return a quantile of values, shape (n,); NaN without any."""
    return float(np.quantile(values, share)) if len(values) else float("nan")


def unexplained(case: Answered) -> bool:
    """Return whether a gap was found and no effect named."""
    return case.verdict == "unexplained"


def has_gap(case: Answered) -> bool:
    """Return whether a gap was found."""
    return case.verdict != "no_gap"


def set_counts(named: Sequence[set[str]], true: Sequence[set[str]]) -> tuple[int, int, int]:
    """Return the numbers of named effects that are true, of named and of true effects over all scenarios."""
    hits = sum(len(names & truth) for names, truth in zip(named, true, strict=True))
    return hits, sum(map(len, named)), sum(map(len, true))


def f1(named: Sequence[set[str]], true: Sequence[set[str]]) -> float:
    """Return the F1 score of named sets over all scenarios; NaN where nothing is true and nothing named."""
    hits, said, there = set_counts(named, true)
    return 2.0 * hits / (said + there) if said + there else float("nan")


def f1_of(cases: Sequence[Answered]) -> float:
    """Return the F1 score of the named sets of cases."""
    return f1([case.named for case in cases], [set(case.label.effects) for case in cases])


def permuted(cases: Sequence[Answered], seed: int = 0) -> list[Answered]:
    """Return the answers with permuted labels, as a control for chance."""
    order = np.random.default_rng(seed).permutation(len(cases))
    return [replace(case, label=cases[k].label) for case, k in zip(cases, order, strict=True)]


def constant_answer_share(cases: Sequence[Answered], effect: str = "dry_friction") -> float:
    """Return the share of single effects that a constant answer names correctly."""
    return mean([case.label.effects[0] == effect for case in cases if case.single])


def in_sample(cases: Sequence[Answered]) -> float:
    """Return the share of single effects that the best fit of the fitted samples names correctly."""
    return mean([case.answer.get("in_sample") == case.label.effects[0] for case in cases if case.single])


def _controls(cases: Sequence[Answered]) -> tuple[Measured, ...]:
    dealt = [[case.rank == 0 for case in permuted(cases, seed) if case.single] for seed in range(PERMUTATIONS)]
    count = sum(case.single for case in cases)
    return (
        Measured(marked("labels permuted"), mean([mean(hits) for hits in dealt if hits]), count),
        Measured(marked("always dry_friction"), constant_answer_share(cases), count),
        Measured(marked("best fit of the fitted samples"), in_sample(cases), count),
    )


def _alike(case: Answered) -> bool:
    first = case.ranking[0] if case.ranking else {}
    return case.label.effects[0] in {first.get("effect"), *first.get("indistinguishable", ())}


def _right_stage(case: Answered) -> bool:
    return case.stage in case.label.stages


def _wrong_and_sure(case: Answered) -> bool:
    # A second name has no probability of its own: it gets that of the first.
    return case.failed and case.probability >= SURE


def _wrong_leader_and_sure(case: Answered) -> bool:
    leader = case.ranking[0]["effect"] if case.ranking else None
    return bool(case.named) and leader not in case.label.effects and case.probability >= SURE


def _figures(single: Sequence[Answered], targets: Targets) -> list[Measured]:
    explained = [case for case in single if case.verdict == "effect" and case.closed is not None]
    relative = [
        case.closed / best for case in explained if case.closed is not None and (best := case.best_closed or 1.0) > 0.05
    ]
    off = [
        abs(case.predicted_closed - case.closed)
        for case in explained
        if case.predicted_closed is not None and case.closed is not None
    ]
    sure = np.array([case.probability for case in single])
    right = np.array([case.rank == 0 for case in single], np.float64)
    return [
        Measured(
            marked("closed share relative to the true model, median"),
            quantile(relative, 0.5),
            len(relative),
            targets.closed_median,
        ),
        Measured(
            marked("closed share relative to the true model, 10th percentile"),
            quantile(relative, 0.1),
            len(relative),
            targets.closed_tenth,
        ),
        Measured(
            marked("predicted minus realised closed share, median magnitude"),
            quantile(off, 0.5),
            len(off),
            targets.predicted_closed,
            at_least=False,
        ),
        Measured(marked("expected calibration error"), calibration_error(sure, right), sure.size),
        Measured(marked("calibration error of exact probabilities, mean"), exact_calibration_error(sure), sure.size),
        Measured(marked("Brier score"), mean((sure - right) ** 2), sure.size),
    ]


def calibration_error(sure: np.ndarray, right: np.ndarray) -> float:
    """Return the expected calibration error of probabilities, shape (n,); ``right``, shape (n,), is 0 or 1."""
    if not sure.size:
        return float("nan")
    bins = np.minimum((sure * CALIBRATION_BINS).astype(int), CALIBRATION_BINS - 1)
    off = [abs(float((sure - right)[bins == k].sum())) for k in range(CALIBRATION_BINS)]
    return sum(off) / sure.size


def exact_calibration_error(sure: np.ndarray) -> float:
    """Return the mean expected calibration error that probabilities, shape (n,), would show if each were exact.

    It is above 0 because each bin holds few answers (Broecker and Smith, Weather Forecast. 22 (2007) 651), and the
    measured error is to be compared with it.
    """
    random = np.random.default_rng(0)
    drawn = random.random((CALIBRATION_DRAWS, sure.size)) < sure
    return mean([calibration_error(sure, right.astype(np.float64)) for right in drawn])


def _pair_scores(pairs: Sequence[Answered], targets: Targets) -> tuple[Measured, Measured]:
    # Targets hold for effects whose own gap survives the refit.
    both = [case for case in pairs if case.all_survive]
    return (
        Measured(PAIRS, f1_of(both), len(both), targets.pairs),
        Measured(marked("the same, with effects whose own gap does not survive"), f1_of(pairs), len(pairs)),
    )


def _confusion(single: Sequence[Answered]) -> dict[str, dict[str, int]]:
    counts: dict[str, dict[str, int]] = {}
    for case in single:
        row = counts.setdefault(case.label.effects[0], {})
        verdict = str(case.ranking[0]["effect"]) if case.verdict == "effect" and case.ranking else case.verdict
        row[verdict] = row.get(verdict, 0) + 1
    return counts


def _risk_coverage(single: Sequence[Answered]) -> tuple[tuple[float, float], ...]:
    ordered = sorted(single, key=lambda case: -case.probability)
    wrong = np.cumsum([case.rank != 0 for case in ordered])
    return tuple(((k + 1) / len(ordered), float(wrong[k] / (k + 1))) for k in range(len(ordered)))


def _failure(case: Answered) -> str:
    true = " + ".join(case.label.effects) or "nothing"
    first = case.ranking[0]["effect"] if case.ranking else "nothing"
    verdict = " + ".join(sorted(case.named)) or case.verdict
    if not case.label.effects:
        return f"{case.name}: {true}; diagnosed as {verdict}" if has_gap(case) else ""
    if not case.survives:
        return f"{case.name}: {true} (does not survive the refit); diagnosed as {verdict}" if case.failed else ""
    good = case.named == set(case.label.effects) if all(case.label.listed) else unexplained(case)
    if good and _right_stage(case):
        return ""
    return (
        f"{case.name}: {true}; diagnosed as {verdict} (stage {case.stage}), "
        f"leading {first} at {case.probability:.0%}, gap {case.answer['gap']['before']:.2%}"
    )


def score_answer(score: BlindScore) -> dict[str, Any]:
    """Return a score for JSON."""

    def judged(item: Rate | Measured) -> dict[str, Any]:
        return {"what": item.what, "cases": item.cases, "asked": item.target, "kept": item.reached}

    return {
        "rates": [
            judged(item) | {"share": item.share, "interval": list(item.interval), "hits": item.hits}
            for item in score.rates
        ],
        "figures": [judged(item) | {"value": item.value} for item in score.figures],
        "confusion": score.confusion,
        "risk_coverage": [list(point) for point in score.risk_coverage],
        "failures": list(score.failures),
        **{key: item.value for key, item in zip(_CONTROLS, score.controls, strict=bool(score.controls))},
    }
