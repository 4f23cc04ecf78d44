"""What is computed of a saved test: quality, readings, report."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.plan_options import Option, Plan
from tissueid.procedures.control import Control
from tissueid.procedures.identification import engine_options
from tissueid.procedures.output_files import HTML, PDF, check_different, check_output, check_report, write_text, writing

if TYPE_CHECKING:
    from tissueid.acquisition.quality import Quality
    from tissueid.analysis import Analysis
    from tissueid.analysis.device_readings import DeviceReadings
    from tissueid.reports.pdf import FurtherTable
    from tissueid.sessions import Session, Test


class QualityPlan(Plan):
    """A session, and the number of one of its tests; None for all."""

    session: Annotated[Path, Option(argument=True, metavar="SESSION", help="session file")]
    test: Annotated[int | None, Option("--test", metavar="N", help="one test; default: all")] = None


def judge_tests(plan: QualityPlan) -> tuple[Session, tuple[tuple[Test, Quality], ...]]:
    """Return a session and its tests with their quality, which is judged again; the file is not changed.

    Raises:
        UnusableInputError: the file is not a session, or does not contain the test.
    """
    from tissueid.acquisition.quality import judge_session
    from tissueid.sessions import read_session

    session = read_session(plan.session)
    chosen = session.test(plan.test).number if plan.test is not None or not session.tests else None
    return session, tuple((test, quality) for test, quality in judge_session(session) if chosen in (None, test.number))


_REFITTING = marked("Refitting the model")


class ReadingsPlan(Plan):
    """A step test, a stochastic test with an engine, and the files to write."""

    session: Annotated[Path, Option(argument=True, metavar="SESSION", help="session file")]
    test: Annotated[
        int | None,
        Option("--test", metavar="N", help="step test; default: the first one; a stochastic test: its model alone"),
    ] = None
    fit_test: Annotated[
        int | None,
        Option("--fit-test", metavar="N", help="test that the model is fitted to; default: the first stochastic test"),
    ] = None
    model_session: Annotated[
        Path | None,
        Option("--model-session", metavar="SESSION", help="session with the stochastic test; default: SESSION"),
    ] = None
    engine: Annotated[str, Option("--engine", metavar="NAME", help="engine of the model")] = "wiener"
    memory_s: Annotated[
        float | None, Option("--memory", metavar="SECONDS", help="memory length; from the record if not given")
    ] = None
    options: Annotated[
        tuple[str, ...],
        Option("--option", metavar="NAME=VALUE", help="another option of the engine; may be repeated"),
    ] = ()
    draws: Annotated[
        int,
        Option("--draws", metavar="N", help="refits for the uncertainty of the model; 0: none"),
        Field(ge=0, le=1000),
    ] = 40
    page: Annotated[Path | None, Option("--report", metavar="FILE", help="write the readings as one HTML page")] = None


def run_readings(plan: ReadingsPlan, control: Control) -> tuple[Session, DeviceReadings]:
    """Compute the readings of a plan and write its page; return them after the session of the step test.

    Raises:
        UnusableInputError: a session, a test, the engine or an option cannot be used, neither way gives readings, or
            the page cannot be written.
        CancelledError: it was cancelled; nothing was written.
    """
    from tissueid.analysis import analyse
    from tissueid.analysis.device_readings import device_readings, step_test
    from tissueid.identification import get_engine
    from tissueid.sessions import read_session

    check_output(plan.page, HTML)
    options = engine_options(plan.options, plan.memory_s)
    engine = get_engine(plan.engine).from_options(options)
    session = read_session(plan.session)
    check_report(plan.page, session)
    fitted = session if plan.model_session is None else read_session(plan.model_session)
    step, number = step_test(session, plan.test), plan.fit_test
    if plan.test is not None and step is not None and step.kind == "stochastic":
        step, number = None, plan.test if number is None else number
    stochastic = next((test.number for test in fitted.tests if test.kind == "stochastic"), None)
    number = stochastic if number is None else fitted.test(number).number
    control.check()
    readings = device_readings(
        step,
        None if number is None else lambda: analyse(fitted, plan.engine, options, test=number),
        engine,
        draws=plan.draws,
        progress=lambda done, total: control.follow(_REFITTING, done / total),
    )
    if plan.page is not None:
        from tissueid.reports.readings_page import readings_page

        write_text(plan.page, readings_page(session, readings))
    return session, readings


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
        control.follow(_FITTING, done / len(names))
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


def run_report(plan: ReportPlan, control: Control, opened: Callable[[], Session] | None = None) -> AnalysedTest:
    """Analyse a test, write the files of the plan, and return the analyses.

    Args:
        plan: the test and the files.
        control: progress and cancellation.
        opened: returns the session; by default it is read from the file of the plan.

    Raises:
        UnusableInputError: the test or an engine is unknown, no engine can use the test, or a file cannot be written.
    """
    from tissueid.sessions import read_session

    check_output(plan.page, HTML)
    check_output(plan.pdf, PDF)
    check_different(plan.page, plan.pdf)
    session = read_session(plan.session) if opened is None else opened()
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
