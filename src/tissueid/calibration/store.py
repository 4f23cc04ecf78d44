"""Folders of calibrations: which one is looked into, and what it holds, readable or not."""

from __future__ import annotations

import os
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import platformdirs

from tissueid.calibration.file import Calibration, read_calibration
from tissueid.errors import UnusableInputError

VARIABLE = "TISSUEID_CALIBRATIONS"
LOCAL = Path("calibration_data")
_MOST_FILES = 5000


@dataclass(frozen=True)
class Stored:
    """A calibration and its file; without ``calibration``, ``problem`` says why it cannot be read."""

    path: Path
    calibration: Calibration | None
    problem: str = ""

    @property
    def made(self) -> datetime:
        """When it was made; long ago where that cannot be read."""
        return self.calibration.made if self.calibration else datetime.min.replace(tzinfo=UTC)


def calibration_folder(given: Path | None = None) -> Path | None:
    """The folder of calibrations: the one that is given, or named by the environment, or near, or the user's own.

    None where there is none at all: nothing was ever calibrated here.

    Raises:
        UnusableInputError: the one that is given or named is not there.
    """
    named = os.environ.get(VARIABLE)
    chosen = given if given is not None else Path(named) if named else None
    if chosen is not None:
        if not chosen.is_dir():
            raise UnusableInputError(f"there is no folder of calibrations {chosen}")
        return chosen
    for folder in (LOCAL, platformdirs.user_data_path("tissueid") / "calibration_data"):
        if folder.is_dir():
            return folder
    return None


def stored_calibrations(folder: Path | None) -> tuple[Stored, ...]:
    """All TOML files of a folder, newest first; those that are no calibrations, or damaged, with the reason.

    Raises:
        UnusableInputError: the folder cannot be read, or holds too many files.
    """
    if folder is None:
        return ()
    try:
        files = sorted(path for path in folder.iterdir() if path.suffix == ".toml" and not path.name.startswith("."))
    except OSError as error:
        raise UnusableInputError(f"cannot read the folder {folder}: {error.strerror}") from error
    if len(files) > _MOST_FILES:
        raise UnusableInputError(f"{folder} holds {len(files)} calibrations; at most {_MOST_FILES} are looked through")
    found = [_stored(path) for path in files]
    return tuple(sorted(found, key=lambda item: (item.made, item.path.name), reverse=True))


def _stored(path: Path) -> Stored:
    try:
        return Stored(path, read_calibration(path))
    except UnusableInputError as error:
        return Stored(path, None, str(error))
