"""A calibration from the window: runs in a thread that alone touches the instrument, and asks the person in front."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from tissueid.acquisition import SessionRecorder
from tissueid.acquisition.waiting import meanwhile
from tissueid.app.calibration_state import calibration_state
from tissueid.app.conversation import CalibrationOutcome, CalibrationPlan, Conversation
from tissueid.app.emergency import EmergencyStop
from tissueid.app.live_calibration import LiveCalibration
from tissueid.audit import Trail
from tissueid.calibration import StaticPlan, calibrate_static, write_calibration
from tissueid.calibration.coil import Spring
from tissueid.calibration.file import Calibration
from tissueid.calibration.in_force import go_by_static, put_in_force
from tissueid.calibration.moved_by_hand import Standing, wait_until_there
from tissueid.calibration.store import free_name, stored_calibrations
from tissueid.calibration.sweep import Sweep, SweepPlan, sweep_tests
from tissueid.calibration.sweep_analysis import SweptSpring, analyse_sweep
from tissueid.calibration.sweep_file import as_calibration
from tissueid.calibration.words import notes_of
from tissueid.errors import CancelledError
from tissueid.instrument import Instrument
from tissueid.language import _, marked

BRING_WORDS = marked("Move the spring so that the probe stands at {position:.1f} mm, and let go. It goes on by itself.")
STANDS_WORDS = marked("The probe stands at {position:.1f} mm.")


def calibrate(
    plan: CalibrationPlan,
    talk: Conversation,
    stop: EmergencyStop,
    opener: Callable[[str], Instrument],
    trail: Trail,
    now: Callable[[], datetime] = datetime.now,
    live: LiveCalibration | None = None,
) -> CalibrationOutcome:
    """Calibrate, and leave the calibration and its report in the folder; a failed one is kept too, and says so.

    However it ends, the coil is released. ``live`` follows what is sampled.

    Raises:
        CancelledError: it was stopped.
        TissueIDError, OSError: it could not begin, or broke off; there is no calibration.
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
            calibration, remarks, write_report = run(plan, path, instrument, talk, stop, trail)
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
    except Exception as error:  # noqa: BLE001 - the calibration is made and in force, whatever befalls its picture
        report = None
        words = _(
            "its report could not be written ({error}); 'tissueid calibrate show' with --report makes it from the file"
        ).format(error=error)
        remarks = (*remarks, words)
    if problem := trail.settle():
        remarks = (*remarks, _("not in the audit log: {problem}").format(problem=problem))
    state = calibration_state(put_in_force(instrument.nominal, stored_calibrations(plan.folder), datetime.now(UTC)))
    return CalibrationOutcome(calibration, path, report, remarks, state)


_Made = tuple[Calibration, tuple[str, ...], Callable[[Calibration, Path], None]]
"""A calibration, remarks, and what writes its report."""


def _static(
    plan: CalibrationPlan, _path: Path, instrument: Instrument, talk: Conversation, stop: EmergencyStop, _trail: Trail
) -> _Made:
    from tissueid.reports.calibration_static import static_report

    nominal = instrument.nominal
    spring = Spring(nominal.calibration_spring_n_per_m, nominal.calibration_relative_uncertainty)
    static = StaticPlan(spring=spring, ambient_c=plan.ambient_c, push_only=plan.push_only)
    found = calibrate_static(instrument, static, ask=talk.ask, progress=talk.show, cancelled=stop.check)
    return found.calibration, found.notes, lambda calibration, report: static_report(calibration).write(report)


def _sweep(
    plan: CalibrationPlan, path: Path, instrument: Instrument, talk: Conversation, stop: EmergencyStop, trail: Trail
) -> _Made:
    from tissueid.reports.calibration import sweep_report

    def bring(position_m: float) -> None:
        """Have the person move the spring: it goes on by itself when the probe stands there."""
        words = _(BRING_WORDS).format(position=1e3 * position_m)

        def tell(standing: Standing) -> None:
            talk.want(words, _(STANDS_WORDS).format(position=1e3 * standing.position_m))

        wait_until_there(instrument, position_m, tell, stop.check)
        talk.want("")

    conditions = go_by_static(instrument, plan.folder)
    recorder = SessionRecorder(path.with_suffix(".h5"), instrument.device, trail=trail)
    swept = SweepPlan()
    sweep = Sweep(
        instrument,
        swept,
        recorder,
        bring=bring,
        progress=lambda fraction: talk.show(_("identifying the spring along the stroke"), fraction),
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

    talk.show(_("working out what the sweep says"), 1.0)
    calibration = meanwhile(instrument, analyse)
    return calibration, notes_of(calibration), lambda made, report: sweep_report(made).write(report)
