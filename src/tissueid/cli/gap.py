"""``tissueid gap``: diagnose differences between simulation and recording."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tissueid.cli.lazy_command import JsonFile, add_command

if TYPE_CHECKING:  # plans are imported when their command is used
    from tissueid.procedures.gap_plans import AcceptPlan, DiagnosisPlan, FolderPlan, WatchPlan

gap = typer.Typer(help="Diagnose the gap between simulation and recording.", no_args_is_help=True)


@add_command(gap, "diagnose", "gap_plans")
def diagnose_command(plan: DiagnosisPlan, json_file: JsonFile = None) -> None:
    """Locate the gap of a session and name its cause.

    Also reports how far the effect closes the gap on held-out data.
    """
    from tissueid.cli.gap_diagnosis import run_diagnose

    run_diagnose(plan, json_file)


@add_command(gap, "batch", "gap_plans")
def batch_command(
    plan: FolderPlan,
    json_file: Annotated[Path, typer.Option("--json", metavar="FILE", help="write the results by file name")],
) -> None:
    """Diagnose every session of a folder.

    For a file that cannot be used, the result is the reason. After a kill the same command continues.
    """
    from tissueid.cli.gap_diagnosis import run_batch

    run_batch(plan, json_file)


@add_command(gap, "watch", "gap_plans")
def watch_command(plan: WatchPlan, json_file: JsonFile = None) -> None:
    """Show the gap of sessions over time against a twin.

    Names the first session of the folder in which the gap grew, and what grew. After a kill the same command continues.
    """
    from tissueid.cli.gap_watch import run_watch

    run_watch(plan, json_file)


@add_command(gap, "accept", "gap_plans")
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


@add_command(gap, "effects")
def effects_command(json_file: JsonFile = None) -> None:
    """List the effects that a diagnosis can name."""
    from tissueid.cli.gap_effects import list_effects

    list_effects(json_file)
