"""``tissueid demo``: a complete test with simulated firmware over a real serial link."""

from __future__ import annotations

from pathlib import Path

from tissueid.analysis import Analysis
from tissueid.cli.output import Output, table
from tissueid.cli.saved_tests import readable
from tissueid.procedures.demo import DemoPlan, run_demo
from tissueid.procedures.instruments import audit_trail
from tissueid.records import Estimate
from tissueid.reports import ComparisonTable


def demonstrate(plan: DemoPlan, out: Output) -> None:
    """Run the demo, print its result and write the JSON."""
    result = out.run(run_demo, plan, audit_trail())
    _print_demo(result.page, result.analyses[1], result.comparison, out)
    out.write_json(result.answer)


def _print_demo(page: Path, main: dict[str, Analysis], comparison: ComparisonTable, out: Output) -> None:
    reports = {engine: analysis.model.report for engine, analysis in main.items()}
    rows = [
        (engine, f"{report.vaf_percent:.1f}", f"{report.vaf_validation_percent:.1f}", f"{report.seconds:.2f}")
        for engine, report in reports.items()
    ]
    out.print(table("Main test", "engine", "VAF fitted %", "VAF held out %", "seconds", rows=rows))
    title = f"Small-amplitude test at {comparison.position_m * 1e3:.2f} mm, against the local values of the plant"
    quantities = table(title, "quantity", "estimate", "plant", "error %", "main test", "unit")
    for row in comparison.rows:
        label, small, unit = readable(row.quantity, row.small)
        _, plant, _ = readable(row.quantity, Estimate(row.truth))
        _, large, _ = readable(row.quantity, row.large)
        error = 100.0 * (row.small.value / row.truth - 1.0)
        quantities.add_row(label, small, plant, f"{error:+.1f}", large, unit)
    out.print(quantities)
    out.print(f"open {page} in a browser. Research use only.")
