"""``tissueid import`` and ``tissueid export``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tissueid.cli.output import (
    ConsoleControl,
    check_json,
    human_output,
    progress_bars,
    table,
    write_json,
)
from tissueid.formatting import clean, number
from tissueid.messages import stored
from tissueid.procedures.import_export import ExportPlan, ImportPlan, run_export, run_import
from tissueid.procedures.instrument_access import audit_trail
from tissueid.procedures.output_files import check_different

if TYPE_CHECKING:  # takes long to import
    from tissueid.sessions import Test
    from tissueid.sessions.imports import Imported


def import_files(plan: ImportPlan, json_file: Path | None) -> None:
    """Import files as a session, and print its tests.

    Raises:
        UnusableInputError: a file, a column or an option cannot be used.
    """
    check_json(json_file)
    check_different(plan.out, json_file)
    with progress_bars() as show:
        made = run_import(plan, ConsoleControl(show), audit_trail())
    tests = [_answer(item, test) for item, test in zip(made.tests, made.session.tests, strict=True)]
    _print_result(plan.out, json_file, tests, made.notices)
    if json_file is not None:
        answer: dict[str, Any] = {
            "session": str(plan.out),
            "session_id": made.session.session_id,
            "tests": tests,
            "notices": list(made.notices),
            "notice_messages": list(map(stored, made.notices)),
        }
        write_json(json_file, answer)


def _answer(item: Imported, test: Test) -> dict[str, Any]:
    """Return the summary of one test for JSON."""
    import numpy as np

    signals = {}
    for column in item.columns:
        values = test.signals[column.role]
        some = bool(np.isfinite(values).any())
        signals[column.role] = {
            "column": column.header,
            "unit": column.unit.symbol,
            "si_unit": column.unit.si,
            "missing": int(np.isnan(values).sum()),
            "minimum": float(np.nanmin(values)) if some else None,
            "maximum": float(np.nanmax(values)) if some else None,
        }
    return {
        "test": test.number,
        "file": str(item.source.path),
        "format": item.format,
        "rows": [item.rows.start, item.rows.stop],
        "kind": test.kind,
        "site": test.site,
        "samples": test.samples,
        "sample_rate_hz": test.sample_rate_hz,
        "signals": signals,
        "notices": list(item.notices),
        "notice_messages": list(map(stored, item.notices)),
    }


def _print_result(path: Path, json_file: Path | None, tests: Sequence[dict[str, Any]], notices: Sequence[str]) -> None:
    out = human_output(json_file, width=120)
    rows = table(str(path), "test", "kind", "samples", "rate Hz", "signal", "column", "unit", "from", "to", "missing")
    for test in tests:
        first = [str(test["test"]), test["kind"], str(test["samples"]), number(test["sample_rate_hz"], 6)]
        for name, signal in test["signals"].items():
            ends = (number(signal["minimum"]), number(signal["maximum"]), str(signal["missing"]))
            rows.add_row(*first, name, clean(signal["column"]), signal["si_unit"], *ends)
            first = [""] * 4
    out.print(rows)
    for test in tests:
        for notice in test["notices"]:
            out.print(f"test {test['test']}: {notice}", markup=False, soft_wrap=True)
    for notice in notices:
        out.print(notice, markup=False, soft_wrap=True)


def export_tests(plan: ExportPlan, json_file: Path | None) -> None:
    """Export a session, and print its files.

    Raises:
        UnusableInputError: the session, an option or the folder cannot be used.
    """
    check_json(json_file)
    check_different(plan.out, json_file)
    with progress_bars() as show:
        made = run_export(plan, ConsoleControl(show), audit_trail())
    out = human_output(json_file)
    out.print(f"{plan.out} contains {len(made.session.tests)} test(s), each with its attributes in JSON:", markup=False)
    for test, name in zip(made.session.tests, made.files[::2], strict=True):
        out.print(f"  {name}: {test.kind}, {test.samples} samples", markup=False)
    if json_file is not None:
        answer = {
            "folder": str(plan.out),
            "format": plan.kind,
            "session_id": made.session.session_id,
            "files": list(made.files),
        }
        write_json(json_file, answer)
