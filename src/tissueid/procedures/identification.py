"""Fits of engines to saved tests: one engine with the tests of its residual, or a comparison of several."""

from __future__ import annotations

import functools
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Unpack

from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.messages import Verbatim, joined
from tissueid.plan_options import Option, Plan, parse_options
from tissueid.procedures.cluster import ClusterPlan, plan_executor
from tissueid.procedures.control import Control, CountedProgress
from tissueid.procedures.output_files import HTML, check_output, check_report, write_figures

if TYPE_CHECKING:  # each takes long to import
    from tissueid.analysis import Analysis, EngineComparison, Split
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


def engine_options(given: Sequence[str], memory_s: float | None) -> dict[str, Any]:
    """Return the options of an engine from NAME=VALUE and its memory, s.

    Raises:
        UnusableInputError: one is malformed, or the memory is given twice.
    """
    options = parse_options(given)
    if memory_s is None:
        return options
    if "memory" in options:
        raise UnusableInputError("identify.memory_twice", "the memory is given twice, by --memory and by --option")
    return options | {"memory": memory_s}


def run_identification(plan: IdentificationPlan, control: Control) -> tuple[Session, Analysis, ResidualTests | None]:
    """Fit the engine of a plan and validate it.

    Returns:
        The session, the analysis, and the tests of the held-out residual; None if too little is held out.

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
    options = engine_options(plan.options, plan.memory_s)
    session = read_session(plan.session)
    control.check()
    analysis = analyse(session, plan.engine, options, tissue_alone=plan.tissue_alone, **plan.selection)
    try:
        return session, analysis, residual_tests(analysis.model, analysis.held_out_record, analysis.held_out)
    except UnusableInputError:
        return session, analysis, None


_FITTING = marked("Fitting engines")


class ComparePlan(FitPlan, ClusterPlan):
    """Tests, engines with their options, and the files to write."""

    engines: Annotated[
        tuple[str, ...] | None,
        Option("--engines", metavar="A,B,...", separator=",", help="engines to compare; default: all"),
    ] = None
    memory_s: Annotated[
        float | None,
        Option(
            "--memory",
            metavar="SECONDS",
            help="memory length of all engines that have one; from the record if not given",
        ),
    ] = None
    options: Annotated[
        tuple[str, ...],
        Option("--option", metavar="ENGINE.NAME=VALUE", help="option of one engine; may be repeated"),
    ] = ()
    sweep: Annotated[bool, Option("--memory-sweep", help="also compute scores against memory; slow")] = False
    page: Annotated[Path | None, Option("--out", metavar="FILE", help="write the report, one HTML page")] = None
    figures: Annotated[
        Path | None, Option("--figures", metavar="DIR", help="folder for all figures as SVG and PNG")
    ] = None


@dataclass(frozen=True)
class ComparedTests:
    """A comparison with its session. ``no_ceiling`` says why the limit set by repeats is not known."""

    session: Session
    comparison: EngineComparison
    no_ceiling: str = ""
    figures: tuple[Path, ...] = ()


def run_comparison(plan: ComparePlan, control: Control) -> ComparedTests:
    """Compare the engines of a plan and write its page and figures.

    Raises:
        UnusableInputError: the session, a test, an engine, an option or a file cannot be used.
        CancelledError: it was cancelled; nothing was written.
    """
    from tissueid.analysis import specifications
    from tissueid.sessions import read_session

    check_output(plan.page, HTML)
    check_figures(plan.figures)
    _check_writable(plan.page if plan.page is None else plan.page.parent)
    shared = {} if plan.memory_s is None else {"memory": plan.memory_s}
    engines = specifications(plan.engines, shared, _by_engine(plan.options))
    session = read_session(plan.session)
    check_report(plan.page, session)
    compared = compare_engines(session, engines, control, sweep=plan.sweep, cluster=plan, **plan.selection)
    if plan.page is None and plan.figures is None:
        return compared
    from tissueid.reports import comparison_report

    report = comparison_report(session, compared.comparison, control.follow)
    return replace(compared, figures=write_figures(report, plan.page, plan.figures))


def compare_engines(
    session: Session,
    engines: Sequence[Engine],
    control: Control,
    *,
    sweep: bool = False,
    cluster: ClusterPlan | None = None,
    **selection: Unpack[Selection],
) -> ComparedTests:
    """Fit engines to one test, or to several jointly, and compare them; ``selection`` is as for ``split``.

    With a ``cluster`` that has a scheduler its workers fit the engines, each one at a time. The control shows the
    name of each engine, and other steps, with the completed share of the step.

    Raises:
        UnusableInputError: a test cannot be used, or every engine refused it.
        CancelledError: it was cancelled.
    """
    from tissueid.analysis import compare, known_ceiling, split

    parts = split(session, **selection)
    no_ceiling = ""
    try:
        ceiling = known_ceiling(session, parts)
    except UnusableInputError as error:
        ceiling, no_ceiling = None, error.message
    fits = None
    if cluster is not None and cluster.scheduler is not None:
        fits = functools.partial(_fits_on_cluster, cluster, control)
    comparison = compare(engines, parts, ceiling=ceiling, sweep=sweep, progress=control.follow, fits=fits)
    return ComparedTests(session, comparison, no_ceiling)


def _fits_on_cluster(
    cluster: ClusterPlan, control: Control, engines: Sequence[Engine], parts: Split
) -> list[Analysis | str]:
    from tissueid.analysis.comparison import fit_or_reason

    done = CountedProgress(control, _FITTING, len(engines))
    with plan_executor(None, cluster) as pool:
        return pool.do(functools.partial(fit_or_reason, parts), list(engines), control.check, done)


def _by_engine(options: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return options given as ENGINE.NAME=VALUE by engine.

    Raises:
        UnusableInputError: an option names no engine.
    """
    by_engine: dict[str, dict[str, Any]] = {}
    for name, value in parse_options(options).items():
        engine, dot, option = name.partition(".")
        if not dot or not option:
            raise UnusableInputError(
                "option.pair",
                "an option must be {form}, got {text}",
                form="ENGINE.NAME=VALUE",
                text=Verbatim(repr(name)),
            )
        by_engine.setdefault(engine, {})[option] = value
    return by_engine


def check_figures(folder: Path | None) -> None:
    """Check that a folder for figures can be made or written.

    Raises:
        UnusableInputError: it is a file, or not writable.
    """
    if folder is None:
        return
    if folder.exists() and not folder.is_dir():
        raise UnusableInputError(
            "file.not_a_folder", "{path} is a file; name a folder for the figures", path=str(folder)
        )
    _check_writable(folder if folder.is_dir() else folder.parent)


def _check_writable(folder: Path | None) -> None:
    """Check that a folder is writable.

    Raises:
        UnusableInputError: the folder exists and is not writable.
    """
    if folder is not None and folder.is_dir() and not os.access(folder, os.W_OK):
        raise UnusableInputError("file.folder_unwritable", "the folder {folder} is not writable", folder=str(folder))
