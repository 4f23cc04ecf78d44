"""``tissueid calibrate sweep``: dynamic sweep, automatic with a stage, otherwise with a person."""

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
from tissueid.calibration.active import go_by_static, static_conditions
from tissueid.calibration.labels import headline_of, notes_of
from tissueid.calibration.manual_positioning import Standing, wait_until_there
from tissueid.calibration.sweep import Bring, Sweep, SweepPlan, sweep_tests
from tissueid.calibration.sweep_analysis import SweepResult, SweptSpring, analyse_sweep
from tissueid.calibration.sweep_file import as_calibration
from tissueid.cli.audit_records import audit_failure, audit_note, audit_record, audit_trail
from tissueid.cli.calibrate_output import check_passed, check_place, place_of, print_place
from tissueid.cli.output import check_json, console, human_output, progress_bars, table, write_json
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.formatting import fixed, plus_minus
from tissueid.instrument import Instrument, open_instrument
from tissueid.procedures.output_files import check_different, check_new, check_output
from tissueid.records import Estimate
from tissueid.sessions import Session, read_session

_FIRST_YEAR = 2000
"""Earliest plausible year of a session."""


@dataclass(frozen=True, kw_only=True)
class SweepOptions:
    """Options of the command, in the units of the command line."""

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
        """Return the plan of the sweep.

        Raises:
            UnusableInputError: an option cannot be used.
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
        """Return the calibration spring; default: the values of the device.

        Raises:
            UnusableInputError: a value is out of bounds.
        """
        stiffness = device.calibration_spring_n_per_m if self.spring_n_per_m is None else self.spring_n_per_m
        relative = (
            device.calibration_relative_uncertainty if self.spring_percent is None else 1e-2 * self.spring_percent
        )
        spring = SweptSpring(stiffness, relative, 1e-3 * self.spring_g)
        spring.check()
        if not 0.0 <= self.spring_g <= 200.0:
            raise UnusableInputError("the mass of the spring must be 0 to 200 g")
        return spring


def run_sweep(
    url: str | None, out: Path | None, report: Path | None, json_file: Path | None, options: SweepOptions
) -> None:
    """Run a sweep or read a saved one, analyse it, save the calibration and print it.

    Raises:
        UnusableInputError: an option cannot be used, or the calibration failed.
    """
    plan = options.plan()
    options.spring(DeviceDescription())  # checks the options before anything moves
    if (url is None) == (options.kept is None):
        raise UnusableInputError("give either --device, or --kept for a saved sweep")
    if options.kept is not None and options.session is not None:
        raise UnusableInputError("--session saves a new recording: leave it out with --kept")
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
    audit_note(
        "technician",
        "calibration.made",
        subject=calibration.serial_number,
        new={"kind": "sweep", "file": place.name, "verdict": calibration.verdict},
    )
    if report is not None:
        from tissueid.reports.calibration import sweep_report

        sweep_report(calibration).write(report)
    _print_result(result, calibration, place, options.session, json_file)
    if json_file is not None:
        seconds = {"seconds": time.perf_counter() - begin, "measuring_seconds": measured - begin}
        write_json(json_file, answer(calibration, place) | seconds)
    check_passed(calibration, out, place)


def _made(session: Session) -> datetime:
    """Return when a session was recorded; a time without zone is UTC.

    Raises:
        UnusableInputError: the session has no date, or an implausible one.
    """
    try:
        made = datetime.fromisoformat(session.created)
        made = made.replace(tzinfo=UTC) if made.tzinfo is None else made.astimezone(UTC)
    except (ValueError, OverflowError) as error:
        raise UnusableInputError(f"the date of the session is not valid: {session.created[:40]!r}") from error
    if made.year < _FIRST_YEAR:
        raise UnusableInputError(f"the date of the session is not plausible: {made.year}")
    return made


@contextmanager
def _session_file(wanted: Path | None) -> Iterator[Path]:
    """Yield the session file of a sweep: ``wanted``, or a temporary file."""
    if wanted is not None:
        yield wanted
        return
    with tempfile.TemporaryDirectory(prefix="tissueid-sweep-") as folder:
        yield Path(folder) / "sweep.h5"


def _recorded(
    url: str, plan: SweepPlan, options: SweepOptions, path: Path
) -> tuple[Session, str, tuple[str, ...], dict[str, float | str]]:
    """Run a sweep. Return its session, the head of the audit log, remarks, and conditions."""
    instrument = open_instrument(url)
    try:
        conditions = go_by_static(instrument, options.folder)
        head = audit_record("technician", "calibration.begun", subject=instrument.device.serial_number, new="sweep")
        recorder = SessionRecorder(path, instrument.device, trail=audit_trail("technician"))
        ended = audit_failure("technician", "calibration", subject=instrument.device.serial_number)
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
                        f"the stage stays at {1e3 * sweep.stage_m:.1f} mm: move it to mid-stroke before a test",
                        markup=False,
                        soft_wrap=True,
                    )
                if recorder.finish_or_discard(error) is not None and options.session is not None:
                    console.print(
                        f"the recording is saved in {path}: analyse it by --kept", markup=False, soft_wrap=True
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
    """Return a function that asks the person at the terminal to move the spring; None if there is no terminal."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return None

    def bring(place_m: float) -> None:
        console.print(
            f"[bold]Move the spring until the probe is at {1e3 * place_m:.1f} mm, then let go.[/bold] "
            "The sweep continues when the probe is at rest there."
        )
        with Live(Text(""), console=console, transient=True) as live:
            wait_until_there(instrument, place_m, lambda standing: live.update(_standing(standing, place_m)))

    return bring


def _standing(standing: Standing, place_m: float) -> Text:
    off = standing.position_m - place_m
    where = "there" if standing.there else f"{1e3 * abs(off):.1f} mm further {'out' if off < 0 else 'in'}"
    return Text(f"probe at {1e3 * standing.position_m:6.2f} mm: {where}")


def answer(calibration: Calibration, out: Path) -> dict[str, object]:
    """Return the result for JSON: all values in SI units, the table by position, the verdict."""
    return {
        "file": str(out),
        "kind": calibration.kind,
        "model": calibration.model,
        "serial_number": calibration.serial_number,
        "date": calibration.date,
        "verdict": calibration.verdict,
        "problems": list(calibration.problems),
        "notes": list(notes_of(calibration)),
        "messages": list(calibration.messages),
        "quantities": {name: found.model_dump() for name, found in calibration.quantities.items()},
        "tables": {name: columns for name, columns in calibration.tables.items() if name != "response"},
    }


def _print_result(
    result: SweepResult, calibration: Calibration, out: Path, session: Path | None, json_file: Path | None
) -> None:
    console = human_output(json_file)
    columns = ("position (mm)", "VAF (%)", "M (g)", "B (N·s/m)", "K (N/m)", "k (N per A)")
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
    console.print(rows)
    region = result.region
    ends = [
        f"{1e3 * end.value:.2f} mm{' or less' if open_end and first else ' or more' if open_end else ''}"
        for end, open_end, first in (
            (region.min_m, region.open_below, True),
            (region.max_m, region.open_above, False),
        )
    ]
    console.print(
        f"linear from {ends[0]} to {ends[1]} (* is outside), "
        f"force constant k {plus_minus(region.plateau_n_per_a)} N per A, "
        f"moving mass {plus_minus(result.moving_mass_kg, 1e3)} g",
        markup=False,
        soft_wrap=True,
    )
    console.print(headline_of(calibration), markup=False)
    for problem in calibration.problems:
        console.print(f"- {problem}", markup=False, soft_wrap=True)
    for note in notes_of(calibration):
        console.print(f"note: {note}", markup=False, soft_wrap=True)
    print_place(console, out)
    if session is not None:
        console.print(f"session: {session}", markup=False, soft_wrap=True)
