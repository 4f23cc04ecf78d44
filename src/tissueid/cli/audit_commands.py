"""``tissueid audit``: show and verify the audit log."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from tissueid.cli.lazy_command import JsonFile, add_command

if TYPE_CHECKING:  # plans are imported when their command is used
    from tissueid.procedures.audit_queries import LogPlan, VerifyLogPlan

audit = typer.Typer(help="Show and verify the audit log.", no_args_is_help=True)


@add_command(audit, "verify", "audit_queries")
def verify_command(plan: VerifyLogPlan, json_file: JsonFile = None) -> None:
    """Verify the log line by line. Exit status 2 and the first altered line if it was changed."""
    from tissueid.cli.audit_output import print_verification

    print_verification(plan, json_file)


@add_command(audit, "show", "audit_queries")
def show_command(plan: LogPlan, json_file: JsonFile = None) -> None:
    """Print the newest lines without verifying them."""
    from tissueid.cli.audit_output import print_lines

    print_lines(plan, json_file)
