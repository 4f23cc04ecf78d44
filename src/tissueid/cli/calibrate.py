"""``tissueid calibrate``: calibrate instruments, and list and show calibrations."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tissueid.cli.plan_command import plan_command
from tissueid.procedures.calibration_plans import DynamicSweepPlan, StaticCalibrationPlan

calibrate = typer.Typer(help="Calibrate an instrument; list and show calibrations.", no_args_is_help=True)

JsonFile = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="write the result as JSON; - prints it")]


@calibrate.command()
@plan_command
def static(plan: StaticCalibrationPlan, json_file: JsonFile = None) -> None:
    """Calibrate channels, force constant and range of motion.

    Scales and zeros: voltage to current to force, position, temperature, acceleration.
    """
    from tissueid.cli.calibrate_static import print_static_calibration

    print_static_calibration(plan, json_file)


@calibrate.command()
@plan_command
def sweep(plan: DynamicSweepPlan, json_file: JsonFile = None) -> None:
    """Find the linear region of the coil by a dynamic sweep.

    The calibration spring and the force constant are identified at each position of the stroke.
    """
    from tissueid.cli.calibrate_sweep import print_sweep

    print_sweep(plan, json_file)


@calibrate.command(name="list")
def list_known(
    folder: Annotated[
        Path | None,
        typer.Option("--calibrations", metavar="DIR", help="calibration folder; default: your own"),
    ] = None,
    serial: Annotated[
        str | None, typer.Option("--serial", metavar="TEXT", help="only of the instrument with this serial number")
    ] = None,
    json_file: JsonFile = None,
) -> None:
    """List calibrations, newest first.

    Marks the newest of each kind that passed.
    """
    from tissueid.cli.calibrate_list import list_calibrations

    list_calibrations(folder, serial, json_file)


@calibrate.command()
def show(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="a calibration, TOML")],
    report: Annotated[
        Path | None, typer.Option("--report", metavar="FILE", help="write the report, one HTML page")
    ] = None,
    json_file: JsonFile = None,
) -> None:
    """Show one calibration: instrument, date, verdict, all values."""
    from tissueid.cli.calibrate_list import show_calibration

    show_calibration(file, report, json_file)
