"""``tissueid twin``: saved twins."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

twin = typer.Typer(help="Twins that a diagnosis left: what is in them.", no_args_is_help=True)

JsonFile = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="write the answer as JSON; - prints it")]


@twin.command("show")
def show_command(
    file: Annotated[Path, typer.Argument(metavar="TWIN.toml", help="a saved twin")], json_file: JsonFile = None
) -> None:
    """What is in a twin: figures, effects, and where it comes from."""
    from tissueid.cli.twin_tables import show_twin

    show_twin(file, json_file)


@twin.command("list")
def list_command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="folder; this one without it")] = Path(),
    json_file: JsonFile = None,
) -> None:
    """The twins in a folder; other files are passed over."""
    from tissueid.cli.twin_tables import list_twins

    list_twins(folder, json_file)
