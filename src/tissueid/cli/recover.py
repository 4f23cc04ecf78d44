"""``tissueid recover``."""

from __future__ import annotations

from pathlib import Path

from tissueid.acquisition import recover
from tissueid.cli.logged import tell, trail
from tissueid.cli.output import check_json, console, people_read, write_json


def run_recover(path: Path, target: Path | None, json_file: Path | None) -> None:
    """Recover, and say what was saved."""
    check_json(json_file)
    own = trail()
    warnings: list[str] = []
    session_file, session = recover(path, target, trail=own, told=warnings.append)
    tell(own)
    for words in warnings:
        console.print(words, markup=False, soft_wrap=True)
    out = people_read(json_file)
    out.print(f"{session_file} holds {len(session.tests)} test(s):", markup=False)
    answer = []
    for test in session.tests:
        seconds = test.samples / test.sample_rate_hz
        out.print(f"  test {test.number}: {test.status}, {test.samples} samples ({seconds:.2f} s)", markup=False)
        answer.append({"test": test.number, "status": test.status, "samples": test.samples})
    if json_file is not None:
        write_json(json_file, {"session": str(session_file), "tests": answer, "warnings": warnings})
