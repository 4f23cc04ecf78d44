"""``tissueid gap``: diagnose differences between simulation and recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tissueid.cli.plan_command import plan_command
from tissueid.procedures.gap_plans import AcceptPlan, DiagnosisPlan, FolderPlan

gap = typer.Typer(help="Diagnose the gap between simulation and recording.", no_args_is_help=True)

Workers = Annotated[
    int | None, typer.Option(min=1, max=64, metavar="N", help="number of processes; default: one per core")
]
JsonFile = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="write the result as JSON; - prints it")]


@gap.command("diagnose")
@plan_command
def diagnose_command(plan: DiagnosisPlan, json_file: JsonFile = None) -> None:
    """Locate the gap of a session and name its cause.

    Also reports how far the effect closes the gap on held-out data.
    """
    from tissueid.cli.gap_diagnosis import run_diagnose

    run_diagnose(plan, json_file)


@gap.command("batch")
@plan_command
def batch_command(
    plan: FolderPlan,
    json_file: Annotated[Path, typer.Option("--json", metavar="FILE", help="write the results by file name")],
) -> None:
    """Diagnose every session of a folder.

    For a file that cannot be used, the result is the reason.
    """
    from tissueid.cli.gap_diagnosis import run_batch

    run_batch(plan, json_file)


@gap.command("accept")
@plan_command
def accept_command(
    plan: AcceptPlan,
    yes: Annotated[bool, typer.Option("--yes", help="accept all members of a combination, and do not ask")] = False,
    json_file: JsonFile = None,
) -> None:
    """Save a twin with diagnosed or given effects.

    At a terminal you choose among the effects of a combination.
    """
    from tissueid.cli.gap_accept import run_accept

    run_accept(plan, json_file, yes=yes)


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
