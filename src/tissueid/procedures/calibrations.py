"""Calibrations of an instrument, static and dynamic sweep, with their files; lists of calibrations."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tissueid.acquisition import SessionRecorder
from tissueid.audit import AuditTrail
from tissueid.calibration.active import static_conditions, use_static_calibration
from tissueid.calibration.file import Calibration, check_writable, read_calibration, save_calibration
from tissueid.calibration.static_procedure import calibrate_static
from tissueid.calibration.status import (
    calibration_folder,
    create_calibration_folder,
    file_status,
    free_name,
    notes_of,
    stored_calibrations,
)
from tissueid.calibration.sweep import ProbePosition, Sweep, sweep_tests, wait_for_position
from tissueid.calibration.sweep_analysis import analyse_sweep, as_calibration
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.instrument import Instrument, open_instrument
from tissueid.language import marked
from tissueid.messages import Action, Message, Quantity, Verbatim
from tissueid.plan_options import Option, Plan
from tissueid.procedures.audit_queries import audit_failure, audit_note
from tissueid.procedures.calibration_plans import CalibrationPlan, DynamicSweepPlan, StaticCalibrationPlan
from tissueid.procedures.control import Control
from tissueid.procedures.output_files import HTML, check_different, check_new, check_output
from tissueid.sessions import Session, read_session

if TYPE_CHECKING:  # each takes long to import
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
    folder, now = calibration_folder(plan.folder), datetime.now(UTC)
    listed = []
    newest: set[tuple[str, str]] = set()
    for item in stored_calibrations(folder):
        calibration = item.calibration
        if plan.serial is not None and (calibration is None or calibration.serial_number != plan.serial):
            continue
        status = file_status(item, now)
        key = ("", "") if calibration is None else (calibration.serial_number, calibration.kind)
        listed.append(ListedCalibration(item.path, calibration, status, status.usable and key not in newest))
        if status.usable:
            newest.add(key)
    return folder, tuple(listed)


def saved_calibration(plan: ShowCalibrationPlan) -> Calibration:
    """Return a calibration, and write its report if the plan names a file.

    Raises:
        UnusableInputError: the file is not a calibration, or the report cannot be written.
    """
    check_output(plan.report, HTML)
    check_new(plan.report)
    calibration = read_calibration(plan.file)
    if plan.report is not None:
        write_calibration_report(calibration, plan.report)
    return calibration


def run_static_calibration(
    plan: StaticCalibrationPlan,
    control: Control,
    trail: AuditTrail,
    opener: Callable[[str], Instrument] | None = None,
    now: Callable[[], datetime] = datetime.now,
) -> CalibrationResult:
    """Calibrate an instrument and save the calibration, also a failed one. The coil is released in every case.

    Args:
        plan: of the calibration and its files.
        control: progress, cancellation, and instructions to a person.
        trail: gets the audit entries.
        opener: opens the instrument at an address; by default ``open_instrument``.
        now: local time, for the name of a new file.

    Raises:
        UnusableInputError: an option cannot be used, a file exists, or the calibration cannot be made as it is.
        CancelledError, InstrumentError, LimitError, AuditError: there is no calibration.
    """
    plan.on(DeviceDescription())  # checks the options before anything moves
    check_files(plan)
    if not control.attended and (plan.weights_kg or plan.orientations > 1):
        raise UnusableInputError(
            "calibration.no_terminal",
            "--weight and --orientations need a person at a terminal, and there is no terminal",
        )
    instrument = (opener or open_instrument)(plan.device or "")
    try:
        control.opened(instrument)
        control.check()
        serial_number = instrument.device.serial_number
        path = calibration_path(plan, serial_number, now)
        trail.record("calibration.begun", subject=serial_number, new=plan.kind)
        with audit_failure(trail, control, "calibration", subject=serial_number):
            result = calibrate_static(
                instrument,
                plan.on(instrument.device),
                ask=control.ask if control.attended else None,
                progress=lambda step, fraction: control.progress(fraction, step),
                cancelled=control.check,
            )
    finally:
        instrument.close()
    return keep(plan, result.calibration, path, control, trail, nominal=instrument.nominal, seconds=result.seconds)


_SWEEPING = Message("calibration.step.sweep", "identifying the spring along the stroke")
_ANALYSING = Message("calibration.step.analysis", "analysing the sweep")
_ANALYSE = Action(
    "sweep.analyse_kept",
    "tissueid calibrate sweep --kept FILE",
    marked("for a calibration, remove the cause and begin the sweep again"),
)
_FIRST_YEAR = 2000
"""Earliest plausible year of a session."""


@dataclass(frozen=True)
class _Recorded:
    """The session of a sweep, the file of its calibration, and where a new recording was saved."""

    session: Session
    path: Path
    nominal: DeviceDescription
    conditions: dict[str, float | str]
    remarks: tuple[str, ...] = ()
    saved: Path | None = None
    made: datetime | None = None


def run_sweep(
    plan: DynamicSweepPlan,
    control: Control,
    trail: AuditTrail,
    opener: Callable[[str], Instrument] | None = None,
    now: Callable[[], datetime] = datetime.now,
) -> CalibrationResult:
    """Run a sweep or read a saved one, analyse it and save the calibration, also a failed one.

    The coil is released in every case.

    Args:
        plan: of the sweep and its files.
        control: progress, cancellation, and instructions to a person.
        trail: gets the audit entries.
        opener: opens the instrument at an address; by default ``open_instrument``.
        now: local time, for the name of a new file.

    Raises:
        UnusableInputError: an option cannot be used, a file exists, or the recording cannot be analysed.
        CancelledError, InstrumentError, LimitError, AuditError, JournalError: there is no calibration.
    """
    plan.spring_of(DeviceDescription())  # checks the options before anything moves
    if (plan.device is None) == (plan.kept is None):
        raise UnusableInputError("sweep.device_or_kept", "give either --device, or --kept for a saved sweep")
    if plan.kept is not None and plan.session is not None:
        raise UnusableInputError("sweep.session_and_kept", "--session saves a new recording: leave it out with --kept")
    check_files(plan)
    begin = time.perf_counter()
    logged: AbstractContextManager[None] = nullcontext()
    if plan.kept is None:
        recorded = _record(plan, control, trail, opener, now)
        logged = audit_failure(trail, control, "calibration", subject=recorded.nominal.serial_number)
    else:
        recorded = _read(plan, plan.kept, now)
    seconds = time.perf_counter() - begin
    control.progress(None, _ANALYSING)
    session = recorded.session
    with logged:
        result = analyse_sweep(
            sweep_tests(session), session.instrument, plan.spring_of(session.instrument), remarks=recorded.remarks
        )
        calibration = as_calibration(
            result,
            conditions=recorded.conditions | {"session_id": session.session_id},
            valid_days=plan.valid_days,
            now=recorded.made,
        )
    return keep(
        plan,
        calibration,
        recorded.path,
        control,
        trail,
        nominal=recorded.nominal,
        seconds=seconds,
        session=recorded.saved,
        sweep=result,
    )


def _read(plan: DynamicSweepPlan, kept: Path, now: Callable[[], datetime]) -> _Recorded:
    session = read_session(kept)
    device = session.instrument
    path = calibration_path(plan, device.serial_number, now)
    return _Recorded(session, path, device, static_conditions(device), made=_date_of(session))


def _date_of(session: Session) -> datetime:
    """Return when a session was recorded; a time without zone is UTC.

    Raises:
        UnusableInputError: the session has no date, or an implausible one.
    """
    try:
        made = datetime.fromisoformat(session.created)
        made = made.replace(tzinfo=UTC) if made.tzinfo is None else made.astimezone(UTC)
    except (ValueError, OverflowError) as error:
        raise UnusableInputError(
            "sweep.date", "the date of the session is not valid: '{date}'", date=Verbatim(session.created[:40])
        ) from error
    if made.year < _FIRST_YEAR:
        raise UnusableInputError("sweep.year", "the date of the session is not plausible: {year}", year=made.year)
    return made


def _record(
    plan: DynamicSweepPlan,
    control: Control,
    trail: AuditTrail,
    opener: Callable[[str], Instrument] | None,
    now: Callable[[], datetime],
) -> _Recorded:
    """Run a sweep and save its recording."""
    instrument = (opener or open_instrument)(plan.device or "")
    try:
        control.opened(instrument)
        control.check()
        device = instrument.device
        path = calibration_path(plan, device.serial_number, now)
        conditions = use_static_calibration(instrument, plan.folder)
        trail.record("calibration.begun", subject=device.serial_number, new=plan.kind)
        wanted = path.with_suffix(".h5") if plan.all_files else plan.session
        with (
            audit_failure(trail, control, "calibration", subject=device.serial_number),
            _session_file(wanted) as file,
        ):
            recorder = SessionRecorder(file, instrument.device, trail=trail)
            sweep = Sweep(
                instrument,
                plan,
                recorder,
                bring=(lambda position_m: _bring(instrument, position_m, control)) if control.attended else None,
                progress=lambda fraction: control.progress(fraction, _SWEEPING),
                cancelled=control.check,
            )
            try:
                sweep.run()
            except BaseException as error:
                _broken_off(sweep, recorder, error, wanted, control)
                raise
            session = recorder.finish()
    finally:
        instrument.close()
    conditions |= {
        "from_m": plan.from_m,
        "to_m": plan.to_m,
        "step_m": plan.step_m,
        "seconds": plan.seconds,
        "by": "motorised stage" if sweep.has_stage else "hand",
    }
    return _Recorded(session, path, instrument.nominal, conditions, tuple(sweep.remarks), wanted)


def _broken_off(
    sweep: Sweep, recorder: SessionRecorder, error: BaseException, wanted: Path | None, control: Control
) -> None:
    """Save what was recorded, and say where the stage stands and where the recording is."""
    if sweep.stage_m is not None:
        control.notice(
            Message(
                "sweep.stage_stays",
                "the stage stays at {position}: move it to mid-stroke before a test",
                position=Quantity(1e3 * sweep.stage_m, "mm", 1),
            )
        )
    if recorder.finish_or_discard(error) is not None and wanted is not None:
        control.notice(
            Message("sweep.kept", "the recording is saved in {path}: {analyse}", path=str(wanted), analyse=_ANALYSE)
        )


@contextmanager
def _session_file(wanted: Path | None) -> Iterator[Path]:
    """Yield the session file of a sweep: ``wanted``, or a temporary file."""
    if wanted is not None:
        yield wanted
        return
    with tempfile.TemporaryDirectory(prefix="tissueid-sweep-") as folder:
        yield Path(folder) / "sweep.h5"


def _bring(instrument: Instrument, position_m: float, control: Control) -> None:
    """Ask the person to move the spring, and return when the probe is at rest at ``position_m``."""
    control.instruct(
        Message(
            "calibration.move_spring",
            (
                "Move the spring so that the probe stands at {position:.1f} mm, and let go. The procedure"
                " continues automatically."
            ),
            position=1e3 * position_m,
        )
    )

    def show(standing: ProbePosition) -> None:
        position_mm, off_mm = 1e3 * standing.position_m, 1e3 * (standing.position_m - position_m)
        if standing.in_place:
            step = Message("calibration.probe_there", "The probe stands at {position:.2f} mm.", position=position_mm)
        elif off_mm < 0:
            step = Message(
                "calibration.probe_before",
                "The probe stands at {position:.2f} mm: {distance:.1f} mm further out.",
                position=position_mm,
                distance=-off_mm,
            )
        else:
            step = Message(
                "calibration.probe_beyond",
                "The probe stands at {position:.2f} mm: {distance:.1f} mm further in.",
                position=position_mm,
                distance=off_mm,
            )
        control.progress(None, step)

    wait_for_position(instrument, position_m, show, control.check)
    control.instruct("")
