"""Diagnosing sealed scenarios, one in each process, and the controls that a good score must beat."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tissueid.gap.answer import as_answer
from tissueid.gap.diagnosis import diagnose
from tissueid.gap.observed import Observed, Purpose
from tissueid.gap.observing import observe
from tissueid.gap.scenarios import read_scenario
from tissueid.gap.scoring import ChannelError, gap, quiet_tests
from tissueid.gap.sealed import Answered, Label
from tissueid.gap.workers import Alone, Crew
from tissueid.sessions import Session
from tissueid.twin.catalogue import library


@dataclass(frozen=True)
class Piece:
    """One scenario to be diagnosed; ``without`` are effects that are taken out of the library."""

    folder: Path
    name: str
    without: tuple[str, ...] = ()

    def diagnosed(self) -> dict[str, Any]:
        """The answer of ``gap diagnose``, with ``oracle`` (the gap that the truth itself leaves) and ``in_sample``.

        ``in_sample`` is the effect that fits the fitted samples best: what a search without held-out data would name.
        """
        observed = observe(read_scenario(self.folder, self.name))
        names = [name for name in library() if name not in self.without] if self.without else None
        found = diagnose(observed, Alone(), candidates=names)
        singles = found.found.singles
        greedy = min(singles, key=lambda item: item.fit.cost, default=None)
        return as_answer(found) | {
            "oracle": _oracle(observed, read_scenario(self.folder, self.name, "clean")),
            "in_sample": greedy.effects[0] if greedy is not None else None,
        }


def diagnosed(piece: Piece) -> dict[str, Any]:
    """Do one piece; runs in a worker's process."""
    return piece.diagnosed()


def answers(
    folder: Path,
    names: Sequence[str],
    crew: Crew,
    done: Callable[[], None] = lambda: None,
    without: Callable[[str], tuple[str, ...]] = lambda name: (),
) -> dict[str, dict[str, Any]]:
    """Answers by scenario."""
    pieces = [Piece(folder, name, without(name)) for name in names]
    found = crew.do(diagnosed, pieces, lambda: False, lambda piece: done())
    return dict(zip(names, found, strict=True))


def opened(found: dict[str, dict[str, Any]], labels: dict[str, Label]) -> list[Answered]:
    """Answers beside their labels."""
    return [Answered(name, labels[name], answer, answer.get("oracle")) for name, answer in found.items()]


def permuted(cases: Sequence[Answered], seed: int = 0) -> list[Answered]:
    """The same answers under labels dealt out anew: what chance alone would score."""
    order = np.random.default_rng(seed).permutation(len(cases))
    return [replace(case, label=cases[k].label) for case, k in zip(cases, order, strict=True)]


def always(cases: Sequence[Answered], effect: str = "dry_friction") -> float:
    """Share of single effects whose cause would be named by who always says the same."""
    single = [case for case in cases if len(case.label.effects) == 1 and case.survives]
    return float(np.mean([case.label.effects[0] == effect for case in single])) if single else float("nan")


def in_sample(cases: Sequence[Answered]) -> float:
    """Share of single effects whose cause is named by who looks at the fitted samples alone."""
    single = [case for case in cases if len(case.label.effects) == 1 and all(case.label.listed) and case.survives]
    hits = [case.answer.get("in_sample") == case.label.effects[0] for case in single]
    return float(np.mean(hits)) if hits else float("nan")


def _oracle(observed: Observed, clean: Session) -> float:
    # What the true signals, without noise, leave of the recorded ones on the samples of the check.
    found = []
    for test in observed.tests:
        truth = clean.test(test.number)
        for name in observed.channels:
            mask = test.serving(Purpose.CHECK) & np.isfinite(test.signals[name]) & np.isfinite(truth.signals[name])
            if mask.any():
                error = float(np.mean((truth.signals[name][mask] - test.signals[name][mask]) ** 2))
                spread = float(np.nanstd(test.signals[name]))
                found.append(ChannelError(test.number, name, error, observed.noise[name], spread, int(mask.sum())))
    return gap(found, quiet_tests(observed.tests))
