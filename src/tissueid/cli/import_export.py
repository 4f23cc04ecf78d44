"""Options of ``tissueid import`` and ``tissueid export``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

_JsonFile = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="write the result as JSON; - prints it")]
_EACH = "; once for all tests, or once for each in order"


def import_command(
    files: Annotated[
        list[str],
        typer.Argument(
            metavar="FILE[@FIRST:LAST]...",
            help="CSV, MAT or LVM file, one test each; rows from 0, LAST excluded, negative rows count from the end",
            show_default=False,
        ),
    ],
    out: Annotated[Path, typer.Option("--out", metavar="SESSION", help="new session file; never overwritten")],
    mapping: Annotated[
        list[str] | None,
        typer.Option(
            "--map",
            metavar="ROLE=COLUMN:UNIT",
            help="which column is which signal: time, force, position, command, voltage, current, temperature, "
            "or input and output of another system. COLUMN is a name, or a number from 1; "
            "without UNIT, the file must contain it",
        ),
    ] = None,
    rate: Annotated[
        float | None, typer.Option("--rate", metavar="HZ", help="sample rate of a file without times")
    ] = None,
    resample: Annotated[
        float | None, typer.Option("--resample", metavar="HZ", help="interpolate irregular times to this rate")
    ] = None,
    kind: Annotated[
        list[str] | None,
        typer.Option(
            "--kind", metavar="KIND", help=f"stochastic, quiet, slow_ramp, step_hold, spring or free_air{_EACH}"
        ),
    ] = None,
    site: Annotated[
        list[str] | None, typer.Option("--site", metavar="TEXT", help=f"site on the body, or material{_EACH}")
    ] = None,
    configuration: Annotated[
        list[str] | None,
        typer.Option("--configuration", metavar="NAME", help=f"indentation, extension or surface{_EACH}"),
    ] = None,
    preload: Annotated[
        list[float] | None,
        typer.Option("--preload", metavar="SECONDS", help=f"length of the preload at the beginning{_EACH}"),
    ] = None,
    surface: Annotated[
        list[float] | None,
        typer.Option("--surface", metavar="METRE", help=f"position of the tissue surface{_EACH}"),
    ] = None,
    subject: Annotated[
        str | None, typer.Option("--subject", metavar="PSEUDONYM", help="pseudonym, never a name")
    ] = None,
    instrument: Annotated[
        list[str] | None,
        typer.Option(
            "--instrument",
            metavar="KEY=VALUE",
            help="a value of the instrument in SI units, such as moving_mass_kg=0.06",
        ),
    ] = None,
    json_file: _JsonFile = None,
) -> None:
    """Import CSV, MAT or LVM files as a session. Files of 'tissueid export' need no --map."""
    from tissueid.cli.importing import ImportPlan, run_import

    run_import(
        ImportPlan(
            files=tuple(files),
            out=out,
            mapping=tuple(mapping or ()),
            rate_hz=rate,
            resample_hz=resample,
            kinds=tuple(kind or ()),
            sites=tuple(site or ()),
            configurations=tuple(configuration or ()),
            preloads_s=tuple(preload or ()),
            surfaces_m=tuple(surface or ()),
            subject=subject,
            instrument=tuple(instrument or ()),
            json_file=json_file,
        )
    )


def export_command(
    session: Annotated[Path, typer.Argument(metavar="SESSION", help="session file")],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="new or empty folder")],
    kind: Annotated[str, typer.Option("--format", metavar="NAME", help="csv, mat or parquet")],
    json_file: _JsonFile = None,
) -> None:
    """Export a session for other programs, one file per test.

    The attributes of each test are written as JSON next to it.
    """
    from tissueid.cli.importing import run_export

    run_export(session, out, kind, json_file)
