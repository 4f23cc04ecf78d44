"""All commands, their groups and their help; the modules of the functions are imported when a command is used.

The list of commands and the version need names and help only; plans import pydantic and take most of the time.
"""

from __future__ import annotations

import importlib
import os
from functools import cache
from typing import Annotated, Any

import typer
from typer.core import TyperCommand
from typer.main import get_command

from tissueid.plugins import load_plugins
from tissueid.version import SOFTWARE


class LazyCommand(TyperCommand):
    """A command whose parameters are built at first use."""

    _built = False

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters; at the first call, import the function and build them."""
        if not self._built:
            built = _built(self.callback.__dict__["function"])
            self.params, self.callback, self._built = built.params, built.callback, True
        return super().get_params(ctx)


def _built(function: str) -> Any:
    from tissueid.cli.plan_command import plan_command

    module, _colon, name = function.partition(":")
    alone = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)
    alone.command()(plan_command(getattr(importlib.import_module(module), name)))
    return get_command(alone)


def add_command(group: typer.Typer, name: str, function: str, help_text: str) -> None:
    """Add a command to a group.

        add_command(app, "test", "tissueid.cli.test:run_tests", "Run a guided test: placement, preload, stimulus.")

    Args:
        group: of the command.
        name: of the command.
        function: module and name of its function, whose parameters are those of the command
            (:func:`~tissueid.cli.plan_command.plan_command`).
        help_text: its help; the first line is shown in the list of commands.
    """

    def declared() -> None:
        """Stand for the function until the command is used."""

    declared.__doc__ = help_text
    declared.__dict__["function"] = function
    group.command(name, cls=LazyCommand)(declared)


app = typer.Typer(
    help="Measure living tissue with a voice coil and nonlinear system identification. Research use only.",
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
calibrate = typer.Typer(help="Calibrate an instrument; list and show calibrations.", no_args_is_help=True)
audit = typer.Typer(help="Show and verify the audit log.", no_args_is_help=True)
gap = typer.Typer(help="Diagnose the gap between simulation and recording.", no_args_is_help=True)
twin = typer.Typer(help="Show saved twins.", no_args_is_help=True)
study = typer.Typer(help="Compare subjects, sites and conditions over many sessions.", no_args_is_help=True)
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
    from tissueid.errors import UnusableInputError

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


add_command(
    app,
    "import",
    "tissueid.cli.sessions:import_files",
    "Import CSV, MAT or LVM files as a session. Files of 'tissueid export' need no --map.",
)
add_command(
    app,
    "export",
    "tissueid.cli.sessions:export_tests",
    """Export a session for other programs, one file per test.

    The attributes of each test are written as JSON next to it.
    """,
)
add_command(
    app,
    "demo",
    "tissueid.cli.demo:demonstrate",
    """Run one guided test on a simulated forearm, without hardware.

    Includes recording, identification and report.
    """,
)
add_command(
    app,
    "samples",
    "tissueid.cli.sessions:print_samples",
    """Record small sample sessions of simulated tissues.

    The output says what each contains and what to try.
    """,
)
add_command(
    app,
    "devices",
    "tissueid.cli.sessions:list_devices",
    "List connected and simulated instruments.",
)
add_command(
    app,
    "test",
    "tissueid.cli.test:run_tests",
    "Run a guided test: placement, preload, stimulus, release.",
)
add_command(
    app,
    "quality",
    "tissueid.cli.saved_tests:print_quality",
    """Check the quality of the tests of a saved session.

    The output says which tests to repeat, and why.
    """,
)
add_command(
    app,
    "stimulus",
    "tissueid.cli.stimulus:print_stimulus",
    """Design a stimulus, or check a saved one.

    Prints its properties and the load on the coil, and writes its figures.
    """,
)
add_command(
    app,
    "identify",
    "tissueid.cli.saved_tests:print_identification",
    """Fit one engine to one saved test, and validate it.

    The validation uses held-out data.
    """,
)
add_command(
    app,
    "engines",
    "tissueid.cli.saved_tests:list_engines",
    "List the identification engines, or the options of one.",
)
add_command(
    app,
    "compare",
    "tissueid.cli.comparisons:compare_session",
    """Fit all engines to one saved test and compare their scores.

    Recommends the description that the test supports.
    """,
)
add_command(
    app,
    "readings",
    "tissueid.cli.saved_tests:print_readings",
    """Compute the readings of commercial probes.

    Ue, Uv, Ur, Uf and R0 to R9 of suction probes; frequency, decrement and stiffness of tapping probes.
    """,
)
add_command(
    app,
    "overlay",
    "tissueid.cli.comparisons:overlay_tests",
    """Draw several tests or several fits in one figure.

    The tests may be of one session or of several. Figures: depth profiles over the calibration, Bode diagrams,
    nonlinearities, kernels and scores.
    """,
)
add_command(
    app,
    "repeats",
    "tissueid.cli.comparisons:repeated_tests",
    """Print mean, SD and CV of every parameter over tests.

    Tests are grouped by site. Without TESTS all stochastic tests of a session are taken.
    """,
)
add_command(
    app,
    "recover",
    "tissueid.cli.sessions:recover_session",
    """Recover a session after a crash.

    All data that had reached the disk is kept.
    """,
)
add_command(
    app,
    "report",
    "tissueid.cli.saved_tests:report_test",
    """Write the report of one saved test as an HTML page.

    The page is self-contained. --pdf adds a short PDF.
    """,
)
add_command(
    app,
    "completion",
    "tissueid.cli.command_reference:print_completion",
    """Print the completion script of a shell.

    For bash: tissueid completion bash > ~/.local/share/bash-completion/completions/tissueid
    """,
)
add_command(
    app,
    "manual",
    "tissueid.cli.command_reference:print_manual",
    """Print the manual page of all commands.

    To read it: tissueid manual | man -l -
    """,
)

add_command(
    calibrate,
    "static",
    "tissueid.cli.calibrate:print_static_calibration",
    """Calibrate channels, force constant and range of motion.

    Scales and zeros: voltage to current to force, position, temperature, acceleration.
    """,
)
add_command(
    calibrate,
    "sweep",
    "tissueid.cli.calibrate:print_sweep",
    """Find the linear region of the coil by a dynamic sweep.

    The calibration spring and the force constant are identified at each position of the stroke.
    """,
)
add_command(
    calibrate,
    "list",
    "tissueid.cli.calibrate:print_calibrations",
    """List calibrations, newest first.

    Marks the newest of each kind that passed.
    """,
)
add_command(
    calibrate,
    "show",
    "tissueid.cli.calibrate:print_calibration",
    "Show one calibration: instrument, date, verdict, all values.",
)

add_command(
    audit,
    "verify",
    "tissueid.cli.audit:print_verification",
    "Verify the log line by line. Exit status 2 and the first altered line if it was changed.",
)
add_command(
    audit,
    "show",
    "tissueid.cli.audit:print_lines",
    "Print the newest lines without verifying them.",
)

add_command(
    gap,
    "diagnose",
    "tissueid.cli.gap:run_diagnose",
    """Locate the gap of a session and name its cause.

    Also reports how far the effect closes the gap on held-out data.
    """,
)
add_command(
    gap,
    "batch",
    "tissueid.cli.gap:run_batch",
    """Diagnose every session of a folder.

    For a file that cannot be used, the result is the reason. After a kill the same command continues.
    """,
)
add_command(
    gap,
    "watch",
    "tissueid.cli.gap:run_watch",
    """Show the gap of sessions over time against a twin.

    Names the first session of the folder in which the gap grew, and what grew. After a kill the same command continues.
    """,
)
add_command(
    gap,
    "accept",
    "tissueid.cli.gap:run_accept",
    """Save a twin with diagnosed or given effects.

    At a terminal you choose among the effects of a combination.
    """,
)
add_command(
    gap,
    "effects",
    "tissueid.cli.gap:list_effects",
    "List the effects that a diagnosis can name.",
)

add_command(
    twin,
    "show",
    "tissueid.cli.gap:show_twin",
    "Show a twin: values, effects and origin.",
)
add_command(
    twin,
    "list",
    "tissueid.cli.gap:list_twins",
    "List the twins in a folder; other files are ignored.",
)

add_command(
    study,
    "run",
    "tissueid.cli.study:print_run",
    """Analyse the sessions of a study that have changed.

    Writes the table with one row per test as CSV and Parquet. After a kill the same command continues.
    """,
)
add_command(
    study,
    "table",
    "tissueid.cli.study:print_table",
    """Show mean, standard deviation and variation of each parameter by site and condition.

    Analyses what has changed before.
    """,
)
add_command(
    study,
    "report",
    "tissueid.cli.study:print_report",
    """Write the report of a study as an HTML page.

    Repeatability, sites, groups, regressions, conditions and sample sizes.
    """,
)
add_command(
    study,
    "demo",
    "tissueid.cli.study:print_population",
    """Measure a simulated population, analyse it and write its report.

    16 subjects, 4 sites and 5 repeats by default, as in the thesis.
    """,
)
add_command(
    study,
    "protocol",
    "tissueid.cli.study:print_protocol",
    """Check the protocol of a study, or write a template of one.

    Sites, repeats, conditions, demographic values that are asked for, and the order of a sitting.
    """,
)
add_command(
    study,
    "sitting",
    "tissueid.cli.study:print_sitting",
    """Run all tests of one subject by the protocol, on the simulator.

    The same command continues a sitting that was interrupted; complete tests are kept.
    """,
)


@cache
def loaded_app() -> typer.Typer:
    """Return the application with the commands of other packages, which may import this module first."""
    load_plugins("tissueid.commands", "command", lambda add_commands: add_commands(app, gap))
    return app
