"""``tissueid twin``: saved twins."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from tissueid.cli.lazy_command import JsonFile, add_command

if TYPE_CHECKING:  # plans are imported when their command is used
    from tissueid.procedures.saved_twins import TwinFolderPlan, TwinPlan

twin = typer.Typer(help="Show saved twins.", no_args_is_help=True)


@add_command(twin, "show", "saved_twins")
def show_command(plan: TwinPlan, json_file: JsonFile = None) -> None:
    """Show a twin: values, effects and origin."""
    from tissueid.cli.twin_output import show_twin

    show_twin(plan, json_file)


@add_command(twin, "list", "saved_twins")
def list_command(plan: TwinFolderPlan, json_file: JsonFile = None) -> None:
    """List the twins in a folder; other files are ignored."""
    from tissueid.cli.twin_output import list_twins

    list_twins(plan, json_file)
