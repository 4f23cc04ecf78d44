"""How ``tissueid calibrate`` ends when the calibration that it made did not pass."""

from __future__ import annotations

from pathlib import Path

from tissueid.calibration import Calibration
from tissueid.errors import UnusableInputError


def check_passed(calibration: Calibration, asked: Path, kept: Path) -> None:
    """End the command with a line where a calibration failed, after it was told, kept in ``kept`` and reported.

    Raises:
        UnusableInputError: it failed: the instrument cannot be calibrated as it is.
    """
    if calibration.verdict == "passed":
        return
    beside = "" if kept == asked else f"; {asked}, which passed, is left as it was"
    raise UnusableInputError(f"the {calibration.kind} calibration failed, and is kept in {kept}{beside}")
