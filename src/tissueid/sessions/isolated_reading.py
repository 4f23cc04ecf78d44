"""Read untrusted sessions in a child process with limits of time and memory (``reader_process``)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from tissueid.sessions.file_policy import check_session_file
from tissueid.sessions.model import Outline, Session, Test
from tissueid.sessions.reader_process import read_in_child


def read_session(path: Path) -> Session:
    """Read a session.

    Raises:
        SessionFormatError: missing, not a session, or not in accordance with the format or a limit.
    """
    head, *tests = _read("session", path)
    session: Session = replace(head, tests=tuple(tests))
    return session


def read_session_head(path: Path) -> Session:
    """Read a session without its tests.

    Raises:
        SessionFormatError: as ``read_session``.
    """
    (head,) = _read("head", path)
    assert isinstance(head, Session)
    return head


def read_outline(path: Path) -> Outline:
    """Read a session without its signals, in a few milliseconds for tests of any length.

    Raises:
        SessionFormatError: as ``read_session``.
    """
    (outline,) = _read("outline", path)
    assert isinstance(outline, Outline)
    return outline


def read_test(path: Path, number: int) -> Test:
    """Read one test of a session.

    Raises:
        SessionFormatError: as ``read_session``, or there is no such test.
    """
    (test,) = _read("test", path, number)
    assert isinstance(test, Test)
    return test


def _read(task: str, path: Path, *arguments: Any) -> list[Any]:
    check_session_file(path)  # at once, and with errors that distinguish a folder from a missing file
    return read_in_child(task, path, *arguments)
