"""``tissueid calibrate static``: static calibration of an instrument, automatic or with a person."""

from __future__ import annotations

from pathlib import Path

from tissueid.calibration.labels import readable
from tissueid.cli.calibrate_output import answer, check_outputs, check_result, print_verdict, terminal_control
from tissueid.cli.output import human_output, table, write_json
from tissueid.procedures.calibration_plans import StaticCalibrationPlan
from tissueid.procedures.instrument_access import audit_trail
from tissueid.procedures.static_calibration import run_static_calibration


def print_static_calibration(plan: StaticCalibrationPlan, json_file: Path | None) -> None:
    """Calibrate and print the calibration.

    Raises:
        UnusableInputError: an option cannot be used, or the calibration failed.
    """
    check_outputs(plan, json_file)
    with terminal_control() as control:
        result = run_static_calibration(plan, control, audit_trail("technician"))
    out = human_output(json_file, width=120)
    rows = table(f"Static calibration of {result.calibration.serial_number}", "quantity", "value", "unit")
    for name, quantity in result.calibration.quantities.items():
        rows.add_row(*readable(name, quantity))
    out.print(rows)
    print_verdict(out, result)
    if json_file is not None:
        write_json(json_file, answer(result) | {"seconds": result.seconds})
    check_result(result, plan.out)
