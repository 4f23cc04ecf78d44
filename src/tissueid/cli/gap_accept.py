"""What ``tissueid gap accept`` does: a diagnosis, or a person, puts effects into a twin that is saved."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from tissueid.cli.logged import noted
from tissueid.cli.output import check_different, check_json, progress_bars
from tissueid.cli.twin_tables import tell
from tissueid.errors import UnusableInputError
from tissueid.gap import Diagnosis, crew
from tissueid.gap.named import believing, file_of
from tissueid.gap.observing import observe
from tissueid.gap.scoring import Candidate, closed, floor, gap, quiet_tests
from tissueid.gap.search import Progress, Search, applicable
from tissueid.instrument.twin_file import MOST_NAMED, TwinFile, check_twin_writable, read_twin, write_twin
from tissueid.sessions import read_session
from tissueid.twin.catalogue import effect


def run_accept(
    session: Path,
    out: Path,
    effects: Sequence[str],
    name: str | None,
    before: Path | None,
    fit: str,
    check: str,
    workers: int | None,
    json_file: Path | None,
) -> None:
    """Save the twin that a diagnosis, or a person, comes down to.

    Raises:
        UnusableInputError: the session, the twin, an effect or an option cannot be used, or there is nothing to accept.
    """
    from tissueid.cli.gap_diagnosis import interruptible, numbers_of, run_diagnose

    check_json(json_file)
    check_different(out, json_file)
    check_twin_writable(out)
    saved = None if before is None else read_twin(before)
    called = name or (saved.name if saved is not None else out.stem)
    with interruptible(), progress_bars() as show:
        if effects:
            chosen = numbers_of("--fit", fit), numbers_of("--check", check)
            content = accept_named(session, effects, called, saved, workers, show, *chosen)
        else:
            read = read_session(session)
            found = run_diagnose(read, fit, check, workers, show, twin=saved)
            content = accepted(found, called, read.session_id, saved)
        write_twin(out, content)
    made = {"file": out.name, "name": content.name, "version": content.version}
    made |= {"effects": [item.name for item in content.effects]}
    noted("researcher", "twin.accepted", subject=content.source.session_id, new=made)
    tell(out, content, json_file)


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
    workers: int | None,
    show: Callable[[str, float], None],
    fit: Sequence[int] = (),
    check: Sequence[int] = (),
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
    with crew(workers) as people:
        search = Search(observed, people, names, lambda step: show(step.what, _share(step)))
        baseline = best = search.baseline(known)
        observed = baseline.fit.parameters.observed
        for name in names:
            search = Search(observed, people, [name], lambda step: show(step.what, _share(step)))
            tried = search.partners(best, [best])
            if not tried:
                raise UnusableInputError(f"these records hold no trace of the effect {name}")
            best = tried[0]
    return file_of(
        best, twin_name, session_id=session.session_id, verdict="by hand", closed=_closed(baseline, best), before=before
    )


def _share(step: Progress) -> float:
    return step.done / max(step.total, 1)


def _closed(baseline: Candidate, best: Candidate) -> float:
    quiet = quiet_tests(baseline.fit.parameters.observed.tests)
    return closed(gap(baseline.checked_by, quiet), gap(best.checked_by, quiet), floor(baseline.checked_by, quiet))
