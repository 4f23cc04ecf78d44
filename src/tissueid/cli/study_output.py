"""Output of ``tissueid study``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd

from tissueid.cli.output import check_json, console_control, human_output, table, write_json
from tissueid.formatting import axis_label, label_and_unit, number
from tissueid.messages import MISSING
from tissueid.procedures.output_files import check_different
from tissueid.procedures.study_demo import PopulationPlan, run_population
from tissueid.procedures.study_plans import RESULTS, StudyPlan, StudyReportPlan
from tissueid.procedures.study_report import StudyReport, report_study
from tissueid.procedures.study_run import StudyRun, run_study
from tissueid.studies.repeatability import variation_by_condition
from tissueid.studies.study_statistics import study_statistics
from tissueid.studies.study_table import as_json_rows
from tissueid.studies.usable_tests import parameters_used, usable_tests
from tissueid.units import display_unit


def print_run(plan: StudyPlan, json_file: Path | None) -> None:
    """Analyse a study and print the counts.

    Raises:
        UnusableInputError: the folder or an option cannot be used.
    """
    check_json(json_file)
    with console_control() as control:
        run = run_study(plan, control)
    _print_counts(run, json_file)
    if json_file is not None:
        write_json(json_file, _answer(run) | {"rows": as_json_rows(run.table)})


def print_table(plan: StudyPlan, json_file: Path | None) -> None:
    """Analyse a study and print mean and variation by site, condition and parameter.

    Raises:
        UnusableInputError: the folder or an option cannot be used.
    """
    check_json(json_file)
    with console_control() as control:
        run = run_study(plan, control)
    used = usable_tests(run.table).used
    rows = variation_by_condition(used, parameters_used(used, []))
    console = human_output(json_file)
    several = not rows.empty and rows["condition"].nunique() > 1
    where = ("Site", "Condition") if several else ("Site",)
    title = "Parameters by site and condition" if several else "Parameters by site"
    shown = table(title, *where, "Parameter", "Subjects", "Tests", "Mean", "SD", "CV within", "CV between")
    for row in rows.to_dict("records"):
        unit, factor = display_unit(label_and_unit(row["parameter"])[1])
        cells = [_text(row["mean"], factor), _text(row["std"], factor)]
        cells += [_percent(row[name]) for name in ("individual_cv", "population_cv")]
        name = axis_label(row["parameter"], unit)
        place = (row["site"], row["condition"] or MISSING) if several else (row["site"],)
        shown.add_row(*place, name, str(row["subjects"]), str(row["tests"]), *cells)
    console.print(shown)
    _print_counts(run, json_file)
    if json_file is not None:
        write_json(json_file, _answer(run) | {"rows": as_json_rows(rows)})


def print_report(plan: StudyReportPlan, json_file: Path | None) -> None:
    """Analyse a study, write its report and print where it is.

    Raises:
        UnusableInputError: the folder, an option or a file cannot be used.
    """
    check_json(json_file)
    check_different(json_file, plan.report, plan.pdf)
    with console_control() as control:
        found = report_study(plan, control)
    _print_report(found, json_file)


def print_population(plan: PopulationPlan, json_file: Path | None) -> None:
    """Measure and report a simulated population.

    Raises:
        UnusableInputError: the folder cannot be used.
    """
    check_json(json_file)
    with console_control() as control:
        found = run_population(plan, control)
    _print_report(found, json_file)


def _print_report(found: StudyReport, json_file: Path | None) -> None:
    console = human_output(json_file)
    for remark in found.statistics.remarks:
        console.print(f"note: {remark}", markup=False, soft_wrap=True)
    _print_counts(found.run, json_file)
    pages = " and ".join(str(path) for path in (found.page, found.pdf) if path is not None)
    console.print(f"report: {pages}", markup=False, soft_wrap=True)
    if json_file is not None:
        write_json(json_file, found.as_answer())


def _answer(run: StudyRun) -> dict[str, Any]:
    return run.as_answer() | study_statistics(run.table).as_answer()


def _print_counts(run: StudyRun, json_file: Path | None) -> None:
    console = human_output(json_file)
    for file, reason in run.failures.items():
        console.print(f"not analysed: {file}: {reason}", markup=False, soft_wrap=True)
    count = len(run.table)
    console.print(f"{count} tests of {run.sessions} sessions, {run.analysed} analysed now", markup=False)
    console.print(f"table: {run.plan.folder / RESULTS / 'table.csv'} and table.parquet", markup=False, soft_wrap=True)


def _text(value: float, factor: float) -> str:
    return MISSING if pd.isna(value) else number(value * factor, 4)


def _percent(share: float) -> str:
    return MISSING if pd.isna(share) else f"{share:.1%}"
