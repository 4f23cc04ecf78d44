"""Output file of ``tissueid calibrate``, and its error when a calibration failed."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

from rich.console import Console

from tissueid.calibration import Calibration, calibration_folder, free_name, is_filed, made_folder
from tissueid.calibration.file import check_writable
from tissueid.errors import UnusableInputError


def check_place(out: Path | None) -> None:
    """Check, before any work, that the calibration can be written.

    Raises:
        UnusableInputError: as ``check_writable``, or the calibration folder cannot be made.
    """
    if out is None:
        made_folder()
    else:
        check_writable(out)


def place_of(out: Path | None, serial_number: str, kind: str) -> Path:
    """Return ``out``, or a new file in the calibration folder if ``out`` is None."""
    return out or free_name(made_folder(), serial_number, kind, datetime.now())


def print_place(console: Console, kept: Path) -> None:
    """Print where the calibration is saved, and what to do if tests will not find it there."""
    console.print(f"calibration: {kept}", markup=False, soft_wrap=True)
    if not is_filed(kept):
        folder = calibration_folder()
        where = "name its folder by --calibrations" if folder is None else f"copy it to {folder}"
        console.print(f"Tests do not find it there: {where}, or leave out --out.", markup=False, soft_wrap=True)


def check_passed(calibration: Calibration, asked: Path, kept: Path) -> None:
    """Raise an error if a calibration failed, after it was saved in ``kept`` and printed.

    Raises:
        UnusableInputError: the calibration failed.
    """
    if calibration.verdict == "passed":
        return
    unchanged = "" if kept == asked else f"; {asked}, which passed, is unchanged"
    raise UnusableInputError(f"the {calibration.kind} calibration failed; it is saved in {kept}{unchanged}")
