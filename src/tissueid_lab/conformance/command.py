"""``tissueid conformance``: test a device against the protocol."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import typer

from tissueid.cli.output import at_terminal, check_json, console_control, human_output, message_json, table, write_json
from tissueid.errors import UnusableInputError
from tissueid.procedures.instrument_access import audit_trail
from tissueid.procedures.output_files import check_different
from tissueid_lab.conformance.procedure import Conformance, ConformancePlan, run_conformance


def print_conformance(plan: ConformancePlan, json_file: Path | None) -> None:
    """Test the clauses and print their table.

    Raises:
        UnusableInputError: an option cannot be used.
        typer.Exit: a clause failed: exit status 1.
    """
    check_different(plan.out, json_file)
    check_json(json_file)
    if plan.attended and not at_terminal():
        raise UnusableInputError(
            "conformance.no_terminal", "--attended needs a person at a terminal, and there is no terminal"
        )
    with console_control() as control:
        found = run_conformance(plan, control, audit_trail("technician"))
    out = human_output(json_file, width=120)
    rows = table(f"Conformance of {found.device or found.url}", "clause", "what the device does", "result")
    for column in rows.columns:
        column.justify = "left"
    for item in found.results:
        rows.add_row(item.id, item.title, "FAILED" if item.outcome == "failed" else item.outcome)
    out.print(rows)
    reasons: dict[str, list[str]] = {}
    for item in found.results:
        if item.reason:
            reasons.setdefault(item.reason, []).append(item.id)
    for reason, clauses in reasons.items():
        out.print(f"{', '.join(clauses)}: {reason}", markup=False, soft_wrap=True)
    out.print(found.headline, markup=False)
    if json_file is not None:
        write_json(json_file, _answer(found))
    if not found.passed:
        raise typer.Exit(1)


def _answer(found: Conformance) -> dict[str, object]:
    clauses = [asdict(item) | {"reason": item.reason, "message": message_json(item.reason)} for item in found.results]
    return {
        "device": found.url,
        "instrument": found.device,
        "firmware_version": found.firmware,
        "attached": found.attached,
        "force_n": found.force_n,
        "passed": found.passed,
        "clauses": clauses,
    }
