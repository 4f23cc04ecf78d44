"""Whether a session can be saved where somebody wants it, found out before a coil is energised."""

from __future__ import annotations

import tempfile
from pathlib import Path

from tissueid.acquisition import journal_path
from tissueid.errors import UnusableInputError
from tissueid.language import _

SUFFIX = ".h5"


def free_place(path: Path) -> Path:
    """Return a path, or the first of ``name-2.ext``, ``name-3.ext``, ... where a file of that name is there already."""
    free, number = path, 2
    while free.exists() or free.is_symlink():
        free, number = path.with_name(f"{path.stem}-{number}{path.suffix}"), number + 1
    return free


def check_place(path: Path) -> None:
    """Refuse a path that no new session can be saved to; nothing is left there by the asking.

    Raises:
        UnusableInputError: says what is wrong with it.
    """
    if not path.name:
        raise UnusableInputError(_("say where to save the session"))
    if path.is_dir():
        raise UnusableInputError(_("{path} is a folder; name a session file").format(path=path))
    if path.suffix.lower() != SUFFIX:
        raise UnusableInputError(_("the name of a session ends in .h5, {name} does not").format(name=path.name))
    if not path.parent.is_dir():
        raise UnusableInputError(
            _("there is no folder {folder}: make it, or choose another one").format(folder=path.parent)
        )
    if path.exists():
        raise UnusableInputError(
            _("{path} is there already; files are never overwritten: choose another name").format(path=path)
        )
    if journal_path(path).exists():
        raise UnusableInputError(
            _("an unfinished test is left at {path}: recover it on the page Start, or choose another name").format(
                path=path
            )
        )
    try:
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise UnusableInputError(
            _("the folder {folder} cannot be written to ({problem}): choose another one").format(
                folder=path.parent, problem=error.strerror or error
            )
        ) from error
