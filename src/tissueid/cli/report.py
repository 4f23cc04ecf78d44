"""``tissueid report``: write the report of a test."""

from __future__ import annotations

from tissueid.cli.output import console_control, human_output
from tissueid.procedures.report import ReportPlan, run_report


def report_test(plan: ReportPlan) -> None:
    """Write the page of a test and optionally a short PDF; print the files and the engines that are left out.

    Raises:
        UnusableInputError: the test or an engine is unknown, no engine can use the test, or a file cannot be written.
    """
    with console_control() as control:
        analysed = run_report(plan, control)
    count, out = len(analysed.session.tests), human_output(None)
    which = f", test {analysed.test.number} of {count}" if count > 1 else ""
    for path in (plan.page, plan.pdf):
        if path is not None:
            out.print(f"report: {path}{which}", markup=False)
    for name, why in analysed.refused.items():
        out.print(f"without {name}: {why}", markup=False, soft_wrap=True)
