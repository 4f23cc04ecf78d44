"""``tissueid readings``: readings of commercial probes from a step test and from a model."""

from __future__ import annotations

from pathlib import Path

from tissueid.analysis.device_readings import DeviceReadings
from tissueid.analysis.step_readings import Reading
from tissueid.cli.output import check_json, console_control, human_output, table, write_json
from tissueid.formatting import plus_minus
from tissueid.messages import MISSING
from tissueid.procedures.readings import ReadingsPlan, run_readings
from tissueid.units import display_unit

_WIDTH = 120
"""Width of the output in characters if it does not go to a terminal."""


def print_readings(plan: ReadingsPlan, json_file: Path | None) -> None:
    """Compute the readings, print them and write the JSON and the page."""
    check_json(json_file)
    with console_control() as control:
        result = run_readings(plan, control)
    found, out = result.found, human_output(json_file, _WIDTH)
    reasons: dict[str, int] = {}
    rows = table(_title(found), "reading", "", "recorded step", "model", "unit", "notes")
    for recorded, model in found.rows():
        definition = recorded.definition
        unit, scale = display_unit(definition.si_unit)
        marks = [str(reasons.setdefault(one.reason, len(reasons) + 1)) for one in (recorded, model) if one.reason]
        cells = [_cell(one, scale) for one in (recorded, model)]
        rows.add_row(definition.symbol, str(definition.meaning), *cells, unit, ",".join(dict.fromkeys(marks)))
    out.print(rows)
    for reason, number in reasons.items():
        out.print(f"  {number}. {reason}", markup=False)
    for note in found.notes:
        out.print(str(note), markup=False)
    if plan.page is not None:
        out.print(f"report: {plan.page}", markup=False)
    if json_file is not None:
        write_json(json_file, {"session_id": result.session.session_id} | found.as_answer())


def _cell(reading: Reading, scale: float) -> str:
    return MISSING if reading.found is None else plus_minus(reading.found, scale)


def _title(found: DeviceReadings) -> str:
    parts = []
    if found.recorded is not None:
        parts.append(f"step test {found.recorded.test.number}")
    if found.analysis is not None:
        parts.append(f"{found.analysis.model.report.engine} on test {found.analysis.test}")
    step = found.course
    force = "" if step is None else f", {step.low_n:.2f} to {step.high_n:.2f} N for {step.hold_s:.2f} s"
    return f"Readings: {', '.join(parts)}{force}"
