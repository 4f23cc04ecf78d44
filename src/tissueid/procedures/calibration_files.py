"""Files, audit entries and result of a calibration; the same for both kinds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tissueid.audit import AuditTrail
from tissueid.calibration.file import Calibration, check_writable, save_calibration
from tissueid.calibration.labels import notes_of
from tissueid.calibration.store import create_calibration_folder, free_name
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.plan_options import Option, Plan
from tissueid.procedures.audit_queries import audit_note
from tissueid.procedures.calibration_plans import CalibrationPlan
from tissueid.procedures.control import Control
from tissueid.procedures.output_files import HTML, check_different, check_new, check_output

if TYPE_CHECKING:
    from tissueid.calibration.status import FileStatus
    from tissueid.calibration.sweep_analysis import SweepResult


@dataclass(frozen=True)
class CalibrationResult:
    """A calibration and its files.

    ``report`` is None if it was not wanted or, with ``report_error``, could not be written; the calibration is
    complete without it. ``nominal`` describes the device without a calibration. ``seconds`` is the duration of the
    measurement; ``sweep`` is None for a static calibration.
    """

    calibration: Calibration
    path: Path
    report: Path | None
    report_error: Exception | None
    nominal: DeviceDescription
    seconds: float
    session: Path | None = None
    sweep: SweepResult | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the measurement that do not fail the calibration."""
        return notes_of(self.calibration)


def check_files(plan: CalibrationPlan) -> None:
    """Check, before anything moves, that all files can be written and that no file is replaced without being asked to.

    Raises:
        UnusableInputError: a folder is missing, a file exists, or two outputs have the same file.
    """
    check_different(*plan.outputs)
    if plan.out is None:
        create_calibration_folder(plan.folder)
    else:
        check_writable(plan.out)
        if plan.out.exists() and not plan.overwrite:
            raise UnusableInputError(
                "calibration.exists",
                "{path} already contains a calibration: choose another file name, or replace it by --overwrite",
                path=str(plan.out),
            )
    check_output(plan.report, HTML)
    if not plan.overwrite:
        check_new(plan.report)


def calibration_path(plan: CalibrationPlan, serial_number: str, now: Callable[[], datetime]) -> Path:
    """Return the file of the calibration: the named one, or a new one in the calibration folder."""
    return plan.out or free_name(create_calibration_folder(plan.folder), serial_number, plan.kind, now())


def keep(
    plan: CalibrationPlan,
    calibration: Calibration,
    path: Path,
    control: Control,
    trail: AuditTrail,
    *,
    nominal: DeviceDescription,
    seconds: float,
    session: Path | None = None,
    sweep: SweepResult | None = None,
) -> CalibrationResult:
    """Write a calibration, its audit entry and its report. A failed calibration is kept too, in a file of its own.

    Raises:
        UnusableInputError: the calibration cannot be written.
    """
    trail.settle()
    if trail.head:
        with_head = calibration.conditions | {"audit_head": trail.head}
        calibration = calibration.model_copy(update={"conditions": with_head})
    path = save_calibration(path, calibration, overwrite=plan.overwrite)
    made = {"kind": plan.kind, "file": path.name, "verdict": calibration.verdict}
    audit_note(trail, control, "calibration.made", subject=calibration.serial_number, new=made)
    report = path.with_suffix(".html") if plan.all_files else plan.report
    problem: Exception | None = None
    if report is not None:
        try:
            write_calibration_report(calibration, report)
        except Exception as error:  # noqa: BLE001 - the calibration is saved; the caller decides
            report, problem = None, error
    return CalibrationResult(calibration, path, report, problem, nominal, seconds, session, sweep)


def write_calibration_report(calibration: Calibration, path: Path) -> None:
    """Write the report of a calibration, one HTML page.

    Raises:
        OSError: it cannot be written.
    """
    from tissueid.reports.calibration_page import static_report, sweep_report

    (sweep_report if calibration.kind == "sweep" else static_report)(calibration).write(path)


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

    check_output(plan.report, HTML)
    check_new(plan.report)
    calibration = read_calibration(plan.file)
    if plan.report is not None:
        write_calibration_report(calibration, plan.report)
    return calibration
