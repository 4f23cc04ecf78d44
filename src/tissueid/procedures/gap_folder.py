"""Diagnosis of all sessions of a folder, which continues after a kill.

Each process stores its answers at once, in the user's cache. They are removed when the procedure ends or is cancelled;
after a kill the same procedure on the same files takes them from there.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from platformdirs import user_cache_path

from tissueid.atomic_write import open_regular
from tissueid.errors import CancelledError, UnusableInputError
from tissueid.gap import Diagnosis, as_answer, diagnose, prepare
from tissueid.gap.answer import store_answer, stored_answer
from tissueid.gap.statement import GapHistory, GapHistoryEntry
from tissueid.gap.twin_export import against_twin
from tissueid.gap.workers import SerialExecutor
from tissueid.instrument.twin_file import TwinFile, read_twin
from tissueid.language import marked
from tissueid.messages import Verbatim
from tissueid.procedures.cluster import plan_executor
from tissueid.procedures.control import Control, CountedProgress
from tissueid.procedures.gap_plans import FolderPlan, WatchPlan
from tissueid.procedures.output_files import HTML, check_output, write_text
from tissueid.sessions import read_session
from tissueid.sessions.file_policy import located, session_files, unreadable
from tissueid.version import __version__

_DIAGNOSING = marked("Diagnosing sessions")
_CREATED, _REASON = "created", "reason"
_BLOCK_BYTES = 1 << 20


@dataclass(frozen=True)
class WatchedFolder:
    """The history of the gap against a twin."""

    plan: WatchPlan
    twin: TwinFile
    history: GapHistory

    @property
    def report_html(self) -> str:
        """The report as HTML, in the language in force."""
        from tissueid.reports.gap_page import watch_html

        return watch_html(self.history, self.twin)


def watch_folder(plan: WatchPlan, control: Control) -> WatchedFolder:
    """Diagnose every session of a folder against a twin, and write the report if one is named.

    Raises:
        UnusableInputError: the twin, or every session, or a file cannot be used.
        CancelledError: it was cancelled; nothing was written.
    """
    check_output(plan.report, HTML)
    twin = read_twin(plan.twin)
    answers = _diagnosed(twin, plan, control, as_answer)
    entries = [_entry(path, answer) for path, answer in answers.items()]
    if all(entry.answer is None for entry in entries):
        raise UnusableInputError(
            "gap.nothing_watched",
            "no session of {folder} can be compared with the twin; {file}: {reason}",
            folder=str(plan.folder),
            file=Verbatim(entries[0].file),
            reason=entries[0].reason,
        )
    watched = WatchedFolder(plan, twin, GapHistory.of(entries))
    if plan.report is not None:
        write_text(plan.report, watched.report_html)
    return watched


def diagnose_folder(
    plan: FolderPlan, control: Control, of: Callable[[Diagnosis], dict[str, Any]]
) -> dict[Path, dict[str, Any] | str]:
    """Diagnose every session of a folder, and return ``of`` each diagnosis; the reason for a file that cannot be used.

    ``of`` must be picklable: it is called in the processes that diagnose. It returns an answer for JSON.

    Raises:
        UnusableInputError: there are no session files.
        CancelledError: it was cancelled.
    """
    answers = _diagnosed(None, plan, control, of)
    return {path: answer.get(_REASON) or answer for path, answer in answers.items()}


def _entry(path: Path, answer: dict[str, Any]) -> GapHistoryEntry:
    created = answer.pop(_CREATED)
    if (reason := answer.get(_REASON)) is not None:
        return GapHistoryEntry(path.name, created, None, reason)
    return GapHistoryEntry(path.name, created, answer)


def _diagnosed(
    twin: TwinFile | None, plan: FolderPlan, control: Control, of: Callable[[Diagnosis], dict[str, Any]]
) -> dict[Path, dict[str, Any]]:
    found = session_files(plan.folder)
    if not found:
        raise UnusableInputError("gap.no_sessions", "there are no session files in {folder}", folder=str(plan.folder))
    files = [path for path, refused in found.items() if refused is None]
    kept = _kept_answers(plan.folder, twin, of)
    done = CountedProgress(control, _DIAGNOSING, len(files))
    try:
        with plan_executor(plan.workers, plan) as pool:
            work = functools.partial(_of_file, of, twin, kept)
            answers = dict(zip(files, pool.do(work, files, control.check, done), strict=True))
    except (CancelledError, KeyboardInterrupt):
        shutil.rmtree(kept, ignore_errors=True)
        raise
    shutil.rmtree(kept, ignore_errors=True)
    return {path: answers.get(path) or {_CREATED: "", _REASON: refused} for path, refused in found.items()}


def _kept_answers(folder: Path, twin: TwinFile | None, of: Callable[[Diagnosis], dict[str, Any]]) -> Path:
    # One folder for each folder of sessions, twin, kind of answer and version.
    about = (str(folder.resolve()), "" if twin is None else twin.model_dump_json(), of.__qualname__)
    digest = hashlib.sha256("\0".join((*about, __version__)).encode()).hexdigest()
    return user_cache_path("tissueid", appauthor=False) / "gap" / digest[:32]


def _of_file(
    of: Callable[[Diagnosis], dict[str, Any]], twin: TwinFile | None, kept: Path, path: Path
) -> dict[str, Any]:
    # One process per session is faster than all processes on one session after another.
    try:
        with open_regular(path) as file:
            digest = hashlib.sha256()
            while block := file.read(_BLOCK_BYTES):
                digest.update(block)
            key = digest.hexdigest()
    except OSError as error:
        return {_CREATED: "", _REASON: located(str(path), unreadable(error))}
    if (before := _kept_answer(kept, key)) is not None:
        return before
    created = ""
    try:
        session = read_session(path)
        created = session.created
        dataset, known = against_twin(prepare(session), twin)
        answer = of(diagnose(dataset, SerialExecutor(), known=known)) | {_CREATED: created}
    except UnusableInputError as error:
        return {_CREATED: created, _REASON: error.message}
    with contextlib.suppress(UnusableInputError):  # without a cache, the procedure begins again after a kill
        store_answer(kept, key, answer)
    return answer


def _kept_answer(kept: Path, key: str) -> dict[str, Any] | None:
    with contextlib.suppress(UnusableInputError):  # a damaged file is replaced
        return stored_answer(kept, key)
    return None
