"""Run a static calibration."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime

from tissueid.audit import AuditTrail
from tissueid.calibration.static import calibrate_static
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.instrument import Instrument, open_instrument
from tissueid.procedures.audit_notes import audit_failure
from tissueid.procedures.calibration_files import CalibrationResult, calibration_path, check_files, keep
from tissueid.procedures.calibration_plans import StaticCalibrationPlan
from tissueid.procedures.control import Control


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
            found = calibrate_static(
                instrument,
                plan.on(instrument.device),
                ask=control.ask if control.attended else None,
                progress=lambda step, fraction: control.progress(fraction, step),
                cancelled=control.check,
            )
    finally:
        instrument.close()
    return keep(plan, found.calibration, path, control, trail, nominal=instrument.nominal, seconds=found.seconds)
