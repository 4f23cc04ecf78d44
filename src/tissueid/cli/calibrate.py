"""``tissueid calibrate``: calibrate an instrument; list and show calibrations."""

from __future__ import annotations

import itertools
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from rich.live import Live
from rich.text import Text

from tissueid.calibration.file import Calibration
from tissueid.calibration.status import calibration_folder, headline_of, is_in_calibration_folder, notes_of, readable
from tissueid.calibration.sweep_analysis import SweepResult
from tissueid.cli.output import ConsoleControl, Output, at_terminal, console, progress_bars, table
from tissueid.errors import UnusableInputError
from tissueid.formatting import fixed, plus_minus
from tissueid.messages import stored
from tissueid.procedures.calibration_plans import DynamicSweepPlan, StaticCalibrationPlan
from tissueid.procedures.calibrations import (
    CalibrationListPlan,
    CalibrationResult,
    ShowCalibrationPlan,
    listed_calibrations,
    run_static_calibration,
    run_sweep,
    saved_calibration,
)
from tissueid.procedures.instruments import audit_trail
from tissueid.procedures.output_files import check_different
from tissueid.records import Estimate


class TerminalControl(ConsoleControl):
    """Asks the person at the terminal, if there is one, to do something."""

    def __init__(self, show: Callable[[str, float | None], None]) -> None:
        super().__init__(show)
        self._live: Live | None = None

    @property
    def attended(self) -> bool:
        """Whether input and messages are those of a terminal."""
        return at_terminal()

    def ask(self, prompt: str) -> None:
        """Show an instruction and wait for Enter."""
        console.print(Text.assemble((prompt, "bold"), " Then press Enter."))
        if not sys.stdin.readline():
            raise UnusableInputError("the terminal was closed; nothing was saved")

    def instruct(self, prompt: str) -> None:
        """Show an instruction, and below it steps of unknown share until the instruction is removed."""
        if self._live is not None:
            self._live.stop()
            self._live = None
        if prompt:
            console.print(prompt, style="bold")
            self._live = Live(Text(""), console=console, transient=True)
            self._live.start()

    def progress(self, fraction: float | None, step: str) -> None:
        """Show a progress bar, or the step below an instruction."""
        if self._live is not None and fraction is None:
            self._live.update(Text(step))
        else:
            super().progress(fraction, step)


@contextmanager
def terminal_control() -> Iterator[TerminalControl]:
    """Yield the control of a calibration in this command."""
    with progress_bars() as show:
        control = TerminalControl(show)
        try:
            yield control
        finally:
            control.instruct("")


def answer(result: CalibrationResult) -> dict[str, Any]:
    """Return the result for JSON: all values in SI units, and the verdict."""
    calibration = result.calibration
    return {
        "file": str(result.path),
        "kind": calibration.kind,
        "model": calibration.model,
        "serial_number": calibration.serial_number,
        "date": calibration.date,
        "verdict": calibration.verdict,
        "problems": list(calibration.problems),
        "notes": list(result.notes),
        "messages": list(calibration.messages),
        "quantities": {name: quantity.model_dump() for name, quantity in calibration.quantities.items()},
        "tables": {name: columns for name, columns in calibration.tables.items() if name != "response"},
    }


def print_verdict(out: Output, result: CalibrationResult) -> None:
    """Print verdict, problems, notes and files, and what to do if tests will not find the calibration."""
    out.print(headline_of(result.calibration))
    out.print_lines((f"- {problem}" for problem in result.calibration.problems), soft_wrap=True)
    out.print_lines((f"note: {note}" for note in result.notes), soft_wrap=True)
    out.print_files(calibration=result.path)
    if not is_in_calibration_folder(result.path):
        folder = calibration_folder()
        where = "name its folder by --calibrations" if folder is None else f"copy it to {folder}"
        out.print(f"Tests do not find it there: {where}, or leave out --out.", soft_wrap=True)
    out.print_files(session=result.session)


def check_result(result: CalibrationResult, out: Path | None) -> None:
    """Raise an error if a calibration failed or has no report, after it was saved and printed.

    Raises:
        UnusableInputError: the calibration failed.
        Exception: the error of the report.
    """
    if result.report_error is not None:
        raise result.report_error
    if result.calibration.verdict == "passed":
        return
    kind, path = result.calibration.kind, str(result.path)
    if out in (None, result.path):
        raise UnusableInputError(
            "calibration.failed_kept", "the {kind} calibration failed; it is saved in {path}", kind=kind, path=path
        )
    raise UnusableInputError(
        "calibration.failed_beside",
        "the {kind} calibration failed; it is saved in {path}; {passed}, which passed, is unchanged",
        kind=kind,
        path=path,
        passed=str(out),
    )


def print_static_calibration(plan: StaticCalibrationPlan, out: Output) -> None:
    """Calibrate and print the calibration.

    Raises:
        UnusableInputError: an option cannot be used, or the calibration failed.
    """
    check_different(*plan.outputs, out.json_file)
    with terminal_control() as control:
        result = run_static_calibration(plan, control, audit_trail("technician"))
    out.widen(120)
    _print_quantities(out, f"Static calibration of {result.calibration.serial_number}", result.calibration)
    print_verdict(out, result)
    out.write_json(answer(result) | {"seconds": result.seconds})
    check_result(result, plan.out)


def _print_quantities(out: Output, title: str, calibration: Calibration) -> None:
    rows = itertools.starmap(readable, calibration.quantities.items())
    out.print(table(title, "quantity", "value", "unit", rows=rows))


def print_sweep(plan: DynamicSweepPlan, out: Output) -> None:
    """Run a sweep or read a saved one, and print its calibration.

    Raises:
        UnusableInputError: an option cannot be used, or the calibration failed.
    """
    check_different(*plan.outputs, out.json_file)
    begin = time.perf_counter()
    with terminal_control() as control:
        result = run_sweep(plan, control, audit_trail("technician"))
    if result.sweep is not None:
        _print_profile(out, result.sweep, result.calibration.serial_number)
    print_verdict(out, result)
    seconds = {"seconds": time.perf_counter() - begin, "measuring_seconds": result.seconds}
    out.write_json(answer(result) | seconds)
    check_result(result, plan.out)


def _print_profile(out: Output, result: SweepResult, serial_number: str) -> None:
    columns = ("position (mm)", "VAF (%)", "M (g)", "B (N·s/m)", "K (N/m)", "k (N per A)")
    rows = table(f"Dynamic sweep of {serial_number}", *columns)
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
    out.print(rows)
    region = result.region
    ends = [
        f"{1e3 * end.value:.2f} mm{' or less' if open_end and first else ' or more' if open_end else ''}"
        for end, open_end, first in (
            (region.min_m, region.open_below, True),
            (region.max_m, region.open_above, False),
        )
    ]
    out.print(
        f"linear from {ends[0]} to {ends[1]} (* is outside), "
        f"force constant k {plus_minus(region.plateau_n_per_a)} N per A, "
        f"moving mass {plus_minus(result.moving_mass_kg, 1e3)} g",
        soft_wrap=True,
    )


def print_calibrations(plan: CalibrationListPlan, out: Output) -> None:
    """Print all calibrations of a folder, newest first, with their status.

    Raises:
        UnusableInputError: the folder of the plan does not exist, or cannot be read.
    """
    folder, listed = listed_calibrations(plan)
    out.widen(120)
    rows = table(f"Calibrations in {folder}", "file", "serial number", "kind", "date", "status", left_aligned=True)
    for item in listed:
        calibration, status = item.calibration, item.status.message
        cells = (
            ("", "", "")
            if calibration is None
            else (calibration.serial_number, calibration.kind, calibration.date[:10])
        )
        rows.add_row(item.path.name, *cells, f"{status}; the newest that passed" if item.newest else status)
    if folder is None:
        out.print(
            "there are no calibrations yet: run 'tissueid calibrate static', or choose another folder by "
            "--calibrations DIR"
        )
    elif not listed:
        out.print(f"there are no calibrations in {folder}", soft_wrap=True)
    else:
        out.print(rows)
    about = ("serial_number", "model", "kind", "date", "verdict")
    answers = [
        {
            "file": str(item.path),
            **{name: getattr(item.calibration, name, None) for name in about},
            "state": item.status.state,
            "words": item.status.message,
            "message": stored(item.status.message),
            "newest_that_passed": item.newest,
        }
        for item in listed
    ]
    out.write_json({"folder": None if folder is None else str(folder), "calibrations": answers})


def print_calibration(plan: ShowCalibrationPlan, out: Output) -> None:
    """Print one calibration: instrument, date, verdict, all values.

    Raises:
        UnusableInputError: the file is not a calibration, or the report cannot be written.
    """
    calibration = saved_calibration(plan)
    out.widen(120)
    out.print(
        f"{calibration.kind} calibration of {calibration.model}, {calibration.serial_number}, {calibration.date}, "
        f"by {calibration.software}",
        soft_wrap=True,
    )
    _print_quantities(out, "", calibration)
    out.print(headline_of(calibration))
    out.print_lines((f"- {line}" for line in (*calibration.problems, *notes_of(calibration))), soft_wrap=True)
    out.write_json(calibration.model_dump(mode="json"))
