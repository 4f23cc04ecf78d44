"""Static calibration (thesis 2.4.1, B.1): electrical, force, position, range, thermometer, accelerometer, supplies.

``static_procedure`` runs the steps; this module turns their results into a calibration with a verdict.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime

from tissueid.calibration.file import Calibration, stored_messages, utc_date
from tissueid.calibration.findings import mean_of_repeats
from tissueid.calibration.labels import stored_text
from tissueid.calibration.plans import StaticPlan
from tissueid.calibration.static_procedure import Ask, Procedure, Show
from tissueid.calibration.status import first_implausible
from tissueid.instrument import Instrument
from tissueid.messages import Message
from tissueid.version import SOFTWARE


@dataclass(frozen=True)
class StaticCalibration:
    """The calibration to be stored, notes for the user, and the duration."""

    calibration: Calibration
    notes: tuple[str, ...]
    seconds: float


def calibrate_static(
    instrument: Instrument,
    plan: StaticPlan | None = None,
    *,
    ask: Ask | None = None,
    progress: Show = lambda _label, _fraction: None,
    cancelled: Callable[[], bool] = lambda: False,
    now: datetime | None = None,
) -> StaticCalibration:
    """Calibrate an instrument, starting from its nominal values; the active calibration is deactivated.

    Args:
        instrument: opened, with the calibration spring under the probe or a motorised stage.
        plan: steps and references; all steps by default.
        ask: shows an instruction to the operator and returns when it is done; None without an operator. Required
            without a motorised stage.
        progress: receives the name of the current step and its completed share.
        cancelled: polled throughout; True cancels the calibration.
        now: date of the calibration.

    Raises:
        UnusableInputError: something is missing, samples were lost, or a channel does not respond.
        CancelledError, LimitError, InstrumentError: the coil is released.
    """
    plan = plan or StaticPlan()
    begin = time.perf_counter()
    procedure = Procedure(instrument, plan, ask, progress, cancelled)
    procedure.drain_release()
    instrument.use_calibration(instrument.nominal, {})
    found = mean_of_repeats([procedure.run(run) for run in range(1, plan.repeats + 1)])
    device = instrument.device
    conditions: dict[str, float | str] = {"repeats": float(plan.repeats), "steps": ", ".join(plan.steps)}
    if plan.ambient_c is not None:
        conditions["ambient_c"] = plan.ambient_c
    if "temperature_at_rest_c" in found.quantities:
        conditions["coil_temperature_c"] = found.quantities["temperature_at_rest_c"].value
    conditions["by"] = (
        "motorised stage" if procedure.has_stage else "spring in place" if plan.in_place or ask is None else "hand"
    )
    conditions |= {f"note_{number}": stored_text(note) for number, note in enumerate(found.notes, start=1)}
    problems = found.problems
    calibration = Calibration(
        kind="static",
        model=device.model,
        serial_number=device.serial_number,
        firmware_version=device.firmware_version,
        date=utc_date(now or datetime.now(UTC)),
        valid_days=plan.valid_days,
        software=SOFTWARE,
        conditions=conditions,
        verdict="failed" if problems else "passed",
        problems=tuple(map(stored_text, problems)),
        quantities=found.quantities,
        tables=found.tables,
        messages=stored_messages((*problems, *found.notes)),
    )
    if calibration.verdict == "passed" and (strange := first_implausible(calibration, instrument.nominal)):
        problem = Message(
            "calibration.implausible",
            "{reason}: this is not plausible; check the fixture and the wiring",
            reason=strange,
        )
        messages = stored_messages((problem, *found.notes))
        failed = {"verdict": "failed", "problems": (stored_text(problem),), "messages": messages}
        calibration = calibration.model_copy(update=failed)
    return StaticCalibration(calibration, found.notes, time.perf_counter() - begin)
