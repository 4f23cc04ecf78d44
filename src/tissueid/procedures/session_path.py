"""Check of the path of a new session before a coil is energised."""

from __future__ import annotations

import errno
from pathlib import Path

from tissueid.atomic_write import check_creatable
from tissueid.errors import UnusableInputError

_SHOWN = 40
"""Characters of a name that a message repeats."""
_TEMPORARY = 26
"""Characters that a temporary name adds; a journal adds fewer."""


def check_session_path(path: Path) -> None:
    """Check that a new session, its journal and its temporary file can be created at a path. Nothing is left there.

    Raises:
        UnusableInputError: it cannot; the message says why.
    """
    from tissueid.acquisition.journal import RECOVER, journal_path

    if not path.name:
        raise UnusableInputError("save_path.empty", "enter the file of the session")
    unwritable = _creation_error(path)
    if unwritable is not None and unwritable.errno == errno.ENAMETOOLONG:
        raise UnusableInputError(
            "save_path.too_long",
            "the name {name}… is too long: a temporary name, which is {more} characters longer, must fit too",
            name=path.name[:_SHOWN],
            more=_TEMPORARY,
        ) from unwritable
    if path.is_dir():
        raise UnusableInputError("save_path.folder", "{path} is a folder; name a session file", path=str(path))
    if not path.parent.is_dir():
        raise UnusableInputError(
            "save_path.no_folder",
            "there is no folder {folder}: make it, or choose another one",
            folder=str(path.parent),
        )
    if path.exists():
        raise UnusableInputError(
            "save_path.exists",
            "{path} is there already; files are never overwritten: choose another name",
            path=str(path),
        )
    if journal_path(path).exists():
        raise UnusableInputError(
            "save_path.unfinished",
            "an unfinished test is left at {path}: recover it ({action}), or choose another name",
            path=str(path),
            action=RECOVER,
        )
    if unwritable is not None:
        raise UnusableInputError(
            "save_path.not_writable",
            "the folder {folder} cannot be written to ({problem}): choose another one",
            folder=str(path.parent),
            problem=unwritable.strerror or str(unwritable),
        ) from unwritable


def _creation_error(path: Path) -> OSError | None:
    """Return why the temporary file of a session cannot be created; None if it can."""
    try:
        check_creatable(path)
    except OSError as error:
        return error
    return None
