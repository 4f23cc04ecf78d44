"""What is kept of a diagnosis: a twin, a report, an answer for scripts. All of it off the window's thread."""

from __future__ import annotations

import functools
import json
import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tissueid.app.place_to_save import free_place
from tissueid.app.views.gap.apart import Step, done_apart
from tissueid.app.views.gap.diagnosing import Asked, Result
from tissueid.audit import Trail
from tissueid.errors import UnusableInputError
from tissueid.language import _
from tissueid.sessions import read_session
from tissueid.whole_file import whole_file
from tissueid.wording import clean

if TYPE_CHECKING:
    from tissueid.gap.workers import Crew
    from tissueid.instrument.twin_file import TwinFile

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._-]{0,79}")
_SUFFIX = ".toml"


def why_not_accepted(result: Result) -> str:
    """Why there is nothing to make a twin of; nothing where there is."""
    if result.diagnosis.verdict == "no_gap":
        return _("There is nothing to accept: there is no gap, so the twin may be used as it is.")
    if result.diagnosis.verdict != "effect" or result.diagnosis.best is None:
        return _("There is nothing to accept: no known effect explains the gap.")
    return ""


def accept_into_twin(result: Result, path: Path, trail: Trail, effects: Sequence[str], *, apart: bool) -> str:
    """Save the twin that has the chosen effects, and log it; returns what is to be said.

    Another choice than the diagnosis names is fitted to the session first, as ``tissueid gap accept --effect`` does;
    with ``apart`` in other processes.

    Raises:
        UnusableInputError: nothing was named, the file's name makes no name of a twin, or it cannot be written.
    """
    from tissueid.gap.accepting import accepted
    from tissueid.gap.workers import Alone
    from tissueid.instrument.twin_file import check_twin_writable, write_twin

    found = result.diagnosis
    if why := why_not_accepted(result):
        raise UnusableInputError(why)
    if not effects:
        raise UnusableInputError(_("There is nothing to accept: no effect is chosen."))
    check_twin_writable(path)
    name = path.stem if result.twin is None else result.twin.name
    if _NAME.fullmatch(name) is None:
        raise UnusableInputError(
            _(
                "a twin is called by its file: {name!r} must begin with a letter or digit and have only "
                "letters of the English alphabet, digits, blanks, dots, dashes and underscores"
            ).format(name=clean(name)[:40])
        )
    if set(effects) == set(found.combination):
        content = accepted(found, name, result.session_id, result.twin)
    else:
        work = functools.partial(_fitted, result.asked, result.twin, name, tuple(effects))
        made = done_apart(work, _no_step, _never) if apart else work(_no_step, Alone(), _never)
        assert made is not None
        content = made
    write_twin(path, content)
    new = {"file": path.name, "name": content.name, "version": content.version}
    new |= {"effects": [item.name for item in content.effects]}
    trail.note("twin.accepted", subject=result.session_id, new=new)
    unlogged = trail.settle()
    said = _("The twin {name}, version {version}, is saved in {path}.").format(
        name=content.name, version=content.version, path=path
    )
    return f"{said} {_('It is not in the audit log: {problem}').format(problem=unlogged)}" if unlogged else said


def _fitted(
    asked: Asked,
    twin: TwinFile | None,
    name: str,
    effects: tuple[str, ...],
    step: Step,
    people: Crew,
    cancelled: Callable[[], bool],
) -> TwinFile:
    from tissueid.gap.accepting import accept_named

    return accept_named(
        asked.session, effects, name, twin, people, lambda _: None, asked.fit, asked.check, cancelled=cancelled
    )


def _no_step(_what: str, _done: int, _total: int) -> None:
    """Ignore progress: it takes seconds."""


def _never() -> bool:
    return False


def report_beside(result: Result) -> Path:
    """Write the page of a diagnosis next to its session, never over an earlier one; return its path.

    Raises:
        OSError: it cannot be written there.
        SessionFormatError: the session cannot be read any more.
    """
    from tissueid.reports.gap import Origin, write_gap_report

    session = result.asked.session
    path = free_place(session.with_name(f"{session.stem}-gap.html"))
    write_gap_report(result.diagnosis, path, origin=Origin(read_session(session), session))
    return path


def export_json(result: Result, path: Path) -> Path:
    """Write the answer that ``tissueid gap diagnose --json`` gives, whole or not at all; returns its path.

    Raises:
        OSError: it cannot be written.
    """
    from tissueid.gap import as_answer

    text = json.dumps(_finite(as_answer(result.diagnosis)), indent=2, allow_nan=False) + "\n"
    with whole_file(path) as partial:
        partial.write_text(text, encoding="utf-8")
    return path


def proposed_twin(result: Result, effects: Sequence[str]) -> Path:
    """A file for the twin beside the session: over the one that it improves, or one of a name that is free."""
    if result.asked.twin is not None:
        return result.asked.twin
    folder = result.asked.session.parent
    stem = re.sub(r"[^A-Za-z0-9._-]+", "-", "-".join(effects)).strip("-._") or "twin"
    return free_place(folder / f"{stem}{_SUFFIX}")


def _finite(value: Any) -> Any:
    # What is no number is null, as the command has it.
    if isinstance(value, dict):
        return {str(name): _finite(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value.item() if hasattr(value, "item") else value
