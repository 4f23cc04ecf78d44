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
from tissueid.procedures.recovery import RecoveryPlan
from tissueid.procedures.report import ReportPlan

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
Engine = Annotated[
    str | None,
    typer.Option("--engine", metavar="NAME", help="required, such as lms or wiener; without it, lists all engines"),
]
OneTest = Annotated[
    int | None, typer.Option("--test", metavar="N", help="test to fit; default: the first stochastic test")
]
MoreTests = Annotated[
    list[int] | None, typer.Option("--also", metavar="N", help="another test to fit jointly; may be repeated")
]
Validate = Annotated[
    int | None, typer.Option(metavar="N", help="test for validation; default: the last quarter of the test is held out")
]
Input = Annotated[str, typer.Option("--input", metavar="SIGNAL", help="input signal")]
Output = Annotated[str, typer.Option("--output", metavar="SIGNAL", help="output signal")]


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
def run_test(
    device: DeviceUrl,
    site: Annotated[str, typer.Option(metavar="TEXT", help="site on the body, or material")],
    out: Annotated[Path, typer.Option("--out", metavar="SESSION", help="new session file; never overwritten")],
    stimulus: Annotated[
        str | None, typer.Option(metavar="NAME", help="default: noise; 'tissueid stimulus' lists all")
    ] = None,
    option: Annotated[
        list[str] | None,
        typer.Option("--option", metavar="NAME=VALUE", help="another option of the stimulus; may be repeated"),
    ] = None,
    stimulus_file: Annotated[
        Path | None, typer.Option("--stimulus-file", metavar="FILE", help="stimulus saved by 'tissueid stimulus'")
    ] = None,
    distribution: Annotated[
        str | None, typer.Option(help="distribution of amplitudes, such as gaussian (noise) or uniform")
    ] = None,
    min_force: Annotated[
        float | None, typer.Option(metavar="NEWTON", help="lower end of the force range; noise: 0.5")
    ] = None,
    max_force: Annotated[
        float | None, typer.Option(metavar="NEWTON", help="upper end of the force range; noise: 10.5")
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="length after 0.5 s of preload; noise: 4")
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, max=2**31 - 1, help="seed of the stimulus")] = None,
    depth_range: Annotated[
        str | None,
        typer.Option("--depth-range", metavar="MM:MM", help="intended depths below the surface, such as 1:4"),
    ] = None,
    multistep: Annotated[
        int | None,
        typer.Option(
            min=1, max=20, metavar="N", help="up to N tests, each designed from the previous ones for a uniform depth"
        ),
    ] = None,
    target: Annotated[
        float | None,
        typer.Option(min=0.0, max=1.0, help="with --multistep: distance from uniform at which to stop; default: 0.05"),
    ] = None,
    stop_when: Annotated[
        list[str] | None,
        typer.Option(
            "--stop-when",
            metavar="NAME=SHARE",
            help="stop at this relative uncertainty, such as stiffness=0.02",
        ),
    ] = None,
    live: Annotated[bool, typer.Option("--live", help="print the parameters as they converge")] = False,
    repeats: Annotated[int, typer.Option(min=1, max=100, help="number of runs of the test")] = 1,
    rest: Annotated[
        float, typer.Option(min=0, max=600, metavar="SECONDS", help="pause between repeats, to cool the coil")
    ] = 0.0,
    limits: Annotated[str, typer.Option(help="clinical (12 N) or research (15 N)")] = "clinical",
    subject: Annotated[str, typer.Option(metavar="PSEUDONYM", help="pseudonym, never a name")] = "anonymous",
    configuration: Annotated[
        str, typer.Option(metavar="NAME", help="indentation, extension or surface")
    ] = "indentation",
    probe: Annotated[str | None, typer.Option(metavar="NAME", help="probe tip; an unknown name lists all")] = None,
    external_spring: Annotated[
        float,
        typer.Option(
            "--external-spring", metavar="N/M", help="stiffness parallel to the tissue, subtracted; for surface"
        ),
    ] = 0.0,
    calibrations: Annotated[
        Path | None, typer.Option("--calibrations", metavar="DIR", help="folder of calibrations; see 'calibrate list'")
    ] = None,
    calibration: Annotated[bool, typer.Option(help="use the newest calibration")] = True,
    kind: Annotated[str | None, typer.Option(metavar="NAME", help="spring or free_air: a test without tissue")] = None,
    json_file: JsonFile = None,
) -> None:
    """Run a guided test: placement, preload, stimulus, release."""
    from tissueid.cli.stimulus_options import CommonOptions
    from tissueid.cli.test import run_tests
    from tissueid.cli.test_plan import TestPlan, millimetres

    run_tests(
        TestPlan(
            url=device,
            site=site,
            out=out,
            stimulus=stimulus,
            stimulus_file=stimulus_file,
            distribution=distribution,
            common=CommonOptions(min_force=min_force, max_force=max_force, seconds=seconds, seed=seed),
            options=tuple(option or ()),
            depth_range_m=None if depth_range is None else millimetres(depth_range),
            multistep=multistep,
            target=target,
            stop_when=tuple(stop_when or ()),
            live=live,
            repeats=repeats,
            rest_s=rest,
            limits=limits,
            subject=subject,
            configuration=configuration,
            probe=probe,
            external_spring_n_per_m=external_spring,
            calibrations=calibrations,
            calibration=calibration,
            kind=kind,
            json_file=json_file,
        )
    )


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
def identify(
    session: Annotated[Path, typer.Argument(metavar="SESSION", help="session file")],
    engine: Engine = None,
    test: OneTest = None,
    also: MoreTests = None,
    validate: Validate = None,
    input_name: Input = "force",
    output_name: Output = "position",
    memory: Annotated[float | None, typer.Option(metavar="SECONDS", help="memory length")] = None,
    option: Annotated[
        list[str] | None,
        typer.Option("--option", metavar="NAME=VALUE", help="another option of the engine; may be repeated"),
    ] = None,
    json_file: JsonFile = None,
) -> None:
    """Fit one engine to one saved test, and validate it.

    The validation uses held-out data.
    """
    from tissueid.cli.identify import run_identify

    run_identify(session, engine, test, also or [], validate, input_name, output_name, memory, option or [], json_file)


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
