"""Commands and their options; each command is implemented in its own module."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tissueid import __version__
from tissueid.cli.audit import audit
from tissueid.cli.audit_records import set_role
from tissueid.cli.calibrate import calibrate
from tissueid.cli.gap import gap
from tissueid.cli.import_export import export_command, import_command
from tissueid.cli.plan_command import plan_command
from tissueid.cli.twin_commands import twin
from tissueid.procedures.comparison import ComparePlan
from tissueid.procedures.demo import DemoPlan
from tissueid.procedures.identification import IdentificationPlan
from tissueid.procedures.recovery import RecoveryPlan
from tissueid.procedures.report import ReportPlan
from tissueid.procedures.test_plan import TestPlan

app = typer.Typer(
    help="Measure living tissue with a voice coil and nonlinear system identification. Research use only.",
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
app.add_typer(calibrate, name="calibrate")
app.add_typer(audit, name="audit")
app.add_typer(gap, name="gap")
app.add_typer(twin, name="twin")
app.command("import")(import_command)
app.command("export")(export_command)

JsonFile = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="write the result as JSON; - prints it")]
DeviceUrl = Annotated[
    str,
    typer.Option(
        "--device", metavar="URL", help="a port, socket://HOST:PORT or simulated://forearm; see 'tissueid devices'"
    ),
]


def _version(requested: bool) -> None:
    if requested:
        typer.echo(f"tissueid {__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def open_window(
    context: typer.Context,
    _version_asked: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="print the version")
    ] = False,
    role: Annotated[
        str | None, typer.Option(metavar="ROLE", help="clinician, researcher or technician, for the audit log")
    ] = None,
) -> int:
    """Open the application if no command is given."""
    if role is not None:
        set_role(role)
    if context.invoked_subcommand is not None:
        return 0
    from tissueid.cli.window import open_application

    return open_application()


@app.command()
@plan_command
def demo(plan: DemoPlan, json_file: JsonFile = None) -> None:
    """Run one guided test on a simulated forearm, without hardware.

    Includes recording, identification and report.
    """
    from tissueid.cli.demo import demonstrate

    demonstrate(plan, json_file)


@app.command()
def devices(
    probe: Annotated[bool, typer.Option("--probe/--no-probe", help="connect to each instrument")] = True,
    json_file: JsonFile = None,
) -> None:
    """List connected and simulated instruments."""
    from tissueid.cli.devices import list_devices

    list_devices(probe, json_file)


@app.command("test")
@plan_command
def run_test(plan: TestPlan, json_file: JsonFile = None) -> None:
    """Run a guided test: placement, preload, stimulus, release."""
    from tissueid.cli.test import run_tests

    run_tests(plan, json_file)


@app.command()
def quality(
    session: Annotated[Path, typer.Argument(metavar="SESSION", help="session file")],
    test: Annotated[int | None, typer.Option("--test", metavar="N", help="one test; default: all")] = None,
    json_file: JsonFile = None,
) -> None:
    """Check the quality of the tests of a saved session.

    The output says which tests to repeat, and why.
    """
    from tissueid.cli.quality import run_quality

    run_quality(session, test, json_file)


@app.command()
def stimulus(
    what: Annotated[
        str | None, typer.Argument(metavar="KIND|FILE", help="a kind or a saved stimulus; default: list the kinds")
    ] = None,
    option: Annotated[
        list[str] | None,
        typer.Option("--option", metavar="NAME=VALUE", help="another option of the kind; may be repeated"),
    ] = None,
    list_options: Annotated[
        bool, typer.Option("--options", help="list the options of the kind with their bounds")
    ] = False,
    min_force: Annotated[float | None, typer.Option(metavar="NEWTON", help="lower end of the force range")] = None,
    max_force: Annotated[float | None, typer.Option(metavar="NEWTON", help="upper end of the force range")] = None,
    min_volts: Annotated[
        float | None, typer.Option(metavar="VOLT", help="lower end of the voltage range, in place of force")
    ] = None,
    max_volts: Annotated[
        float | None, typer.Option(metavar="VOLT", help="upper end of the voltage range, in place of force")
    ] = None,
    seconds: Annotated[float | None, typer.Option(metavar="SECONDS", help="length without preload")] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, max=2**63 - 1, help="seed; the same seed gives the same samples")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="save the stimulus for 'tissueid test'")
    ] = None,
    csv: Annotated[Path | None, typer.Option("--csv", metavar="FILE", help="write the samples as CSV")] = None,
    plot: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE", help="write the figures as .html, .pdf, .png or .svg")
    ] = None,
    device: Annotated[
        str | None,
        typer.Option("--device", metavar="URL", help="instrument that plays it; default: the desktop device"),
    ] = None,
    limits: Annotated[str, typer.Option(help="clinical (12 N) or research (15 N)")] = "clinical",
    json_file: JsonFile = None,
) -> None:
    """Design a stimulus, or check a saved one.

    Prints its properties and the load on the coil, and writes its figures.
    """
    from tissueid.cli.stimulus import run_stimulus
    from tissueid.cli.stimulus_options import CommonOptions
    from tissueid.cli.stimulus_output import Targets

    common = CommonOptions(
        min_force=min_force,
        max_force=max_force,
        min_volts=min_volts,
        max_volts=max_volts,
        seconds=seconds,
        seed=seed,
    )
    targets = Targets(out=out, csv=csv, plot=plot, json=json_file)
    run_stimulus(what, common, option or [], list_options, targets, device, limits)


@app.command()
@plan_command
def identify(plan: IdentificationPlan, json_file: JsonFile = None) -> None:
    """Fit one engine to one saved test, and validate it.

    The validation uses held-out data.
    """
    from tissueid.cli.identify import print_identification

    print_identification(plan, json_file)


@app.command()
def engines(
    engine: Annotated[str | None, typer.Argument(metavar="[ENGINE]", help="engine whose options are listed")] = None,
    json_file: JsonFile = None,
) -> None:
    """List the identification engines, or the options of one."""
    from tissueid.cli.engines import list_engines

    list_engines(engine, json_file)


@app.command()
@plan_command
def compare(plan: ComparePlan, json_file: JsonFile = None) -> None:
    """Fit all engines to one saved test and compare their scores.

    Recommends the description that the test supports.
    """
    from tissueid.cli.compare import compare_session

    compare_session(plan, json_file)


@app.command()
@plan_command
def recover(plan: RecoveryPlan, json_file: JsonFile = None) -> None:
    """Recover a session after a crash.

    All data that had reached the disk is kept.
    """
    from tissueid.cli.recover import recover_session

    recover_session(plan, json_file)


@app.command()
@plan_command
def report(plan: ReportPlan) -> None:
    """Write the report of one saved test as an HTML page.

    The page is self-contained. --pdf adds a short PDF.
    """
    from tissueid.cli.report import report_test

    report_test(plan)
