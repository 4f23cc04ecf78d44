"""Jobs on sessions: analysis of a test and quality judgement."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from tissueid.app.findings import Findings
from tissueid.errors import TissueIDError
from tissueid.sessions import Session, read_outline, read_session
from tissueid.sessions.accepted_result import MOST_TESTS, sitting_of
from tissueid.sessions.quality import quality_of

if TYPE_CHECKING:
    pass


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
        test if quality_of(test) is not None else replace(test, notes=test.notes | quality.as_notes())
        for test, quality in judge_session(session)
    )
    return find(findings.path, replace(session, tests=tests), findings.test.number)


def open_test(path: Path) -> Findings:
    """Analyse the first test of a saved session, with the other tests of its sitting if no result of it is accepted.

    Raises:
        UnusableInputError: the file is not a session, or holds no test.
    """
    findings = find(path)
    key = sitting_of(findings.test)
    if key is None or findings.accepted is not None or findings.unread or len(findings.session.tests) != 1:
        return findings
    tests = [*_others_of_sitting(findings, key), findings]
    return replace(findings, repeats=tuple(sorted(tests, key=lambda test: (test.session.created, test.path))))


def _others_of_sitting(findings: Findings, key: str) -> Iterable[Findings]:
    """Analyse the other tests of a sitting: sessions next to the test, of its subject and site, saved about then."""
    saved = findings.path.stat().st_mtime
    files = [file for file in findings.path.parent.glob("*.h5") if file.name != findings.path.name and file.is_file()]
    for file in sorted(files, key=lambda file: abs(file.stat().st_mtime - saved))[:MOST_TESTS]:
        with contextlib.suppress(TissueIDError, OSError):  # a file that cannot be read is no test of it
            outline = read_outline(file)
            tests = [entry.test for entry in outline.tests]
            same = outline.head.subject.pseudonym == findings.session.subject.pseudonym
            if same and len(tests) == 1 and (sitting_of(tests[0]), tests[0].site) == (key, findings.test.site):
                yield find(file)
