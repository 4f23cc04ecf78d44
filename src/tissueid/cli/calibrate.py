"""``tissueid calibrate``: calibrate instruments, and list and show calibrations."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

calibrate = typer.Typer(help="Calibrate an instrument; list and show calibrations.", no_args_is_help=True)

JsonFile = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="write the result as JSON; - prints it")]
DeviceUrl = Annotated[str, typer.Option("--device", metavar="URL", help="see 'tissueid devices'")]
OutFile = Annotated[
    Path | None,
    typer.Option(
        "--out", metavar="FILE", help="calibration file to write, TOML; default: a new file in the calibration folder"
    ),
]
Folder = Annotated[
    Path | None,
    typer.Option("--calibrations", metavar="DIR", help="calibration folder; default: your own (see 'list')"),
]
ReportFile = Annotated[Path | None, typer.Option("--report", metavar="FILE", help="write the report, one HTML page")]


@calibrate.command()
def static(
    device: DeviceUrl,
    out: OutFile = None,
    report: ReportFile = None,
    steps: Annotated[
        str | None, typer.Option("--steps", metavar="A,B", help="only these steps; an unknown name lists all")
    ] = None,
    spring: Annotated[
        float | None,
        typer.Option(
            "--spring", metavar="N/M", help="stiffness of the calibration spring; default: the value of the device"
        ),
    ] = None,
    spring_uncertainty: Annotated[
        float | None,
        typer.Option(
            "--spring-uncertainty", metavar="PERCENT", min=0, max=50, help="relative uncertainty of the stiffness"
        ),
    ] = None,
    weight: Annotated[
        list[float] | None, typer.Option("--weight", metavar="GRAMS", help="a known weight; may be repeated")
    ] = None,
    gauge: Annotated[
        list[float] | None,
        typer.Option("--gauge", metavar="MM", help="height of a gauge block, if there is no stage; three or more"),
    ] = None,
    ambient: Annotated[float | None, typer.Option("--ambient", metavar="DEGC", help="room temperature")] = None,
    orientations: Annotated[
        int, typer.Option("--orientations", min=1, max=2, help="2: also upside down, for the zero of the accelerometer")
    ] = 1,
    in_place: Annotated[
        bool, typer.Option("--in-place", help="the spring is under the probe; skip steps that need a person")
    ] = False,
    push_only: Annotated[
        bool, typer.Option("--push-only", help="the probe pushes on the spring and is not fixed to it")
    ] = False,
    repeats: Annotated[int, typer.Option("--repeats", min=1, max=100, help="number of runs")] = 1,
    valid_days: Annotated[int, typer.Option("--valid-days", min=1, max=3650, help="validity in days")] = 90,
    json_file: JsonFile = None,
) -> None:
    """Calibrate channels, force constant and range of motion.

    Scales and zeros: voltage to current to force, position, temperature, acceleration.
    """
    from tissueid.cli.calibrate_static import StaticOptions, run_static

    options = StaticOptions(
        steps=steps,
        spring_n_per_m=spring,
        spring_percent=spring_uncertainty,
        weights_g=tuple(weight or ()),
        gauges_mm=tuple(gauge or ()),
        ambient_c=ambient,
        orientations=orientations,
        in_place=in_place,
        push_only=push_only,
        repeats=repeats,
        valid_days=valid_days,
    )
    run_static(device, out, report, json_file, options)


@calibrate.command()
def sweep(
    out: OutFile = None,
    device: Annotated[str | None, typer.Option("--device", metavar="URL", help="see 'tissueid devices'")] = None,
    report: ReportFile = None,
    first: Annotated[float, typer.Option("--from", metavar="MM", help="first position on the stroke")] = 2.0,
    last: Annotated[float, typer.Option("--to", metavar="MM", help="last position")] = 30.0,
    step: Annotated[float, typer.Option("--step", metavar="MM", help="distance between positions")] = 2.0,
    seconds: Annotated[float, typer.Option("--seconds", metavar="S", help="length of the test at each position")] = 4.0,
    swing: Annotated[float, typer.Option("--swing", metavar="MM", help="largest amplitude to either side")] = 2.5,
    repeats: Annotated[int, typer.Option("--repeats", metavar="N", help="number of sweeps")] = 1,
    seed: Annotated[int, typer.Option("--seed", min=0, max=2**31 - 1, help="seed of the noise")] = 1,
    spring: Annotated[
        float | None,
        typer.Option(
            "--spring", metavar="N/M", help="stiffness of the calibration spring; default: the value of the device"
        ),
    ] = None,
    spring_uncertainty: Annotated[
        float | None,
        typer.Option("--spring-uncertainty", metavar="PERCENT", help="relative uncertainty of the stiffness"),
    ] = None,
    spring_mass: Annotated[float, typer.Option("--spring-mass", metavar="GRAMS", help="mass of the spring")] = 18.0,
    session: Annotated[
        Path | None, typer.Option("--session", metavar="FILE", help="save all recordings as a session")
    ] = None,
    kept: Annotated[
        Path | None, typer.Option("--kept", metavar="SESSION", help="analyse a saved sweep, without a device")
    ] = None,
    folder: Folder = None,
    valid_days: Annotated[int, typer.Option("--valid-days", min=1, max=3650, help="validity in days")] = 90,
    json_file: JsonFile = None,
) -> None:
    """Find the linear region of the coil by a dynamic sweep.

    The calibration spring and the force constant are identified at each position of the stroke.
    """
    from tissueid.cli.calibrate_sweep import SweepOptions, run_sweep

    options = SweepOptions(
        first_mm=first,
        last_mm=last,
        step_mm=step,
        seconds=seconds,
        swing_mm=swing,
        repeats=repeats,
        seed=seed,
        spring_n_per_m=spring,
        spring_percent=spring_uncertainty,
        spring_g=spring_mass,
        session=session,
        kept=kept,
        folder=folder,
        valid_days=valid_days,
    )
    run_sweep(device, out, report, json_file, options)


@calibrate.command(name="list")
def list_known(
    folder: Folder = None,
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
    report: ReportFile = None,
    json_file: JsonFile = None,
) -> None:
    """Show one calibration: instrument, date, verdict, all values."""
    from tissueid.cli.calibrate_list import show_calibration

    show_calibration(file, report, json_file)
