"""Paths of new sessions."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

from platformdirs import user_documents_path

from tissueid.atomic_write import unused_path
from tissueid.errors import UnusableInputError
from tissueid.messages import Message
from tissueid.procedures.session_path import check_session_path

SUFFIX = ".h5"


def check_save_path(path: Path) -> None:
    """Check that a new session can be saved to a path that ends in .h5. Nothing is written.

    Raises:
        UnusableInputError: it cannot; the message says why.
    """
    if path.name and not path.is_dir() and path.suffix.lower() != SUFFIX:
        raise UnusableInputError(
            Message("save_path.suffix", "the name of a session ends in .h5, {name} does not", name=path.name)
        )
    check_session_path(path)


def default_folder() -> Path:
    """Return the default folder of sessions."""
    return user_documents_path() / "TissueID"


def dated_path(folder: Path, moment: datetime) -> Path:
    """Return an unused path of a session, named by date and time, that has no journal either."""
    return unused_path(
        folder / f"{moment:%Y-%m-%d_%H-%M-%S}{SUFFIX}",
        separator="_",
        taken=lambda path: path.exists() or path.with_name(f"{path.name}.journal").exists(),
    )
