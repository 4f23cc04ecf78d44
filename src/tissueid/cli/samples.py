"""``tissueid samples``: small sample sessions."""

from __future__ import annotations

from pathlib import Path

from tissueid.cli.output import check_json, console_control, human_output, table, write_json
from tissueid.procedures.samples import SAMPLES, SamplesPlan, make_samples


def print_samples(plan: SamplesPlan, json_file: Path | None) -> None:
    """Record the samples, and print what each contains and what to try.

    Raises:
        UnusableInputError: the folder or a file cannot be used.
    """
    check_json(json_file)
    with console_control() as control:
        made = make_samples(plan, control)
    rows = table(f"Samples in {plan.out}", "file", "tests", "content", "try")
    for name, session in made.items():
        rows.add_row(name, str(len(session.tests)), SAMPLES[name].about, SAMPLES[name].command)
    human_output(json_file, width=150).print(rows)
    if json_file is not None:
        answer = [
            {"file": str(plan.out / name), "session_id": session.session_id, "tests": len(session.tests)}
            for name, session in made.items()
        ]
        write_json(json_file, answer)
