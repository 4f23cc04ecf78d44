"""Diagnosing sealed scenarios, one in each process, with answers that outlive an interruption."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tissueid.gap.answer import as_answer
from tissueid.gap.diagnosis import diagnose
from tissueid.gap.kept_answers import keep_answer, kept_answer
from tissueid.gap.observed import Observed, Purpose
from tissueid.gap.observing import observe
from tissueid.gap.scenarios import alone_sessions, read_scenario
from tissueid.gap.scoring import ChannelError, floor, gap, quiet_tests
from tissueid.gap.sealed import Answered, Label, Score, survives
from tissueid.gap.search import Search
from tissueid.gap.workers import Alone, Crew
from tissueid.sessions import Session
from tissueid.twin.catalogue import all_effects


@dataclass(frozen=True)
class Piece:
    """One scenario to be diagnosed; ``without`` are effects that are taken out of the library.

    With ``keep`` the answer is kept beside the scenarios as soon as there is one.
    """

    folder: Path
    name: str
    without: tuple[str, ...] = ()
    keep: bool = False

    @property
    def key(self) -> str:
        """Name under which its answer is kept."""
        return "-without-".join([self.name, *self.without])

    def answered(self) -> dict[str, Any]:
        """The answer, kept where that is asked for.

        Raises:
            UnusableInputError: it cannot be kept.
        """
        found = self.diagnosed()
        if self.keep:
            keep_answer(self.folder, self.key, found)
        return found

    def diagnosed(self) -> dict[str, Any]:
        """The answer of ``gap diagnose``, with ``oracle`` (the gap that the truth itself leaves) and ``in_sample``.

        ``in_sample`` is the effect that fits the fitted samples best: what a search without held-out data would name.
        Of a pair ``survive_alone`` tells of each effect whether the session with it alone has a gap that survives.
        """
        observed = observe(read_scenario(self.folder, self.name))
        names = [name for name in all_effects() if name not in self.without] if self.without else None
        found = diagnose(observed, Alone(), candidates=names)
        singles = found.found.singles
        greedy = min(singles, key=lambda item: item.fit.cost, default=None)
        return as_answer(found) | {
            "oracle": _oracle(observed, read_scenario(self.folder, self.name, "clean")),
            "in_sample": greedy.effects[0] if greedy is not None else None,
            "survive_alone": [_survives(alone) for alone in alone_sessions(self.folder, self.name)],
        }


def diagnosed(piece: Piece) -> dict[str, Any]:
    """Do one piece; runs in a worker's process."""
    return piece.answered()


def nothing_out(name: str) -> tuple[str, ...]:
    """The whole library serves every scenario."""
    return ()


def answers(
    folder: Path,
    names: Sequence[str],
    crew: Crew,
    done: Callable[[], None] = lambda: None,
    without: Callable[[str], tuple[str, ...]] = nothing_out,
    keep: bool = False,
) -> dict[str, dict[str, Any]]:
    """Answers by scenario.

    With ``keep`` each is kept beside the scenarios as it comes, and what is kept there already is not asked again.

    Raises:
        UnusableInputError: a kept answer cannot be read, or one cannot be kept.
    """
    pieces = [Piece(folder, name, without(name), keep) for name in names]
    found = {piece.name: kept_answer(folder, piece.key) for piece in pieces} if keep else {}
    known = {name: answer for name, answer in found.items() if answer is not None}
    for _ in known:
        done()
    left = [piece for piece in pieces if piece.name not in known]
    fresh = crew.do(diagnosed, left, lambda: False, lambda piece: done())
    known |= {piece.name: answer for piece, answer in zip(left, fresh, strict=True)}
    return {name: known[name] for name in names}


@dataclass(frozen=True)
class BlindCheck:
    """A sealed check that is done: the SHA-256 of its labels, its draw, and a score for each kind of session.

    ``scores`` holds title, number of scenarios and score, by ``single`` and ``full``.
    """

    seal: str
    n: int
    seed: int
    scores: dict[str, tuple[str, int, Score]]


def opened(found: dict[str, dict[str, Any]], labels: dict[str, Label]) -> list[Answered]:
    """Answers beside their labels."""
    return [Answered(name, labels[name], answer, answer.get("oracle")) for name, answer in found.items()]


def _survives(session: Session) -> bool:
    observed = observe(session)
    checked = Search(observed, Alone()).baseline().checked_by
    quiet = quiet_tests(observed.tests)
    return survives(gap(checked, quiet), floor(checked, quiet))


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
