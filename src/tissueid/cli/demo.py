"""``tissueid demo``: a complete test with simulated firmware over a real serial link."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from tissueid.analysis import Analysis
from tissueid.cli.identify import readable
from tissueid.cli.output import check_json, console_control, human_output, table, write_json
from tissueid.procedures.demo import DemoPlan, run_demo
from tissueid.procedures.instrument_access import audit_trail
from tissueid.records import Estimate
from tissueid.reports import ComparisonTable


def demonstrate(plan: DemoPlan, json_file: Path | None) -> None:
    """Run the demo, print its result and write the JSON."""
    check_json(json_file)
    with console_control() as control:
        result = run_demo(plan, control, audit_trail())
    _print_result(result.page, result.analyses[1], result.comparison, human_output(json_file))
    if json_file is not None:
        write_json(json_file, result.answer)


def _print_result(page: Path, main: dict[str, Analysis], comparison: ComparisonTable, console: Console) -> None:
    rows = table("Main test", "engine", "VAF fitted %", "VAF held out %", "seconds")
    for engine, analysis in main.items():
        report = analysis.model.report
        rows.add_row(
            engine, f"{report.vaf_percent:.1f}", f"{report.vaf_validation_percent:.1f}", f"{report.seconds:.2f}"
        )
    console.print(rows)
    title = f"Small-amplitude test at {comparison.position_m * 1e3:.2f} mm, against the local values of the plant"
    rows = table(title, "quantity", "estimate", "plant", "error %", "main test", "unit")
    for row in comparison.rows:
        label, small, unit = readable(row.quantity, row.small)
        _, plant, _ = readable(row.quantity, Estimate(row.truth))
        _, large, _ = readable(row.quantity, row.large)
        error = 100.0 * (row.small.value / row.truth - 1.0)
        rows.add_row(label, small, plant, f"{error:+.1f}", large, unit)
    console.print(rows)
    console.print(f"open {page} in a browser. Research use only.", markup=False)
