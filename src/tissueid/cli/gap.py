"""``tissueid gap``: where simulated and recorded differ, which effect causes it, and how far it shrinks with that."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

gap = typer.Typer(help="Diagnose the gap between the simulated and the recorded.", no_args_is_help=True)

Session = Annotated[Path, typer.Argument(metavar="SESSION", help="a session file")]
Fit = Annotated[str, typer.Option(metavar="N,...", help="tests to fit; chosen without it")]
Check = Annotated[str, typer.Option(metavar="N,...", help="tests to hold out; chosen without it")]
Twin = Annotated[Path | None, typer.Option("--twin", metavar="FILE", help="a saved twin to begin with")]
Workers = Annotated[int | None, typer.Option(min=1, max=64, metavar="N", help="processes; one a core without it")]
JsonFile = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="write the answer as JSON; - prints it")]


@gap.command("diagnose")
def diagnose_command(
    session: Session,
    fit: Fit = "",
    check: Check = "",
    out: Annotated[Path | None, typer.Option(metavar="PAGE", help="write the report, one HTML page")] = None,
    twin: Twin = None,
    twin_out: Annotated[
        Path | None, typer.Option("--twin-out", metavar="FILE", help="save the twin it ends in")
    ] = None,
    workers: Workers = None,
    json_file: JsonFile = None,
) -> None:
    """Where the gap of a session lies, and which effect causes it.

    And how far it shrinks once that is added.
    """
    from tissueid.cli.gap_diagnosis import diagnose_session

    diagnose_session(session, fit, check, out, twin, twin_out, workers, json_file)


@gap.command("batch")
def batch_command(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="a folder of session files")],
    json_file: Annotated[Path, typer.Option("--json", metavar="FILE", help="answers by file name")],
    workers: Workers = None,
) -> None:
    """Diagnose every session of a folder.

    A file that cannot be used is answered by the reason.
    """
    from tissueid.cli.gap_diagnosis import diagnose_folder

    diagnose_folder(folder, json_file, workers)


@gap.command("accept")
def accept_command(
    session: Session,
    out: Annotated[Path, typer.Option("--out", metavar="TWIN.toml", help="the twin to write")],
    effects: Annotated[
        list[str] | None, typer.Option("--effect", metavar="NAME", help="accept this one; may be repeated")
    ] = None,
    name: Annotated[str | None, typer.Option(metavar="TEXT", help="name of the twin; that of the file")] = None,
    twin: Twin = None,
    fit: Fit = "",
    check: Check = "",
    workers: Workers = None,
    json_file: JsonFile = None,
) -> None:
    """Put what a diagnosis finds into a twin that is saved.

    Or the effect that you name.
    """
    from tissueid.cli.gap_accept import run_accept

    run_accept(session, out, effects or [], name, twin, fit, check, workers, json_file)


@gap.command("blind-check")
def blind_check_command(
    n: Annotated[int | None, typer.Option("--n", min=1, max=5000, metavar="N", help="scenarios; 40 without it")] = None,
    seed: Annotated[
        int | None, typer.Option("--seed", min=0, help="of the draw, 1 without it; keep it from whoever diagnoses")
    ] = None,
    full_share: Annotated[
        float | None,
        typer.Option(
            "--full-share", min=0.0, max=1.0, help="share of full sessions, 0.3 without it; the others are one test"
        ),
    ] = None,
    take_out: Annotated[
        bool, typer.Option("--take-out", help="once more with the true effect taken out of the library")
    ] = False,
    keep: Annotated[Path | None, typer.Option(metavar="DIR", help="keep recordings, labels and answers here")] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="go on with the check that was interrupted in the folder of --keep")
    ] = False,
    out: Annotated[Path | None, typer.Option("--out", metavar="PAGE", help="write the report, one HTML page")] = None,
    workers: Workers = None,
    json_file: JsonFile = None,
) -> None:
    """Score the diagnosis on scenarios with sealed labels.

    They are of the simulated laboratory, and stay sealed until it has answered.
    """
    from tissueid.cli.gap_blind import BlindPlan, run_blind_check

    run_blind_check(BlindPlan(n, seed, full_share, workers, take_out, keep, resume, out, json_file))
