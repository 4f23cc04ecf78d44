"""What ``tissueid gap accept`` does: a diagnosis, or a person, puts effects into a twin that is saved."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from tissueid.cli.logged import noted
from tissueid.cli.output import check_different, check_json, progress_bars
from tissueid.cli.twin_tables import tell
from tissueid.gap import crew
from tissueid.gap.accepting import accept_named, accepted
from tissueid.gap.search import Progress
from tissueid.instrument.twin_file import check_twin_writable, read_twin, write_twin
from tissueid.sessions import read_session


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
            with crew(workers) as people:
                content = accept_named(session, effects, called, saved, people, _shown(show), *chosen)
        else:
            read = read_session(session)
            found = run_diagnose(read, fit, check, workers, show, twin=saved)
            content = accepted(found, called, read.session_id, saved)
        write_twin(out, content)
    made = {"file": out.name, "name": content.name, "version": content.version}
    made |= {"effects": [item.name for item in content.effects]}
    noted("researcher", "twin.accepted", subject=content.source.session_id, new=made)
    tell(out, content, json_file)


def _shown(show: Callable[[str, float], None]) -> Callable[[Progress], None]:
    return lambda step: show(step.what, step.done / max(step.total, 1))
