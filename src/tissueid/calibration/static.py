"""Static calibration: voltage to current to force, position, range of motion, thermometer, accelerometer, supplies.

After thesis 2.4.1 and B.1. ``procedure`` has the steps; this gathers what they find into a calibration with a verdict.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime

from tissueid import __version__
from tissueid.calibration.file import Calibration, utc_date
from tissueid.calibration.findings import repeated
from tissueid.calibration.plausible import implausible
from tissueid.calibration.procedure import Ask, Procedure, Show, StaticPlan
from tissueid.instrument import Instrument


@dataclass(frozen=True)
class StaticCalibration:
    """What came of it: the calibration as it is kept, what else is worth saying, and how long it took."""

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
    """Calibrate an instrument from its nominal figures on; a calibration that was in force is put out of force.

    Where the instrument has no motorised stage, ``ask`` tells a person what to put under the probe; None: nobody is
    there.

    Raises:
        UnusableInputError: something is missing, and what to give for it; samples were lost; nothing follows anything.
        CancelledError, LimitError, InstrumentError: the coil is released.
    """
    plan = plan or StaticPlan()
    begin = time.perf_counter()
    procedure = Procedure(instrument, plan, ask, progress, cancelled)
    procedure.see_off()
    instrument.use_calibration(instrument.nominal, {})
    runs = []
    for run in range(plan.repeats):
        label = f" ({run + 1} of {plan.repeats})" if plan.repeats > 1 else ""
        runs.append(procedure.run(label))
    found = repeated(runs)
    device = instrument.device
    conditions: dict[str, float | str] = {"repeats": float(plan.repeats), "steps": ", ".join(plan.steps)}
    if plan.ambient_c is not None:
        conditions["ambient_c"] = plan.ambient_c
    if "temperature_at_rest_c" in found.quantities:
        conditions["coil_temperature_c"] = found.quantities["temperature_at_rest_c"].value
    if plan.in_place or ask is None:
        conditions["by"] = "motorised stage" if procedure.has_stage else "spring in place"
    conditions |= {f"note_{number}": note[:500] for number, note in enumerate(found.notes, start=1)}
    calibration = Calibration(
        kind="static",
        model=device.model,
        serial_number=device.serial_number,
        firmware_version=device.firmware_version,
        date=utc_date(now or datetime.now(UTC)),
        valid_days=plan.valid_days,
        software=f"tissueid {__version__}",
        conditions=conditions,
        verdict="failed" if found.problems else "passed",
        problems=found.problems,
        quantities=found.quantities,
        tables=found.tables,
    )
    if calibration.verdict == "passed" and (strange := implausible(calibration, instrument.nominal)):
        problem = f"{strange}: that is not believed; check the fixture and the wiring"
        calibration = calibration.model_copy(update={"verdict": "failed", "problems": (problem,)})
    return StaticCalibration(calibration, found.notes, time.perf_counter() - begin)
