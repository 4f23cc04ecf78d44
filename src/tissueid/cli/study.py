"""Commands of studies: run, table, report, demo, protocol, sitting."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from tissueid.cli.output import ConsoleControl, Output, progress_bars, table
from tissueid.cli.stop_key import StopKey, stop_key
from tissueid.formatting import axis_label, label_and_unit, number
from tissueid.messages import MISSING
from tissueid.procedures.instruments import audit_trail
from tissueid.procedures.output_files import check_different
from tissueid.procedures.study_demo import PopulationPlan, run_population
from tissueid.procedures.study_plans import RESULTS, StudyPlan, StudyReportPlan
from tissueid.procedures.study_protocol import PROTOCOL_FILE, sitting_steps
from tissueid.procedures.study_run import StudyReport, StudyRun, report_study, run_study
from tissueid.procedures.study_sitting import (
    ProtocolPlan,
    SittingRunPlan,
    SittingState,
    open_sitting,
    run_sitting,
    write_protocol,
)
from tissueid.units import display_unit

if TYPE_CHECKING:
    import pandas as pd


def print_run(plan: StudyPlan, out: Output) -> None:
    """Analyse a study and print the counts.

    Raises:
        UnusableInputError: the folder or an option cannot be used.
    """
    run = out.run(run_study, plan)
    _print_counts(run, out)
    _write_answer(run, run.table, out)


def print_table(plan: StudyPlan, out: Output) -> None:
    """Analyse a study and print mean and variation by site, condition and parameter.

    Raises:
        UnusableInputError: the folder or an option cannot be used.
    """
    run = out.run(run_study, plan)
    from tissueid.studies.repeatability import variation_by_condition  # imports pandas, after it was checked
    from tissueid.studies.usable_tests import parameters_used, usable_tests

    used = usable_tests(run.table).used
    rows = variation_by_condition(used, parameters_used(used, []))
    several = not rows.empty and rows["condition"].nunique() > 1
    where = ("Site", "Condition") if several else ("Site",)
    title = "Parameters by site and condition" if several else "Parameters by site"
    shown = table(title, *where, "Parameter", "Subjects", "Tests", "Mean", "SD", "CV within", "CV between")
    for row in rows.to_dict("records"):
        unit, factor = display_unit(label_and_unit(row["parameter"])[1])
        cells = [_text(row["mean"], factor), _text(row["std"], factor)]
        cells += [_percent(row[name]) for name in ("individual_cv", "population_cv")]
        name = axis_label(row["parameter"], unit)
        group = (row["site"], row["condition"] or MISSING) if several else (row["site"],)
        shown.add_row(*group, name, str(row["subjects"]), str(row["tests"]), *cells)
    out.print(shown)
    _print_counts(run, out)
    _write_answer(run, rows, out)


def print_report(plan: StudyReportPlan, out: Output) -> None:
    """Analyse a study, write its report and print where it is.

    Raises:
        UnusableInputError: the folder, an option or a file cannot be used.
    """
    check_different(out.json_file, plan.report, plan.pdf)
    _print_report(out.run(report_study, plan), out)


def print_population(plan: PopulationPlan, out: Output) -> None:
    """Measure and report a simulated population.

    Raises:
        UnusableInputError: the folder cannot be used.
    """
    _print_report(out.run(run_population, plan), out)


def _print_report(report: StudyReport, out: Output) -> None:
    out.print_lines((f"note: {remark}" for remark in report.statistics.remarks), soft_wrap=True)
    _print_counts(report.run, out)
    pages = " and ".join(str(path) for path in (report.page, report.pdf) if path is not None)
    out.print(f"report: {pages}", soft_wrap=True)
    out.write_json(report.as_answer())


def _write_answer(run: StudyRun, rows: pd.DataFrame, out: Output) -> None:
    from tissueid.studies.study_statistics import study_statistics
    from tissueid.studies.study_table import as_json_rows

    out.write_json(run.as_answer() | study_statistics(run.table).as_answer() | {"rows": as_json_rows(rows)})


def _print_counts(run: StudyRun, out: Output) -> None:
    out.print_lines((f"not analysed: {file}: {reason}" for file, reason in run.failures.items()), soft_wrap=True)
    count = len(run.table)
    out.print(f"{count} tests of {run.sessions} sessions, {run.analysed} analysed now")
    out.print(f"table: {run.plan.folder / RESULTS / 'table.csv'} and table.parquet", soft_wrap=True)


def _text(value: float, factor: float) -> str:
    return MISSING if math.isnan(value) else number(value * factor, 4)


def _percent(share: float) -> str:
    return MISSING if math.isnan(share) else f"{share:.1%}"


def print_protocol(plan: ProtocolPlan, out: Output) -> None:
    """Check or write a protocol and print its order.

    Raises:
        UnusableInputError: it is not valid, or cannot be written.
    """
    protocol, written = write_protocol(plan)
    path = plan.folder / PROTOCOL_FILE
    out.print(f"{'template written' if written else 'protocol'}: {path}", soft_wrap=True)
    steps = sitting_steps(protocol, "P01")
    order = "fixed" if protocol.order == "fixed" else "randomised by subject; shown for P01"
    rows = [(step.site, step.condition.text or MISSING, str(step.repeats)) for step in steps if step.repeat == 1]
    title = f"{protocol.name}: {len(steps)} tests for each subject, order {order}"
    out.print(table(title, "Site", "Condition", "Tests", rows=rows))
    out.print(f"asks for: {', '.join(protocol.demographics) or 'nothing'}", soft_wrap=True)
    out.write_json({"protocol": protocol.model_dump(mode="json"), "written": written, "tests": len(steps)})


def print_sitting(plan: SittingRunPlan, out: Output) -> None:
    """Run what is left of a sitting and print where it stands, also if it ends early.

    Raises:
        TissueIDError: it could not start, or a test failed or was stopped.
    """
    try:
        with contextlib.ExitStack() as stack:
            control = _SittingControl(stack.enter_context(progress_bars()), stack.enter_context(stop_key()))
            state = run_sitting(plan, control, audit_trail())
    except BaseException:
        with contextlib.suppress(Exception):  # the first error is the one that is shown
            if (state := open_sitting(plan.folder, plan.subject)).tests:
                _print_state(state, out)
        raise
    _print_state(state, out)
    out.write_json(
        {
            "subject": state.subject,
            "steps": state.total,
            "done": _done(state),
            "tests": [test.condition.model_dump() | {"site": test.site, "counts": test.counts} for test in state.tests],
            "problems": dict(state.problems),
        }
    )


def _done(state: SittingState) -> int:
    return state.total if state.step is None else state.step.position - 1


class _SittingControl(ConsoleControl):
    """Shows progress and notices; the stop keys end the sitting."""

    def __init__(self, show: Callable[[str, float | None], None], key: StopKey) -> None:
        super().__init__(show)
        self._key = key

    def check(self) -> bool:
        """Return False, or raise if a stop key was pressed."""
        return self._key.check()


def _print_state(state: SittingState, out: Output) -> None:
    out.print(f"{state.subject}: {_done(state)} of {state.total} steps done")
    if poor := sum(not test.counts for test in state.tests):
        out.print(f"{poor} tests do not count: their quality is 'repeat'")
    if (step := state.step) is not None:
        where = f"{step.site}, test {step.repeat} of {step.repeats}"
        out.print(f"next: {where}; the same command continues", soft_wrap=True)
    out.print(f"sessions: {state.sessions}", soft_wrap=True)
