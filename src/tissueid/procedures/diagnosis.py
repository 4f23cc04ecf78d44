"""Diagnosis of the gap: of a session, of all sessions of a folder, and twins with the effects that it names.

Each process of a folder stores its answers at once, in the user's cache. They are removed when the procedure ends or is
cancelled; after a kill the same procedure on the same files takes them from there.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import math
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from platformdirs import user_cache_path

from tissueid.atomic_write import open_regular
from tissueid.audit import AuditTrail
from tissueid.errors import CancelledError, UnusableInputError
from tissueid.gap import Diagnosis, as_answer, diagnose, executor, prepare
from tissueid.gap.answer import store_answer, stored_answer
from tissueid.gap.search import STEPS
from tissueid.gap.statement import GapHistory, GapHistoryEntry
from tissueid.gap.twin_export import NamedEffects, accept_named, against_twin, named_effects
from tissueid.gap.workers import SerialExecutor
from tissueid.instrument.twin_file import TwinFile, check_twin_name, check_twin_writable, read_twin, write_twin
from tissueid.instrument.twin_list import SUFFIX
from tissueid.language import marked
from tissueid.messages import Verbatim
from tissueid.plan_options import Option, Plan
from tissueid.procedures.audit_queries import audit_note
from tissueid.procedures.cluster import plan_executor
from tissueid.procedures.control import Control, CountedProgress, RemainingTime, counted
from tissueid.procedures.gap_plans import AcceptPlan, DiagnosisPlan, FolderPlan, WatchPlan
from tissueid.procedures.output_files import HTML, check_different, check_output, check_report, write_text
from tissueid.procedures.separate_process import run_in_process
from tissueid.sessions import Session, read_session
from tissueid.sessions.file_policy import located, session_files, unreadable
from tissueid.twin.catalogue import effect
from tissueid.version import __version__

if TYPE_CHECKING:  # each takes long to import
    from tissueid.gap.search import SearchProgress, Work

SHARES: Mapping[Work, tuple[float, float]] = {
    "baseline": (0.0, 0.05),
    "screening": (0.05, 0.4),
    "likeliest candidates": (0.4, 0.5),
    "candidates": (0.5, 0.65),
    "leading candidates": (0.65, 0.9),
    "near relations": (0.9, 1.0),
}
"""Share of a search for one effect at the begin and the end of each step, from timings of sessions of one test."""
_SINGLES = 0.2
"""Share of the search for single effects in a search that continues with sets."""
_TYPICAL_STEPS = 5.0
"""Steps of the search for sets after which about two thirds are done."""
_ENDS: frozenset[Work] = frozenset(
    {"leading candidates", "near relations", "leading additions", "leading replacements"}
)
_LAST = marked("Working out where, which and how far")
_READING = marked("Reading the session")


@dataclass(frozen=True)
class DiagnosedSession:
    """A diagnosis with the session and the baseline twin (None for the nominal one) from which it was made."""

    plan: DiagnosisPlan
    session: Session
    twin: TwinFile | None
    diagnosis: Diagnosis

    @property
    def named(self) -> NamedEffects:
        """What the diagnosis names for a twin."""
        return named_effects(self.diagnosis, self.session.session_id, self.twin)

    @property
    def report_html(self) -> str:
        """The report as HTML, in the language in force."""
        from tissueid.reports.gap_page import DiagnosisOrigin, gap_html

        return gap_html(self.diagnosis, origin=DiagnosisOrigin(self.session, self.plan.session))


def diagnose_session(plan: DiagnosisPlan, control: Control) -> DiagnosedSession:
    """Diagnose a session and write the report if one is named. Whether a twin can be saved is checked before.

    Raises:
        UnusableInputError: the session, the twin, a test number, an effect or a file cannot be used.
        CancelledError: the diagnosis was cancelled; nothing was written.
    """
    check_output(plan.report, HTML)
    check_different(plan.report, plan.twin_out)
    if plan.twin_out is not None:
        check_twin_writable(plan.twin_out)
    for name in plan.without:
        effect(name)
    control.progress(None, _READING)
    twin = None if plan.twin is None else read_twin(plan.twin)
    session = read_session(plan.session)
    check_report(plan.report, session)
    dataset, effects = against_twin(prepare(session, plan.fit, plan.check), twin)
    with executor(plan.workers) as pool:
        diagnosis = diagnose(
            dataset,
            pool,
            accepted=effects,
            without=plan.without,
            seconds=plan.seconds,
            progress=SearchDisplay(control),
            cancelled=control.check,
        )
    diagnosed = DiagnosedSession(plan, session, twin, diagnosis)
    if plan.report is not None:
        write_text(plan.report, diagnosed.report_html)
    return diagnosed


class SearchDisplay:
    """Shows the progress of a search with the share of the whole search that is done and the remaining time.

    A search for one effect has known steps. If it continues with sets of effects, the number of its steps is not known:
    every further step completes a part of what is left.
    """

    def __init__(self, control: Control, remaining: RemainingTime | None = None) -> None:
        self._control = control
        self._remaining = remaining or RemainingTime()
        self._what: Work = "baseline"
        self._steps_of_sets = 0
        self._share = 0.0

    def __call__(self, progress: SearchProgress) -> None:
        """Show the progress of a step."""
        done, total = progress.done, progress.total
        if progress.what != self._what:
            self._what = progress.what
            if self._steps_of_sets or progress.what not in SHARES:
                self._share = self._share if self._steps_of_sets else 0.0
                self._steps_of_sets += 1
        self._share = max(self._share, self._share_at(done / max(total, 1)))
        if progress.what in _ENDS and done == total:
            self._control.progress(None, _LAST)
        elif total > 1:
            step = self._remaining.added_to(counted(STEPS[progress.what], done, total), self._share)
            self._control.progress(self._share, step)
        else:
            self._control.progress(None, STEPS[progress.what])

    def _share_at(self, part: float) -> float:
        if self._steps_of_sets:
            return _SINGLES + (1.0 - _SINGLES) * (1.0 - math.exp(-(self._steps_of_sets - 1 + part) / _TYPICAL_STEPS))
        begin, end = SHARES[self._what]
        return begin + part * (end - begin)


_DIAGNOSING = marked("Diagnosing sessions")
_CREATED, _REASON = "created", "reason"
_BLOCK_BYTES = 1 << 20


def watch_folder(plan: WatchPlan, control: Control) -> GapHistory:
    """Diagnose every session of a folder against a twin, and write the report if one is named.

    Returns:
        The history of the gap against the twin.

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
    history = GapHistory.of(entries)
    if plan.report is not None:
        from tissueid.reports.gap_page import watch_html

        write_text(plan.report, watch_html(history, twin))
    return history


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
    refusals = session_files(plan.folder)
    if not refusals:
        raise UnusableInputError("gap.no_sessions", "there are no session files in {folder}", folder=str(plan.folder))
    files = [path for path, refused in refusals.items() if refused is None]
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
    return {path: answers.get(path) or {_CREATED: "", _REASON: refused} for path, refused in refusals.items()}


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
        dataset, effects = against_twin(prepare(session), twin)
        answer = of(diagnose(dataset, SerialExecutor(), accepted=effects)) | {_CREATED: created}
    except UnusableInputError as error:
        return {_CREATED: created, _REASON: error.message}
    with contextlib.suppress(UnusableInputError):  # without a cache, the procedure begins again after a kill
        store_answer(kept, key, answer)
    return answer


def _kept_answer(kept: Path, key: str) -> dict[str, Any] | None:
    with contextlib.suppress(UnusableInputError):  # a damaged file is replaced
        return stored_answer(kept, key)
    return None


class TwinPlan(Plan):
    """A saved twin."""

    file: Annotated[Path, Option(argument=True, metavar="TWIN.toml", help="a saved twin")]


class TwinFolderPlan(Plan):
    """A folder with saved twins."""

    folder: Annotated[Path, Option(argument=True, metavar="DIR", help="folder; default: the current one")] = Path()


def saved_twins(plan: TwinFolderPlan) -> dict[Path, TwinFile]:
    """Read the twins of a folder, by file name; other files are left out.

    Raises:
        UnusableInputError: the folder does not exist.
    """
    if not plan.folder.is_dir():
        raise UnusableInputError("file.no_folder", "there is no folder {folder}", folder=str(plan.folder))
    twins = {}
    for path in sorted(plan.folder.glob(f"*{SUFFIX}")):
        try:
            twins[path] = read_twin(path)
        except UnusableInputError:
            continue
    return twins


def accept_effects(
    plan: AcceptPlan,
    control: Control,
    trail: AuditTrail,
    named: NamedEffects | None = None,
    *,
    separate_process: bool = False,
) -> TwinFile:
    """Save a twin with effects of a session, log it and return its content.

    Args:
        plan: with the chosen effects; none accepts those of ``named``.
        control: progress and cancellation.
        trail: of the audit log.
        named: what a diagnosis names; another choice of effects is fitted to the session. Its baseline twin counts
            instead of that of the plan.
        separate_process: fit in another process.

    Raises:
        UnusableInputError: there is nothing to accept, or the session, the twin, its name or an effect cannot be used.
        CancelledError: it was cancelled; nothing was written.
    """
    check_twin_writable(plan.out)
    baseline = None if named is None else named.baseline
    if named is None and plan.twin is not None:
        baseline = read_twin(plan.twin)
    name = plan.name or (plan.out.stem if baseline is None else baseline.name)
    check_twin_name(name)
    if named is not None and set(plan.effects or named.effects) == set(named.effects):
        content = named.twin_called(name)
    elif not plan.effects:
        raise UnusableInputError("gap.accept_none", "There is nothing to accept: no effect is chosen.")
    else:
        fitted = functools.partial(_fitted, plan, name, baseline)
        content = run_in_process(fitted, control) if separate_process else fitted(control)
    write_twin(plan.out, content)
    new = {"file": plan.out.name, "name": content.name, "version": content.version}
    new |= {"effects": [item.name for item in content.effects]}
    audit_note(trail, control, "twin.accepted", subject=content.source.session_id, new=new)
    return content


def _fitted(plan: AcceptPlan, name: str, baseline: TwinFile | None, control: Control) -> TwinFile:
    display = SearchDisplay(control)
    with executor(plan.workers) as pool:
        return accept_named(
            plan.session, plan.effects, name, baseline, pool, display, plan.fit, plan.check, control.check
        )
