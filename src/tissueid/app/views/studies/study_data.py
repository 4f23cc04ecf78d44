"""Content of a study as the page shows it: tests of its table, and its figures. Independent of Qt."""

from __future__ import annotations

import csv
import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tissueid.analysis.curves.plot import Axis, Bars, Curve, Mark, Plot, Surface
from tissueid.app.user_files import default_path, stamp_of
from tissueid.atomic_write import private_folder, write_private
from tissueid.errors import UnusableInputError
from tissueid.formatting import clean, label_and_unit, principal_first, text_of_cell
from tissueid.language import _, current_language, marked
from tissueid.messages import Message, Verbatim, message_from, translated
from tissueid.procedures.session_store import FolderStore
from tissueid.procedures.study_plans import CURVES_FILE, NOT_ANALYSED_FILE, RESULTS
from tissueid.procedures.study_protocol import PROTOCOL_FILE, Protocol, read_protocol, sitting_steps

if TYPE_CHECKING:
    from tissueid.procedures.control import Control
    from tissueid.procedures.study_plans import StudyPlan, StudyReportPlan
    from tissueid.studies.study_statistics import StudyStatistics

TABLE = "table.csv"
_LARGEST = 50_000_000
"""Largest file of figures that is read, bytes."""
_MOST_STUDIES = 8
_KINDS: Mapping[str, Callable[..., Any]] = {kind.__name__: kind for kind in (Axis, Bars, Curve, Mark, Plot, Surface)}


@dataclass(frozen=True)
class StudyFigures:
    """Figures by heading, each with the label of its parameter, in the language in which they were made; remarks."""

    groups: tuple[tuple[str, tuple[tuple[str, Plot], ...]], ...] = ()
    remarks: tuple[str, ...] = ()


def figures_of(statistics: StudyStatistics) -> StudyFigures:
    """Compute the figures of the statistics."""
    from tissueid.reports.study_page import OF_SEVERAL, simulated_line, study_plots

    groups = []
    for _key, heading, plots in study_plots(statistics):
        names = principal_first(plots)
        labels = [
            _("all parameters")
            if name in OF_SEVERAL
            else str(name)
            if isinstance(name, Verbatim)
            else _(label_and_unit(name)[0])
            for name in names
        ]
        groups.append((heading, tuple((label, plots[name]()) for label, name in zip(labels, names, strict=True))))
    simulated = simulated_line(statistics)
    remarks = (*([simulated] if simulated else []), *(translated(remark) for remark in statistics.remarks))
    return StudyFigures(tuple(group for group in groups if group[1]), remarks)


def keep_figures(folder: Path, figures: StudyFigures) -> None:
    """Keep the figures of the table of a study; errors of the disk only cost the next start its figures."""
    content = {"of": _state(folder), "groups": _plain(figures.groups), "remarks": list(figures.remarks)}
    file = _place(folder)
    try:
        write_private(private_folder(file.parent) / file.name, json.dumps(content))
        kept = sorted(file.parent.iterdir(), key=lambda path: path.stat().st_mtime)
        for path in kept[:-_MOST_STUDIES]:
            path.unlink()
    except OSError:
        return


def kept_figures(folder: Path) -> StudyFigures | None:
    """Return the kept figures of the table of a study; None where there are none, or the table has changed."""
    try:
        path = _place(folder)
        if path.stat().st_size > _LARGEST:
            return None
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["of"] != _state(folder):
            return None
        return StudyFigures(_restored(content["groups"]), tuple(map(str, content["remarks"])))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None


def _place(folder: Path) -> Path:
    name = hashlib.sha256(str(folder.resolve()).encode()).hexdigest()[:16]
    return default_path().with_name("study-figures") / f"{name}.json"


def _state(folder: Path) -> list[Any]:
    return [str(folder.resolve()), list(stamp_of(folder / RESULTS / TABLE) or ()), current_language()]


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return {"array": value.tolist()}
    if isinstance(value, Message):
        return {"text": str(value), "message": value.as_dict()}
    if isinstance(value, Verbatim):
        return {"verbatim": str(value)}
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    if is_dataclass(value) and not isinstance(value, type):
        return {"type": type(value).__name__} | {
            field.name: _plain(getattr(value, field.name)) for field in fields(value)
        }
    return value.item() if isinstance(value, np.generic) else value


def _restored(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(map(_restored, value))
    if not isinstance(value, dict):
        return value
    if "array" in value:
        return np.asarray(value["array"], np.float64)
    if "message" in value:
        return message_from(value["message"], value["text"])
    if "verbatim" in value:
        return Verbatim(value["verbatim"])
    return _KINDS[value.pop("type")](**{name: _restored(item) for name, item in value.items()})


STD_SUFFIX = "_sd"
NOT_ANALYSED = marked("not analysed yet: press “Analyse”")
_LARGEST_TABLE = 500_000_000
_MOST_COLUMNS = 1000
_LONGEST = 200
_MOST_FAILURES = 1000


@dataclass(frozen=True, slots=True)
class TestRow:
    """A test of the table, or a session without one (``is_test`` is False): ``problem`` says why.

    ``repeat`` is 0 for a test that does not count. ``values`` and ``stds`` are by parameter, SI, and NaN where the
    engine gave none. ``search_text`` is what a search looks through, folded.
    """

    __test__ = False

    session: str
    subject: str = ""
    site: str = ""
    condition: str = ""
    minutes: float = math.nan
    repeat: int = 0
    quality: str = ""
    engine: str = ""
    vaf_percent: float = math.nan
    problem: str = ""
    values: tuple[float, ...] = ()
    stds: tuple[float, ...] = ()
    search_text: str = ""
    is_test: bool = True


@dataclass(frozen=True)
class StudyData:
    """A study: its tests in the order of the table, the names of the parameters, and the number of session files.

    ``figures`` are those that were kept, None where they have not been computed of this table.

    ``protocol`` is None where there is none, or where it cannot be used: ``protocol_problem`` then says why.
    """

    folder: Path
    rows: tuple[TestRow, ...] = ()
    parameters: tuple[str, ...] = ()
    sessions: int = 0
    protocol: Protocol | None = None
    protocol_problem: str = ""
    figures: StudyFigures | None = None

    @property
    def tests(self) -> int:
        """Number of tests in the table."""
        return sum(row.is_test for row in self.rows)

    @property
    def without_row(self) -> int:
        """Number of sessions without a test in the table."""
        return len(self.rows) - self.tests

    @property
    def steps(self) -> int:
        """Number of tests of each subject by the protocol."""
        return 0 if self.protocol is None else len(sitting_steps(self.protocol, ""))


def load_study(folder: Path) -> StudyData:
    """Read the table of a study and list its sessions, with the reason of those that could not be analysed.

    Raises:
        UnusableInputError: the folder or the table cannot be read.
    """
    from tissueid.procedures.study_run import read_failures

    results = folder / RESULTS
    files = FolderStore(folder).sessions()
    rows, parameters = _read_table(results / TABLE)
    listed = {row.session for row in rows}
    reasons = read_failures(results / NOT_ANALYSED_FILE, files)
    missing = [_without_test(file, reasons.get(file, NOT_ANALYSED)) for file in sorted(set(files) - listed)]
    protocol, problem = None, ""
    if (folder / PROTOCOL_FILE).exists():
        try:
            protocol = read_protocol(folder)
        except UnusableInputError as error:
            problem = error.message
    figures = kept_figures(folder)
    return StudyData(folder, (*missing[:_MOST_FAILURES], *rows), parameters, len(files), protocol, problem, figures)


def analyse_study(plan: StudyPlan, control: Control) -> StudyData:
    """Analyse the sessions that have changed and return the content of the study.

    Raises:
        UnusableInputError: the folder, the engine or an option cannot be used, or a package is missing.
        CancelledError: it was cancelled; what is analysed already is kept.
    """
    from tissueid.procedures.study_run import run_study

    run_study(plan, control)
    return load_study(plan.folder)


def report_and_load(plan: StudyReportPlan, control: Control) -> tuple[Path, StudyData]:
    """Write the report of a study; return its page and the content of the study.

    Raises:
        UnusableInputError: the folder, the engine, an option or a file cannot be used, or a package is missing.
        CancelledError: it was cancelled; what is analysed already is kept.
    """
    from tissueid.procedures.study_run import report_study

    report = report_study(plan, control)
    keep_figures(plan.folder, figures_of(report.statistics))
    return report.page, load_study(plan.folder)


def compute_figures(folder: Path, control: Control) -> StudyFigures:
    """Compute and keep the figures of the table of a study.

    Raises:
        UnusableInputError: there is no table yet, it cannot be read, or a package is missing.
    """
    from tissueid.extras import check_packages

    check_packages("pandas", "pyarrow", "statsmodels", "sklearn")
    import pandas as pd

    from tissueid.studies.curve_groups import read_curves
    from tissueid.studies.study_statistics import study_statistics

    control.progress(None, marked("Computing statistics"))
    path = folder / RESULTS / "table.parquet"
    try:
        table = pd.read_parquet(path)
    except (OSError, ValueError) as error:
        raise UnusableInputError(
            "study.no_table", "{folder} has no table yet: analyse its sessions first", folder=str(folder)
        ) from error
    figures = figures_of(study_statistics(table, read_curves(folder / RESULTS / CURVES_FILE)))
    keep_figures(folder, figures)
    return figures


def _read_table(path: Path) -> tuple[list[TestRow], tuple[str, ...]]:
    if not path.is_file():
        return [], ()
    try:
        if path.stat().st_size > _LARGEST_TABLE:
            raise ValueError("it is too large")
        with path.open(encoding="utf-8", newline="") as file:
            lines = csv.reader(file)
            head = next(lines, [])
            if len(head) > _MOST_COLUMNS or not {"session", "subject", "site"} <= set(head):
                raise ValueError("it is not the table of a study")
            parameters = tuple(principal_first(name for name in head if f"{name}{STD_SUFFIX}" in head))
            read = _Reader(head, parameters)
            return [read(cells) for cells in lines if len(cells) == len(head)], parameters
    except (OSError, ValueError, csv.Error) as error:
        raise UnusableInputError(
            "study.table_unreadable",
            "{path} cannot be read: {reason}",
            path=str(path),
            reason=Verbatim(str(error).splitlines()[0]),
        ) from error


class _Reader:
    """Makes rows from the cells of lines."""

    def __init__(self, head: Sequence[str], parameters: Sequence[str]) -> None:
        self._at = {name: index for index, name in enumerate(head)}
        self._values = [self._at[name] for name in parameters]
        self._stds = [self._at[f"{name}{STD_SUFFIX}"] for name in parameters]

    def __call__(self, cells: Sequence[str]) -> TestRow:
        row = TestRow(
            self._text(cells, "session"),
            self._text(cells, "subject"),
            self._text(cells, "site"),
            self._text(cells, "condition"),
            _number(self._text(cells, "minutes_since_application")),
            int(_finite(self._text(cells, "repeat"))),
            self._text(cells, "quality"),
            self._text(cells, "engine"),
            _number(self._text(cells, "vaf_percent")),
            self._text(cells, "problem"),
            tuple(_number(cells[index]) for index in self._values),
            tuple(_number(cells[index]) for index in self._stds),
        )
        return _searched(row)

    def _text(self, cells: Sequence[str], name: str) -> str:
        index = self._at.get(name)
        return "" if index is None else clean(text_of_cell(cells[index]))[:_LONGEST]


def _without_test(session: str, problem: str) -> TestRow:
    return _searched(TestRow(session, problem=problem, is_test=False))


def _searched(row: TestRow) -> TestRow:
    texts = (row.subject, row.site, row.condition, row.quality, row.engine, row.problem, row.session)
    return replace(row, search_text=" ".join(texts).casefold())


def _number(text: str) -> float:
    try:
        return float(text) if text else math.nan
    except ValueError:
        return math.nan


def _finite(text: str) -> float:
    value = _number(text)
    return value if math.isfinite(value) and abs(value) < 1e9 else 0.0
