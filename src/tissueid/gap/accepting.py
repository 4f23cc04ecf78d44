"""Acceptance of effects into a twin: those that a diagnosis names, or those that the operator chooses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from tissueid.errors import UnusableInputError
from tissueid.gap.diagnosis import Diagnosis
from tissueid.gap.preparation import prepare
from tissueid.gap.scoring import Candidate, closed, floor, gap, quiet_tests
from tissueid.gap.search import Search, SearchProgress, applicable
from tissueid.gap.twin_export import twin_file_of, with_prior_twin
from tissueid.gap.workers import Executor
from tissueid.instrument.twin_file import MOST_NAMED, TwinFile
from tissueid.language import marked
from tissueid.messages import Action, Message
from tissueid.sessions import read_session
from tissueid.twin.catalogue import effect

_CHOOSE = Action("accept.choose", "--effect NAME", marked("choose it on the page Gap"))


def accepted(found: Diagnosis, name: str, session_id: str, before: TwinFile | None) -> TwinFile:
    """Return the twin file of the effects that a diagnosis names.

    Raises:
        UnusableInputError: the diagnosis names no effect.
    """
    if found.verdict != "effect" or found.best is None:
        if found.verdict == "no_gap":
            raise UnusableInputError(
                Message(
                    "accept.no_gap",
                    "nothing to accept: there is no gap. To accept an effect: {choose}",
                    choose=_CHOOSE,
                )
            )
        raise UnusableInputError(
            Message(
                "accept.unexplained",
                "nothing to accept: no candidate explains the gap. To accept an effect: {choose}",
                choose=_CHOOSE,
            )
        )
    probability = found.ranking[0].probability if found.ranking else None
    return twin_file_of(
        found.best,
        name,
        session_id=session_id,
        verdict=found.verdict,
        closed=found.gap.closed,
        probability=probability,
        before=before,
    )


def accept_named(
    path: Path,
    names: Sequence[str],
    twin_name: str,
    before: TwinFile | None,
    people: Executor,
    progress: Callable[[SearchProgress], None],
    fit: Sequence[int] = (),
    check: Sequence[int] = (),
    cancelled: Callable[[], bool] = lambda: False,
) -> TwinFile:
    """Fit a session with chosen effects, and return the twin file.

    Raises:
        UnusableInputError: an effect does not exist, needs signals that were not recorded, or is not in the records.
    """
    if twice := [name for place, name in enumerate(names) if name in names[:place]]:
        raise UnusableInputError(Message("accept.twice", "the effect {effect} is named twice", effect=twice[0]))
    count = len(names) + (0 if before is None else len(before.effects))
    if count > MOST_NAMED:
        raise UnusableInputError(
            Message(
                "accept.too_many",
                "a twin holds at most {most} effects, not {count}",
                most=MOST_NAMED,
                count=count,
            )
        )
    session = read_session(path)
    dataset = prepare(session, fit, check)
    known: tuple[str, ...] = ()
    if before is not None:
        dataset, known = with_prior_twin(dataset, before.twin), before.twin.effects
    for name in names:
        if name in known:
            raise UnusableInputError(Message("accept.known", "the twin has the effect {effect} already", effect=name))
        if not applicable(dataset, effect(name)):
            raise UnusableInputError(
                Message(
                    "accept.signals",
                    "these records cannot show the effect {effect}: it needs other signals",
                    effect=name,
                )
            )
    search = Search(dataset, people, names, progress, cancelled)
    baseline = best = search.baseline(known)
    dataset = baseline.fit.parameters.dataset
    for name in names:
        tried = Search(dataset, people, [name], progress, cancelled).pairs_with(best, [best])
        if not tried:
            raise UnusableInputError(
                Message(
                    "accept.no_trace",
                    "these records hold no trace of the effect {effect}",
                    effect=name,
                )
            )
        best = tried[0]
    return twin_file_of(
        best, twin_name, session_id=session.session_id, verdict="by hand", closed=_closed(baseline, best), before=before
    )


def _closed(baseline: Candidate, best: Candidate) -> float:
    quiet = quiet_tests(baseline.fit.parameters.dataset.tests)
    return closed(gap(baseline.checked_by, quiet), gap(best.checked_by, quiet), floor(baseline.checked_by, quiet))
