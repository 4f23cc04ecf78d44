"""Statistics and report of a study, after its sessions are analysed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tissueid.errors import UnusableInputError
from tissueid.extras import check_packages
from tissueid.formatting import clean
from tissueid.language import marked
from tissueid.messages import MISSING, Verbatim, joined
from tissueid.procedures.control import Control
from tissueid.procedures.output_files import HTML, PDF, check_different, check_output, write_text, writing
from tissueid.procedures.study_plans import RESULTS, StudyReportPlan
from tissueid.procedures.study_protocol import read_protocol
from tissueid.procedures.study_run import StudyRun, run_study
from tissueid.procedures.test_plan import MAX_TEXT

if TYPE_CHECKING:
    import pandas as pd

    from tissueid.studies.study_statistics import StudyStatistics

_COMPUTING = marked("Computing statistics")


@dataclass(frozen=True)
class StudyReport:
    """A study with its statistics, and the page; of the subjects that meet the conditions of ``subgroup``."""

    run: StudyRun
    statistics: StudyStatistics
    page: Path
    pdf: Path | None
    subgroup: tuple[str, ...] = ()

    def as_answer(self) -> dict[str, Any]:
        """Return the statistics for JSON."""
        return self.run.as_answer() | {"subgroup": self.subgroup} | self.statistics.as_answer()


def study_name(folder: Path) -> str:
    """Return the name in the protocol of a study, or that of its folder if it has no readable protocol."""
    try:
        return read_protocol(folder).name
    except UnusableInputError:
        return folder.resolve().name


def report_study(plan: StudyReportPlan, control: Control) -> StudyReport:
    """Analyse what has changed, compute the statistics and write the page.

    Raises:
        UnusableInputError: the folder, the engine, an option or a file cannot be used, a column or condition does not
            exist, or a package is missing.
        CancelledError: it was cancelled; what is analysed already is kept.
    """
    check_packages("pandas", "pyarrow", "statsmodels", "sklearn")
    check_output(plan.report, HTML)
    check_output(plan.pdf, PDF)
    check_different(plan.report, plan.pdf)
    run = run_study(plan, control)
    _check_names(plan, run.table)
    from tissueid.studies.study_table import subgroup

    run = replace(run, table=subgroup(run.table, plan.only))
    from tissueid.reports.study_page import study_html, write_study_pdf
    from tissueid.studies.study_statistics import study_statistics

    control.progress(0.0, _COMPUTING)
    found = study_statistics(
        run.table,
        run.curves,
        factors=plan.factors,
        regressors=plan.regressors,
        before=plan.before,
        after=plan.after,
        margin=plan.margin,
    )
    control.check()
    page = plan.report or plan.folder / RESULTS / "report.html"
    name = ", ".join((study_name(plan.folder), *plan.only))
    write_text(page, study_html(name, plan.engine, found, run.failures))
    if plan.pdf is not None:
        with writing(plan.pdf):
            write_study_pdf(plan.pdf, name, plan.engine, found, run.failures)
    control.progress(1.0, _COMPUTING)
    return StudyReport(run, found, page, plan.pdf, plan.only)


def _check_names(plan: StudyReportPlan, table: pd.DataFrame) -> None:
    """Check that the table has the columns and conditions that were asked for.

    Raises:
        UnusableInputError: it has not.
    """
    from tissueid.studies.study_table import subject_columns

    for name in (*plan.factors, *plan.regressors):
        if name not in table:
            raise UnusableInputError(
                "study.unknown_column",
                "there is no column '{name}'; columns with values of subjects: {known}",
                name=Verbatim(clean(name)[:MAX_TEXT]),
                known=joined(map(Verbatim, subject_columns(table))) or MISSING,
            )
    known = sorted({str(name) for name in table["condition"].dropna() if name})
    for condition in filter(None, (plan.before, plan.after)):
        if condition not in known:
            raise UnusableInputError(
                "study.unknown_condition",
                "no test has the condition '{name}'; conditions: {known}",
                name=Verbatim(clean(condition)[:MAX_TEXT]),
                known=joined(map(Verbatim, known)) or MISSING,
            )
