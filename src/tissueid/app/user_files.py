"""Files of the window's user: paths of new sessions, file stamps, and the folder of analyses."""

from __future__ import annotations

import os
from datetime import datetime
from pathlib import Path

from platformdirs import user_data_path, user_documents_path

from tissueid.atomic_write import unused_path
from tissueid.errors import UnusableInputError
from tissueid.procedures.output_files import check_session_path

SUFFIX = ".h5"


def check_save_path(path: Path, *, taken: bool = False) -> None:
    """Check that a new session can be saved to a path that ends in .h5. Nothing is written.

    ``taken`` is whether another program may use the name: another one is chosen then.

    Raises:
        UnusableInputError: it cannot; the message says why.
    """
    if path.name and path.suffix.lower() != SUFFIX and not path.is_dir():
        raise UnusableInputError(
            "save_path.suffix", "the name of a session ends in .h5, {name} does not", name=path.name
        )
    check_session_path(path, taken=taken)


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


Stamp = tuple[int, int]
"""When a file was last changed, ns, and its size."""


def stamp_of(path: Path) -> Stamp | None:
    """Return the stamp of a file, None where it is not there."""
    try:
        status = path.stat()
    except (OSError, ValueError):
        return None
    return status.st_mtime_ns, status.st_size


ENVIRONMENT = "TISSUEID_ANALYSES"
"""Environment variable with the file of analyses; results and diagnoses are in the same folder."""


def default_path() -> Path:
    """Return the file of analyses: ``TISSUEID_ANALYSES``, or a file in the user's data folder."""
    named = os.environ.get(ENVIRONMENT)
    return Path(named) if named else user_data_path("tissueid", appauthor=False) / "analyses.jsonl"
