"""What both calibrations have on the command line: the person at the terminal, the answer, the error if it failed."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.markup import escape
from rich.text import Text

from tissueid.calibration.labels import headline_of
from tissueid.calibration.store import calibration_folder, is_in_calibration_folder
from tissueid.cli.output import ConsoleControl, at_terminal, check_json, console, progress_bars
from tissueid.errors import UnusableInputError
from tissueid.procedures.calibration_files import CalibrationResult
from tissueid.procedures.calibration_plans import CalibrationPlan
from tissueid.procedures.output_files import check_different


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
        console.print(f"[bold]{escape(prompt)}[/bold] Then press Enter.")
        if not sys.stdin.readline():
            raise UnusableInputError("the terminal was closed; nothing was saved")

    def instruct(self, prompt: str) -> None:
        """Show an instruction, and below it steps of unknown share until the instruction is removed."""
        if self._live is not None:
            self._live.stop()
            self._live = None
        if prompt:
            console.print(f"[bold]{escape(prompt)}[/bold]")
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


def check_outputs(plan: CalibrationPlan, json_file: Path | None) -> None:
    """Check the JSON file against the files of the plan.

    Raises:
        UnusableInputError: it cannot be written, or is named for two outputs.
    """
    check_different(*plan.outputs, json_file)
    check_json(json_file)


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


def print_verdict(console: Console, result: CalibrationResult) -> None:
    """Print verdict, problems, notes and files, and what to do if tests will not find the calibration."""
    console.print(headline_of(result.calibration), markup=False)
    for problem in result.calibration.problems:
        console.print(f"- {problem}", markup=False, soft_wrap=True)
    for note in result.notes:
        console.print(f"note: {note}", markup=False, soft_wrap=True)
    console.print(f"calibration: {result.path}", markup=False, soft_wrap=True)
    if not is_in_calibration_folder(result.path):
        folder = calibration_folder()
        where = "name its folder by --calibrations" if folder is None else f"copy it to {folder}"
        console.print(f"Tests do not find it there: {where}, or leave out --out.", markup=False, soft_wrap=True)
    if result.session is not None:
        console.print(f"session: {result.session}", markup=False, soft_wrap=True)


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
