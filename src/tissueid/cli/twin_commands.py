"""``tissueid twin``: saved twins."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

twin = typer.Typer(help="Show saved twins.", no_args_is_help=True)

JsonFile = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="write the result as JSON; - prints it")]


@twin.command("show")
def show_command(
    file: Annotated[Path, typer.Argument(metavar="TWIN.toml", help="a saved twin")], json_file: JsonFile = None
) -> None:
    """Show a twin: values, effects and origin."""
    from tissueid.cli.twin_output import show_twin

    show_twin(file, json_file)


@twin.command("list")
def list_command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="folder; default: the current one")] = Path(),
    json_file: JsonFile = None,
) -> None:
    """List the twins in a folder; other files are ignored."""
    from tissueid.cli.twin_output import list_twins

    list_twins(folder, json_file)
