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


@dataclass(frozen=True)
class Rate:
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

    @property
    def interval(self) -> tuple[float, float]:
        """95 % Wilson interval."""
        if not self.cases:
            return float("nan"), float("nan")
        found = binomtest(self.hits, self.cases).proportion_ci(method="wilson")
        return float(found.low), float(found.high)

    @property
    def reached(self) -> bool | None:
        """Whether the target was reached; None where there were no cases."""
        if not self.cases:
            return None
        return self.share >= self.target if self.at_least else self.share <= self.target


@dataclass(frozen=True)
class Measured:
    """A score that is not a share of cases."""

    what: str
    value: float
    cases: int
    target: float | None = None
    at_least: bool = True

    @property
    def reached(self) -> bool | None:
        """Whether the target was reached; None without a target or without cases."""
        if self.target is None or not self.cases:
            return None
        return self.value >= self.target if self.at_least else self.value <= self.target


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
class Score:
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


def score_of(cases: Sequence[Answered], targets: Targets, taken_out: Sequence[Answered] = ()) -> Score:
    """Score answers against labels.

    Args:
        cases: answers with labels.
        targets: targets for this kind of session.
        taken_out: answers to some cases with the true effect removed from the library.
    """
    single = _single(cases)
    none = [case for case in cases if not case.label.effects]
    unknown = [case for case in cases if case.label.effects and not all(case.label.listed) and case.survives]
    pairs = [case for case in cases if len(case.label.effects) > 1 and all(case.label.listed) and case.survives]
    above = [case for case in cases if case.label.effects and case.survives]
    rates = [
        _rate(marked("top-1"), single, lambda case: _place(case) == 0, targets.top1),
        _rate(marked("top-1 including inseparable effects"), single, _alike, targets.alike),
        _rate(marked("top-3"), single, lambda case: _place(case) < 3, targets.top3),
        _rate(marked("stage"), [*single, *unknown], lambda case: _stage(case) in case.label.stages, targets.stage),
        _rate(
            marked("unknown effect: unexplained"),
            unknown,
            lambda case: case.verdict == "unexplained",
            targets.unexplained,
        ),
        _rate(
            marked("known effect: unexplained"),
            single,
            lambda case: case.verdict == "unexplained",
            0.05,
            at_least=False,
        ),
        _rate(marked("wrong name at 90 % or more"), above, _wrong_and_sure, targets.wrong_and_sure, at_least=False),
        _rate(marked("the leading name alone"), above, _wrong_leader_and_sure, targets.wrong_and_sure, at_least=False),
        _rate(
            marked("false alarms without effect"),
            none,
            lambda case: case.verdict != "no_gap",
            targets.false_alarm,
            False,
        ),
        _rate(marked("gap missed"), single, lambda case: case.verdict == "no_gap", 0.05, at_least=False),
    ]
    if taken_out:
        abstained = [case for case in taken_out if case.verdict == "unexplained"]
        rates += [
            _rate(TAKEN_OUT, taken_out, lambda case: case.verdict == "unexplained", targets.unexplained),
            _rate(
                marked("of these the right stage"),
                abstained,
                lambda case: _stage(case) in case.label.stages,
                targets.stage,
            ),
        ]
    return Score(
        tuple(rates),
        (*_figures(single, targets), *_pair_scores(pairs, targets)),
        _confusion(single),
        _risk_coverage(single),
        tuple(failure for case in cases if (failure := _failure(case))),
        _controls(cases),
    )


def permuted(cases: Sequence[Answered], seed: int = 0) -> list[Answered]:
    """Return the answers with permuted labels, as a control for chance."""
    order = np.random.default_rng(seed).permutation(len(cases))
    return [replace(case, label=cases[k].label) for case, k in zip(cases, order, strict=True)]


def constant_answer_share(cases: Sequence[Answered], effect: str = "dry_friction") -> float:
    """Return the share of single effects that a constant answer names correctly."""
    single = _single(cases)
    return float(np.mean([case.label.effects[0] == effect for case in single])) if single else float("nan")


def in_sample(cases: Sequence[Answered]) -> float:
    """Return the share of single effects that the best fit of the fitted samples names correctly."""
    hits = [case.answer.get("in_sample") == case.label.effects[0] for case in _single(cases)]
    return float(np.mean(hits)) if hits else float("nan")


def _controls(cases: Sequence[Answered]) -> tuple[Measured, ...]:
    dealt = [[_place(case) == 0 for case in _single(permuted(cases, seed))] for seed in range(PERMUTATIONS)]
    shares = [float(np.mean(hits)) for hits in dealt if hits]
    count = len(_single(cases))
    return (
        Measured(marked("labels permuted"), float(np.mean(shares)) if shares else float("nan"), count),
        Measured(marked("always dry_friction"), constant_answer_share(cases), count),
        Measured(marked("best fit of the fitted samples"), in_sample(cases), count),
    )


def _single(cases: Sequence[Answered]) -> list[Answered]:
    return [case for case in cases if len(case.label.effects) == 1 and case.label.listed[0] and case.survives]


def _rate(
    what: str, cases: Sequence[Answered], hit: Callable[[Answered], bool], target: float, at_least: bool = True
) -> Rate:
    return Rate(what, sum(hit(case) for case in cases), len(cases), target, at_least)


def _place(case: Answered) -> int:
    names = [item["effect"] for item in case.ranking]
    return names.index(case.label.effects[0]) if case.label.effects[0] in names else len(names) + 10


def _alike(case: Answered) -> bool:
    first = case.ranking[0] if case.ranking else {}
    return case.label.effects[0] in {first.get("effect"), *first.get("indistinguishable", ())}


def _stage(case: Answered) -> str:
    return str(case.answer["where"]["stage"])


def _wrong_and_sure(case: Answered) -> bool:
    # A second name has no probability of its own: it gets that of the first.
    wrong = bool(case.named) and not case.named <= set(case.label.effects)
    return wrong and case.probability >= SURE


def _wrong_leader_and_sure(case: Answered) -> bool:
    leader = case.ranking[0]["effect"] if case.ranking else None
    return bool(case.named) and leader not in case.label.effects and case.probability >= SURE


def _figures(single: Sequence[Answered], targets: Targets) -> list[Measured]:
    explained = [case for case in single if case.verdict == "effect"]
    relative = np.array(
        [
            closed / best
            for case in explained
            if (closed := case.closed) is not None and (best := case.best_closed or 1.0) > 0.05
        ]
    )
    off = np.array(
        [
            abs(verdict - closed)
            for case in explained
            if (verdict := case.predicted_closed) is not None and (closed := case.closed) is not None
        ]
    )
    sure = np.array([case.probability for case in single])
    right = np.array([_place(case) == 0 for case in single], np.float64)
    return [
        Measured(
            marked("closed share relative to the true model, median"),
            float(np.median(relative)) if relative.size else float("nan"),
            relative.size,
            targets.closed_median,
        ),
        Measured(
            marked("closed share relative to the true model, 10th percentile"),
            float(np.quantile(relative, 0.1)) if relative.size else float("nan"),
            relative.size,
            targets.closed_tenth,
        ),
        Measured(
            marked("predicted minus realised closed share, median magnitude"),
            float(np.median(off)) if off.size else float("nan"),
            off.size,
            targets.predicted_closed,
            at_least=False,
        ),
        Measured(marked("expected calibration error"), calibration_error(sure, right), sure.size),
        Measured(marked("calibration error of exact probabilities, mean"), exact_calibration_error(sure), sure.size),
        Measured(marked("Brier score"), float(np.mean((sure - right) ** 2)) if sure.size else float("nan"), sure.size),
    ]


def calibration_error(sure: np.ndarray, right: np.ndarray) -> float:
    """Return the expected calibration error of probabilities, shape (n,); ``right``, shape (n,), is 0 or 1."""
    if not sure.size:
        return float("nan")
    place = np.minimum((sure * CALIBRATION_BINS).astype(int), CALIBRATION_BINS - 1)
    total = 0.0
    for k in range(CALIBRATION_BINS):
        inside = place == k
        if inside.any():
            total += inside.sum() * abs(sure[inside].mean() - right[inside].mean())
    return float(total / sure.size)


def exact_calibration_error(sure: np.ndarray) -> float:
    """Return the mean expected calibration error that probabilities, shape (n,), would show if each were exact.

    It is above 0 because each bin holds few answers (Broecker and Smith, Weather Forecast. 22 (2007) 651), and the
    measured error is to be compared with it.
    """
    random = np.random.default_rng(0)
    drawn = random.random((CALIBRATION_DRAWS, sure.size)) < sure
    return float(np.mean([calibration_error(sure, right.astype(np.float64)) for right in drawn]))


def _pair_scores(pairs: Sequence[Answered], targets: Targets) -> tuple[Measured, Measured]:
    # Targets hold for effects whose own gap survives the refit.
    both = [case for case in pairs if case.all_survive]
    return (
        Measured(PAIRS, _f1(both), len(both), targets.pairs),
        Measured(marked("the same, with effects whose own gap does not survive"), _f1(pairs), len(pairs)),
    )


def _f1(pairs: Sequence[Answered]) -> float:
    # F1 score of the named sets over all pairs.
    hits = sum(len(case.named & set(case.label.effects)) for case in pairs)
    named = sum(len(case.named) for case in pairs)
    true = sum(len(case.label.effects) for case in pairs)
    return 2.0 * hits / (named + true) if named + true else float("nan")


def _confusion(single: Sequence[Answered]) -> dict[str, dict[str, int]]:
    found: dict[str, dict[str, int]] = {}
    for case in single:
        row = found.setdefault(case.label.effects[0], {})
        verdict = str(case.ranking[0]["effect"]) if case.verdict == "effect" and case.ranking else case.verdict
        row[verdict] = row.get(verdict, 0) + 1
    return found


def _risk_coverage(single: Sequence[Answered]) -> tuple[tuple[float, float], ...]:
    ordered = sorted(single, key=lambda case: -case.probability)
    wrong = np.cumsum([_place(case) != 0 for case in ordered])
    return tuple(((k + 1) / len(ordered), float(wrong[k] / (k + 1))) for k in range(len(ordered)))


def _failure(case: Answered) -> str:
    true = " + ".join(case.label.effects) or "nothing"
    first = case.ranking[0]["effect"] if case.ranking else "nothing"
    verdict = " + ".join(sorted(case.named)) or case.verdict
    if not case.label.effects:
        return "" if case.verdict == "no_gap" else f"{case.name}: {true}; diagnosed as {verdict}"
    if not case.survives:
        wrong = bool(case.named) and not case.named <= set(case.label.effects)
        return f"{case.name}: {true} (does not survive the refit); diagnosed as {verdict}" if wrong else ""
    known = all(case.label.listed)
    good = case.named == set(case.label.effects) if known else case.verdict == "unexplained"
    if good and _stage(case) in case.label.stages:
        return ""
    return (
        f"{case.name}: {true}; diagnosed as {verdict} (stage {_stage(case)}), "
        f"leading {first} at {case.probability:.0%}, gap {case.answer['gap']['before']:.2%}"
    )
