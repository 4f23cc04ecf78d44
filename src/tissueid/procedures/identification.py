"""Fit of one engine to saved tests, with the tests of its residual."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tissueid.errors import UnusableInputError
from tissueid.messages import Verbatim, joined
from tissueid.plan_options import Option, Plan, parse_options
from tissueid.procedures.control import Control

if TYPE_CHECKING:  # each takes long to import
    from tissueid.analysis import Analysis
    from tissueid.analysis.split import Selection
    from tissueid.identification import Engine
    from tissueid.identification.validation.residual_tests import ResidualTests
    from tissueid.sessions import Session


class FitPlan(Plan):
    """The tests that are fitted, the test for validation, and the signals."""

    session: Annotated[Path, Option(argument=True, metavar="SESSION", help="session file")]
    test: Annotated[
        int | None, Option("--test", metavar="N", help="test to fit; default: the first stochastic test")
    ] = None
    also: Annotated[
        tuple[int, ...], Option("--also", metavar="N", help="another test to fit jointly; may be repeated")
    ] = ()
    validation_test: Annotated[
        int | None,
        Option(
            "--validate",
            metavar="N",
            help="test for validation; default: the last quarter of the test is held out",
        ),
    ] = None
    input_name: Annotated[str, Option("--input", metavar="SIGNAL", help="input signal")] = "force"
    output_name: Annotated[str, Option("--output", metavar="SIGNAL", help="output signal")] = "position"
    detrend: Annotated[bool, Option("--detrend", help="subtract the linear drift of the output before the fit")] = False
    low_hz: Annotated[
        float | None, Option("--band-low", metavar="HZ", help="remove lower frequencies from both signals")
    ] = None
    high_hz: Annotated[
        float | None, Option("--band-high", metavar="HZ", help="remove higher frequencies from both signals")
    ] = None

    @property
    def selection(self) -> Selection:
        """Tests and signals for an analysis or a comparison."""
        return {
            "test": self.test,
            "also": self.also,
            "validate": self.validation_test,
            "input_name": self.input_name,
            "output_name": self.output_name,
            "detrend": self.detrend,
            "band_hz": (self.low_hz, self.high_hz),
        }


class IdentificationPlan(FitPlan):
    """An engine with its options, and the tests that it is fitted to."""

    engine: Annotated[
        str | None,
        Option("--engine", metavar="NAME", help="required, such as lms or wiener; without it, lists all engines"),
    ] = None
    memory_s: Annotated[
        float | None, Option("--memory", metavar="SECONDS", help="memory length; from the record if not given")
    ] = None
    options: Annotated[
        tuple[str, ...],
        Option("--option", metavar="NAME=VALUE", help="another option of the engine; may be repeated"),
    ] = ()
    tissue_alone: Annotated[
        bool,
        Option("--tissue-alone", help="also report mass and damping without the moving part of the instrument"),
    ] = False


class EnginesPlan(Plan):
    """The engine whose options are listed; None for all engines."""

    engine: Annotated[str | None, Option(argument=True, metavar="[ENGINE]", help="engine whose options are listed")] = (
        None
    )


def listed_engines(plan: EnginesPlan) -> list[type[Engine]]:
    """Return the engine of a plan, or all.

    Raises:
        UnusableInputError: there is no engine of that name.
    """
    from tissueid.identification import engine_names, get_engine

    return [get_engine(name) for name in ((plan.engine,) if plan.engine is not None else engine_names())]


@dataclass(frozen=True)
class IdentifiedTests:
    """An analysis with its session, and the tests of the held-out residual; None if too little is held out."""

    session: Session
    analysis: Analysis
    residual_tests: ResidualTests | None


def run_identification(plan: IdentificationPlan, control: Control) -> IdentifiedTests:
    """Fit the engine of a plan and validate it.

    Raises:
        UnusableInputError: no engine is named, or the session, a test or an option cannot be used.
    """
    from tissueid.analysis import analyse
    from tissueid.identification.registry import engine_names
    from tissueid.identification.validation.residual_tests import residual_tests
    from tissueid.sessions import read_session

    if plan.engine is None:
        raise UnusableInputError(
            "identify.no_engine", "--engine is required: one of {names}", names=joined(map(Verbatim, engine_names()))
        )
    options = parse_options(plan.options)
    if plan.memory_s is not None:
        if "memory" in options:
            raise UnusableInputError("identify.memory_twice", "the memory is given twice, by --memory and by --option")
        options["memory"] = plan.memory_s
    session = read_session(plan.session)
    control.check()
    analysis = analyse(
        session,
        plan.engine,
        options,
        tissue_alone=plan.tissue_alone,
        **plan.selection,
    )
    try:
        tests = residual_tests(analysis.model, analysis.held_out_record, analysis.held_out)
    except UnusableInputError:
        tests = None
    return IdentifiedTests(session, analysis, tests)
