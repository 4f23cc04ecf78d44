"""Check of the path of a new session before a coil is energised."""

from __future__ import annotations

import tempfile
from pathlib import Path

from tissueid.errors import UnusableInputError
from tissueid.messages import Message


def check_session_path(path: Path) -> None:
    """Check that a new session can be saved to a path. Nothing is written.

    Raises:
        UnusableInputError: it cannot; the message says why.
    """
    from tissueid.acquisition.journal import RECOVER, journal_path

    if not path.name:
        raise UnusableInputError(Message("save_path.empty", "enter the file of the session"))
    if path.is_dir():
        raise UnusableInputError(Message("save_path.folder", "{path} is a folder; name a session file", path=str(path)))
    if not path.parent.is_dir():
        raise UnusableInputError(
            Message(
                "save_path.no_folder",
                "there is no folder {folder}: make it, or choose another one",
                folder=str(path.parent),
            )
        )
    if path.exists():
        raise UnusableInputError(
            Message(
                "save_path.exists",
                "{path} is there already; files are never overwritten: choose another name",
                path=str(path),
            )
        )
    if journal_path(path).exists():
        raise UnusableInputError(
            Message(
                "save_path.unfinished",
                "an unfinished test is left at {path}: recover it ({action}), or choose another name",
                path=str(path),
                action=RECOVER,
            )
        )
    try:
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise UnusableInputError(
            Message(
                "save_path.not_writable",
                "the folder {folder} cannot be written to ({problem}): choose another one",
                folder=str(path.parent),
                problem=error.strerror or str(error),
            )
        ) from error
