"""``tissueid calibrate sweep``: the dynamic sweep, on its own where the device has a stage, else with a person."""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from rich.live import Live
from rich.text import Text

from tissueid.acquisition import SessionRecorder
from tissueid.calibration import Calibration, keep_calibration
from tissueid.calibration.in_force import go_by_static, static_conditions
from tissueid.calibration.moved_by_hand import Standing, wait_until_there
from tissueid.calibration.sweep import Bring, Sweep, SweepPlan, sweep_tests
from tissueid.calibration.sweep_analysis import SweepResult, SweptSpring, analyse_sweep
from tissueid.calibration.sweep_file import as_calibration
from tissueid.calibration.words import notes_of, verdict_of
from tissueid.cli.calibrate_verdict import check_passed, check_place, place_of, print_place
from tissueid.cli.logged import end_noted, logged, noted, trail
from tissueid.cli.output import (
    check_different,
    check_json,
    check_new,
    check_output,
    console,
    people_read,
    progress_bars,
    table,
    write_json,
)
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.instrument import Instrument, open_instrument
from tissueid.records import Estimate
from tissueid.sessions import Session, read_session
from tissueid.wording import fixed, plus_minus

_FIRST_YEAR = 2000
"""No session is older than this."""


@dataclass(frozen=True, kw_only=True)
class SweepOptions:
    """What the command line asks for, in the units that people type."""

    first_mm: float = 2.0
    last_mm: float = 30.0
    step_mm: float = 2.0
    seconds: float = 4.0
    swing_mm: float = 2.5
    repeats: int = 1
    seed: int = 1
    spring_n_per_m: float | None = None
    spring_percent: float | None = None
    spring_g: float = 18.0
    session: Path | None = None
    kept: Path | None = None
    folder: Path | None = None
    valid_days: int = 90

    def plan(self) -> SweepPlan:
        """Where and how long.

        Raises:
            UnusableInputError: says what cannot be.
        """
        return SweepPlan(
            from_m=1e-3 * self.first_mm,
            to_m=1e-3 * self.last_mm,
            step_m=1e-3 * self.step_mm,
            seconds=self.seconds,
            swing_m=1e-3 * self.swing_mm,
            repeats=self.repeats,
            seed=self.seed,
        )

    def spring(self, device: DeviceDescription) -> SweptSpring:
        """The spring, which is the device's own unless it is said.

        Raises:
            UnusableInputError: no spring is like that.
        """
        stiffness = device.calibration_spring_n_per_m if self.spring_n_per_m is None else self.spring_n_per_m
        relative = (
            device.calibration_relative_uncertainty if self.spring_percent is None else 1e-2 * self.spring_percent
        )
        if not 10.0 <= stiffness <= 1e5 or not 0.0 <= relative < 0.5:
            raise UnusableInputError("a spring has 10 to 100000 N/m, known to better than 50 %")
        if not 0.0 <= self.spring_g <= 200.0:
            raise UnusableInputError("the mass of the spring is 0 to 200 g")
        return SweptSpring(stiffness, relative, 1e-3 * self.spring_g)


def run_sweep(
    url: str | None, out: Path | None, report: Path | None, json_file: Path | None, options: SweepOptions
) -> None:
    """Sweep, or take a sweep that was kept; analyse it, keep the calibration, and tell it.

    Raises:
        UnusableInputError: what is asked cannot be done, or the calibration failed.
    """
    plan = options.plan()
    options.spring(DeviceDescription())  # what is wrong with the options is said before anything moves
    if (url is None) == (options.kept is None):
        raise UnusableInputError("name the instrument with --device, or a sweep that was kept with --kept; not both")
    if options.kept is not None and options.session is not None:
        raise UnusableInputError("--session keeps what is recorded now; it does not go with --kept")
    check_different(out, report, json_file, options.session, options.kept)
    check_place(out)
    check_output(report, ("<!DOCTYPE html",))
    if url is not None:
        check_new(report)
    check_json(json_file)
    begin = time.perf_counter()
    head = ""
    remarks: tuple[str, ...] = ()
    conditions: dict[str, float | str] = {}
    made: datetime | None = None
    if url is None:
        assert options.kept is not None
        session = read_session(options.kept)
        made = _made(session)
        conditions = static_conditions(session.instrument)
    else:
        with _session_file(options.session) as path:
            session, head, remarks, conditions = _recorded(url, plan, options, path)
    measured = time.perf_counter()
    with console.status("analysing the sweep"):
        result = analyse_sweep(
            sweep_tests(session), session.instrument, options.spring(session.instrument), remarks=remarks
        )
    calibration = as_calibration(
        result,
        conditions=conditions | ({"audit_head": head} if head else {}) | {"session_id": session.session_id},
        valid_days=options.valid_days,
        now=made,
    )
    out = place_of(out, calibration.serial_number, "sweep")
    place = keep_calibration(out, calibration)
    noted(
        "technician",
        "calibration.made",
        subject=calibration.serial_number,
        new={"kind": "sweep", "file": place.name, "verdict": calibration.verdict},
    )
    if report is not None:
        from tissueid.reports.calibration import sweep_report

        sweep_report(calibration).write(report)
    _tell(result, calibration, place, options.session, json_file)
    if json_file is not None:
        seconds = {"seconds": time.perf_counter() - begin, "measuring_seconds": measured - begin}
        write_json(json_file, answer(calibration, place) | seconds)
    check_passed(calibration, out, place)


def _made(session: Session) -> datetime:
    """When a session was recorded; a time without its zone is UTC, as sessions have it.

    Raises:
        UnusableInputError: it does not say, or says what cannot be.
    """
    try:
        made = datetime.fromisoformat(session.created)
        made = made.replace(tzinfo=UTC) if made.tzinfo is None else made.astimezone(UTC)
    except (ValueError, OverflowError) as error:
        raise UnusableInputError(
            f"the session says that it was made {session.created[:40]!r}: that is no time"
        ) from error
    if made.year < _FIRST_YEAR:
        raise UnusableInputError(f"the session says that it was made in {made.year}: there was no such instrument then")
    return made


@contextmanager
def _session_file(wanted: Path | None) -> Iterator[Path]:
    """Where the tests of a sweep go: to a file that is kept, or to one that lasts as long as the sweep."""
    if wanted is not None:
        yield wanted
        return
    with tempfile.TemporaryDirectory(prefix="tissueid-sweep-") as folder:
        yield Path(folder) / "sweep.h5"


def _recorded(
    url: str, plan: SweepPlan, options: SweepOptions, path: Path
) -> tuple[Session, str, tuple[str, ...], dict[str, float | str]]:
    """The session of a sweep, the head of the audit log at its beginning, what was left out, and how it was made."""
    instrument = open_instrument(url)
    try:
        conditions = go_by_static(instrument, options.folder)
        head = logged("technician", "calibration.begun", subject=instrument.device.serial_number, new="sweep")
        recorder = SessionRecorder(path, instrument.device, trail=trail("technician"))
        ended = end_noted("technician", "calibration", subject=instrument.device.serial_number)
        with progress_bars() as show, ended:
            sweep = Sweep(
                instrument,
                plan,
                recorder,
                bring=_person(instrument),
                progress=lambda fraction: show("sweep along the stroke", fraction),
            )
            try:
                sweep.run()
            except BaseException as error:
                if sweep.stage_m is not None:
                    console.print(
                        f"the stage stays at {1e3 * sweep.stage_m:.1f} mm: bring it back to mid-stroke before a test",
                        markup=False,
                        soft_wrap=True,
                    )
                if recorder.finish_or_discard(error) is not None and options.session is not None:
                    console.print(
                        f"what was measured is kept: {path}; analyse it with --kept", markup=False, soft_wrap=True
                    )
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
    return session, head, tuple(sweep.remarks), conditions


def _person(instrument: Instrument) -> Bring | None:
    """Somebody at the terminal who moves the spring and sees where the probe stands; None without a terminal."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return None

    def bring(place_m: float) -> None:
        console.print(
            f"[bold]Move the spring so that the probe stands at {1e3 * place_m:.1f} mm, and let go.[/bold] "
            "It goes on by itself when the probe stands still there."
        )
        with Live(Text(""), console=console, transient=True) as live:
            wait_until_there(instrument, place_m, lambda standing: live.update(_standing(standing, place_m)))

    return bring


def _standing(standing: Standing, place_m: float) -> Text:
    off = standing.position_m - place_m
    where = "there" if standing.there else f"{1e3 * abs(off):.1f} mm further {'out' if off < 0 else 'in'}"
    return Text(f"probe at {1e3 * standing.position_m:6.2f} mm: {where}")


def answer(calibration: Calibration, out: Path) -> dict[str, object]:
    """What scripts read: all figures in SI units, the table by position, the verdict."""
    return {
        "file": str(out),
        "kind": calibration.kind,
        "model": calibration.model,
        "serial_number": calibration.serial_number,
        "date": calibration.date,
        "verdict": calibration.verdict,
        "problems": list(calibration.problems),
        "notes": list(notes_of(calibration)),
        "quantities": {name: found.model_dump() for name, found in calibration.quantities.items()},
        "tables": {name: columns for name, columns in calibration.tables.items() if name != "response"},
    }


def _tell(
    result: SweepResult, calibration: Calibration, out: Path, session: Path | None, json_file: Path | None
) -> None:
    people = people_read(json_file)
    columns = ("position (mm)", "VAF (%)", "M (g)", "B (N·s/m)", "K (N/m)", "k (N/A)")
    rows = table(f"Dynamic sweep of {calibration.serial_number}", *columns)
    profile = result.force_constant
    for point in result.points:
        at = np.array([point.position_m])
        inside = result.region.min_m.value <= point.position_m <= result.region.max_m.value
        rows.add_row(
            f"{1e3 * point.position_m:.1f}{'' if inside else ' *'}",
            fixed(point.vaf_percent, 1),
            fixed(1e3 * point.mass_kg.value, 1),
            fixed(point.damping_n_s_per_m.value, 2),
            fixed(point.stiffness_n_per_m.value, 0),
            plus_minus(Estimate(float(profile.at(at)[0]), float(profile.std_at(at)[0]))),
        )
    people.print(rows)
    region = result.region
    ends = [
        f"{1e3 * end.value:.2f} mm{' or less' if open_end and first else ' or more' if open_end else ''}"
        for end, open_end, first in (
            (region.min_m, region.open_below, True),
            (region.max_m, region.open_above, False),
        )
    ]
    people.print(
        f"linear from {ends[0]} to {ends[1]} (* is outside), "
        f"force constant k {plus_minus(region.plateau_n_per_a)} N/A, "
        f"moving mass {plus_minus(result.moving_mass_kg, 1e3)} g",
        markup=False,
        soft_wrap=True,
    )
    people.print(f"The calibration {verdict_of(calibration)}", markup=False)
    for problem in calibration.problems:
        people.print(f"- {problem}", markup=False, soft_wrap=True)
    for note in notes_of(calibration):
        people.print(f"note: {note}", markup=False, soft_wrap=True)
    print_place(people, out)
    if session is not None:
        people.print(f"session: {session}", markup=False, soft_wrap=True)
