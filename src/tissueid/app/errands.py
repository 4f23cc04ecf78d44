"""What is done off the window's thread besides measuring and analysing: recovery, and the report."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from tissueid.acquisition.journal import JournalError, lock
from tissueid.app.findings import Findings, find
from tissueid.app.place_to_save import free_place
from tissueid.app.words import in_words
from tissueid.audit import Trail
from tissueid.errors import TissueIDError
from tissueid.sessions import Session
from tissueid.sessions.quality import quality_of


@dataclass(frozen=True)
class Recovery:
    """What became of unfinished tests: sessions with their files, and in words what could not be recovered."""

    sessions: list[tuple[Path, Session]]
    problems: list[str]


def unfinished(folder: Path) -> list[Path]:
    """Journals in a folder that a dead program left; those of tests that still run are passed over."""
    found = []
    for path in sorted(folder.glob("*.journal")):
        try:
            with path.open("rb") as file:
                lock(file)
        except (OSError, JournalError):
            continue
        found.append(path)
    return found


def recover_all(journals: list[Path], trail: Trail | None = None) -> Recovery:
    """Make sessions of journals, and log it; one that cannot be recovered does not keep the others back."""
    from tissueid.acquisition.recovery import recover

    recovery = Recovery([], [])
    for journal in journals:
        try:
            recovery.sessions.append(recover(journal, trail=trail, told=recovery.problems.append))
        except (TissueIDError, OSError) as error:
            recovery.problems.append(in_words(error))
    return recovery


def judge_and_find(findings: Findings) -> Findings:
    """Judge the tests of a session that the quality gate never judged, and analyse the shown one again."""
    from tissueid.acquisition.quality import judge_session

    session = findings.session
    tests = tuple(
        test if quality_of(test) is not None else replace(test, notes=test.notes | found.as_notes())
        for test, found in judge_session(session)
    )
    return find(findings.path, replace(session, tests=tests), findings.test.number)


def write_report_beside(findings: Findings) -> Path:
    """Write the page of one test next to its session, never over an earlier one; return its path."""
    from tissueid.reports import write_report

    path = free_place(findings.path.with_name(f"{findings.path.stem}-report.html"))
    write_report(path, findings.session, {findings.test.number: findings.analyses})
    return path
