"""All commands, their groups and their help; the modules of the functions are imported when a command is used.

The list of commands and the version need names and help only; plans import pydantic and take most of the time.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Mapping
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
_GROUPS = {
    name: typer.Typer(help=about, no_args_is_help=True)
    for name, about in {
        "calibrate": "Calibrate an instrument; list and show calibrations.",
        "audit": "Show and verify the audit log.",
        "gap": "Diagnose the gap between simulation and recording.",
        "twin": "Show saved twins.",
        "study": "Compare subjects, sites and conditions over many sessions.",
    }.items()
}
for _group, _typer in _GROUPS.items():
    app.add_typer(_typer, name=_group)


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


_COMMANDS: Mapping[str, Mapping[str, tuple[str, str]]] = {
    "": {
        "import": (
            "sessions:import_files",
            "Import CSV, MAT or LVM files as a session. Files of 'tissueid export' need no --map.",
        ),
        "export": (
            "sessions:export_tests",
            "Export a session for other programs, one file per test.\n\n"
            "The attributes of each test are written as JSON next to it.",
        ),
        "demo": (
            "demo:demonstrate",
            "Run one guided test on a simulated forearm, without hardware.\n\n"
            "Includes recording, identification and report.",
        ),
        "samples": (
            "sessions:print_samples",
            "Record small sample sessions of simulated tissues.\n\nThe output says what each contains and what to try.",
        ),
        "devices": ("sessions:list_devices", "List connected and simulated instruments."),
        "test": ("test:run_tests", "Run a guided test: placement, preload, stimulus, release."),
        "quality": (
            "saved_tests:print_quality",
            "Check the quality of the tests of a saved session.\n\nThe output says which tests to repeat, and why.",
        ),
        "stimulus": (
            "stimulus:print_stimulus",
            "Design a stimulus, or check a saved one.\n\n"
            "Prints its properties and the load on the coil, and writes its figures.",
        ),
        "identify": (
            "saved_tests:print_identification",
            "Fit one engine to one saved test, and validate it.\n\nThe validation uses held-out data.",
        ),
        "engines": ("saved_tests:list_engines", "List the identification engines, or the options of one."),
        "compare": (
            "comparisons:compare_session",
            "Fit all engines to one saved test and compare their scores.\n\n"
            "Recommends the description that the test supports.",
        ),
        "readings": (
            "saved_tests:print_readings",
            "Compute the readings of commercial probes.\n\n"
            "Ue, Uv, Ur, Uf and R0 to R9 of suction probes; frequency, decrement and stiffness of tapping probes.",
        ),
        "overlay": (
            "comparisons:overlay_tests",
            "Draw several tests or several fits in one figure.\n\n"
            "The tests may be of one session or of several. Figures: depth profiles over the calibration, "
            "Bode diagrams, nonlinearities, kernels and scores.",
        ),
        "repeats": (
            "comparisons:repeated_tests",
            "Print mean, SD and CV of every parameter over tests.\n\n"
            "Tests are grouped by site. Without TESTS all stochastic tests of a session are taken.",
        ),
        "recover": (
            "sessions:recover_session",
            "Recover a session after a crash.\n\nAll data that had reached the disk is kept.",
        ),
        "report": (
            "saved_tests:report_test",
            "Write the report of one saved test as an HTML page.\n\n"
            "The page is self-contained. --pdf adds a short PDF.",
        ),
        "completion": (
            "command_reference:print_completion",
            "Print the completion script of a shell.\n\n"
            "For bash: tissueid completion bash > ~/.local/share/bash-completion/completions/tissueid",
        ),
        "manual": (
            "command_reference:print_manual",
            "Print the manual page of all commands.\n\nTo read it: tissueid manual | man -l -",
        ),
    },
    "calibrate": {
        "static": (
            "calibrate:print_static_calibration",
            "Calibrate channels, force constant and range of motion.\n\n"
            "Scales and zeros: voltage to current to force, position, temperature, acceleration.",
        ),
        "sweep": (
            "calibrate:print_sweep",
            "Find the linear region of the coil by a dynamic sweep.\n\n"
            "The calibration spring and the force constant are identified at each position of the stroke.",
        ),
        "list": (
            "calibrate:print_calibrations",
            "List calibrations, newest first.\n\nMarks the newest of each kind that passed.",
        ),
        "show": ("calibrate:print_calibration", "Show one calibration: instrument, date, verdict, all values."),
    },
    "audit": {
        "verify": (
            "audit:print_verification",
            "Verify the log line by line. Exit status 2 and the first altered line if it was changed.",
        ),
        "show": ("audit:print_lines", "Print the newest lines without verifying them."),
    },
    "gap": {
        "diagnose": (
            "gap:run_diagnose",
            "Locate the gap of a session and name its cause.\n\n"
            "Also reports how far the effect closes the gap on held-out data.",
        ),
        "batch": (
            "gap:run_batch",
            "Diagnose every session of a folder.\n\n"
            "For a file that cannot be used, the result is the reason. After a kill the same command continues.",
        ),
        "watch": (
            "gap:run_watch",
            "Show the gap of sessions over time against a twin.\n\n"
            "Names the first session of the folder in which the gap grew, and what grew. "
            "After a kill the same command continues.",
        ),
        "accept": (
            "gap:run_accept",
            "Save a twin with diagnosed or given effects.\n\n"
            "At a terminal you choose among the effects of a combination.",
        ),
        "effects": ("gap:list_effects", "List the effects that a diagnosis can name."),
    },
    "twin": {
        "show": ("gap:show_twin", "Show a twin: values, effects and origin."),
        "list": ("gap:list_twins", "List the twins in a folder; other files are ignored."),
    },
    "study": {
        "run": (
            "study:print_run",
            "Analyse the sessions of a study that have changed.\n\n"
            "Writes the table with one row per test as CSV and Parquet. After a kill the same command continues.",
        ),
        "table": (
            "study:print_table",
            "Show mean, standard deviation and variation of each parameter by site and condition.\n\n"
            "Analyses what has changed before.",
        ),
        "report": (
            "study:print_report",
            "Write the report of a study as an HTML page.\n\n"
            "Repeatability, sites, groups, regressions, conditions and sample sizes.",
        ),
        "demo": (
            "study:print_population",
            "Measure a simulated population, analyse it and write its report.\n\n"
            "16 subjects, 4 sites and 5 repeats by default, as in the thesis.",
        ),
        "protocol": (
            "study:print_protocol",
            "Check the protocol of a study, or write a template of one.\n\n"
            "Sites, repeats, conditions, demographic values that are asked for, and the order of a sitting.",
        ),
        "sitting": (
            "study:print_sitting",
            "Run all tests of one subject by the protocol, on the simulator.\n\n"
            "The same command continues a sitting that was interrupted; complete tests are kept.",
        ),
    },
}
"""Function, in ``tissueid.cli``, and help of each command by its group; the empty name is ``tissueid`` itself."""
for _group, _commands in _COMMANDS.items():
    for _name, (_function, _help) in _commands.items():
        add_command(_GROUPS[_group] if _group else app, _name, f"tissueid.cli.{_function}", _help)


@cache
def loaded_app() -> typer.Typer:
    """Return the application with the commands of other packages, which may import this module first."""
    load_plugins("tissueid.commands", "command", lambda add_commands: add_commands(app, _GROUPS["gap"]))
    return app
