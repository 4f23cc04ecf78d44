"""Analysis of all sessions of a study, on one machine or a cluster. It continues after a kill.

``results/ANALYSIS/KEY.json`` in the folder of the study holds the rows of one session. ANALYSIS depends on engine,
options and version, KEY on the path, size and modification time of the file: a second run reads what has not changed.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tissueid import __version__
from tissueid.atomic_write import atomic_file, private_folder
from tissueid.errors import TissueIDError, UnusableInputError
from tissueid.extras import check_packages
from tissueid.gap.workers import Executor, executor
from tissueid.language import marked
from tissueid.messages import Message, Verbatim
from tissueid.procedures.control import Control, CountedProgress
from tissueid.procedures.plan_options import parse_options
from tissueid.procedures.study_plans import CONDITION, MINUTES_SINCE, RESULTS, SUBJECTS_FILE, StudyPlan

if TYPE_CHECKING:
    import pandas as pd

    from tissueid.sessions import Session, Test

_ANALYSING = marked("Analysing sessions")
_LARGEST_RESULT = 5_000_000
_FAILED = "failed"


@dataclass(frozen=True)
class StudyRun:
    """The table of a study (one row per test), the sessions that could not be analysed with the reason, and counts."""

    plan: StudyPlan
    table: pd.DataFrame
    failures: Mapping[str, str]
    sessions: int
    analysed: int
    """Sessions analysed in this run; the others were unchanged."""


def run_study(plan: StudyPlan, control: Control) -> StudyRun:
    """Analyse every session of a study that has changed, and write the table as CSV and Parquet.

    Raises:
        UnusableInputError: the folder, the engine or an option cannot be used, or a package is missing.
        CancelledError: it was cancelled; what is analysed already is kept.
    """
    check_packages("pandas", "pyarrow", *(() if plan.scheduler is None else ("distributed",)))
    from tissueid.identification import get_engine
    from tissueid.studies.study_table import read_subjects, study_table, write_table

    options = parse_options(plan.options)
    get_engine(plan.engine).from_options(options)
    files = _session_files(plan.folder)
    subjects = read_subjects(path) if (path := plan.folder / SUBJECTS_FILE).is_file() else None
    results = plan.folder / RESULTS
    kept = results / _analysis(plan, options)
    for folder in (results, kept):
        private_folder(folder)
    keys = {path: _key(plan.folder, path) for path in files}
    for stale in {path.stem for path in kept.glob("*.json")} - set(keys.values()):
        (kept / f"{stale}.json").unlink(missing_ok=True)
    known = {path: found for path, key in keys.items() if (found := _stored(kept, key)) is not None}
    new = [path for path in files if path not in known]
    work = functools.partial(_analysed, plan, options, kept, {path: keys[path] for path in new})
    if new:
        done = CountedProgress(control, _ANALYSING, len(new))
        with _executor(plan) as pool:
            known |= dict(zip(new, pool.do(work, new, control.check, done), strict=True))
    failures = {
        str(path.relative_to(plan.folder)): reason for path in files if (reason := known[path].get(_FAILED)) is not None
    }
    rows = [
        row | {"session": str(path.relative_to(plan.folder))} for path in files for row in known[path].get("rows", ())
    ]
    if not rows:
        name, reason = next(iter(failures.items()))
        raise UnusableInputError(
            Message(
                "study.nothing",
                "no test of {folder} could be analysed; {file}: {reason}",
                folder=str(plan.folder),
                file=Verbatim(name),
                reason=Verbatim(reason),
            )
        )
    table = study_table(rows, subjects)
    for suffix in ("csv", "parquet"):
        write_table(table, results / f"table.{suffix}")
    return StudyRun(plan, table, failures, len(files), len(new))


def _session_files(folder: Path) -> list[Path]:
    if not folder.is_dir():
        raise UnusableInputError(Message("study.no_folder", "{folder} is not a folder", folder=str(folder)))
    results = folder / RESULTS
    files = sorted(path for path in folder.rglob("*.h5") if results not in path.parents)
    if not files:
        raise UnusableInputError(
            Message("study.no_sessions", "there are no session files in {folder}", folder=str(folder))
        )
    return files


def _analysis(plan: StudyPlan, options: Mapping[str, Any]) -> str:
    about = json.dumps([dict(options), plan.held_out, __version__], sort_keys=True)
    return f"{plan.engine}-{hashlib.sha256(about.encode()).hexdigest()[:12]}"


def _key(folder: Path, path: Path) -> str:
    try:
        status = path.stat()
    except OSError:
        stamp = (-1, -1)
    else:
        stamp = (status.st_size, status.st_mtime_ns)
    return hashlib.sha256(json.dumps((str(path.relative_to(folder)), *stamp)).encode()).hexdigest()[:40]


def _stored(kept: Path, key: str) -> dict[str, Any] | None:
    path = kept / f"{key}.json"
    try:
        if path.stat().st_size > _LARGEST_RESULT:
            return None
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):  # a missing or damaged file is computed again
        return None
    return found if isinstance(found, dict) and ("rows" in found or _FAILED in found) else None


def _executor(plan: StudyPlan) -> AbstractContextManager[Executor]:
    if plan.scheduler is None:
        return executor(plan.workers)
    from tissueid.procedures.cluster import cluster_executor

    return cluster_executor(plan.scheduler)


def _analysed(
    plan: StudyPlan, options: Mapping[str, Any], kept: Path, keys: Mapping[Path, str], path: Path
) -> dict[str, Any]:
    # Called in the worker, which stores the result at once.
    from tissueid.sessions import read_session

    found: dict[str, Any]
    try:
        session = read_session(path)
        found = {"rows": [row for test in session.tests for row in _rows(session, test, plan, options)]}
    except TissueIDError as error:
        found = {_FAILED: str(error)}
    if not found.get("rows") and _FAILED not in found:
        found[_FAILED] = "no test could be analysed"
    with contextlib.suppress(OSError), atomic_file(kept / f"{keys[path]}.json") as partial:
        partial.write_text(json.dumps(found), encoding="utf-8")
    return found


def _rows(session: Session, test: Test, plan: StudyPlan, options: Mapping[str, Any]) -> list[dict[str, Any]]:
    from tissueid.acquisition.quality import judge
    from tissueid.analysis.fitting import fit_split, fit_whole
    from tissueid.analysis.split import split
    from tissueid.identification import get_engine

    row: dict[str, Any] = {
        "session_id": session.session_id,
        "created": session.created,
        "test": test.number,
        "subject": session.subject.pseudonym,
        "site": test.site,
        "condition": str(test.notes.get(CONDITION, "")),
        "minutes_since_application": test.notes.get(MINUTES_SINCE),
        "configuration": test.configuration,
        "coupling": test.notes.get("coupling"),
        "orientation_deg": test.notes.get("orientation_deg"),
        "kind": test.kind,
        "status": test.status,
        "quality": judge(test, session.instrument).verdict,
        "engine": plan.engine,
    }
    row |= session.subject.demographics
    try:
        parts = split(session, test=test.number)
        fit = fit_split if plan.held_out else fit_whole
        report = fit(get_engine(plan.engine).from_options(options), parts).model.report
    except UnusableInputError as error:
        return [row | {"status": "not analysed", "problem": str(error)}]
    row |= {"vaf_percent": report.vaf_percent, "vaf_validation_percent": report.vaf_validation_percent, "problem": ""}
    for name, estimate in report.reportable_parameters.items():
        row |= {name: _finite(estimate.value), f"{name}_sd": _finite(estimate.std)}
    return [row]


def _finite(value: float | None) -> float | None:
    return None if value is None or not abs(value) < float("inf") else float(value)
