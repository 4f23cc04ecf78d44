"""``tissueid calibrate``: the technician's calibrations, and what is known of the instruments."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

calibrate = typer.Typer(help="Calibrate an instrument, and see which calibrations are in force.", no_args_is_help=True)

JsonFile = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="write the answer as JSON; - prints it")]
DeviceUrl = Annotated[str, typer.Option("--device", metavar="URL", help="see 'tissueid devices'")]
OutFile = Annotated[Path, typer.Option("--out", metavar="FILE", help="calibration to make, TOML")]
ReportFile = Annotated[Path | None, typer.Option("--report", metavar="FILE", help="HTML page with the figures")]


@calibrate.command()
def static(device: DeviceUrl, out: OutFile, report: ReportFile = None, json_file: JsonFile = None) -> None:
    """Voltage to current to force, position along the stroke, temperature, acceleration, range of motion."""
    from tissueid.cli.calibrate_static import run_static

    run_static(device, out, report, json_file)


@calibrate.command()
def sweep(device: DeviceUrl, out: OutFile, report: ReportFile = None, json_file: JsonFile = None) -> None:
    """Identify the calibration spring along the stroke: where the coil is linear, and its force constant there."""
    from tissueid.cli.calibrate_sweep import run_sweep

    run_sweep(device, out, report, json_file)
