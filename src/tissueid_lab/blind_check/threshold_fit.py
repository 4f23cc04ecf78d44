"""Thresholds of the decision from stored answers of one laboratory, and their score on another.

Each scenario is decided with the complete library, and where its only effect is of the library, once more without that
effect (leave one effect out): then the right decision is that the gap is unexplained. Thresholds are changed one at a
time. Those of the decision maximise the share of the true effects that are named, less ``WRONG`` for each that is not
there, or the share of scenarios in which nothing is named where nothing of the library is there; single effects,
several, none, and left out ones count alike. Those of the probabilities minimise the Brier score.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tissueid.errors import UnusableInputError
from tissueid.gap.answer import stored_answer
from tissueid.gap.decision import Grounds, decide, probabilities
from tissueid.gap.thresholds import THRESHOLDS, Thresholds
from tissueid_lab.blind_check.answers import BlindScenario, scenario_names, unseal
from tissueid_lab.blind_check.scoring import calibration_error, f1, mean, survives

WRONG = 1.0
"""Right names that a name which is not there outweighs."""
DECISION: dict[str, tuple[float, ...]] = {
    "at_the_floor": (0.04, 0.06, 0.08, 0.10, 0.12, 0.16, 0.20, 0.25),
    "explained_closed": (0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9),
    "explained_share": (0.2, 0.3, 0.4, 0.5, 0.55, 0.6, 0.7),
    "explained_gain": (2.0, 3.0, 4.0, 5.0, 20.0),
    "clear_share": (0.04, 0.08, 0.12, 0.2, 0.3),
    "set_gain": (0.3, 0.4, 0.5, 0.7, 1.0),
    "set_leaves": (0.1, 0.15, 0.2, 0.25, 0.3, 0.36),
    "set_leaves_score": (0.2, 0.25, 0.3, 0.36, 0.4, 0.45, 0.5),
    "stand_in_score": (1.0, 1.5, 2.0, 3.0, 20.0),
    "structural": (0.8, 0.85, 0.9, 0.93, 0.95, 0.97, 0.98, 0.99, 1.0),
}
"""Values that are tried. Those of sets begin where the search ends, which has discarded what lies below."""
PROBABILITY: dict[str, tuple[float, ...]] = {
    "temperature": (0.02, 0.04, 0.06, 0.09, 0.13, 0.2),
    "temperature_share": (0.0, 0.05, 0.1, 0.15, 0.2, 0.3),
}
ROUNDS = 4


@dataclass(frozen=True)
class Decided:
    """Grounds of the decision on one scenario, and the effects that should be named.

    ``alone`` is true where a single effect of the library is there and its gap survives the refit, ``left_out`` where
    that effect was removed from the library.
    """

    grounds: Grounds
    true: frozenset[str]
    alone: bool
    left_out: bool = False


def read_decided(folder: Path) -> list[Decided]:
    """Return the grounds of all stored answers of a finished blind check with ``--take-out --keep FOLDER``.

    Scenarios whose gap does not survive the refit are left out.

    Raises:
        UnusableInputError: an answer is missing or cannot be read, or the labels cannot.
    """
    labels, decided = unseal(folder), []
    for name in scenario_names(folder):
        label, answer = labels[name], stored_answer(folder, BlindScenario(folder, name).key)
        if answer is None or "grounds" not in answer:
            raise UnusableInputError(f"{folder} has no grounds of the decision on {name}")
        if label.effects and not survives(answer["gap"]["before"], answer["gap"]["floor"]):
            continue
        listed = frozenset(effect for effect, is_listed in zip(label.effects, label.listed, strict=True) if is_listed)
        alone = len(label.effects) == len(listed) == 1
        decided.append(Decided(Grounds.from_dict(answer["grounds"]), listed, alone))
        without = stored_answer(folder, BlindScenario(folder, name, label.effects).key) if alone else None
        if without is not None:
            decided.append(Decided(Grounds.from_dict(without["grounds"]), frozenset(), alone, left_out=True))
    return decided


def fit_thresholds(cases: Sequence[Decided], start: Thresholds = THRESHOLDS) -> Thresholds:
    """Return thresholds fitted to decisions of one laboratory. Of equally good values the middle one is taken."""
    thresholds = _searched(start, DECISION, lambda tried: value(cases, tried))
    return _searched(thresholds, PROBABILITY, lambda tried: -_brier(cases, tried))


def _searched(
    thresholds: Thresholds, grids: dict[str, tuple[float, ...]], goodness: Callable[[Thresholds], float]
) -> Thresholds:
    for _ in range(ROUNDS):
        before = thresholds
        for name, grid in grids.items():
            values = [goodness(changed(thresholds, name, item)) for item in grid]
            best = [item for item, reached in zip(grid, values, strict=True) if reached >= max(values) - 1e-9]
            thresholds = changed(thresholds, name, best[len(best) // 2])
        if thresholds == before:
            break
    return thresholds


def changed(thresholds: Thresholds, name: str, value: float) -> Thresholds:
    """Return thresholds with one of them changed."""
    change: dict[str, Any] = {name: value}
    return replace(thresholds, **change)


def value(cases: Sequence[Decided], thresholds: Thresholds) -> float:
    """Return the objective of the decision's thresholds, at most the number of kinds of scenarios."""
    kinds: dict[tuple[int, bool], list[float]] = {}
    for case in cases:
        names = decide(case.grounds, thresholds)
        right = len(names & case.true) / len(case.true) - WRONG * len(names - case.true) if case.true else not names
        kinds.setdefault((min(len(case.true), 2), case.left_out), []).append(float(right))
    return sum(float(np.mean(values)) for values in kinds.values())


def _sure(cases: Sequence[Decided], thresholds: Thresholds) -> tuple[np.ndarray, np.ndarray]:
    # Probability of the first place and whether it is right, for single effects.
    sure, right = [], []
    for case in cases:
        singles = sorted((item for item in case.grounds.tried if len(item.effects) == 1), key=lambda item: item.cost)
        if not case.alone or case.left_out or not singles:
            continue
        costs = [item.cost for item in singles]
        sure.append(probabilities(case.grounds.baseline, costs, clearly=singles[0].strict, thresholds=thresholds)[0])
        right.append(float(set(singles[0].effects) == case.true))
    return np.array(sure), np.array(right)


def _brier(cases: Sequence[Decided], thresholds: Thresholds) -> float:
    sure, right = _sure(cases, thresholds)
    return float(np.mean((sure - right) ** 2)) if sure.size else 0.0


def scores(cases: Sequence[Decided], thresholds: Thresholds) -> dict[str, tuple[float, int]]:
    """Return the figures of decisions with these thresholds, each with its number of cases."""
    names = [decide(case.grounds, thresholds) for case in cases]
    pairs = list(zip(cases, names, strict=True))
    single = [(case, name) for case, name in pairs if case.alone and not case.left_out]
    sets = [(case, name) for case, name in pairs if len(case.true) > 1]
    unlisted = [name for case, name in pairs if not case.true and not case.left_out]
    left_out = [name for case, name in pairs if case.left_out]
    complete = [(case, name) for case, name in pairs if not case.left_out]
    sure, right = _sure(cases, thresholds)
    return {
        "single effect named, nothing else": _share([name == case.true for case, name in single]),
        "single effect first": (mean(right), right.size),
        "several effects: F1": (f1([set(name) for _, name in sets], [set(case.true) for case, _ in sets]), len(sets)),
        "no effect or none of the library: nothing named": _share([not name for name in unlisted]),
        "effect left out of the library: nothing named": _share([not name for name in left_out]),
        "named effects that are not there, per scenario": (
            sum(len(name - case.true) for case, name in complete) / max(len(complete), 1),
            len(complete),
        ),
        "expected calibration error": (calibration_error(sure, right), sure.size),
    }


def _share(hits: Sequence[bool]) -> tuple[float, int]:
    return mean(hits), len(hits)
