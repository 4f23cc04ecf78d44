"""A calibration from the window, in the thread that owns the instrument; it prompts the person at the window."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from tissueid.acquisition import SessionRecorder
from tissueid.acquisition.background_work import run_while_polling
from tissueid.app.calibration_state import calibration_state
from tissueid.app.emergency import EmergencyStop
from tissueid.app.live_calibration import LiveCalibration
from tissueid.app.operator_prompts import CalibrationOutcome, CalibrationPlan, OperatorPrompts
from tissueid.app.words import in_words
from tissueid.audit import AuditTrail
from tissueid.calibration import StaticPlan, calibrate_static, write_calibration
from tissueid.calibration.active import go_by_static, put_in_force
from tissueid.calibration.coil import Spring
from tissueid.calibration.file import Calibration
from tissueid.calibration.labels import notes_of
from tissueid.calibration.manual_positioning import Standing, wait_until_there
from tissueid.calibration.store import free_name, stored_calibrations
from tissueid.calibration.sweep import Sweep, SweepPlan, sweep_tests
from tissueid.calibration.sweep_analysis import SweptSpring, analyse_sweep
from tissueid.calibration.sweep_file import as_calibration
from tissueid.errors import CancelledError
from tissueid.instrument import Instrument
from tissueid.messages import Message

_IDENTIFYING = Message("calibration.step.sweep", "identifying the spring along the stroke")
_ANALYSING = Message("calibration.step.analysis", "analysing the sweep")


def calibrate(
    plan: CalibrationPlan,
    prompts: OperatorPrompts,
    stop: EmergencyStop,
    opener: Callable[[str], Instrument],
    trail: AuditTrail,
    now: Callable[[], datetime] = datetime.now,
    live: LiveCalibration | None = None,
) -> CalibrationOutcome:
    """Calibrate an instrument and save the calibration, also a failed one, and its report in the folder.

    The coil is released in every case. ``live`` gets the samples.

    Raises:
        CancelledError: it was stopped.
        TissueIDError, OSError: it could not start, or was broken off; there is no calibration.
    """
    instrument = opener(plan.url)
    try:
        stop.check()
        if live is not None:
            live.watch(instrument)
        serial_number = instrument.device.serial_number
        trail.record("calibration.begun", subject=serial_number, new=plan.kind)
        path = free_name(plan.folder, serial_number, plan.kind, now())
        try:
            run = _static if plan.kind == "static" else _sweep
            calibration, remarks, write_report = run(plan, path, instrument, prompts, stop, trail)
        except Exception as error:
            what = "calibration.stopped" if isinstance(error, CancelledError) else "calibration.broken_off"
            trail.note(what, subject=serial_number, new=str(error))
            raise
    finally:
        instrument.close()
    if trail.head:
        calibration = calibration.model_copy(update={"conditions": calibration.conditions | {"audit_head": trail.head}})
    write_calibration(path, calibration)
    made = {"kind": plan.kind, "file": path.name, "verdict": calibration.verdict}
    trail.note("calibration.made", subject=serial_number, new=made)
    report: Path | None = path.with_suffix(".html")
    try:
        write_report(calibration, path.with_suffix(".html"))
    except Exception as error:  # noqa: BLE001 - the calibration is saved; it needs no report
        report = None
        remarks = (
            *remarks,
            Message(
                "calibration.no_report",
                "its report could not be written ({problem}); the calibration is complete without it",
                problem=in_words(error).removesuffix("."),
            ),
        )
    if problem := trail.settle():
        remarks = (*remarks, Message("audit.not_logged", "not in the audit log: {problem}", problem=problem))
    state = calibration_state(put_in_force(instrument.nominal, stored_calibrations(plan.folder), datetime.now(UTC)))
    return CalibrationOutcome(calibration, path, report, remarks, state)


_Made = tuple[Calibration, tuple[str, ...], Callable[[Calibration, Path], None]]
"""A calibration, remarks, and the function that writes its report."""


def _static(
    plan: CalibrationPlan,
    _path: Path,
    instrument: Instrument,
    prompts: OperatorPrompts,
    stop: EmergencyStop,
    _trail: AuditTrail,
) -> _Made:
    from tissueid.reports.calibration_static import static_report

    nominal = instrument.nominal
    spring = Spring(nominal.calibration_spring_n_per_m, nominal.calibration_relative_uncertainty)
    static = StaticPlan(spring=spring, ambient_c=plan.ambient_c, push_only=plan.push_only)
    found = calibrate_static(
        instrument, static, ask=prompts.prompt_and_wait, progress=prompts.show, cancelled=stop.check
    )
    return found.calibration, found.notes, lambda calibration, report: static_report(calibration).write(report)


def _sweep(
    plan: CalibrationPlan,
    path: Path,
    instrument: Instrument,
    prompts: OperatorPrompts,
    stop: EmergencyStop,
    trail: AuditTrail,
) -> _Made:
    from tissueid.reports.calibration import sweep_report

    def bring(position_m: float) -> None:
        """Ask the person to move the spring, and return when the probe is at ``position_m``."""
        instruction = Message(
            "calibration.move_spring",
            "Move the spring so that the probe stands at {position:.1f} mm, and let go. It goes on by itself.",
            position=1e3 * position_m,
        )

        def show(standing: Standing) -> None:
            position_mm = 1e3 * standing.position_m
            step = Message("calibration.probe_at", "The probe stands at {position:.1f} mm.", position=position_mm)
            prompts.prompt(instruction, step)

        wait_until_there(instrument, position_m, show, stop.check)
        prompts.prompt("")

    conditions = go_by_static(instrument, plan.folder)
    recorder = SessionRecorder(path.with_suffix(".h5"), instrument.device, trail=trail)
    swept = SweepPlan()
    sweep = Sweep(
        instrument,
        swept,
        recorder,
        bring=bring,
        progress=lambda fraction: prompts.show(_IDENTIFYING, fraction),
        cancelled=stop.check,
    )
    try:
        sweep.run()
    except BaseException as error:
        recorder.finish_or_discard(error)
        raise

    def analyse() -> Calibration:
        session = recorder.finish()
        device = session.instrument
        spring = SweptSpring(device.calibration_spring_n_per_m, device.calibration_relative_uncertainty)
        result = analyse_sweep(sweep_tests(session), device, spring, remarks=sweep.remarks)
        return as_calibration(
            result,
            conditions=conditions
            | {
                "session_id": session.session_id,
                "from_m": swept.from_m,
                "to_m": swept.to_m,
                "step_m": swept.step_m,
                "seconds": swept.seconds,
                "by": "motorised stage" if sweep.has_stage else "hand",
            },
        )

    prompts.show(_ANALYSING, 1.0)
    calibration = run_while_polling(instrument, analyse)
    return calibration, notes_of(calibration), lambda made, report: sweep_report(made).write(report)
