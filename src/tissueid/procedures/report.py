"""Report of a saved test: its analyses, the HTML page and the PDF."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.plan_options import Option, Plan
from tissueid.procedures.control import Control
from tissueid.procedures.output_files import HTML, PDF, check_different, check_output, check_report, writing

if TYPE_CHECKING:  # each takes long to import
    from tissueid.analysis import Analysis
    from tissueid.reports.pdf import FurtherTable
    from tissueid.sessions import Session, Test

_FITTING = marked("Fitting the engines")
_WRITING = marked("Writing the report")


class ReportPlan(Plan):
    """A test, the engines of its report and the files to write."""

    session: Annotated[Path, Option(argument=True, metavar="SESSION", help="session file")]
    page: Annotated[Path, Option("--out", metavar="FILE", help="HTML page to write")]
    test: Annotated[
        int | None, Option("--test", metavar="N", help="test to fit; default: the first stochastic test")
    ] = None
    engines: Annotated[
        tuple[str, ...] | None,
        Option("--engines", metavar="A,B,...", separator=",", help="engines to report; default: lms,spectral,wiener"),
    ] = None
    pdf: Annotated[Path | None, Option("--pdf", metavar="FILE", help="also write a short PDF")] = None
    tissue_alone: Annotated[
        bool,
        Option("--tissue-alone", help="also report mass and damping without the moving part of the instrument"),
    ] = False


@dataclass(frozen=True)
class AnalysedTest:
    """A test with its analyses by engine, and the engines that could not use it with their reasons."""

    session: Session
    test: Test
    analyses: dict[str, Analysis]
    refused: dict[str, str]


def analyse_test(
    session: Session,
    number: int | None = None,
    engines: Iterable[str] | None = None,
    control: Control | None = None,
    *,
    tissue_alone: bool = False,
) -> AnalysedTest:
    """Fit the engines of the standard report, or those that are named, to one test.

    An engine that cannot use the test is left out.

    Args:
        session: the session.
        number: of the test; None for the first stochastic one.
        engines: names; None for the standard report.
        control: progress and cancellation.
        tissue_alone: also report mass and damping without those of the actuator.

    Raises:
        UnusableInputError: there is no such test or engine.
    """
    from tissueid.analysis import analyse_all, engines_of
    from tissueid.identification import get_engine

    control = control or Control()
    test = session.test(number)
    analyses: dict[str, Analysis] = {}
    refused: dict[str, str] = {}
    names = engines_of(test) if engines is None else tuple(dict.fromkeys(engines))
    for done, name in enumerate(names):
        get_engine(name)
        control.progress(done / len(names), _FITTING)
        control.check()
        try:
            analyses |= analyse_all(session, (name,), test=test, tissue_alone=tissue_alone)
        except UnusableInputError as error:
            refused[name] = error.message
    return AnalysedTest(session, test, analyses, refused)


def write_page(path: Path, analysed: AnalysedTest) -> Path:
    """Write the HTML page of a test; return its path.

    Raises:
        UnusableInputError: no engine could use the test, or the file cannot be written.
    """
    from tissueid.reports import write_report

    with writing(path):
        analyses = {analysed.test.number: analysed.analyses}
        write_report(path, analysed.session, analyses, refused=analysed.refused)
    return path


def write_pdf(
    path: Path,
    analysed: AnalysedTest,
    result: tuple[FurtherTable, Sequence[str]] | None = None,
    further: Sequence[FurtherTable] = (),
) -> Path:
    """Write the PDF of a test with further tables; return its path.

    Raises:
        UnusableInputError: no engine could use the test, or the file cannot be written.
    """
    from tissueid.reports import pdf

    with writing(path):
        pdf.write_pdf(path, analysed.session, analysed.test, analysed.analyses, result=result, further=further)
    return path


def run_report(plan: ReportPlan, control: Control) -> AnalysedTest:
    """Analyse a test, write the files of the plan, and return the analyses.

    Raises:
        UnusableInputError: the test or an engine is unknown, no engine can use the test, or a file cannot be written.
    """
    from tissueid.sessions import read_session

    check_output(plan.page, HTML)
    check_output(plan.pdf, PDF)
    check_different(plan.page, plan.pdf)
    session = read_session(plan.session)
    for target in (plan.page, plan.pdf):
        check_report(target, session)
    analysed = analyse_test(session, plan.test, plan.engines, control, tissue_alone=plan.tissue_alone)
    if not analysed.analyses and analysed.refused:
        raise UnusableInputError(next(iter(analysed.refused.values())))
    control.progress(None, _WRITING)
    write_page(plan.page, analysed)
    if plan.pdf is not None:
        write_pdf(plan.pdf, analysed)
    return analysed
