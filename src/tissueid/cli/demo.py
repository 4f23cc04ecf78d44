"""``tissueid demo``: a complete test with simulated firmware over a real serial link."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from tissueid.analysis import Analysis
from tissueid.cli.output import (
    Output,
    table,
)
from tissueid.cli.saved_tests import readable
from tissueid.procedures.demo import DemoPlan, run_demo
from tissueid.procedures.instrument_access import audit_trail
from tissueid.records import Estimate
from tissueid.reports import ComparisonTable

if TYPE_CHECKING:
    pass


def demonstrate(plan: DemoPlan, out: Output) -> None:
    """Run the demo, print its result and write the JSON."""
    result = out.run(run_demo, plan, audit_trail())
    _print_demo(result.page, result.analyses[1], result.comparison, out)
    out.write_json(result.answer)


def _print_demo(page: Path, main: dict[str, Analysis], comparison: ComparisonTable, out: Output) -> None:
    rows = table("Main test", "engine", "VAF fitted %", "VAF held out %", "seconds")
    for engine, analysis in main.items():
        report = analysis.model.report
        rows.add_row(
            engine, f"{report.vaf_percent:.1f}", f"{report.vaf_validation_percent:.1f}", f"{report.seconds:.2f}"
        )
    out.print(rows)
    title = f"Small-amplitude test at {comparison.position_m * 1e3:.2f} mm, against the local values of the plant"
    rows = table(title, "quantity", "estimate", "plant", "error %", "main test", "unit")
    for row in comparison.rows:
        label, small, unit = readable(row.quantity, row.small)
        _, plant, _ = readable(row.quantity, Estimate(row.truth))
        _, large, _ = readable(row.quantity, row.large)
        error = 100.0 * (row.small.value / row.truth - 1.0)
        rows.add_row(label, small, plant, f"{error:+.1f}", large, unit)
    out.print(rows)
    out.print(f"open {page} in a browser. Research use only.")
