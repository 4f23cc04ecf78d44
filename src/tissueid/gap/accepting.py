"""Acceptance of effects into a twin: those that a diagnosis names, or those that the operator chooses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from tissueid.errors import UnusableInputError
from tissueid.gap.diagnosis import Diagnosis
from tissueid.gap.preparation import prepare
from tissueid.gap.scoring import Candidate, closed, floor, gap, quiet_tests
from tissueid.gap.search import Search, SearchProgress, applicable
from tissueid.gap.twin_export import against_twin, next_version, time_of_creation, twin_file_of
from tissueid.gap.workers import Executor
from tissueid.instrument.twin_file import MOST_NAMED, TwinFile
from tissueid.language import marked
from tissueid.messages import Action, Message
from tissueid.sessions import read_session
from tissueid.twin.catalogue import effect

_CHOOSE = Action("accept.choose", "--effect NAME", marked("choose it on the page Gap"))
_NO_GAP = Message("accept.no_gap", "nothing to accept: there is no gap. To accept an effect: {choose}", choose=_CHOOSE)
_UNEXPLAINED = Message(
    "accept.unexplained",
    "nothing to accept: no candidate explains the gap. To accept an effect: {choose}",
    choose=_CHOOSE,
)


@dataclass(frozen=True)
class NamedEffects:
    """The effects that a diagnosis names, and the twin that has them.

    ``twin`` is None where there is no such twin, and ``refused`` says why. ``baseline`` is the twin that it extends;
    None is the nominal one.
    """

    effects: tuple[str, ...]
    twin: TwinFile | None
    refused: str = ""
    baseline: TwinFile | None = None

    def twin_called(self, name: str, now: datetime | None = None) -> TwinFile:
        """Return the twin under another name; the next version where it extends a twin of that name.

        Raises:
            UnusableInputError: there is no twin.
        """
        if self.twin is None:
            raise UnusableInputError(self.refused)
        changes = {"name": name, "version": next_version(name, self.baseline), "created": time_of_creation(now)}
        return TwinFile(**self.twin.model_dump() | changes)


def named_effects(found: Diagnosis, session_id: str, baseline: TwinFile | None) -> NamedEffects:
    """Return the effects that a diagnosis names, with the twin that has them."""
    if found.verdict != "effect" or found.best is None:
        return NamedEffects((), None, _NO_GAP if found.verdict == "no_gap" else _UNEXPLAINED, baseline)
    try:
        twin = twin_file_of(
            found.best,
            "twin" if baseline is None else baseline.name,
            session_id=session_id,
            verdict=found.verdict,
            closed=found.gap.closed,
            probability=found.ranking[0].probability if found.ranking else None,
            before=baseline,
        )
    except UnusableInputError as error:
        return NamedEffects(found.combination, None, error.message, baseline)
    return NamedEffects(found.combination, twin, baseline=baseline)


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
        raise UnusableInputError("accept.twice", "the effect {effect} is named twice", effect=twice[0])
    count = len(names) + (0 if before is None else len(before.effects))
    if count > MOST_NAMED:
        raise UnusableInputError(
            "accept.too_many", "a twin holds at most {most} effects, not {count}", most=MOST_NAMED, count=count
        )
    session = read_session(path)
    dataset, known = against_twin(prepare(session, fit, check), before)
    for name in names:
        if name in known:
            raise UnusableInputError("accept.known", "the twin has the effect {effect} already", effect=name)
        if not applicable(dataset, effect(name)):
            raise UnusableInputError(
                "accept.signals", "these records cannot show the effect {effect}: it needs other signals", effect=name
            )
    search = Search(dataset, people, names, progress, cancelled)
    baseline = best = search.baseline(known)
    dataset = baseline.fit.parameters.dataset
    for name in names:
        tried = Search(dataset, people, [name], progress, cancelled).add_to([best])
        if not tried:
            raise UnusableInputError(
                "accept.no_trace", "these records hold no trace of the effect {effect}", effect=name
            )
        best = tried[0]
    return twin_file_of(
        best, twin_name, session_id=session.session_id, verdict="by hand", closed=_closed(baseline, best), before=before
    )


def _closed(baseline: Candidate, best: Candidate) -> float:
    quiet = quiet_tests(baseline.fit.parameters.dataset.tests)
    return closed(gap(baseline.checked_by, quiet), gap(best.checked_by, quiet), floor(baseline.checked_by, quiet))
