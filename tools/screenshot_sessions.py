"""Files shown in the screenshots: sessions of simulated subjects, calibrations, an audit log."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
from screenshot_scene import SetClock, set_clock

from firmware_sim.effects import LISTED
from firmware_sim.laboratory.scenario_generation import NOMINAL, draw_scenario
from tissueid.acquisition import SessionRecorder
from tissueid.app.emergency import EmergencyStop
from tissueid.app.live_signals import LiveSignals
from tissueid.app.live_test import LiveTest
from tissueid.app.user_files import dated_path
from tissueid.audit import AuditLog, AuditTrail
from tissueid.calibration import CalibratedQuantity, Calibration, write_calibration
from tissueid.calibration.file import utc_date
from tissueid.device import DeviceDescription
from tissueid.errors import CancelledError
from tissueid.instrument import SimulatedInstrument
from tissueid.instrument.tissues import TISSUES, SimulatedTissue
from tissueid.procedures.control import BY_KEY, Control
from tissueid.procedures.study_sitting import SittingRunPlan, run_sitting
from tissueid.procedures.test_plan import TestPlan
from tissueid.procedures.test_run import run_test
from tissueid.sessions import Session, Subject, Test, write_session

FOREARM, ANTERIOR, SPRING = "simulated://forearm", "simulated://anterior-forearm", "simulated://spring"
PAST = (
    (-64, "P-002", "left forearm, anterior", ANTERIOR, 10.5),
    (-41, "P-001", "left forearm, posterior", FOREARM, 8.0),
    (-40, "P-003", "right forearm, anterior", ANTERIOR, 10.5),
    (-15, "P-001", "left forearm, anterior", ANTERIOR, 8.0),
    (-6, "P-002", "left forearm, posterior", FOREARM, 10.5),
)
"""Earlier tests: day, subject, site, simulated instrument, and greatest force, N."""
STUDY = {
    "name": "Lotion on the forearm",
    "sites": [
        "left forearm, anterior",
        "left forearm, posterior",
        "right forearm, anterior",
        "right forearm, posterior",
    ],
    "repeats": 2,
    "conditions": [{}, {"product": "lotion", "minutes_since_application": 60.0}],
    "photograph": True,
}
SERIAL = "TWIN-7"
_seeds = itertools.count(1)
PLACES_M = tuple(0.002 * k for k in range(1, 16))


def opener(url: str) -> SimulatedInstrument:
    """Return the simulated instrument of an address, with different noise each time."""
    played = SimulatedInstrument(url.removeprefix("simulated://"), seed=next(_seeds))
    played.nominal = played.device = replace(played.device, serial_number=SERIAL)
    return played


class PausableWait:
    """Wait function that runs the simulation without delay up to one poll, and further on request."""

    def __init__(self, held_at: int) -> None:
        self.left = held_at
        self.held, self.go_on = threading.Event(), threading.Event()

    def wait(self, _seconds: float) -> None:
        """Hold the test at the moment of its picture."""
        self.left -= 1
        if self.left == 0:
            self.held.set()
            self.go_on.wait()


def record_study(folder: Path) -> None:
    """Run the sittings of four subjects of a study, and one of a fifth that was interrupted."""
    folder.mkdir(parents=True)
    (folder / "protocol.json").write_text(json.dumps(STUDY), encoding="utf-8")
    for number, ages in enumerate((24, 31, 28, 35, 22), 1):
        set_clock(-20 + number)
        played = itertools.count(1000 * number)
        skin = TISSUES["forearm"].of_subject(number).varied(1.0)
        gender, height_m = ("female", 1.66) if number % 2 else ("male", 1.79)
        given = {"age_years": ages, "gender": gender, "height_m": height_m, "weight_kg": 55 + 5 * number}
        plan = SittingRunPlan(
            folder=folder,
            subject=f"P-00{number}",
            url=FOREARM,
            values=tuple(f"{name}={value}" for name, value in given.items()),
            calibration=False,
        )
        steps = _LastSubjectSteps() if number == 5 else Control()
        with contextlib.suppress(CancelledError):
            run_sitting(plan, steps, None, opener=lambda _url, skin=skin, played=played: _of_study(skin, next(played)))


def _of_study(skin: SimulatedTissue, seed: int) -> SimulatedInstrument:
    played = SimulatedInstrument(skin, seed=seed)
    played.nominal = played.device = replace(played.device, serial_number=SERIAL)
    return played


class _LastSubjectSteps(Control):
    """Interrupts a sitting after some steps."""

    def __init__(self) -> None:
        self._left = 5

    def progress(self, _fraction: float | None, _step: str) -> None:
        """Count the steps."""
        self._left -= 1

    def cancelled(self) -> bool:
        """Return whether the steps are over."""
        return self._left < 0


def record_past(folder: Path, audit: AuditLog, calibrate: object) -> None:
    """Run the tests of earlier days, one of them stopped by key, and leave one unfinished."""
    folder.mkdir(parents=True)
    trail = AuditTrail(audit, "clinician")
    for number, (day, subject, site, url, force_n) in enumerate(PAST):
        set_clock(day, 17 * number)
        plan = TestPlan(
            url=url,
            site=site,
            out=dated_path(folder, SetClock.now()),
            subject=subject,
            max_force_n=force_n,
            seed=number + 1,
            live=True,
        )
        _run(plan, EmergencyStop(), trail, calibrate)
        _date(plan.out)
    set_clock(-2, 20)
    plan = TestPlan(url=FOREARM, site="left calf", out=dated_path(folder, SetClock.now()), subject="P-004", live=True)
    stop = EmergencyStop()
    _run(plan, stop, trail, calibrate, stop_after=300)
    _date(plan.out)
    set_clock(-1, 45)
    unfinished = SessionRecorder(dated_path(folder, SetClock.now()), opener(FOREARM).device, Subject("P-004"))
    unfinished.abandon()


def _run(plan: TestPlan, stop: EmergencyStop, trail: AuditTrail, calibrate: object, stop_after: int = 0) -> None:
    polls = 0

    def wait(_seconds: float) -> None:
        nonlocal polls
        polls += 1
        if polls == stop_after:
            stop.press(BY_KEY)

    control = LiveTest(LiveSignals(), stop)
    run_test(plan, control, trail, opener=opener, calibrate=calibrate, pace=wait, separate_process=False)  # type: ignore[arg-type]


def _date(path: Path) -> None:
    """Set the modification time of a file, by which the list of sessions is sorted."""
    os.utime(path, (SetClock.moment.timestamp(),) * 2)


def record_laboratory(path: Path) -> None:
    """Record a session with full tests of a plant with dry friction in the bearing, which the nominal twin does not
    model.
    """
    set_clock(-3)
    others = tuple(name for name in LISTED if name != "dry_friction")
    drawn = draw_scenario(3, effects=1, without=others, full=False)
    tests = tuple(
        Test(
            number,
            plan.kind,
            {name: getattr(made, name)[:4000] for name in ("time", "command", "voltage", "current", "position")},
            2000.0,
            preload_s=0.5,
            surface_position_m=made.surface_m,
            repeat_of=plan.repeats,
            site="left forearm, posterior",
        )
        for number, (plan, made) in enumerate(zip(drawn.tests, drawn.record(), strict=True), 1)
    )
    write_session(path, Session(replace(DeviceDescription(**NOMINAL), serial_number="DI-0042"), tests=tests))
    _date(path)


def write_calibrations(folder: Path) -> Path:
    """Write static calibrations and sweeps of the simulated instrument over half a year, with a drifting force
    constant.
    """
    folder.mkdir(parents=True)
    device = opener(FOREARM).device
    for kind, days, share in (
        ("static", -171, 1.006),
        ("sweep", -170, 1.004),
        ("static", -88, 1.002),
        ("sweep", -87, 1.001),
        ("static", -12, 0.997),
        ("sweep", -12, 0.998),
    ):
        set_clock(days, -60)
        made = Calibration(
            kind=kind,  # type: ignore[arg-type]
            model=device.model,
            serial_number=device.serial_number,
            date=utc_date(SetClock.now(SetClock.moment.tzinfo)),
            software="tissueid",
            verdict="passed",
            quantities=_static(share) if kind == "static" else _sweep(share),
            tables=_residuals() if kind == "static" else _along(share),
        )
        write_calibration(folder / f"{made.serial_number}-{made.date[:10]}-{kind}.toml", made)
    return folder


def _static(share: float) -> dict[str, CalibratedQuantity]:
    return {
        "coil_resistance_ohm": CalibratedQuantity(value=12.0 + 3.0 * (1.0 - share), std=0.003, unit="ohm"),
        "force_constant_n_per_a": CalibratedQuantity(value=3.0 * share, std=0.004, unit="N/A"),
        "current_offset_a": CalibratedQuantity(value=0.001, std=1e-4, unit="A"),
    }


def _sweep(share: float) -> dict[str, CalibratedQuantity]:
    return {
        "force_constant_n_per_a": CalibratedQuantity(value=3.0 * share, std=0.006, unit="N/A"),
        "linear_region_min_m": CalibratedQuantity(value=0.004, std=5e-5, unit="m"),
        "linear_region_max_m": CalibratedQuantity(value=0.0275, std=5e-5, unit="m"),
    }


def _residuals() -> dict[str, dict[str, tuple[float, ...]]]:
    volts = tuple(float(v) for v in np.linspace(-6.0, 6.0, 13))
    return {"electrical": {"voltage_v": volts, "residual_a": tuple(2e-4 * float(np.sin(2.1 * v)) for v in volts)}}


def _along(share: float) -> dict[str, dict[str, tuple[float, ...]]]:
    """Return a coil whose force decreases towards both ends of the stroke."""
    off = (np.array(PLACES_M) - 0.0158) / 0.0155
    constant = 3.0 * share * (1.0 - 0.06 * off**4 + 0.002 * np.cos(9.0 * off))
    mass, damping = 0.0602 + 0.0002 * np.cos(5.0 * off), 3.5 + 0.15 * off**2
    columns = {
        "vaf_percent": 99.7 - 0.4 * off**2,
        "mass_kg": mass,
        "damping_n_s_per_m": damping,
        "stiffness_n_per_m": 1000.0 + 4.0 * np.sin(4.0 * off),
    }
    return {
        "force_constant": {"position_m": PLACES_M, "value_n_per_a": tuple(map(float, constant))},
        "sweep": {"position_m": PLACES_M} | {name: tuple(map(float, values)) for name, values in columns.items()},
    }
