"""Where ``tissueid calibrate`` puts what it made, and how it ends when that did not pass."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

from rich.console import Console

from tissueid.calibration import Calibration, calibration_folder, free_name, is_filed, made_folder
from tissueid.calibration.file import check_writable
from tissueid.errors import UnusableInputError


def check_place(out: Path | None) -> None:
    """Refuse, before any work, a place where the calibration cannot be written.

    Raises:
        UnusableInputError: as ``check_writable``, or the folder of calibrations is not there and cannot be made.
    """
    if out is None:
        made_folder()
    else:
        check_writable(out)


def place_of(out: Path | None, serial_number: str, kind: str) -> Path:
    """Return ``out``, or a new name in the folder of calibrations where no file was named."""
    return out or free_name(made_folder(), serial_number, kind, datetime.now())


def print_place(people: Console, kept: Path) -> None:
    """Print where the calibration is kept, and what to do where no test looks for it there."""
    people.print(f"calibration: {kept}", markup=False, soft_wrap=True)
    if not is_filed(kept):
        folder = calibration_folder()
        where = "name its folder with --calibrations" if folder is None else f"copy it to {folder}"
        people.print(f"Tests do not look for it there: {where}, or leave out --out.", markup=False, soft_wrap=True)


def check_passed(calibration: Calibration, asked: Path, kept: Path) -> None:
    """End the command with a line where a calibration failed, after it was told, kept in ``kept`` and reported.

    Raises:
        UnusableInputError: it failed: the instrument cannot be calibrated as it is.
    """
    if calibration.verdict == "passed":
        return
    beside = "" if kept == asked else f"; {asked}, which passed, is left as it was"
    raise UnusableInputError(f"the {calibration.kind} calibration failed, and is kept in {kept}{beside}")
