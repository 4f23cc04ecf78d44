"""Commands of the first level; the plans of ``tissueid.procedures`` declare their options."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from tissueid.cli.audit_commands import audit
from tissueid.cli.calibrate import calibrate
from tissueid.cli.gap import gap
from tissueid.cli.lazy_command import JsonFile, add_command
from tissueid.cli.study import study
from tissueid.cli.twin_commands import twin
from tissueid.errors import UnusableInputError
from tissueid.plugins import load_plugins
from tissueid.version import SOFTWARE

if TYPE_CHECKING:  # plans are imported when their command is used
    from tissueid.procedures.comparison import ComparePlan
    from tissueid.procedures.demo import DemoPlan
    from tissueid.procedures.identification import EnginesPlan, IdentificationPlan
    from tissueid.procedures.import_export import ExportPlan, ImportPlan
    from tissueid.procedures.instrument_queries import DevicesPlan
    from tissueid.procedures.overlay import OverlayPlan, RepeatsPlan
    from tissueid.procedures.quality import QualityPlan
    from tissueid.procedures.readings import ReadingsPlan
    from tissueid.procedures.recovery import RecoveryPlan
    from tissueid.procedures.report import ReportPlan
    from tissueid.procedures.samples import SamplesPlan
    from tissueid.procedures.stimulus_design import StimulusPlan
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
app.add_typer(study, name="study")


def _version(requested: bool) -> None:
    if requested:
        typer.echo(SOFTWARE)
        raise typer.Exit


def _set_role(role: str) -> None:
    """Set the user role of this command and of the processes that it starts.

    Raises:
        UnusableInputError: the role is unknown.
    """
    from tissueid.audit import ROLE_ENVIRONMENT, ROLES

    if role.strip().lower() not in ROLES:
        raise UnusableInputError(f"--role must be {' or '.join(ROLES)}, got {role!r}")
    os.environ[ROLE_ENVIRONMENT] = role


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
        _set_role(role)
    if context.invoked_subcommand is not None:
        return 0
    from tissueid.cli.window import open_application

    return open_application()


@add_command(app, "import", "import_export")
def import_command(plan: ImportPlan, json_file: JsonFile = None) -> None:
    """Import CSV, MAT or LVM files as a session. Files of 'tissueid export' need no --map."""
    from tissueid.cli.import_export import import_files

    import_files(plan, json_file)


@add_command(app, "export", "import_export")
def export_command(plan: ExportPlan, json_file: JsonFile = None) -> None:
    """Export a session for other programs, one file per test.

    The attributes of each test are written as JSON next to it.
    """
    from tissueid.cli.import_export import export_tests

    export_tests(plan, json_file)


@add_command(app, "demo", "demo")
def demo(plan: DemoPlan, json_file: JsonFile = None) -> None:
    """Run one guided test on a simulated forearm, without hardware.

    Includes recording, identification and report.
    """
    from tissueid.cli.demo import demonstrate

    demonstrate(plan, json_file)


@add_command(app, "samples", "samples")
def samples(plan: SamplesPlan, json_file: JsonFile = None) -> None:
    """Record small sample sessions of simulated tissues.

    The output says what each contains and what to try.
    """
    from tissueid.cli.samples import print_samples

    print_samples(plan, json_file)


@add_command(app, "devices", "instrument_queries")
def devices(plan: DevicesPlan, json_file: JsonFile = None) -> None:
    """List connected and simulated instruments."""
    from tissueid.cli.devices import list_devices

    list_devices(plan, json_file)


@add_command(app, "test", "test_plan")
def run_test(plan: TestPlan, json_file: JsonFile = None) -> None:
    """Run a guided test: placement, preload, stimulus, release."""
    from tissueid.cli.test import run_tests

    run_tests(plan, json_file)


@add_command(app, "quality", "quality")
def quality(plan: QualityPlan, json_file: JsonFile = None) -> None:
    """Check the quality of the tests of a saved session.

    The output says which tests to repeat, and why.
    """
    from tissueid.cli.quality import print_quality

    print_quality(plan, json_file)


@add_command(app, "stimulus", "stimulus_design")
def stimulus(plan: StimulusPlan, json_file: JsonFile = None) -> None:
    """Design a stimulus, or check a saved one.

    Prints its properties and the load on the coil, and writes its figures.
    """
    from tissueid.cli.stimulus import print_stimulus

    print_stimulus(plan, json_file)


@add_command(app, "identify", "identification")
def identify(plan: IdentificationPlan, json_file: JsonFile = None) -> None:
    """Fit one engine to one saved test, and validate it.

    The validation uses held-out data.
    """
    from tissueid.cli.identify import print_identification

    print_identification(plan, json_file)


@add_command(app, "engines", "identification")
def engines(plan: EnginesPlan, json_file: JsonFile = None) -> None:
    """List the identification engines, or the options of one."""
    from tissueid.cli.engines import list_engines

    list_engines(plan, json_file)


@add_command(app, "compare", "comparison")
def compare(plan: ComparePlan, json_file: JsonFile = None) -> None:
    """Fit all engines to one saved test and compare their scores.

    Recommends the description that the test supports.
    """
    from tissueid.cli.compare import compare_session

    compare_session(plan, json_file)


@add_command(app, "readings", "readings")
def readings(plan: ReadingsPlan, json_file: JsonFile = None) -> None:
    """Compute the readings of commercial probes.

    Ue, Uv, Ur, Uf and R0 to R9 of suction probes; frequency, decrement and stiffness of tapping probes.
    """
    from tissueid.cli.readings import print_readings

    print_readings(plan, json_file)


@add_command(app, "overlay", "overlay")
def overlay(plan: OverlayPlan, json_file: JsonFile = None) -> None:
    """Draw several tests or several fits in one figure.

    The tests may be of one session or of several. Figures: depth profiles over the calibration, Bode diagrams,
    nonlinearities, kernels and scores.
    """
    from tissueid.cli.overlay import overlay_tests

    overlay_tests(plan, json_file)


@add_command(app, "repeats", "overlay")
def repeats(plan: RepeatsPlan, json_file: JsonFile = None) -> None:
    """Print mean, SD and CV of every parameter over tests.

    Tests are grouped by site. Without TESTS all stochastic tests of a session are taken.
    """
    from tissueid.cli.overlay import repeated_tests

    repeated_tests(plan, json_file)


@add_command(app, "recover", "recovery")
def recover(plan: RecoveryPlan, json_file: JsonFile = None) -> None:
    """Recover a session after a crash.

    All data that had reached the disk is kept.
    """
    from tissueid.cli.recover import recover_session

    recover_session(plan, json_file)


@add_command(app, "report", "report")
def report(plan: ReportPlan) -> None:
    """Write the report of one saved test as an HTML page.

    The page is self-contained. --pdf adds a short PDF.
    """
    from tissueid.cli.report import report_test

    report_test(plan)


@add_command(app, "completion")
def completion(
    shell: Annotated[Literal["bash", "zsh", "fish"], typer.Argument(metavar="SHELL", help="bash, zsh or fish")],
) -> None:
    """Print the completion script of a shell.

    For bash: tissueid completion bash > ~/.local/share/bash-completion/completions/tissueid
    """
    from tissueid.cli.completion import completion_script

    typer.echo(completion_script(shell, app), nl=False)


@add_command(app, "manual")
def manual() -> None:
    """Print the manual page of all commands.

    To read it: tissueid manual | man -l -
    """
    from tissueid.cli.manual import manual_page

    typer.echo(manual_page(app), nl=False)


load_plugins("tissueid.commands", "command", lambda add_commands: add_commands(app, gap))
