"""Comparison of engines on saved tests, with the page and the figures."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Unpack

from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.messages import Verbatim
from tissueid.plan_options import Option, parse_options
from tissueid.procedures.cluster import ClusterPlan, plan_executor
from tissueid.procedures.control import Control, CountedProgress
from tissueid.procedures.identification import FitPlan
from tissueid.procedures.output_files import HTML, check_output, check_report, unwritable

if TYPE_CHECKING:  # each takes long to import
    from tissueid.analysis import Analysis, EngineComparison, Split
    from tissueid.analysis.split import Selection
    from tissueid.identification import Engine
    from tissueid.sessions import Session

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
    found: EngineComparison
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
    compared = compare_engines(
        session,
        engines,
        control,
        sweep=plan.sweep,
        cluster=plan,
        **plan.selection,
    )
    figures = _draw(compared, plan.page, plan.figures, control)
    return ComparedTests(session, compared.found, compared.no_ceiling, figures)


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
    found = compare(engines, parts, ceiling=ceiling, sweep=sweep, progress=_shown(control), fits=fits)
    return ComparedTests(session, found, no_ceiling)


def _fits_on_cluster(
    cluster: ClusterPlan, control: Control, engines: Sequence[Engine], parts: Split
) -> list[Analysis | str]:
    from tissueid.analysis.comparison import fit_or_reason

    done = CountedProgress(control, _FITTING, len(engines))
    with plan_executor(None, cluster) as pool:
        return pool.do(functools.partial(fit_or_reason, parts), list(engines), control.check, done)


def _shown(control: Control) -> Callable[[str, float], None]:
    def show(step: str, share: float) -> None:
        control.progress(share, step)
        control.check()

    return show


def _by_engine(options: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return options given as ENGINE.NAME=VALUE by engine.

    Raises:
        UnusableInputError: an option names no engine.
    """
    found: dict[str, dict[str, Any]] = {}
    for name, value in parse_options(options).items():
        engine, dot, option = name.partition(".")
        if not dot or not option:
            raise UnusableInputError(
                "option.pair",
                "an option must be {form}, got {text}",
                form="ENGINE.NAME=VALUE",
                text=Verbatim(repr(name)),
            )
        found.setdefault(engine, {})[option] = value
    return found


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


def _draw(compared: ComparedTests, page: Path | None, figures: Path | None, control: Control) -> tuple[Path, ...]:
    """Write the requested page and figures, and return the files of the figures.

    Raises:
        UnusableInputError: the page or a figure cannot be written.
    """
    if page is None and figures is None:
        return ()
    from tissueid.reports import comparison_report

    report = comparison_report(compared.session, compared.found, _shown(control))
    try:
        if page is not None:
            report.write(page)
        if figures is not None:
            return report.write_figures(figures)
    except OSError as error:
        raise unwritable(Path(error.filename or page or figures or ""), error) from error
    return ()
