"""The calibration folder: its location, its files, and the name of a new calibration."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import platformdirs

from tissueid.atomic_write import unused_path
from tissueid.calibration.file import Calibration, read_calibration
from tissueid.errors import UnusableInputError

VARIABLE = "TISSUEID_CALIBRATIONS"
"""Environment variable that names a calibration folder other than the user's own."""
_MAX_FILES = 5000
"""Maximum number of files in the folder."""


@dataclass(frozen=True)
class Stored:
    """Calibration and its file. ``problem`` is the reason why ``calibration`` is None."""

    path: Path
    calibration: Calibration | None
    problem: str = ""

    @property
    def made(self) -> datetime:
        """Date of the calibration; the earliest possible date if it cannot be read."""
        return self.calibration.made if self.calibration else datetime.min.replace(tzinfo=UTC)


def calibration_folder(given: Path | None = None) -> Path | None:
    """Return the calibration folder: ``given``, else from the environment variable, else the user's own.

    The current folder is never used: the active calibration must not depend on where a program is started. None if the
    folder does not exist yet, because no instrument was calibrated on this account.

    Raises:
        UnusableInputError: the given or named folder does not exist.
    """
    named = os.environ.get(VARIABLE)
    chosen = given if given is not None else Path(named) if named else None
    if chosen is not None:
        if not chosen.is_dir():
            raise UnusableInputError(
                "calibration.no_folder", "there is no calibration folder {folder}", folder=str(chosen)
            )
        return chosen
    own = user_calibration_folder()
    return own if own.is_dir() else None


def user_calibration_folder() -> Path:
    """Return the calibration folder in the user's data folder; it need not exist."""
    return platformdirs.user_data_path("tissueid") / "calibration_data"


def create_calibration_folder(given: Path | None = None) -> Path:
    """Return ``calibration_folder(given)``, and create it if it does not exist yet.

    Raises:
        UnusableInputError: the given or named folder does not exist, or the user's own cannot be created.
    """
    folder = calibration_folder(given) or user_calibration_folder()
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise UnusableInputError(
            "file.no_new_folder",
            "cannot create the folder {folder}: {reason}",
            folder=str(folder),
            reason=str(error.strerror),
        ) from error
    return folder


def free_name(folder: Path, serial_number: str, kind: str, moment: datetime) -> Path:
    """Return an unused path for a new calibration, named by instrument, kind and time."""
    name = f"{re.sub(r'[^A-Za-z0-9-]+', '-', serial_number).strip('-') or 'unknown'}-{kind}-{moment:%Y-%m-%d_%H-%M-%S}"
    suffixes = (".toml", ".html", ".h5")
    return unused_path(
        folder / f"{name}.toml",
        separator="_",
        taken=lambda path: any(path.with_suffix(suffix).exists() for suffix in suffixes),
    )


def is_in_calibration_folder(path: Path) -> bool:
    """Return whether ``path`` is in the calibration folder, where tests look for calibrations."""
    try:
        folder = calibration_folder()
    except UnusableInputError:
        return False
    return folder is not None and path.parent.resolve() == folder.resolve()


def stored_calibrations(folder: Path | None) -> tuple[Stored, ...]:
    """Return all TOML files of a folder, newest first; unreadable files have the reason as ``problem``.

    Raises:
        UnusableInputError: the folder cannot be read or has too many files.
    """
    if folder is None:
        return ()
    try:
        files = sorted(path for path in folder.iterdir() if path.suffix == ".toml" and not path.name.startswith("."))
    except OSError as error:
        raise UnusableInputError(
            "file.folder_unreadable",
            "cannot read the folder {folder}: {reason}",
            folder=str(folder),
            reason=str(error.strerror),
        ) from error
    if len(files) > _MAX_FILES:
        raise UnusableInputError(
            "calibration.too_many",
            "{folder} contains {count} calibrations; the limit is {limit}: move old ones to another folder",
            folder=str(folder),
            count=len(files),
            limit=_MAX_FILES,
        )
    found = [_stored(path) for path in files]
    return tuple(sorted(found, key=lambda item: (item.made, item.path.name), reverse=True))


def _stored(path: Path) -> Stored:
    try:
        return Stored(path, read_calibration(path))
    except UnusableInputError as error:
        return Stored(path, None, error.message)
