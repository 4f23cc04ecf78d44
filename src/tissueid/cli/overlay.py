"""``tissueid overlay`` and ``tissueid repeats``: fits of several tests in figures and in a table."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tissueid.analysis.overlay import Overlay, OverlayEntry, quantity_label, repeated_values
from tissueid.cli.output import check_json, console_control, human_output, table, write_json
from tissueid.formatting import fixed, grouped, number
from tissueid.messages import MISSING, stored
from tissueid.procedures.output_files import check_different
from tissueid.procedures.overlay import OverlayPlan, RepeatsPlan, run_overlay, run_repeats
from tissueid.units import display_unit

_WIDTH = 120


def overlay_tests(plan: OverlayPlan, json_file: Path | None) -> None:
    """Fit the tests, print their scores, and write the page, the figures, the numbers and the JSON."""
    check_json(json_file)
    check_different(plan.page, plan.csv, json_file)
    with console_control() as control:
        done = run_overlay(plan, control)
    found, out = done.found, human_output(json_file, width=_WIDTH)
    columns = (
        "tests",
        "fit",
        "fitted\nVAF %",
        "held out\nVAF %",
        "scheduled\nVAF %",
        "AICc",
        "para-\nmeters",
        "sec-\nonds",
    )
    rows = table("Scores", *columns)
    for entry in found.entries:
        report = entry.analysis.model.report
        criterion = report.aicc if entry.scheduled_aicc is None else entry.scheduled_aicc
        rows.add_row(
            entry.source,
            entry.fit.label + ("" if entry.swept is None else f", {found.swept} {entry.swept:g}"),
            fixed(report.vaf_percent, 1),
            fixed(report.vaf_validation_percent, 1),
            fixed(entry.scheduled_percent, 1),
            grouped(criterion),
            grouped(report.n_parameters),
            fixed(report.seconds, 2),
        )
    out.print(rows)
    for line in found.refused:
        out.print(f"left out: {line}", markup=False, soft_wrap=True)
    for name, path in (("report", plan.page), ("figures", plan.figures), ("numbers", plan.csv)):
        if path is not None:
            out.print(f"{name}: {path}", markup=False)
    if json_file is not None:
        write_json(json_file, {"fits": [_entry_answer(found, entry) for entry in found.entries], **_refused(found)})


def repeated_tests(plan: RepeatsPlan, json_file: Path | None) -> None:
    """Fit the tests, print mean, standard deviation and coefficient of variation, and write the table and the JSON."""
    check_json(json_file)
    check_different(plan.csv, json_file)
    with console_control() as control:
        found = run_repeats(plan, control)
    out = human_output(json_file, width=_WIDTH)
    rows = table(
        "Mean and standard deviation over tests", "tests", "fit", "quantity", "unit", "count", "mean", "SD", "CV %"
    )
    values = repeated_values(found)
    for one in values:
        label, si_unit = quantity_label(one.quantity)
        unit, scale = display_unit(si_unit)
        single = one.count < 2
        rows.add_row(
            one.source,
            one.fit,
            label,
            unit,
            str(one.count),
            number(scale * one.mean),
            MISSING if single else number(scale * one.std, 3),
            MISSING if single else fixed(100.0 * one.cv, 2),
        )
    out.print(rows)
    for line in found.refused:
        out.print(f"left out: {line}", markup=False, soft_wrap=True)
    if plan.csv is not None:
        out.print(f"table: {plan.csv}", markup=False)
    if json_file is not None:
        names = ("source", "fit", "quantity", "count", "mean", "std", "cv")
        answer = [{name: getattr(one, name) for name in names} for one in values]
        write_json(json_file, {"repeats": answer, **_refused(found)})


def _entry_answer(found: Overlay, entry: OverlayEntry) -> dict[str, Any]:
    about: dict[str, Any] = {"source": entry.source, "fit": entry.fit.label}
    if entry.swept is not None:
        about[found.swept] = entry.swept
    scores = {"vaf_scheduled_fitted_percent": entry.scheduled_percent, "aicc_scheduled": entry.scheduled_aicc}
    return about | scores | entry.analysis.as_answer()


def _refused(found: Overlay) -> dict[str, Any]:
    return {"refused": list(found.refused), "refused_messages": list(map(stored, found.refused))}
