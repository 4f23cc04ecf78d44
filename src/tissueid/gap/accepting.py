"""Effects accepted into a twin: those that a diagnosis names, or those that a person chooses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from tissueid.errors import UnusableInputError
from tissueid.gap.diagnosis import Diagnosis
from tissueid.gap.named import believing, file_of
from tissueid.gap.observing import observe
from tissueid.gap.scoring import Candidate, closed, floor, gap, quiet_tests
from tissueid.gap.search import Progress, Search, applicable
from tissueid.gap.workers import Crew
from tissueid.instrument.twin_file import MOST_NAMED, TwinFile
from tissueid.sessions import read_session
from tissueid.twin.catalogue import effect


def accepted(found: Diagnosis, name: str, session_id: str, before: TwinFile | None) -> TwinFile:
    """The twin that a diagnosis comes down to.

    Raises:
        UnusableInputError: it found no effect to accept.
    """
    if found.verdict != "effect" or found.best is None:
        said = "there is no gap" if found.verdict == "no_gap" else "no candidate explains the gap"
        raise UnusableInputError(f"nothing to accept: {said}; --effect NAME accepts one all the same")
    probability = found.ranking[0].probability if found.ranking else None
    return file_of(
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
    people: Crew,
    progress: Callable[[Progress], None],
    fit: Sequence[int] = (),
    check: Sequence[int] = (),
    cancelled: Callable[[], bool] = lambda: False,
) -> TwinFile:
    """Fit a session with the effects that a person names, and make a twin of it.

    Raises:
        UnusableInputError: an effect does not exist, cannot be told from these records, or leaves no trace in them.
    """
    if twice := [name for place, name in enumerate(names) if name in names[:place]]:
        raise UnusableInputError(f"the effect {twice[0]} is named twice")
    count = len(names) + (0 if before is None else len(before.effects))
    if count > MOST_NAMED:
        raise UnusableInputError(f"a twin holds at most {MOST_NAMED} effects, not {count}")
    session = read_session(path)
    observed = observe(session, fit, check)
    known: tuple[str, ...] = ()
    if before is not None:
        observed, known = believing(observed, before.twin), before.twin.effects
    for name in names:
        if name in known:
            raise UnusableInputError(f"the twin has the effect {name} already")
        if not applicable(observed, effect(name)):
            raise UnusableInputError(f"these records cannot tell the effect {name}: it needs other signals")
    search = Search(observed, people, names, progress, cancelled)
    baseline = best = search.baseline(known)
    observed = baseline.fit.parameters.observed
    for name in names:
        tried = Search(observed, people, [name], progress, cancelled).partners(best, [best])
        if not tried:
            raise UnusableInputError(f"these records hold no trace of the effect {name}")
        best = tried[0]
    return file_of(
        best, twin_name, session_id=session.session_id, verdict="by hand", closed=_closed(baseline, best), before=before
    )


def _closed(baseline: Candidate, best: Candidate) -> float:
    quiet = quiet_tests(baseline.fit.parameters.observed.tests)
    return closed(gap(baseline.checked_by, quiet), gap(best.checked_by, quiet), floor(baseline.checked_by, quiet))
