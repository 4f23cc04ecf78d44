"""``tissueid gap diagnose`` and ``batch``."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from tissueid.cli.output import check_json, human_output, progress_bars, table, write_json
from tissueid.errors import CancelledError, UnusableInputError
from tissueid.gap import Diagnosis, as_answer, diagnose, executor, prepare
from tissueid.gap.accepting import accepted
from tissueid.gap.search import SearchProgress
from tissueid.gap.statement import headline_of, members_of, ordered_candidates, percent
from tissueid.gap.twin_export import with_prior_twin
from tissueid.gap.workers import SerialExecutor
from tissueid.instrument.twin_file import TwinFile, check_twin_writable, read_twin, write_twin
from tissueid.messages import MISSING
from tissueid.procedures.output_files import check_different, check_output, check_report
from tissueid.sessions import Session, read_session
from tissueid.twin.effect import STAGE_NAMES


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
    """Diagnose a session, print the result and write the requested files.

    Raises:
        UnusableInputError: the session, the twin or an option cannot be used.
        CancelledError: the diagnosis was interrupted; nothing was written.
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
    console = human_output(json_file)
    for line in summary_lines(found):
        console.print(line, markup=False)
    if ordered_candidates(found):
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
    """Diagnose every session of a folder; for a file that cannot be used, the result is the reason.

    Raises:
        UnusableInputError: there are no session files.
        CancelledError: the diagnosis was interrupted; nothing was written.
    """
    check_json(json_file)
    files = sorted(folder.glob("*.h5"))
    if not files:
        raise UnusableInputError(f"there are no session files in {folder}")
    console = human_output(json_file)
    with interruptible(), progress_bars() as show, executor(workers) as pool:
        count = 0

        def done(path: Path) -> None:
            nonlocal count
            count += 1
            show("sessions", count / len(files))

        show("sessions", 0.0)
        answered = pool.do(_of_file, files, lambda: False, done)
    for path, (line, _) in zip(files, answered, strict=True):
        console.print(f"{path.name}: {line}", markup=False, soft_wrap=True)
    answers = {path.name: answer for path, (_, answer) in zip(files, answered, strict=True)}
    write_json(json_file, answers)


def _of_file(path: Path) -> tuple[str, dict[str, Any]]:
    # One process per session is faster than all processes on one session after another.
    try:
        found = diagnose(prepare(read_session(path)), SerialExecutor())
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
    """Diagnose one session and show progress; ``twin`` is a saved twin to start from.

    Raises:
        UnusableInputError: the session cannot be used.
    """
    observed = prepare(session, numbers_of("--fit", fit), numbers_of("--check", check))
    known: tuple[str, ...] = ()
    if twin is not None:
        observed, known = with_prior_twin(observed, twin.twin), twin.twin.effects
    with executor(workers) as pool:
        return diagnose(observed, pool, known=known, progress=lambda step: show(*_bar(step)))


def _bar(step: SearchProgress) -> tuple[str, float]:
    return step.what, step.done / max(step.total, 1)


def numbers_of(option: str, text: str) -> tuple[int, ...]:
    """Return test numbers from a text separated by commas.

    Raises:
        UnusableInputError: the text is something else.
    """
    try:
        return tuple(int(part) for part in text.split(",") if part.strip())
    except ValueError:
        raise UnusableInputError(f"{option} must be test numbers separated by commas, got {text!r}") from None


@contextmanager
def interruptible() -> Iterator[None]:
    """Convert an interrupt from the keyboard to a ``CancelledError``."""
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


def summary_lines(found: Diagnosis) -> list[str]:
    """Return the diagnosis as a few lines."""
    figures = found.gap
    lines = [f"{headline_of(found)[0]}."]
    lines.append(f"Gap on held-out data: {figures.before:.2%}; noise floor {figures.floor:.2%}.")
    if found.combination:
        lines.append(
            f"With {' and '.join(found.combination)}: {figures.after:.2%}, {figures.closed:.0%} of the gap closed "
            f"({_interval(figures.closed_ci)})."
        )
    if np.isfinite(found.ceiling):
        lines.append(f"Ceiling: {found.ceiling:.0%}, closed by a flexible regression or by the best candidate.")
    if found.at_fault:
        lines.append(f"Stage at fault: {' and '.join(STAGE_NAMES[stage] for stage in found.at_fault)}.")
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
    """Return the table of candidates, best first."""
    rows = table("Candidates", "Effect", "Stage", "Probability", "Closed", "Indistinguishable from")
    for column in rows.columns[:4]:
        column.no_wrap = True
    for item in ordered_candidates(found):
        interval = _interval(item.closed_ci)
        rows.add_row(
            item.effect,
            item.stage,
            f"{item.probability:.1%}" if np.isfinite(item.probability) else MISSING,
            f"{item.closed:.0%} ({interval})" if interval != MISSING else _share(item.closed),
            ", ".join(item.indistinguishable),
        )
    return rows
