"""Analysis of the sessions of a study that have changed; its table, statistics and report."""

from __future__ import annotations

import contextlib
import csv
import functools
import hashlib
import itertools
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from tissueid.atomic_write import private_folder
from tissueid.errors import TissueIDError, UnusableInputError
from tissueid.extras import check_packages
from tissueid.formatting import clean, csv_text, text_of_cell
from tissueid.language import marked
from tissueid.messages import MISSING, Verbatim, joined
from tissueid.plan_options import parse_options
from tissueid.procedures.cluster import plan_executor
from tissueid.procedures.control import Control, CountedProgress
from tissueid.procedures.output_files import HTML, PDF, check_different, check_output, write_text, writing
from tissueid.procedures.session_store import FolderStore, RemoteStore, SessionStore
from tissueid.procedures.study_plans import (
    CURVES_FILE,
    NOT_ANALYSED_FILE,
    RESULTS,
    SUBJECTS_FILE,
    StudyPlan,
    StudyReportPlan,
)
from tissueid.procedures.study_protocol import read_protocol
from tissueid.procedures.test_plan import MAX_TEXT
from tissueid.sessions import Session, Test, read_session
from tissueid.stored_values import finite
from tissueid.test_settings import PROPERTIES
from tissueid.version import __version__

if TYPE_CHECKING:  # each takes long to import
    import pandas as pd

    from tissueid.analysis.curves.samples import SampledCurve
    from tissueid.studies.study_statistics import StudyStatistics


_ANALYSING = marked("Analysing sessions")
_FAILED, _CURVES, _DETAILS = "failed", "curves", "details"
_FORMAT = 5
"""Format of stored rows: those of another one are computed again."""
_MOST_FAILURES, _LONGEST_REASON = 100_000, 1000


_Count = Annotated[int, Field(ge=0, lt=2**31)]


class _StoredRow(BaseModel):
    """Row of one test: the columns by which a study sorts and counts; ``study_table`` makes the others uniform."""

    model_config = ConfigDict(strict=True, extra="allow")
    __pydantic_extra__: dict[str, str | bool | float | None] = Field(init=False)
    session_id: str
    created: str
    test: _Count
    subject: str
    site: str
    condition: str
    configuration: str
    simulated: bool
    status: str
    quality: str
    findings: str
    engine: str


class _StoredResult(BaseModel):
    """Content of the file of one session: rows, details of the fits and curves of its tests, or why it has none."""

    model_config = ConfigDict(strict=True)
    rows: list[_StoredRow] = []
    details: list[dict[str, float]] = []
    failed: str | None = None
    curves: list[tuple[_Count, list[Any]]] = []


@dataclass(frozen=True)
class StudyRun:
    """The table of a study (one row per test), the sessions that could not be analysed with the reason, and counts.

    ``curves`` is the table of the sampled curves (``studies/curve_groups.py``).
    """

    plan: StudyPlan
    table: pd.DataFrame
    curves: pd.DataFrame
    failures: Mapping[str, str]
    sessions: int
    analysed: int
    """Sessions analysed in this run; the others were unchanged."""

    def as_answer(self) -> dict[str, Any]:
        """Return the sessions and those that could not be analysed for JSON."""
        return {"failures": dict(self.failures), "sessions": self.sessions}


def run_study(plan: StudyPlan, control: Control) -> StudyRun:
    """Analyse every session of a study that has changed, and write the table and the sampled curves.

    Raises:
        UnusableInputError: the folder, the engine or an option cannot be used, or a package is missing.
        CancelledError: it was cancelled; what is analysed already is kept.
    """
    check_packages("pandas", "pyarrow", *(() if plan.scheduler is None else ("distributed",)))
    from tissueid.identification import get_engine
    from tissueid.studies.curve_groups import curves_table, write_curves
    from tissueid.studies.study_table import read_subjects, study_table, write_table

    options = parse_options(plan.options)
    specification = get_engine(plan.engine).from_options(options)
    if plan.sessions is not None:
        check_packages("fsspec")
    store: SessionStore = FolderStore(plan.folder) if plan.sessions is None else RemoteStore(plan.sessions)
    keys = store.sessions()
    if not keys:
        where = plan.sessions or str(plan.folder)
        raise UnusableInputError("study.no_sessions", "there are no session files in {folder}", folder=where)
    subjects = read_subjects(path) if (path := plan.folder / SUBJECTS_FILE).is_file() else None
    results = plan.folder / RESULTS
    for folder in (plan.folder, results):
        private_folder(folder)
    answers, new = _analyse(plan, options, store, keys, control)
    common = specification.common([details for answer in answers.values() for details in answer.get(_DETAILS, ())])
    if common != specification:  # one model for all tests, as parameters of different ones are not comparable
        answers, again = _analyse(plan, common.options(), store, keys, control)
        new = max(new, again)
    failures = {name: reason for name in keys if (reason := answers[name].get(_FAILED)) is not None}
    lines = ((name, " ".join(reason.split()), keys[name]) for name, reason in failures.items())
    write_text(results / NOT_ANALYSED_FILE, csv_text([("session", "reason", "key"), *lines]))
    rows = [row | {"session": name} for name in keys for row in answers[name].get("rows", ())]
    if not rows:
        name, reason = next(iter(failures.items()))
        raise UnusableInputError(
            "study.nothing",
            "no test of {folder} could be analysed; {file}: {reason}",
            folder=str(plan.folder),
            file=Verbatim(name),
            reason=Verbatim(reason),
        )
    table = study_table(rows, subjects)
    curves = curves_table(
        (name, test, curve) for name in keys for test, curve in answers[name].get(_CURVES, ()) if name not in failures
    )
    written = (
        (table, "table.csv", write_table),
        (table, "table.parquet", write_table),
        (curves, CURVES_FILE, write_curves),
    )
    for rows_of, file_name, write in written:
        with writing(results / file_name):
            write(rows_of, results / file_name)
    return StudyRun(plan, table, curves, failures, len(keys), new)


def _analyse(
    plan: StudyPlan, options: Mapping[str, Any], store: SessionStore, keys: Mapping[str, str], control: Control
) -> tuple[dict[str, dict[str, Any]], int]:
    """Return the results of all sessions by name, and how many of them were not stored before."""
    about = json.dumps([dict(options), plan.held_out, __version__, _FORMAT], sort_keys=True)
    analysis = f"{plan.engine}-{hashlib.sha256(about.encode()).hexdigest()[:12]}"
    stored = set(store.results(analysis))
    for stale in stored - set(keys.values()):
        store.remove_result(analysis, stale)
    answers = {
        name: answer
        for name, key in keys.items()
        if key in stored and (answer := _decoded(store.read_result(analysis, key))) is not None
    }
    new = [name for name in keys if name not in answers]
    if new:
        work = functools.partial(_analysed, plan, options, store, analysis)
        done = CountedProgress(control, _ANALYSING, len(new))
        with plan_executor(plan.workers, plan) as pool:
            items = [(name, keys[name]) for name in new]
            answers |= dict(zip(new, pool.do(work, items, control.check, done), strict=True))
    return answers, len(new)


def read_failures(path: Path, keys: Mapping[str, str]) -> dict[str, str]:
    """Return the reason of each session that could not be analysed and has not changed since.

    Args:
        path: file that a run wrote; empty without it, or if it cannot be used.
        keys: key of each session by its name.
    """
    try:
        if not path.is_file():
            return {}
        with path.open(encoding="utf-8", newline="") as file:
            lines = list(itertools.islice(csv.DictReader(file), _MOST_FAILURES))
    except (OSError, ValueError, csv.Error):
        return {}
    return {
        name: text_of_cell(line.get("reason") or "")[:_LONGEST_REASON]
        for line in lines
        if (name := text_of_cell(line.get("session") or "")) in keys and keys[name] == line.get("key")
    }


def _decoded(content: bytes | None) -> dict[str, Any] | None:
    # None for a damaged file, which is computed again.
    from tissueid.analysis.curves.samples import from_json

    if content is None:
        return None
    try:
        stored = _StoredResult.model_validate_json(content)
        # As arrays at once: the texts of thousands of sessions do not fit in memory as lists.
        curves = [(test, from_json(curve)) for test, curve in stored.curves]
    except (ValueError, TypeError, OverflowError):
        return None
    if stored.failed is not None:
        return {_FAILED: stored.failed}
    rows = [row.model_dump() for row in stored.rows]
    return {"rows": rows, _DETAILS: stored.details, _CURVES: curves} if rows else None


def _analysed(
    plan: StudyPlan, options: Mapping[str, Any], store: SessionStore, analysis: str, item: tuple[str, str]
) -> dict[str, Any]:
    # Called in the worker, which stores the result at once.
    from tissueid.analysis.curves.samples import from_json

    name, key = item
    local_path = ""
    answer: dict[str, Any]
    try:
        with store.local_file(name) as path:
            local_path = str(path)
            session = read_session(path)
        answer = {"rows": [], _CURVES: [], _DETAILS: []}
        for test in session.tests:
            row, details, sampled = _row(session, test, plan, options)
            answer["rows"].append(row)
            answer[_DETAILS].append(details)
            # As they are read again, so that a second run gives the same report.
            answer[_CURVES] += [(test.number, from_json(curve.as_json())) for curve in sampled]
    except TissueIDError as error:
        answer = {_FAILED: str(error).removeprefix(local_path).lstrip(" :")}  # the name of the file is stated with it
    if not answer.get("rows") and _FAILED not in answer:
        answer[_FAILED] = "no test could be analysed"
    with contextlib.suppress(OSError, UnusableInputError):
        stored = [(test, curve.as_json()) for test, curve in answer.get(_CURVES, ())]
        store.write_result(analysis, key, json.dumps(answer | {_CURVES: stored}).encode())
    return answer


def _row(
    session: Session, test: Test, plan: StudyPlan, options: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, float], list[SampledCurve]]:
    from tissueid.acquisition.quality import judge
    from tissueid.analysis.curves.samples import sampled_curves
    from tissueid.analysis.fitting import fit_split, fit_whole, scheduled_scores
    from tissueid.analysis.split import split
    from tissueid.identification import get_engine
    from tissueid.identification.base import NEGATIVE_MASS, PREDICTS_NOTHING
    from tissueid.studies.study_table import DESCRIPTION, KEYS, STD_SUFFIX

    quality = judge(test, session.instrument)
    row: dict[str, Any] = {
        "session_id": session.session_id,
        "created": session.created,
        "test": test.number,
        "subject": session.subject.pseudonym,
        "site": test.site,
        "condition": str(test.notes.get("condition", "")),
        "configuration": test.configuration,
        **{name: test.notes.get(name) for name in PROPERTIES},
        "simulated": session.instrument.simulated,
        "kind": test.kind,
        "status": test.status,
        "quality": quality.verdict,
        "findings": ", ".join(finding.code for finding in quality.findings if finding.severity == quality.verdict),
        "engine": plan.engine,
    }
    own = (*KEYS, *DESCRIPTION)
    demographics = session.subject.demographics.items()
    row |= {name: value for name, value in demographics if name not in own and not name.endswith(STD_SUFFIX)}
    try:
        parts = split(session, test=test.number)
        fit = fit_split if plan.held_out else fit_whole
        analysis = fit(get_engine(plan.engine).from_options(options), parts)
    except UnusableInputError as error:
        return row | {"status": "not analysed", "problem": str(error)}, {}, []
    report = analysis.model.report
    if NEGATIVE_MASS in report.warnings:
        return row | {"status": "not analysed", "problem": str(NEGATIVE_MASS)}, {}, []
    record = analysis.record
    row |= {
        "model": report.model,
        "signals": f"{record.input_name} ({record.input_unit}), {record.output_name} ({record.output_unit})",
        "vaf_percent": report.vaf_percent,
        "vaf_validation_percent": report.vaf_validation_percent,
        "vaf_scheduled_percent": scheduled_scores(analysis)[0],
        "problem": str(PREDICTS_NOTHING) if report.predicts_nothing else "",
    }
    for name, estimate in report.reportable_parameters.items():
        row |= {name: finite(estimate.value), f"{name}_sd": finite(estimate.std)}
    details = {name: value for name, value in report.details.items() if finite(value) is not None}
    return row, details, sampled_curves(analysis, test.surface_position_m)


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
    statistics = study_statistics(
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
    write_text(page, study_html(name, plan.engine, statistics, run.failures))
    if plan.pdf is not None:
        with writing(plan.pdf):
            write_study_pdf(plan.pdf, name, plan.engine, statistics, run.failures)
    control.progress(1.0, _COMPUTING)
    return StudyReport(run, statistics, page, plan.pdf, plan.only)


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
    conditions = sorted({str(name) for name in table["condition"].dropna() if name})
    for condition in filter(None, (plan.before, plan.after)):
        if condition not in conditions:
            raise UnusableInputError(
                "study.unknown_condition",
                "no test has the condition '{name}'; conditions: {known}",
                name=Verbatim(clean(condition)[:MAX_TEXT]),
                known=joined(map(Verbatim, conditions)) or MISSING,
            )
