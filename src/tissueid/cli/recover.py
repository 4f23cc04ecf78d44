"""``tissueid recover``: recover a session after a crash."""

from __future__ import annotations

from pathlib import Path

from tissueid.cli.output import ConsoleControl, check_json, human_output, progress_bars, write_json
from tissueid.messages import stored
from tissueid.procedures.instrument_access import audit_trail
from tissueid.procedures.recovery import RecoveryPlan, run_recovery


def recover_session(plan: RecoveryPlan, json_file: Path | None) -> None:
    """Recover a session and print its tests."""
    check_json(json_file)
    with progress_bars() as show:
        recovered = run_recovery(plan, ConsoleControl(show), audit_trail())
    out = human_output(json_file)
    out.print(f"{recovered.path} contains {len(recovered.session.tests)} test(s):", markup=False)
    answer = []
    for test in recovered.session.tests:
        seconds = test.samples / test.sample_rate_hz
        out.print(f"  test {test.number}: {test.status}, {test.samples} samples ({seconds:.2f} s)", markup=False)
        answer.append({"test": test.number, "status": test.status, "samples": test.samples})
    if json_file is not None:
        write_json(
            json_file,
            {
                "session": str(recovered.path),
                "tests": answer,
                "warnings": list(recovered.warnings),
                "warning_messages": list(map(stored, recovered.warnings)),
            },
        )
