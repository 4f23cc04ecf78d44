"""What ``tissueid gap diagnose`` and ``batch`` do, and how they say it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from tissueid.cli.output import (
    check_different,
    check_json,
    check_output,
    check_report,
    people_read,
    progress_bars,
    table,
    write_json,
)
from tissueid.errors import CancelledError, UnusableInputError
from tissueid.gap import Diagnosis, as_answer, crew, diagnose, observe
from tissueid.gap.accepting import accepted
from tissueid.gap.named import believing
from tissueid.gap.search import Progress
from tissueid.gap.statement import headline_of, listed, members_of, percent
from tissueid.gap.workers import Alone
from tissueid.instrument.twin_file import TwinFile, check_twin_writable, read_twin, write_twin
from tissueid.sessions import Session, read_session
from tissueid.twin.effect import STAGE_NAMES
from tissueid.wording import MISSING


def diagnose_session(
    session: Path,
    fit: str,
    check: str,
    out: Path | None,
    twin: Path | None,
    twin_out: Path | None,
    workers: int | None,
    json_file: Path | None,
) -> None:
    """Diagnose a session and leave what was asked for.

    Raises:
        UnusableInputError: the session, the twin or an option cannot be used.
        CancelledError: it was interrupted; nothing was written.
    """
    check_json(json_file)
    check_output(out, ("<!",))
    check_different(json_file, out, twin_out)
    if twin_out is not None:
        check_twin_writable(twin_out)
    saved = None if twin is None else read_twin(twin)
    with interruptible(), progress_bars() as show:
        read = read_session(session)
        check_report(out, read)
        found = run_diagnose(read, fit, check, workers, show, saved)
        if out is not None:
            from tissueid.reports.gap import Origin, write_gap_report

            write_gap_report(found, out, origin=Origin(read, session))
    console = people_read(json_file)
    for line in in_words(found):
        console.print(line, markup=False)
    if listed(found):
        console.print(ranking_table(found))
    if json_file is not None:
        write_json(json_file, as_answer(found))
    if out is not None:
        console.print(f"report: {out}", markup=False)
    if twin_out is not None:
        called = saved.name if saved is not None else twin_out.stem
        write_twin(twin_out, accepted(found, called, read.session_id, saved))
        console.print(f"twin: {twin_out}", markup=False)


def diagnose_folder(folder: Path, json_file: Path, workers: int | None) -> None:
    """Diagnose every session of a folder; a file that cannot be used is answered by the reason.

    Raises:
        UnusableInputError: there are no session files.
        CancelledError: it was interrupted; nothing was written.
    """
    check_json(json_file)
    files = sorted(folder.glob("*.h5"))
    if not files:
        raise UnusableInputError(f"there are no session files in {folder}")
    console = people_read(json_file)
    with interruptible(), progress_bars() as show, crew(workers) as people:
        count = 0

        def done(path: Path) -> None:
            nonlocal count
            count += 1
            show("sessions", count / len(files))

        show("sessions", 0.0)
        answered = people.do(_of_file, files, lambda: False, done)
    for path, (line, _) in zip(files, answered, strict=True):
        console.print(f"{path.name}: {line}", markup=False, soft_wrap=True)
    answers = {path.name: answer for path, (_, answer) in zip(files, answered, strict=True)}
    write_json(json_file, answers)


def _of_file(path: Path) -> tuple[str, dict[str, Any]]:
    # One session in one process: many sessions are done sooner so than each by all.
    try:
        found = diagnose(observe(read_session(path)), Alone())
    except UnusableInputError as error:
        return str(error), {"error": str(error)}
    return _short(found), as_answer(found)


def run_diagnose(
    session: Session,
    fit: str,
    check: str,
    workers: int | None,
    show: Callable[[str, float], None],
    twin: TwinFile | None = None,
) -> Diagnosis:
    """Diagnose one session, showing progress; ``twin`` is a saved one to begin with.

    Raises:
        UnusableInputError: the session cannot be used.
    """
    observed = observe(session, numbers_of("--fit", fit), numbers_of("--check", check))
    known: tuple[str, ...] = ()
    if twin is not None:
        observed, known = believing(observed, twin.twin), twin.twin.effects
    with crew(workers) as people:
        return diagnose(observed, people, known=known, progress=lambda step: show(*_bar(step)))


def _bar(step: Progress) -> tuple[str, float]:
    return step.what, step.done / max(step.total, 1)


def numbers_of(option: str, text: str) -> tuple[int, ...]:
    """Numbers of tests with commas between them.

    Raises:
        UnusableInputError: they are none; names the option.
    """
    try:
        return tuple(int(part) for part in text.split(",") if part.strip())
    except ValueError:
        raise UnusableInputError(f"{option} takes numbers of tests with commas between them, not {text!r}") from None


@contextmanager
def interruptible() -> Iterator[None]:
    """An interrupt from the keyboard ends the work in one line."""
    try:
        yield
    except KeyboardInterrupt:
        raise CancelledError("cancelled; nothing was written") from None


def _short(found: Diagnosis) -> str:
    named = " + ".join(found.combination) or found.verdict.replace("_", " ")
    figures = found.gap
    details = [f"stage {' and '.join(found.at_fault)}"] if found.at_fault else []
    details += [f"{member.effect} {percent(member.probability)} %" for member in members_of(found)]
    about = f" ({', '.join(details)})" if details else ""
    return (
        f"{named}{about}; gap {figures.before:.2%} to {figures.after:.2%}, floor {figures.floor:.2%}, "
        f"{found.seconds:.0f} s"
    )


def in_words(found: Diagnosis) -> list[str]:
    """The diagnosis in a few lines."""
    figures = found.gap
    lines = [f"{headline_of(found)[0]}."]
    lines.append(f"Gap on held-out data: {figures.before:.2%} before; what noise alone leaves is {figures.floor:.2%}.")
    if found.combination:
        lines.append(
            f"With {' and '.join(found.combination)}: {figures.after:.2%}, {figures.closed:.0%} of the gap closed "
            f"({_interval(figures.closed_ci)})."
        )
    if np.isfinite(found.ceiling):
        lines.append(
            f"Ceiling: {found.ceiling:.0%}, what a flexible regression closes, or a candidate if that is more."
        )
    if found.at_fault:
        lines.append(f"It lies in the stage: {' and '.join(STAGE_NAMES[stage] for stage in found.at_fault)}.")
    if found.next_experiment is not None:
        lines.append(f"Next: {found.next_experiment.kind}. {found.next_experiment.why}")
        if found.next_experiment.command_line:
            lines.append(f"      {found.next_experiment.command_line}")
    lines += found.remarks
    return lines


def _interval(of: tuple[float, float]) -> str:
    return f"{of[0]:.0%} to {of[1]:.0%}" if of[0] <= of[1] else MISSING


def _share(of: float) -> str:
    return f"{of:.0%}" if np.isfinite(of) else MISSING


def ranking_table(found: Diagnosis) -> Table:
    """The candidates, best first."""
    rows = table("Candidates", "Effect", "Stage", "Probable", "Closed", "Cannot be told from")
    for column in rows.columns[:4]:
        column.no_wrap = True
    for item in listed(found):
        interval = _interval(item.closed_ci)
        rows.add_row(
            item.effect,
            item.stage,
            f"{item.probability:.1%}" if np.isfinite(item.probability) else MISSING,
            f"{item.closed:.0%} ({interval})" if interval != MISSING else _share(item.closed),
            ", ".join(item.indistinguishable),
        )
    return rows
