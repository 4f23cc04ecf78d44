"""Saved calibrations: a list with the status of each, or one with its report."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tissueid.plan_options import Option, Plan
from tissueid.procedures.output_files import HTML, check_new, check_output

if TYPE_CHECKING:  # each takes long to import
    from tissueid.calibration.file import Calibration
    from tissueid.calibration.status import FileStatus


class CalibrationListPlan(Plan):
    """A calibration folder, None for the folder of the user, and the instrument whose calibrations are listed."""

    folder: Annotated[
        Path | None, Option("--calibrations", metavar="DIR", help="calibration folder; default: your own")
    ] = None
    serial: Annotated[
        str | None, Option("--serial", metavar="TEXT", help="only of the instrument with this serial number")
    ] = None


class ShowCalibrationPlan(Plan):
    """A calibration, and the file of its report."""

    file: Annotated[Path, Option(argument=True, metavar="FILE", help="a calibration, TOML")]
    report: Annotated[Path | None, Option("--report", metavar="FILE", help="write the report, one HTML page")] = None


@dataclass(frozen=True)
class ListedCalibration:
    """A file and its status; ``calibration`` is None if it cannot be read.

    ``newest`` marks the newest usable calibration of its kind and instrument.
    """

    path: Path
    calibration: Calibration | None
    status: FileStatus
    newest: bool


def listed_calibrations(plan: CalibrationListPlan) -> tuple[Path | None, tuple[ListedCalibration, ...]]:
    """Return the folder, None if it does not exist, and its calibrations, newest first.

    Which of them an instrument uses also depends on its nominal values: it can refuse a calibration.

    Raises:
        UnusableInputError: the folder of the plan does not exist, or cannot be read.
    """
    from tissueid.calibration.status import file_status
    from tissueid.calibration.store import calibration_folder, stored_calibrations

    folder, now = calibration_folder(plan.folder), datetime.now(UTC)
    listed = []
    newest: set[tuple[str, str]] = set()
    for item in stored_calibrations(folder):
        found = item.calibration
        if plan.serial is not None and (found is None or found.serial_number != plan.serial):
            continue
        status = file_status(item, now)
        key = ("", "") if found is None else (found.serial_number, found.kind)
        listed.append(ListedCalibration(item.path, found, status, status.usable and key not in newest))
        if status.usable:
            newest.add(key)
    return folder, tuple(listed)


def saved_calibration(plan: ShowCalibrationPlan) -> Calibration:
    """Return a calibration, and write its report if the plan names a file.

    Raises:
        UnusableInputError: the file is not a calibration, or the report cannot be written.
    """
    from tissueid.calibration.file import read_calibration
    from tissueid.procedures.calibration_files import write_calibration_report

    check_output(plan.report, HTML)
    check_new(plan.report)
    calibration = read_calibration(plan.file)
    if plan.report is not None:
        write_calibration_report(calibration, plan.report)
    return calibration
