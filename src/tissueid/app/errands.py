"""What is done off the window's thread besides measuring and analysing: recovery, and the report."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tissueid.acquisition.journal import JournalError, lock
from tissueid.app.findings import Findings
from tissueid.app.words import in_words
from tissueid.audit import Trail
from tissueid.errors import TissueIDError
from tissueid.sessions import Session


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


def write_report_beside(findings: Findings) -> Path:
    """Write the page of one test beside its session; returns its path."""
    from tissueid.reports import write_report

    path = findings.path.with_name(f"{findings.path.stem}-report.html")
    write_report(path, findings.session, {findings.test.number: findings.analyses})
    return path
