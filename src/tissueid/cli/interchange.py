"""``tissueid import`` and ``tissueid export``: their options."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

_JsonFile = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="write the answer as JSON; - prints it")]
_EACH = "; once for all tests, or once for each in order"


def import_command(
    files: Annotated[
        list[str],
        typer.Argument(
            metavar="FILE[@FIRST:LAST]...",
            help="CSV, MAT or LVM, a test each; rows from 0, LAST left out, negative ones from the end",
            show_default=False,
        ),
    ],
    out: Annotated[Path, typer.Option("--out", metavar="SESSION", help="session file to make; never overwritten")],
    mapping: Annotated[
        list[str] | None,
        typer.Option(
            "--map",
            metavar="ROLE=COLUMN:UNIT",
            help="which column is which signal: time, force, position, command, voltage, current, temperature, "
            "or input and output of something else. COLUMN by name, or number from 1; "
            "without UNIT, the file must tell it",
        ),
    ] = None,
    rate: Annotated[
        float | None, typer.Option("--rate", metavar="HZ", help="sample rate, where there are no times")
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
        list[str] | None, typer.Option("--site", metavar="TEXT", help=f"where on the body, or which material{_EACH}")
    ] = None,
    configuration: Annotated[
        list[str] | None,
        typer.Option("--configuration", metavar="NAME", help=f"indentation, extension or surface{_EACH}"),
    ] = None,
    preload: Annotated[
        list[float] | None,
        typer.Option("--preload", metavar="SECONDS", help=f"how long the mean load is held before{_EACH}"),
    ] = None,
    surface: Annotated[
        list[float] | None,
        typer.Option("--surface", metavar="METRE", help=f"position at which the tissue begins{_EACH}"),
    ] = None,
    subject: Annotated[str | None, typer.Option("--subject", metavar="PSEUDONYM", help="never a name")] = None,
    instrument: Annotated[
        list[str] | None,
        typer.Option(
            "--instrument", metavar="KEY=VALUE", help="a figure of the instrument, SI, such as moving_mass_kg=0.06"
        ),
    ] = None,
    json_file: _JsonFile = None,
) -> None:
    """Make a session of records from elsewhere: CSV, MAT or LVM. What 'tissueid export' wrote needs no --map."""
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
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="folder to make, or an empty one")],
    kind: Annotated[str, typer.Option("--format", metavar="NAME", help="csv, mat or parquet")],
    json_file: _JsonFile = None,
) -> None:
    """Write a session for other programs, one file a test.

    The attributes of a test are in JSON beside it.
    """
    from tissueid.cli.importing import run_export

    run_export(session, out, kind, json_file)
