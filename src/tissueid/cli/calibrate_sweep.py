"""``tissueid calibrate sweep``: dynamic sweep, automatic with a stage, otherwise with a person."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
from rich.console import Console

from tissueid.calibration.sweep_analysis import SweepResult
from tissueid.cli.calibrate_output import answer, check_outputs, check_result, print_verdict, terminal_control
from tissueid.cli.output import human_output, table, write_json
from tissueid.formatting import fixed, plus_minus
from tissueid.procedures.calibration_plans import DynamicSweepPlan
from tissueid.procedures.instrument_access import audit_trail
from tissueid.procedures.sweep import run_sweep
from tissueid.records import Estimate


def print_sweep(plan: DynamicSweepPlan, json_file: Path | None) -> None:
    """Run a sweep or read a saved one, and print its calibration.

    Raises:
        UnusableInputError: an option cannot be used, or the calibration failed.
    """
    check_outputs(plan, json_file)
    begin = time.perf_counter()
    with terminal_control() as control:
        result = run_sweep(plan, control, audit_trail("technician"))
    out = human_output(json_file)
    if result.sweep is not None:
        _print_profile(out, result.sweep, result.calibration.serial_number)
    print_verdict(out, result)
    if json_file is not None:
        seconds = {"seconds": time.perf_counter() - begin, "measuring_seconds": result.seconds}
        write_json(json_file, answer(result) | seconds)
    check_result(result, plan.out)


def _print_profile(console: Console, result: SweepResult, serial_number: str) -> None:
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
