"""Commands of the laboratory, which an entry point of the group ``tissueid.commands`` adds to ``tissueid``."""

from __future__ import annotations

import typer

from tissueid.cli.commands import add_command


def add_commands(app: typer.Typer, gap: typer.Typer) -> None:
    """Add the commands of the laboratory to the groups ``tissueid`` and ``tissueid gap``."""
    add_command(
        app,
        "conformance",
        "tissueid_lab.command_output:conformance",
        """Test a device against the protocol, clause by clause.

        Exit status 0: no clause failed; 1: a clause failed.
        """,
    )
    add_command(
        app,
        "reproduce",
        "tissueid_lab.command_output:reproduce",
        """Make figures and tables of the thesis from simulated tests.

        Shows its numbers and those found here. Without --out, lists them.
        """,
    )
    add_command(
        gap,
        "blind-check",
        "tissueid_lab.command_output:blind_check",
        """Score the diagnosis on scenarios with sealed labels.

        The scenarios are simulated. The labels stay sealed until all scenarios are diagnosed.
        """,
    )
