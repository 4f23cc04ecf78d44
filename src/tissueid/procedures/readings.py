"""Readings of commercial probes from a step test and from an identified model, with the page."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.plan_options import Option, Plan, parse_options
from tissueid.procedures.control import Control
from tissueid.procedures.output_files import HTML, check_output, check_report, write_text

if TYPE_CHECKING:  # each takes long to import
    from tissueid.analysis.device_readings import DeviceReadings
    from tissueid.sessions import Session

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


@dataclass(frozen=True)
class SessionReadings:
    """Readings with the session of the step test."""

    session: Session
    found: DeviceReadings


def run_readings(plan: ReadingsPlan, control: Control) -> SessionReadings:
    """Compute the readings of a plan and write its page.

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
    options = parse_options(plan.options)
    if plan.memory_s is not None:
        if "memory" in options:
            raise UnusableInputError("identify.memory_twice", "the memory is given twice, by --memory and by --option")
        options["memory"] = plan.memory_s
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

    def progress(done: int, total: int) -> None:
        control.progress(done / total, _REFITTING)
        control.check()

    found = device_readings(
        step,
        None if number is None else lambda: analyse(fitted, plan.engine, options, test=number),
        engine,
        draws=plan.draws,
        progress=progress,
    )
    if plan.page is not None:
        from tissueid.reports.readings_page import readings_page

        write_text(plan.page, readings_page(session, found))
    return SessionReadings(session, found)
