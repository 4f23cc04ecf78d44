"""``tissueid calibrate``: calibrate instruments, and list and show calibrations."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from tissueid.cli.lazy_command import JsonFile, add_command

if TYPE_CHECKING:  # plans are imported when their command is used
    from tissueid.procedures.calibration_plans import DynamicSweepPlan, StaticCalibrationPlan
    from tissueid.procedures.calibration_queries import CalibrationListPlan, ShowCalibrationPlan

calibrate = typer.Typer(help="Calibrate an instrument; list and show calibrations.", no_args_is_help=True)


@add_command(calibrate, "static", "calibration_plans")
def static(plan: StaticCalibrationPlan, json_file: JsonFile = None) -> None:
    """Calibrate channels, force constant and range of motion.

    Scales and zeros: voltage to current to force, position, temperature, acceleration.
    """
    from tissueid.cli.calibrate_static import print_static_calibration

    print_static_calibration(plan, json_file)


@add_command(calibrate, "sweep", "calibration_plans")
def sweep(plan: DynamicSweepPlan, json_file: JsonFile = None) -> None:
    """Find the linear region of the coil by a dynamic sweep.

    The calibration spring and the force constant are identified at each position of the stroke.
    """
    from tissueid.cli.calibrate_sweep import print_sweep

    print_sweep(plan, json_file)


@add_command(calibrate, "list", "calibration_queries")
def list_command(plan: CalibrationListPlan, json_file: JsonFile = None) -> None:
    """List calibrations, newest first.

    Marks the newest of each kind that passed.
    """
    from tissueid.cli.calibrate_list import print_calibrations

    print_calibrations(plan, json_file)


@add_command(calibrate, "show", "calibration_queries")
def show_command(plan: ShowCalibrationPlan, json_file: JsonFile = None) -> None:
    """Show one calibration: instrument, date, verdict, all values."""
    from tissueid.cli.calibrate_list import print_calibration

    print_calibration(plan, json_file)
