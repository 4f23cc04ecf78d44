"""``tissueid gap accept``: save a twin with the effects of a diagnosis or with given effects."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from tissueid.cli.audit_records import audit_note
from tissueid.cli.output import check_json, console, human_output, progress_bars
from tissueid.cli.twin_output import print_twin
from tissueid.errors import CancelledError, UnusableInputError
from tissueid.gap import Diagnosis, executor
from tissueid.gap.accepting import accept_named, accepted
from tissueid.gap.search import SearchProgress
from tissueid.gap.statement import members_of, percent
from tissueid.instrument.twin_file import TwinFile, check_twin_writable, read_twin, write_twin
from tissueid.procedures.output_files import check_different
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
    *,
    yes: bool = False,
) -> None:
    """Save the twin with the effects of a diagnosis, or with those that are named.

    At a terminal the user is asked which members of a combination to accept, except with ``yes``.

    Raises:
        UnusableInputError: the session, the twin, an effect or an option cannot be used, or there is nothing to accept.
        CancelledError: interrupted, or no member was chosen; nothing was written.
    """
    from tissueid.cli.gap_diagnosis import interruptible, numbers_of, run_diagnose

    check_json(json_file)
    check_different(out, json_file)
    check_twin_writable(out)
    saved = None if before is None else read_twin(before)
    called = name or (saved.name if saved is not None else out.stem)

    def fitted(names: Sequence[str]) -> TwinFile:
        chosen = numbers_of("--fit", fit), numbers_of("--check", check)
        with progress_bars() as show, executor(workers) as pool:
            return accept_named(session, names, called, saved, pool, _shown(show), *chosen)

    with interruptible():
        if effects:
            content = fitted(effects)
        else:
            read = read_session(session)
            with progress_bars() as show:
                found = run_diagnose(read, fit, check, workers, show, twin=saved)
            content = accepted(found, called, read.session_id, saved)
            for line in _odds(found):
                human_output(json_file).print(line, markup=False)
            wanted = found.combination if yes else _chosen(found.combination)
            if wanted != found.combination:
                content = fitted(wanted)
        write_twin(out, content)
    made = {"file": out.name, "name": content.name, "version": content.version}
    made |= {"effects": [item.name for item in content.effects]}
    audit_note("researcher", "twin.accepted", subject=content.source.session_id, new=made)
    print_twin(out, content, json_file)


def _odds(found: Diagnosis) -> list[str]:
    """Return a line for each member of the combination: its probability, and the close rivals with theirs."""
    lines = []
    for number, member in enumerate(members_of(found), 1):
        rivals = ", ".join(f"{name} {percent(share)} %" for name, share in member.rivals)
        share = "unknown" if member.probability != member.probability else f"{percent(member.probability)} %"
        lines.append(f"{number}. {member.effect}: probability {share}{f'; rivals: {rivals}' if rivals else ''}")
    return lines


def _chosen(members: tuple[str, ...]) -> tuple[str, ...]:
    """Ask at the terminal which members of a combination to accept; all of them if there is no terminal.

    Raises:
        UnusableInputError: the answer names something else.
        CancelledError: the input ended.
    """
    if len(members) < 2 or not (sys.stdin.isatty() and sys.stderr.isatty()):
        return members
    console.print("Which effects should the twin have? Numbers separated by commas; Enter selects all.")
    line = sys.stdin.readline()
    if not line:
        raise CancelledError("cancelled; nothing was written")
    numbers = line.replace(",", " ").split()
    if not all(number.isdecimal() and 1 <= int(number) <= len(members) for number in numbers):
        raise UnusableInputError(f"choose numbers from 1 to {len(members)}, not {line.strip()!r}; nothing was written")
    wanted = {int(number) for number in numbers} or set(range(1, len(members) + 1))
    return tuple(member for place, member in enumerate(members, 1) if place in wanted)


def _shown(show: Callable[[str, float], None]) -> Callable[[SearchProgress], None]:
    return lambda step: show(step.what, step.done / max(step.total, 1))
