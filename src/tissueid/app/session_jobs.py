"""Jobs on sessions: analysis of a test, recovery of unfinished tests, quality judgement, and the report."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from tissueid.acquisition.journal import JournalError, lock
from tissueid.app.findings import Findings
from tissueid.app.words import in_words, sentence
from tissueid.audit import AuditTrail
from tissueid.errors import TissueIDError
from tissueid.messages import translated
from tissueid.procedures.output_files import unused_path
from tissueid.sessions import Session, read_session
from tissueid.sessions.quality import quality_of


@dataclass(frozen=True)
class Recovery:
    """Result of a recovery: sessions with their files, and messages about tests that could not be recovered."""

    sessions: list[tuple[Path, Session]]
    problems: list[str]


def find(path: Path, session: Session | None = None, number: int | None = None) -> Findings:
    """Analyse one test of a session, the first stochastic one unless ``number`` names another.

    An engine that cannot use the record is left out.

    Raises:
        UnusableInputError: the file is not a session, or holds no such test.
    """
    from tissueid.app.identifying import identify  # engines and figures take longer to import than the window to open

    return identify(path, session or read_session(path), number)


def unfinished(folder: Path) -> list[Path]:
    """Return the journals of unfinished tests in a folder, without those of running tests."""
    found = []
    for path in sorted(folder.glob("*.journal")):
        try:
            with path.open("rb") as file:
                lock(file)
        except (OSError, JournalError):
            continue
        found.append(path)
    return found


def recover_all(journals: list[Path], trail: AuditTrail | None = None) -> Recovery:
    """Recover sessions from journals and log it. A journal that fails does not prevent the others."""
    from tissueid.acquisition.recovery import recover

    recovery = Recovery([], [])

    def report(problem: str) -> None:
        recovery.problems.append(sentence(translated(problem)))

    for journal in journals:
        try:
            recovery.sessions.append(recover(journal, trail=trail, report=report))
        except (TissueIDError, OSError) as error:
            recovery.problems.append(in_words(error))
    return recovery


def judge_and_analyse(findings: Findings) -> Findings:
    """Judge the tests of a session without a quality judgement, and analyse the shown test again."""
    from tissueid.acquisition.quality import judge_session

    session = findings.session
    tests = tuple(
        test if quality_of(test) is not None else replace(test, notes=test.notes | found.as_notes())
        for test, found in judge_session(session)
    )
    return find(findings.path, replace(session, tests=tests), findings.test.number)


def write_test_report(findings: Findings) -> Path:
    """Write the report of one test next to its session under an unused name; return its path."""
    from tissueid.reports import write_report

    path = unused_path(findings.path.with_name(f"{findings.path.stem}-report.html"))
    write_report(path, findings.session, {findings.test.number: findings.analyses})
    return path
