"""``tissueid gap``: where simulated and recorded differ, which effect causes it, and how far it shrinks with that."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.table import Table

from tissueid.cli.output import check_json, check_output, people_read, progress_bars, table, write_json
from tissueid.cli.twins import accept_command, accepted
from tissueid.errors import CancelledError, UnusableInputError
from tissueid.gap import Diagnosis, as_answer, crew, diagnose, observe
from tissueid.gap.named import believing
from tissueid.gap.search import Progress
from tissueid.instrument.twin_file import TwinFile, check_twin_writable, read_twin, write_twin
from tissueid.sessions import read_session
from tissueid.wording import MISSING

gap = typer.Typer(help="Diagnose the gap between the simulated and the recorded.", no_args_is_help=True)

Workers = Annotated[int | None, typer.Option(min=1, max=64, metavar="N", help="processes; one a core without it")]
JsonFile = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="write the answer as JSON; - prints it")]
VERDICTS = {
    "effect": "an effect that the twin does not model explains the gap",
    "no_gap": "nothing stands above the noise: the twin is as good as this recording can tell",
    "unexplained": "there is a gap, and no candidate explains it",
}


def run_diagnose(
    path: Path,
    fit: str,
    check: str,
    workers: int | None,
    show: Callable[[str, float], None],
    twin: TwinFile | None = None,
) -> Diagnosis:
    """Diagnose one session, showing progress; ``twin`` is a saved one to begin with.

    Raises:
        UnusableInputError: the session cannot be read or used.
    """
    observed = observe(read_session(path), _numbers("--fit", fit), _numbers("--check", check))
    known: tuple[str, ...] = ()
    if twin is not None:
        observed, known = believing(observed, twin.twin), twin.twin.effects
    with crew(workers) as people:
        return diagnose(observed, people, known=known, progress=lambda step: show(*_bar(step)))


def _bar(step: Progress) -> tuple[str, float]:
    return step.what, step.done / max(step.total, 1)


def _numbers(option: str, text: str) -> tuple[int, ...]:
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


@gap.command("diagnose")
def diagnose_command(
    session: Annotated[Path, typer.Argument(metavar="SESSION", help="a session file")],
    fit: Annotated[str, typer.Option(metavar="N,...", help="tests to fit; chosen without it")] = "",
    check: Annotated[str, typer.Option(metavar="N,...", help="tests to hold out; chosen without it")] = "",
    out: Annotated[Path | None, typer.Option(metavar="PAGE", help="write the report, one HTML page")] = None,
    twin: Annotated[Path | None, typer.Option(metavar="FILE", help="a saved twin to begin with")] = None,
    twin_out: Annotated[
        Path | None, typer.Option("--twin-out", metavar="FILE", help="save the twin it ends in")
    ] = None,
    workers: Workers = None,
    json_file: JsonFile = None,
) -> None:
    """Where the gap of a session lies, which effect causes it, and how far it shrinks once that is added."""
    check_json(json_file)
    check_output(out, ("<!",))
    if twin_out is not None:
        check_twin_writable(twin_out)
    saved = None if twin is None else read_twin(twin)
    with interruptible(), progress_bars() as show:
        found = run_diagnose(session, fit, check, workers, show, saved)
        if out is not None:
            from tissueid.reports.gap import write_gap_report

            write_gap_report(found, out)
    console = people_read(json_file)
    for line in in_words(found):
        console.print(line, markup=False)
    console.print(ranking_table(found))
    if json_file is not None:
        write_json(json_file, as_answer(found))
    if out is not None:
        console.print(f"report: {out}", markup=False)
    if twin_out is not None:
        called = saved.name if saved is not None else twin_out.stem
        write_twin(twin_out, accepted(found, called, read_session(session).session_id, saved))
        console.print(f"twin: {twin_out}", markup=False)


gap.command("accept")(accept_command)


@gap.command("batch")
def batch_command(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="a folder of session files")],
    json_file: Annotated[Path, typer.Option("--json", metavar="FILE", help="answers by file name")],
    workers: Workers = None,
) -> None:
    """Diagnose every session of a folder; a file that cannot be used is answered by the reason."""
    check_json(json_file)
    files = sorted(folder.glob("*.h5"))
    if not files:
        raise UnusableInputError(f"there are no session files in {folder}")
    answers: dict[str, object] = {}
    console = people_read(json_file)
    with interruptible(), progress_bars() as show:
        for number, path in enumerate(files):
            show(f"session {number + 1} of {len(files)}", number / len(files))
            try:
                found = run_diagnose(path, "", "", workers, lambda what, share: None)
            except UnusableInputError as error:
                answers[path.name] = {"error": str(error)}
                console.print(f"{path.name}: {error}", markup=False)
                continue
            answers[path.name] = as_answer(found)
            console.print(f"{path.name}: {_short(found)}", markup=False)
    write_json(json_file, answers)


@gap.command("blind-check")
def blind_check_command(
    n: Annotated[int, typer.Option("--n", min=1, max=5000, metavar="N", help="scenarios")] = 40,
    seed: Annotated[int, typer.Option("--seed", min=0, help="of the draw; keep it from whoever diagnoses")] = 1,
    full_share: Annotated[
        float, typer.Option("--full-share", min=0.0, max=1.0, help="share of full sessions; the others are one test")
    ] = 0.3,
    take_out: Annotated[
        bool, typer.Option("--take-out", help="once more with the true effect taken out of the library")
    ] = False,
    keep: Annotated[Path | None, typer.Option(metavar="DIR", help="keep recordings and labels here")] = None,
    workers: Workers = None,
    json_file: JsonFile = None,
) -> None:
    """Score the diagnosis on scenarios of the simulated laboratory whose labels are sealed until it has answered."""
    from tissueid.cli.gap_blind import run_blind_check

    check_json(json_file)
    with interruptible():
        run_blind_check(n, seed, full_share, workers, take_out, keep, json_file)


def _short(found: Diagnosis) -> str:
    named = " + ".join(found.combination) or found.verdict.replace("_", " ")
    figures = found.gap
    sure = f", {found.ranking[0].probability:.0%} sure" if found.combination and found.ranking else ""
    return (
        f"{named} (stage {found.where.stage or MISSING}{sure}); gap {figures.before:.2%} to {figures.after:.2%}, "
        f"floor {figures.floor:.2%}, {found.seconds:.0f} s"
    )


def in_words(found: Diagnosis) -> list[str]:
    """The diagnosis in a few lines."""
    figures = found.gap
    lines = [f"{found.verdict}: {VERDICTS[found.verdict]}."]
    lines.append(f"Gap on held-out data: {figures.before:.2%} before; what noise alone leaves is {figures.floor:.2%}.")
    if found.combination:
        low, high = figures.closed_ci
        lines.append(
            f"With {' and '.join(found.combination)}: {figures.after:.2%}, {figures.closed:.0%} of the gap closed "
            f"({low:.0%} to {high:.0%})."
        )
    if np.isfinite(found.ceiling):
        lines.append(
            f"Ceiling: {found.ceiling:.0%}, what a flexible regression closes, or a candidate if that is more."
        )
    if found.verdict != "no_gap":
        lines.append(f"It lies in the stage: {found.where.stage or MISSING}.")
    if found.next_experiment is not None:
        lines.append(f"Next: {found.next_experiment.kind}. {found.next_experiment.why}")
        if found.next_experiment.command_line:
            lines.append(f"      {found.next_experiment.command_line}")
    lines += found.remarks
    return lines


def ranking_table(found: Diagnosis) -> Table:
    """The candidates, best first."""
    rows = table("Candidates", "Effect", "Stage", "Probability", "Closed", "95 %", "Cannot be told from")
    for item in found.ranking:
        low, high = item.closed_ci
        rows.add_row(
            item.effect,
            item.stage,
            f"{item.probability:.1%}",
            f"{item.closed:.0%}",
            f"{low:.0%} to {high:.0%}",
            ", ".join(item.indistinguishable),
        )
    return rows
