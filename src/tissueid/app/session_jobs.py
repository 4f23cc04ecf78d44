"""Jobs on sessions: analysis of a test and quality judgement."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from tissueid.app.findings import Findings
from tissueid.sessions import Session, read_session
from tissueid.sessions.quality import quality_of


def find(path: Path, session: Session | None = None, number: int | None = None) -> Findings:
    """Analyse one test of a session, the first stochastic one unless ``number`` names another.

    An engine that cannot use the record is left out.

    Raises:
        UnusableInputError: the file is not a session, or holds no such test.
    """
    from tissueid.app.identifying import identify  # engines and figures take longer to import than the window to open

    return identify(path, session or read_session(path), number)


def judge_and_analyse(findings: Findings) -> Findings:
    """Judge the tests of a session without a quality judgement, and analyse the shown test again."""
    from tissueid.acquisition.quality import judge_session

    session = findings.session
    tests = tuple(
        test if quality_of(test) is not None else replace(test, notes=test.notes | found.as_notes())
        for test, found in judge_session(session)
    )
    return find(findings.path, replace(session, tests=tests), findings.test.number)
