"""``tissueid calibrate static``: the static calibration of an instrument, on its own or with a person's hands."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from rich.markup import escape

from tissueid.calibration import StaticCalibration, StaticPlan, calibrate_static, keep_calibration
from tissueid.calibration.coil import Spring
from tissueid.calibration.procedure import STEPS, Ask
from tissueid.calibration.words import readable, verdict_of
from tissueid.cli.calibrate_verdict import check_passed, check_place, place_of, print_place
from tissueid.cli.logged import end_noted, logged, noted
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
from tissueid.instrument import open_instrument

_DEFAULT = DeviceDescription()


@dataclass(frozen=True, kw_only=True)
class StaticOptions:
    """What the command line asks for, in the units that people type."""

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
        """What is to be done on a device.

        Raises:
            UnusableInputError: says which option cannot be used.
        """
        stiffness = self.spring_n_per_m if self.spring_n_per_m is not None else device.calibration_spring_n_per_m
        relative = device.calibration_relative_uncertainty
        if self.spring_percent is not None:
            relative = 0.01 * self.spring_percent
        steps = STEPS if self.steps is None else tuple(step.strip() for step in self.steps.split(",") if step.strip())
        if self.in_place and (self.weights_g or self.gauges_mm or self.orientations > 1):
            raise UnusableInputError(
                "--in-place asks nobody for anything: it does not go with --weight, --gauge and --orientations"
            )
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
    """Calibrate, keep it, and tell it. A failed calibration is kept as well, beside one that passed.

    Raises:
        UnusableInputError: what is asked cannot be done, or the calibration failed.
    """
    options.plan(_DEFAULT)  # what is wrong with the options is said before anything moves
    check_different(out, report, json_file)
    check_place(out)
    check_output(report, ("<!DOCTYPE html",))
    check_new(report)
    check_json(json_file)
    ask = _asker()
    if ask is None and (options.weights_g or options.orientations > 1):
        raise UnusableInputError("--weight and --orientations need a person on a terminal: nobody is there")
    instrument = open_instrument(url)
    try:
        head = logged("technician", "calibration.begun", subject=instrument.device.serial_number, new="static")
        ended = end_noted("technician", "calibration", subject=instrument.device.serial_number)
        with progress_bars() as show, ended:
            found = calibrate_static(instrument, options.plan(instrument.device), ask=ask, progress=show)
    finally:
        instrument.close()
    calibration = found.calibration.model_copy(
        update={"conditions": found.calibration.conditions | ({"audit_head": head} if head else {})}
    )
    out = place_of(out, calibration.serial_number, "static")
    kept = keep_calibration(out, calibration)
    noted(
        "technician",
        "calibration.made",
        subject=calibration.serial_number,
        new={"kind": "static", "file": kept.name, "verdict": calibration.verdict},
    )
    if report is not None:
        from tissueid.reports.calibration_static import static_report

        static_report(calibration).write(report)
    _tell(found, kept, json_file)
    if json_file is not None:
        write_json(json_file, answer(found, kept))
    check_passed(calibration, out, kept)


def answer(found: StaticCalibration, out: Path) -> dict[str, object]:
    """What scripts read: all figures in SI units, the verdict, and how long it took."""
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
        "quantities": {name: quantity.model_dump() for name, quantity in calibration.quantities.items()},
        "tables": calibration.tables,
        "seconds": found.seconds,
    }


def _asker() -> Ask | None:
    """Somebody at the terminal who is told what to do; None where there is no terminal."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return None

    def ask(words: str) -> None:
        console.print(f"[bold]{escape(words)}[/bold] Then press Enter.")
        if not sys.stdin.readline():
            raise UnusableInputError("nobody is at the terminal any more; nothing was kept")

    return ask


def _tell(found: StaticCalibration, out: Path, json_file: Path | None) -> None:
    people = people_read(json_file)
    if not people.is_terminal:
        people.width = 120
    calibration = found.calibration
    rows = table(f"Static calibration of {calibration.serial_number}", "quantity", "value", "unit")
    for name, quantity in calibration.quantities.items():
        rows.add_row(*readable(name, quantity))
    people.print(rows)
    people.print(f"The calibration {verdict_of(calibration)}", markup=False)
    for problem in calibration.problems:
        people.print(f"- {problem}", markup=False, soft_wrap=True)
    for note in found.notes:
        people.print(f"note: {note}", markup=False, soft_wrap=True)
    print_place(people, out)
