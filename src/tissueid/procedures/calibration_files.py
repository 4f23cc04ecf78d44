"""Files, audit entries and result of a calibration; the same for both kinds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from tissueid.audit import AuditTrail
from tissueid.calibration.file import Calibration, check_writable, save_calibration
from tissueid.calibration.labels import notes_of
from tissueid.calibration.store import create_calibration_folder, free_name
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.procedures.audit_notes import audit_note
from tissueid.procedures.calibration_plans import CalibrationPlan
from tissueid.procedures.control import Control
from tissueid.procedures.output_files import HTML, check_different, check_new, check_output

if TYPE_CHECKING:
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
