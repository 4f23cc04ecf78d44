"""``tissueid gap``: diagnose differences between simulation and recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

gap = typer.Typer(help="Diagnose the gap between simulation and recording.", no_args_is_help=True)

Session = Annotated[Path, typer.Argument(metavar="SESSION", help="a session file")]
Fit = Annotated[str, typer.Option(metavar="N,...", help="tests to fit; default: chosen automatically")]
Check = Annotated[str, typer.Option(metavar="N,...", help="tests to hold out; default: chosen automatically")]
Twin = Annotated[Path | None, typer.Option("--twin", metavar="FILE", help="saved twin to start from")]
Workers = Annotated[
    int | None, typer.Option(min=1, max=64, metavar="N", help="number of processes; default: one per core")
]
JsonFile = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="write the result as JSON; - prints it")]


@gap.command("diagnose")
def diagnose_command(
    session: Session,
    fit: Fit = "",
    check: Check = "",
    out: Annotated[Path | None, typer.Option(metavar="PAGE", help="write the report, one HTML page")] = None,
    twin: Twin = None,
    twin_out: Annotated[Path | None, typer.Option("--twin-out", metavar="FILE", help="save the resulting twin")] = None,
    workers: Workers = None,
    json_file: JsonFile = None,
) -> None:
    """Locate the gap of a session and name its cause.

    Also reports how far the effect closes the gap on held-out data.
    """
    from tissueid.cli.gap_diagnosis import diagnose_session

    diagnose_session(session, fit, check, out, twin, twin_out, workers, json_file)


@gap.command("batch")
def batch_command(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="a folder of session files")],
    json_file: Annotated[Path, typer.Option("--json", metavar="FILE", help="write the results by file name")],
    workers: Workers = None,
) -> None:
    """Diagnose every session of a folder.

    For a file that cannot be used, the result is the reason.
    """
    from tissueid.cli.gap_diagnosis import diagnose_folder

    diagnose_folder(folder, json_file, workers)


@gap.command("accept")
def accept_command(
    session: Session,
    out: Annotated[Path, typer.Option("--out", metavar="TWIN.toml", help="the twin to write")],
    effects: Annotated[
        list[str] | None, typer.Option("--effect", metavar="NAME", help="effect to accept; may be repeated")
    ] = None,
    name: Annotated[
        str | None, typer.Option(metavar="TEXT", help="name of the twin; default: that of the file")
    ] = None,
    twin: Twin = None,
    fit: Fit = "",
    check: Check = "",
    workers: Workers = None,
    yes: Annotated[bool, typer.Option("--yes", help="accept all members of a combination, and do not ask")] = False,
    json_file: JsonFile = None,
) -> None:
    """Save a twin with diagnosed or given effects.

    At a terminal you choose among the effects of a combination.
    """
    from tissueid.cli.gap_accept import run_accept

    run_accept(session, out, effects or [], name, twin, fit, check, workers, json_file, yes=yes)


@gap.command("effects")
def effects_command(json_file: JsonFile = None) -> None:
    """List the effects that a diagnosis can name."""
    from tissueid.cli.gap_effects import list_effects

    list_effects(json_file)


@gap.command("blind-check")
def blind_check_command(
    n: Annotated[
        int | None, typer.Option("--n", min=1, max=5000, metavar="N", help="number of scenarios; default: 40")
    ] = None,
    seed: Annotated[
        int | None, typer.Option("--seed", min=0, help="seed of the scenarios, default 1; unknown to the diagnosis")
    ] = None,
    full_share: Annotated[
        float | None,
        typer.Option(
            "--full-share", min=0.0, max=1.0, help="share of full sessions, default 0.3; the others are single tests"
        ),
    ] = None,
    take_out: Annotated[bool, typer.Option("--take-out", help="repeat without the true effect in the library")] = False,
    keep: Annotated[
        Path | None, typer.Option(metavar="DIR", help="keep recordings, labels and answers in this folder")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="continue the interrupted check in the folder of --keep")
    ] = False,
    out: Annotated[Path | None, typer.Option("--out", metavar="PAGE", help="write the report, one HTML page")] = None,
    workers: Workers = None,
    json_file: JsonFile = None,
) -> None:
    """Score the diagnosis on scenarios with sealed labels.

    The scenarios are simulated. The labels stay sealed until all scenarios are diagnosed.
    """
    from tissueid.cli.gap_blind import BlindPlan, run_blind_check

    run_blind_check(BlindPlan(n, seed, full_share, workers, take_out, keep, resume, out, json_file))
