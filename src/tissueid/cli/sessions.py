"""Commands without analysis: import, export, recover, samples, devices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tissueid.cli.output import Output, table
from tissueid.formatting import clean, number
from tissueid.messages import stored
from tissueid.procedures.demo import SAMPLES, SamplesPlan, make_samples
from tissueid.procedures.import_export import ExportPlan, ImportPlan, RecoveryPlan, run_export, run_import, run_recovery
from tissueid.procedures.instruments import DevicesPlan, audit_trail, listed_instruments
from tissueid.procedures.output_files import check_different

if TYPE_CHECKING:
    from tissueid.sessions import Test
    from tissueid.sessions.imports import Imported


def import_files(plan: ImportPlan, out: Output) -> None:
    """Import files as a session, and print its tests.

    Raises:
        UnusableInputError: a file, a column or an option cannot be used.
    """
    check_different(plan.out, out.json_file)
    made = out.run(run_import, plan, audit_trail())
    tests = [_answer(item, test) for item, test in zip(made.tests, made.session.tests, strict=True)]
    _print_result(plan.out, out, tests, made.notices)
    out.write_json(
        {
            "session": str(plan.out),
            "session_id": made.session.session_id,
            "tests": tests,
            "notices": list(made.notices),
            "notice_messages": list(map(stored, made.notices)),
        }
    )


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


def _print_result(path: Path, out: Output, tests: Sequence[dict[str, Any]], notices: Sequence[str]) -> None:
    out.widen(120)
    rows = table(str(path), "test", "kind", "samples", "rate Hz", "signal", "column", "unit", "from", "to", "missing")
    for test in tests:
        first = [str(test["test"]), test["kind"], str(test["samples"]), number(test["sample_rate_hz"], 6)]
        for name, signal in test["signals"].items():
            ends = (number(signal["minimum"]), number(signal["maximum"]), str(signal["missing"]))
            rows.add_row(*first, name, clean(signal["column"]), signal["si_unit"], *ends)
            first = [""] * 4
    out.print(rows)
    own = [f"test {test['test']}: {notice}" for test in tests for notice in test["notices"]]
    out.print_lines([*own, *notices], soft_wrap=True)


def export_tests(plan: ExportPlan, out: Output) -> None:
    """Export a session, and print its files.

    Raises:
        UnusableInputError: the session, an option or the folder cannot be used.
    """
    check_different(plan.out, out.json_file)
    session, files = out.run(run_export, plan, audit_trail())
    out.print(f"{plan.out} contains {len(session.tests)} test(s), each with its attributes in JSON:")
    tests = zip(session.tests, files[::2], strict=True)
    out.print_lines(f"  {name}: {test.kind}, {test.samples} samples" for test, name in tests)
    about = {"folder": str(plan.out), "format": plan.kind, "session_id": session.session_id}
    out.write_json(about | {"files": files})


def recover_session(plan: RecoveryPlan, out: Output) -> None:
    """Recover a session and print its tests."""
    recovered = out.run(run_recovery, plan, audit_trail())
    out.print(f"{recovered.path} contains {len(recovered.session.tests)} test(s):")
    answer = []
    for test in recovered.session.tests:
        seconds = test.samples / test.sample_rate_hz
        out.print(f"  test {test.number}: {test.status}, {test.samples} samples ({seconds:.2f} s)")
        answer.append({"test": test.number, "status": test.status, "samples": test.samples})
    out.write_json(
        {
            "session": str(recovered.path),
            "tests": answer,
            "warnings": list(recovered.warnings),
            "warning_messages": list(map(stored, recovered.warnings)),
        }
    )


def print_samples(plan: SamplesPlan, out: Output) -> None:
    """Record the samples, and print what each contains and what to try.

    Raises:
        UnusableInputError: the folder or a file cannot be used.
    """
    made = out.run(make_samples, plan)
    rows = [(name, str(len(made[name].tests)), SAMPLES[name].about, SAMPLES[name].command) for name in made]
    out.widen(150)
    out.print(table(f"Samples in {plan.out}", "file", "tests", "content", "try", rows=rows))
    out.write_json(
        [
            {"file": str(plan.out / name), "session_id": session.session_id, "tests": len(session.tests)}
            for name, session in made.items()
        ]
    )


_ANSWERS = {True: "yes", False: "no", None: "not probed"}


def list_devices(plan: DevicesPlan, out: Output) -> None:
    """Print the instruments that were found, and why some did not answer."""
    instruments = listed_instruments(plan)
    rows = [
        (item.url, f"{item.what}: {item.detail}" if item.answers and item.detail else item.what, _ANSWERS[item.answers])
        for item in instruments
    ]
    out.print(table("Instruments", "device", "what", "answers", rows=rows, left_aligned=True))
    out.print_lines(item.detail for item in instruments if item.answers is False)
    out.write_json([asdict(item) for item in instruments])
