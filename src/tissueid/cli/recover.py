"""``tissueid recover``: recover a session after a crash."""

from __future__ import annotations

from pathlib import Path

from tissueid.acquisition import recover
from tissueid.cli.audit_records import audit_trail, print_audit_problems
from tissueid.cli.output import check_json, console, human_output, messages_json, write_json


def run_recover(path: Path, target: Path | None, json_file: Path | None) -> None:
    """Recover a session and print its tests."""
    check_json(json_file)
    own = audit_trail()
    warnings: list[str] = []
    session_file, session = recover(path, target, trail=own, report=warnings.append)
    print_audit_problems(own)
    for words in warnings:
        console.print(words, markup=False, soft_wrap=True)
    out = human_output(json_file)
    out.print(f"{session_file} contains {len(session.tests)} test(s):", markup=False)
    answer = []
    for test in session.tests:
        seconds = test.samples / test.sample_rate_hz
        out.print(f"  test {test.number}: {test.status}, {test.samples} samples ({seconds:.2f} s)", markup=False)
        answer.append({"test": test.number, "status": test.status, "samples": test.samples})
    if json_file is not None:
        write_json(
            json_file,
            {
                "session": str(session_file),
                "tests": answer,
                "warnings": warnings,
                "warning_messages": messages_json(warnings),
            },
        )
