"""``tissueid gap``: diagnose differences between simulation and recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tissueid.cli.plan_command import plan_command
from tissueid.procedures.blind_check import BlindCheckPlan
from tissueid.procedures.gap_plans import AcceptPlan, DiagnosisPlan, FolderPlan

gap = typer.Typer(help="Diagnose the gap between simulation and recording.", no_args_is_help=True)

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
@plan_command
def blind_check_command(plan: BlindCheckPlan, json_file: JsonFile = None) -> None:
    """Score the diagnosis on scenarios with sealed labels.

    The scenarios are simulated. The labels stay sealed until all scenarios are diagnosed.
    """
    from tissueid.cli.gap_blind import check_blind

    check_blind(plan, json_file)
