"""``tissueid calibrate static``: static calibration of an instrument, automatic or with a person."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from rich.markup import escape

from tissueid.calibration import StaticCalibration, StaticPlan, calibrate_static, keep_calibration
from tissueid.calibration.coil import Spring
from tissueid.calibration.labels import headline_of, readable
from tissueid.calibration.static_procedure import STEPS, Ask
from tissueid.cli.audit_records import audit_failure, audit_note, audit_record
from tissueid.cli.calibrate_output import check_passed, check_place, place_of, print_place
from tissueid.cli.output import check_json, console, human_output, progress_bars, table, write_json
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.instrument import open_instrument
from tissueid.procedures.output_files import check_different, check_new, check_output

_DEFAULT = DeviceDescription()


@dataclass(frozen=True, kw_only=True)
class StaticOptions:
    """Options of the command, in the units of the command line."""

    steps: str | None = None
    spring_n_per_m: float | None = None
    spring_percent: float | None = None
    weights_g: tuple[float, ...] = ()
    gauges_mm: tuple[float, ...] = ()
    ambient_c: float | None = None
    orientations: int = 1
    in_place: bool = False
    push_only: bool = False
    repeats: int = 1
    valid_days: int = 90

    def plan(self, device: DeviceDescription) -> StaticPlan:
        """Return the plan of the calibration for a device.

        Raises:
            UnusableInputError: an option cannot be used.
        """
        stiffness = self.spring_n_per_m if self.spring_n_per_m is not None else device.calibration_spring_n_per_m
        relative = device.calibration_relative_uncertainty
        if self.spring_percent is not None:
            relative = 0.01 * self.spring_percent
        steps = STEPS if self.steps is None else tuple(step.strip() for step in self.steps.split(",") if step.strip())
        if self.in_place and (self.weights_g or self.gauges_mm or self.orientations > 1):
            raise UnusableInputError("--in-place runs without a person: leave out --weight, --gauge and --orientations")
        return StaticPlan(
            steps=steps,
            spring=Spring(stiffness, relative),
            weights_kg=tuple(1e-3 * grams for grams in self.weights_g),
            gauges_m=tuple(1e-3 * height for height in self.gauges_mm),
            ambient_c=self.ambient_c,
            turn_over=self.orientations > 1,
            in_place=self.in_place,
            push_only=self.push_only,
            repeats=self.repeats,
            valid_days=self.valid_days,
        )


def run_static(url: str, out: Path | None, report: Path | None, json_file: Path | None, options: StaticOptions) -> None:
    """Calibrate, save the calibration and print it. A failed calibration is saved too, in its own file.

    Raises:
        UnusableInputError: an option cannot be used, or the calibration failed.
    """
    options.plan(_DEFAULT)  # checks the options before anything moves
    check_different(out, report, json_file)
    check_place(out)
    check_output(report, ("<!DOCTYPE html",))
    check_new(report)
    check_json(json_file)
    ask = _asker()
    if ask is None and (options.weights_g or options.orientations > 1):
        raise UnusableInputError("--weight and --orientations need a person at a terminal, and there is no terminal")
    instrument = open_instrument(url)
    try:
        head = audit_record("technician", "calibration.begun", subject=instrument.device.serial_number, new="static")
        ended = audit_failure("technician", "calibration", subject=instrument.device.serial_number)
        with progress_bars() as show, ended:
            found = calibrate_static(instrument, options.plan(instrument.device), ask=ask, progress=show)
    finally:
        instrument.close()
    calibration = found.calibration.model_copy(
        update={"conditions": found.calibration.conditions | ({"audit_head": head} if head else {})}
    )
    out = place_of(out, calibration.serial_number, "static")
    kept = keep_calibration(out, calibration)
    audit_note(
        "technician",
        "calibration.made",
        subject=calibration.serial_number,
        new={"kind": "static", "file": kept.name, "verdict": calibration.verdict},
    )
    if report is not None:
        from tissueid.reports.calibration_static import static_report

        static_report(calibration).write(report)
    _print_result(found, kept, json_file)
    if json_file is not None:
        write_json(json_file, answer(found, kept))
    check_passed(calibration, out, kept)


def answer(found: StaticCalibration, out: Path) -> dict[str, object]:
    """Return the result for JSON: all values in SI units, the verdict, and the duration."""
    calibration = found.calibration
    return {
        "file": str(out),
        "kind": calibration.kind,
        "model": calibration.model,
        "serial_number": calibration.serial_number,
        "date": calibration.date,
        "verdict": calibration.verdict,
        "problems": list(calibration.problems),
        "notes": list(found.notes),
        "messages": list(calibration.messages),
        "quantities": {name: quantity.model_dump() for name, quantity in calibration.quantities.items()},
        "tables": calibration.tables,
        "seconds": found.seconds,
    }


def _asker() -> Ask | None:
    """Return a function that asks the person at the terminal to do something; None if there is no terminal."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return None

    def ask(words: str) -> None:
        console.print(f"[bold]{escape(words)}[/bold] Then press Enter.")
        if not sys.stdin.readline():
            raise UnusableInputError("the terminal was closed; nothing was saved")

    return ask


def _print_result(found: StaticCalibration, out: Path, json_file: Path | None) -> None:
    console = human_output(json_file)
    if not console.is_terminal:
        console.width = 120
    calibration = found.calibration
    rows = table(f"Static calibration of {calibration.serial_number}", "quantity", "value", "unit")
    for name, quantity in calibration.quantities.items():
        rows.add_row(*readable(name, quantity))
    console.print(rows)
    console.print(headline_of(calibration), markup=False)
    for problem in calibration.problems:
        console.print(f"- {problem}", markup=False, soft_wrap=True)
    for note in found.notes:
        console.print(f"note: {note}", markup=False, soft_wrap=True)
    print_place(console, out)
