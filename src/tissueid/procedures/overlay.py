"""Fits of several tests of one session or of several: figures over all of them, and tables over repeats."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from tissueid.errors import UnusableInputError
from tissueid.formatting import csv_text
from tissueid.messages import Message, Verbatim, joined
from tissueid.plan_options import Option, Plan, name_and_value
from tissueid.procedures.control import Control
from tissueid.procedures.identification import check_figures
from tissueid.procedures.output_files import HTML, check_different, check_output, write_figures, write_text

if TYPE_CHECKING:  # each takes long to import
    import numpy as np

    from tissueid.analysis.overlay import NamedFit, Overlay, TestSource
    from tissueid.sessions import Session

_SOURCE = re.compile(r"(?P<file>.+?)(?::(?P<tests>all|\d+(?:[+,]\d+)*))?(?:@(?P<fits>[^@/\\]+))?")
_MOST_SOURCES = 2000
_LONGEST_LABEL = 60
"""Letters of a site that are used as a label."""
_CSV = ("plot,", "source,")
"""First characters of CSV files that may be overwritten."""


class SourcesPlan(Plan):
    """Tests and the fits that are run on each."""

    sources: Annotated[
        tuple[str, ...],
        Option(
            argument=True,
            metavar="[LABEL=]SESSION[:TESTS][@FITS]...",
            help="sessions, also 'a-*.h5'; TESTS: 1,3, all or joined 1+2, default the first stochastic; FITS: labels",
        ),
    ]
    engines: Annotated[
        tuple[str, ...] | None,
        Option("--engines", metavar="A,B,...", separator=",", help="engines with their default options"),
    ] = None
    fits: Annotated[
        tuple[str, ...],
        Option(
            "--fit",
            metavar="[LABEL=]ENGINE[,NAME=VALUE...]",
            help="an engine with options; may be repeated, also with one engine",
        ),
    ] = ()
    whole: Annotated[
        bool, Option("--whole", help="fit whole tests; nothing is held out, all scores are of fitted samples")
    ] = False
    downsample: Annotated[
        int,
        Option("--downsample", metavar="N", help="keep every N-th sample, without a filter, as in the thesis"),
        Field(ge=1, le=1000),
    ] = 1
    input_name: Annotated[str, Option("--input", metavar="SIGNAL", help="input signal")] = "force"
    output_name: Annotated[str, Option("--output", metavar="SIGNAL", help="output signal")] = "position"


class OverlayPlan(SourcesPlan):
    """Tests, fits, and the files to write."""

    calibration: Annotated[
        Path | None,
        Option("--sweep-file", metavar="FILE", help="dynamic sweep whose mass, damping and stiffness lie underneath"),
    ] = None
    sweep: Annotated[
        str | None, Option("--sweep", metavar="NAME=V,V,...", help="option of the fits and the values to try")
    ] = None
    page: Annotated[Path | None, Option("--out", metavar="FILE", help="write the report, one HTML page")] = None
    figures: Annotated[
        Path | None, Option("--figures", metavar="DIR", help="folder for all figures as SVG and PNG")
    ] = None
    csv: Annotated[Path | None, Option("--csv", metavar="FILE", help="write the numbers of all figures")] = None


class RepeatsPlan(SourcesPlan):
    """Tests, fits, and the file of the table."""

    csv: Annotated[Path | None, Option("--csv", metavar="FILE", help="write the table")] = None


def run_overlay(plan: OverlayPlan, control: Control) -> Overlay:
    """Fit the tests of a plan and write its page, figures and numbers.

    Raises:
        UnusableInputError: a source, a fit, the sweep or a file cannot be used, or every fit failed.
        CancelledError: it was cancelled; nothing was written.
    """
    check_output(plan.page, HTML)
    check_output(plan.csv, _CSV)
    check_different(plan.page, plan.csv)
    check_figures(plan.figures)
    calibration = None if plan.calibration is None else sweep_columns(plan.calibration)
    overlay = fitted(plan, control, sweep=_sweep(plan.sweep))
    if plan.page is None and plan.figures is None and plan.csv is None:
        return overlay
    from tissueid.reports.overlay_page import overlay_report

    control.progress(None, Message("report.drawing", "Drawing the figures"))
    report = overlay_report(overlay, calibration)
    write_figures(report, plan.page, plan.figures)
    if plan.csv is not None:
        write_text(plan.csv, report.csv())
    return overlay


def run_repeats(plan: RepeatsPlan, control: Control) -> Overlay:
    """Fit the tests of a plan and write the table of means and standard deviations.

    Raises:
        UnusableInputError: a source, a fit or the file cannot be used, or every fit failed.
        CancelledError: it was cancelled; nothing was written.
    """
    check_output(plan.csv, _CSV)
    overlay = fitted(plan, control, every=True)
    if plan.csv is not None:
        write_text(plan.csv, repeats_csv(overlay))
    return overlay


def fitted(
    plan: SourcesPlan, control: Control, *, sweep: tuple[str, Sequence[float]] = ("", ()), every: bool = False
) -> Overlay:
    """Read the sources of a plan and run its fits.

    ``every`` takes all stochastic tests of a session without TESTS, labelled by their sites.

    Raises:
        UnusableInputError: a source or a fit cannot be used, or every fit failed.
        CancelledError: it was cancelled.
    """
    from tissueid.analysis.overlay import overlay

    fits = named_fits(plan.engines, plan.fits)
    sources = read_sources(plan.sources, every=every)
    return overlay(
        sources,
        fits,
        whole=plan.whole,
        downsample=plan.downsample,
        sweep=sweep,
        input_name=plan.input_name,
        output_name=plan.output_name,
        progress=control.follow,
    )


def named_fits(engines: Sequence[str] | None, fits: Sequence[str]) -> list[NamedFit]:
    """Return the fits of a plan: engines with default options, then those with options of their own.

    Raises:
        UnusableInputError: there is none, a label is given twice, or an engine or an option is unknown.
    """
    from tissueid.analysis.overlay import NamedFit
    from tissueid.identification import engine_names, get_engine

    named = [NamedFit(name, get_engine(name)()) for name in engines or ()]
    for text in fits:
        label, name, options = _fit_parts(text)
        named.append(NamedFit(label, get_engine(name).from_options(options)))
    labels = [fit.label for fit in named]
    if twice := [label for label in labels if labels.count(label) > 1]:
        raise UnusableInputError(
            "overlay.fit_twice", "two fits are called '{name}': give each a LABEL=", name=Verbatim(twice[0])
        )
    if not named:
        raise UnusableInputError(
            "overlay.no_fit",
            "--engines or --fit is required, with engines among {names}",
            names=joined(map(Verbatim, engine_names())),
        )
    return named


def _fit_parts(text: str) -> tuple[str, str, dict[str, Any]]:
    """Return label, engine and options of [LABEL=]ENGINE[,NAME=VALUE...]; a value may hold commas, as lists do."""
    head, *rest = text.split(",")
    label, equals, name = head.partition("=")
    if not equals:
        name = label
    pairs: list[str] = []
    for part in rest:
        if "=" in part or not pairs:
            pairs.append(part)
        else:
            pairs[-1] += f",{part}"
    return label.strip(), name.strip(), dict(map(name_and_value, pairs))


def read_sources(texts: Sequence[str], *, every: bool = False) -> list[TestSource]:
    """Return the tests of [LABEL=]SESSION[:TESTS][@FITS]; the label is the site of the test where none is given.

    A site that several sources of different sessions share gives the same label, as ``every`` and the localized
    parameters need; ``every`` takes all stochastic tests where no tests are named.

    Raises:
        UnusableInputError: a source has another form, a session cannot be read, or it lacks a test.
    """
    from tissueid.analysis.overlay import TestSource
    from tissueid.sessions import read_session

    read = cache(read_session)
    sources: list[TestSource] = []
    for text in texts:
        label, pattern, tests, fits = _source_parts(text)
        for path in _files(pattern):
            session = read(path)
            for numbers in _groups(session, "all" if every and not tests else tests):
                site = (session.test(numbers[0]).site or path.stem)[:_LONGEST_LABEL]
                sources.append(TestSource(label or site, session, numbers, fits))
        if len(sources) > _MOST_SOURCES:
            raise UnusableInputError("overlay.too_many", "more than {most} tests are given", most=_MOST_SOURCES)
    return sources


def _files(path: Path) -> list[Path]:
    """Return a file, or those of a pattern with * or ?, in the order of their names."""
    if path.exists() or not any(mark in str(path) for mark in "*?"):
        return [path]
    return sorted(path.parent.glob(path.name)) or [path]


def _source_parts(text: str) -> tuple[str, Path, str, tuple[str, ...]]:
    """Return label, file, tests and fits of a source.

    Raises:
        UnusableInputError: it names no file.
    """
    label, equals, rest = text.partition("=")
    if not equals or Path(text).exists() or "/" in label or "\\" in label:
        label, rest = "", text
    matched = _SOURCE.fullmatch(rest)
    if matched is None:
        raise UnusableInputError(
            "overlay.source",
            "a source must be {form}, got {text}",
            form="[LABEL=]SESSION[:TESTS][@FITS]",
            text=Verbatim(repr(text)),
        )
    if Path(rest).exists():
        return label.strip(), Path(rest), "", ()
    fits = tuple(name.strip() for name in (matched["fits"] or "").split(",") if name.strip())
    return label.strip(), Path(matched["file"]), matched["tests"] or "", fits


def _groups(session: Session, tests: str) -> list[tuple[int, ...]]:
    """Return the tests that are fitted together, for each fit."""
    if tests == "all":
        stochastic = [test.number for test in session.tests if test.kind == "stochastic"]
        return [(number,) for number in stochastic] or [(session.test().number,)]
    if not tests:
        return [(session.test().number,)]
    return [tuple(session.test(int(number)).number for number in group.split("+")) for group in tests.split(",")]


def _sweep(text: str | None) -> tuple[str, tuple[float, ...]]:
    """Return name and values of NAME=V,V,...

    Raises:
        UnusableInputError: a value is not a number, or there is none.
    """
    if text is None:
        return "", ()
    name, values = name_and_value(text)
    given = values if isinstance(values, list) else [values]
    if not given or not all(isinstance(value, int | float) and not isinstance(value, bool) for value in given):
        raise UnusableInputError(
            "overlay.sweep", "a sweep must be {form}, got {text}", form="NAME=V,V,...", text=Verbatim(repr(text))
        )
    return name, tuple(value for value in given)


def sweep_columns(path: Path) -> dict[str, np.ndarray]:
    """Return the columns of a dynamic sweep, SI.

    Raises:
        UnusableInputError: the file is no calibration, or holds no sweep.
    """
    import numpy as np

    from tissueid.calibration.file import read_calibration

    calibration = read_calibration(path)
    columns = calibration.tables.get("sweep", {})
    if calibration.kind != "sweep" or not columns.get("position_m"):
        raise UnusableInputError(
            "report.not_a_sweep", "this is not a dynamic sweep but a calibration of kind {kind}", kind=calibration.kind
        )
    return {name: np.array(values) for name, values in columns.items()}


def repeats_csv(overlay: Overlay) -> str:
    """Return mean, standard deviation and coefficient of variation of every quantity as CSV, SI."""
    from tissueid.analysis.overlay import repeated_values

    rows: list[tuple[object, ...]] = [("source", "fit", "quantity", "count", "mean", "std", "cv")]
    for repeated in repeated_values(overlay):
        numbers = (None if value != value else value for value in (repeated.mean, repeated.std, repeated.cv))
        rows.append((repeated.source, repeated.fit, repeated.quantity, repeated.count, *numbers))
    return csv_text(rows)
