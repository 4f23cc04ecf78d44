"""The commands and their options; what each does stands in a module of its own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tissueid import __version__
from tissueid.cli.audit import audit
from tissueid.cli.calibrate import calibrate
from tissueid.cli.gap import gap
from tissueid.cli.interchange import export_command, import_command
from tissueid.cli.logged import take_role
from tissueid.cli.twins import twin

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

JsonFile = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="write the answer as JSON; - prints it")]
DeviceUrl = Annotated[
    str,
    typer.Option(
        "--device", metavar="URL", help="a port, socket://HOST:PORT or simulated://forearm; see 'tissueid devices'"
    ),
]
Engine = Annotated[
    str | None, typer.Option("--engine", metavar="NAME", help="needed: such as lms or wiener; without it lists all")
]
OneTest = Annotated[int | None, typer.Option("--test", metavar="N", help="test to fit; the first stochastic one")]
MoreTests = Annotated[
    list[int] | None, typer.Option("--also", metavar="N", help="another test to fit together with it; may be repeated")
]
Validate = Annotated[
    int | None, typer.Option(metavar="N", help="test to validate on; otherwise the last quarter is held out")
]
Input = Annotated[str, typer.Option("--input", metavar="SIGNAL", help="input signal")]
Output = Annotated[str, typer.Option("--output", metavar="SIGNAL", help="output signal")]


def _version(asked: bool) -> None:
    if asked:
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
    """Without a command: open the application."""
    if role is not None:
        take_role(role)
    if context.invoked_subcommand is not None:
        return 0
    from tissueid.cli.window import open_application

    return open_application()


@app.command()
def demo(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="folder for session.h5, results.json, report.html")],
    seed: Annotated[int, typer.Option(min=0, max=2**31 - 1, help="seed of stimulus and sensor noise")] = 1,
    preset: Annotated[str, typer.Option(help="tissue; see 'tissueid-firmware-sim --list'")] = "left-posterior-forearm",
    json_file: JsonFile = None,
) -> None:
    """Run one guided test on a simulated forearm; needs no hardware.

    From the cable to the report.
    """
    from tissueid.cli.demo import run_demo

    run_demo(out, seed, preset, json_file)


@app.command()
def devices(
    probe: Annotated[bool, typer.Option("--probe/--no-probe", help="shake hands with each")] = True,
    json_file: JsonFile = None,
) -> None:
    """List the instruments that can be reached, simulated ones too."""
    from tissueid.cli.devices import list_devices

    list_devices(probe, json_file)


@app.command("test")
def run_test(
    device: DeviceUrl,
    site: Annotated[str, typer.Option(metavar="TEXT", help="where on the body, or which material")],
    out: Annotated[Path, typer.Option("--out", metavar="SESSION", help="session file to make; never overwritten")],
    stimulus: Annotated[
        str | None, typer.Option(metavar="NAME", help="noise by default; 'tissueid stimulus' lists them")
    ] = None,
    option: Annotated[
        list[str] | None, typer.Option("--option", metavar="NAME=VALUE", help="any other option of the stimulus")
    ] = None,
    stimulus_file: Annotated[
        Path | None, typer.Option("--stimulus-file", metavar="FILE", help="plays what 'tissueid stimulus' saved")
    ] = None,
    distribution: Annotated[
        str | None, typer.Option(help="distribution of the stimulus: of noise gaussian, or uniform and others")
    ] = None,
    min_force: Annotated[
        float | None, typer.Option(metavar="NEWTON", help="lower end of the force range; of noise 0.5")
    ] = None,
    max_force: Annotated[
        float | None, typer.Option(metavar="NEWTON", help="upper end of the force range; of noise 10.5")
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="length; of noise 4. 0.5 s of preload come first")
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, max=2**31 - 1, help="seed of the stimulus")] = None,
    depth_range: Annotated[
        str | None,
        typer.Option("--depth-range", metavar="MM:MM", help="depths to spread over, from the surface, such as 1:4"),
    ] = None,
    multistep: Annotated[
        int | None,
        typer.Option(
            min=1, max=20, metavar="N", help="up to N tests, each designed from those before for an even depth"
        ),
    ] = None,
    target: Annotated[
        float | None,
        typer.Option(min=0.0, max=1.0, help="with --multistep: distance from even that is enough; 0.05 without"),
    ] = None,
    stop_when: Annotated[
        list[str] | None,
        typer.Option(
            "--stop-when", metavar="NAME=SHARE", help="ends when known so well, such as stiffness=0.02; may be repeated"
        ),
    ] = None,
    live: Annotated[bool, typer.Option("--live", help="prints the parameters as they converge")] = False,
    repeats: Annotated[int, typer.Option(min=1, max=100, help="how often the same test is run")] = 1,
    rest: Annotated[
        float, typer.Option(min=0, max=600, metavar="SECONDS", help="between repeats: lets the coil cool")
    ] = 0.0,
    limits: Annotated[str, typer.Option(help="clinical (12 N) or research (15 N)")] = "clinical",
    subject: Annotated[str, typer.Option(metavar="PSEUDONYM", help="never a name")] = "anonymous",
    configuration: Annotated[
        str, typer.Option(metavar="NAME", help="indentation, extension or surface")
    ] = "indentation",
    probe: Annotated[str | None, typer.Option(metavar="NAME", help="the tip; a wrong one lists all")] = None,
    external_spring: Annotated[
        float,
        typer.Option("--external-spring", metavar="N/M", help="stiffness beside the tissue, subtracted; for surface"),
    ] = 0.0,
    calibrations: Annotated[
        Path | None, typer.Option("--calibrations", metavar="DIR", help="folder of calibrations; see 'calibrate list'")
    ] = None,
    calibration: Annotated[bool, typer.Option(help="put the newest calibration in force")] = True,
    kind: Annotated[
        str | None, typer.Option(metavar="NAME", help="spring or free_air, where the probe meets no tissue")
    ] = None,
    json_file: JsonFile = None,
) -> None:
    """Run a guided test: place, preload, stimulus, release."""
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
    test: Annotated[int | None, typer.Option("--test", metavar="N", help="one test; all without it")] = None,
    json_file: JsonFile = None,
) -> None:
    """Judge the tests of a saved session anew: can they be believed?

    And what to do about those that cannot.
    """
    from tissueid.cli.quality import run_quality

    run_quality(session, test, json_file)


@app.command()
def stimulus(
    what: Annotated[
        str | None, typer.Argument(metavar="KIND|FILE", help="a kind, or a saved stimulus; without it, lists the kinds")
    ] = None,
    option: Annotated[
        list[str] | None, typer.Option("--option", metavar="NAME=VALUE", help="any other option of the kind")
    ] = None,
    list_options: Annotated[bool, typer.Option("--options", help="list what the kind takes, with bounds")] = False,
    min_force: Annotated[float | None, typer.Option(metavar="NEWTON", help="lower end of the force range")] = None,
    max_force: Annotated[float | None, typer.Option(metavar="NEWTON", help="upper end of the force range")] = None,
    min_volts: Annotated[float | None, typer.Option(metavar="VOLT", help="lower end: designs the voltage")] = None,
    max_volts: Annotated[float | None, typer.Option(metavar="VOLT", help="upper end: designs the voltage")] = None,
    seconds: Annotated[float | None, typer.Option(metavar="SECONDS", help="length, without a preload")] = None,
    seed: Annotated[int | None, typer.Option(min=0, max=2**63 - 1, help="the same seed, the same samples")] = None,
    out: Annotated[Path | None, typer.Option("--out", metavar="FILE", help="saves it, to be played by 'test'")] = None,
    csv: Annotated[Path | None, typer.Option("--csv", metavar="FILE", help="its samples as text")] = None,
    plot: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE", help="its figures: .html, .pdf, .png or .svg")
    ] = None,
    device: Annotated[
        str | None,
        typer.Option("--device", metavar="URL", help="what is to play it; the desktop research device without"),
    ] = None,
    limits: Annotated[str, typer.Option(help="clinical (12 N) or research (15 N)")] = "clinical",
    json_file: JsonFile = None,
) -> None:
    """Design a stimulus, or check a saved one.

    What it is, what it does to the coil, and its figures.
    """
    from tissueid.cli.stimulus import run_stimulus
    from tissueid.cli.stimulus_options import CommonOptions
    from tissueid.cli.stimulus_targets import Targets

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
        list[str] | None, typer.Option("--option", metavar="NAME=VALUE", help="any other option of the engine")
    ] = None,
    json_file: JsonFile = None,
) -> None:
    """Fit one engine to one saved test, and validate it.

    It is validated on data that was not fitted.
    """
    from tissueid.cli.identify import run_identify

    run_identify(session, engine, test, also or [], validate, input_name, output_name, memory, option or [], json_file)


@app.command()
def compare(
    session: Annotated[Path, typer.Argument(metavar="SESSION", help="session file")],
    engines: Annotated[str | None, typer.Option(metavar="A,B,...", help="engines to compare; all by default")] = None,
    test: OneTest = None,
    also: MoreTests = None,
    validate: Validate = None,
    input_name: Input = "force",
    output_name: Output = "position",
    memory: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="memory length of all engines that have one")
    ] = None,
    option: Annotated[
        list[str] | None, typer.Option("--option", metavar="ENGINE.NAME=VALUE", help="any option of one engine")
    ] = None,
    sweep: Annotated[
        bool, typer.Option("--memory-sweep", help="scores against memory for all engines that have one; slow")
    ] = False,
    json_file: JsonFile = None,
    out: Annotated[Path | None, typer.Option("--out", metavar="FILE", help="HTML page to make")] = None,
    figures: Annotated[
        Path | None, typer.Option("--figures", metavar="DIR", help="folder for every figure as SVG and PNG")
    ] = None,
) -> None:
    """Fit every engine to one saved test, scores side by side.

    And which description the test supports.
    """
    from tissueid.cli.compare import run_compare

    run_compare(
        session,
        engines,
        test,
        also or [],
        validate,
        input_name,
        output_name,
        memory,
        option or [],
        sweep,
        json_file,
        out,
        figures,
    )


@app.command()
def recover(
    path: Annotated[Path, typer.Argument(metavar="PATH", help="the session that was to be, or its journal")],
    out: Annotated[
        Path | None, typer.Option("--out", metavar="SESSION", help="where it goes; beside the journal by default")
    ] = None,
    json_file: JsonFile = None,
) -> None:
    """Finish a session whose host died.

    Everything that had reached the disk is kept.
    """
    from tissueid.cli.recover import run_recover

    run_recover(path, out, json_file)


@app.command()
def report(
    session: Annotated[Path, typer.Argument(metavar="SESSION", help="session file")],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="HTML page to make")],
    test: OneTest = None,
    engines: Annotated[
        str | None, typer.Option(metavar="A,B,...", help="engines to report; lms, spectral and wiener by default")
    ] = None,
    pdf: Annotated[Path | None, typer.Option("--pdf", metavar="FILE", help="and, in short, a PDF to print")] = None,
) -> None:
    """Make the report of one saved test, an HTML page.

    The page is self-contained; a PDF is made where one is asked for.
    """
    from tissueid.cli.report import run_report

    run_report(session, out, test, engines, pdf)
