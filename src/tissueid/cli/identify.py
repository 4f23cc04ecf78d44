"""``tissueid identify``: fit one engine to a test and validate it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from tissueid.analysis import Analysis
from tissueid.cli.output import check_json, human_output, table, write_json
from tissueid.cli.quality import repeat_warnings
from tissueid.configuration import travel_word
from tissueid.formatting import fixed, label_and_unit, plus_minus
from tissueid.identification.depth_profile import DepthProfile
from tissueid.identification.validation.residual_tests import ResidualTests
from tissueid.messages import stored
from tissueid.procedures.control import Control
from tissueid.procedures.identification import IdentificationPlan, run_identification
from tissueid.records import Estimate
from tissueid.units import display_unit

_MOST_DEPTHS = 16
"""Largest number of rows of the table against depth; the JSON contains all."""


def print_identification(plan: IdentificationPlan, json_file: Path | None) -> None:
    """Fit and validate one engine, print the result and write the JSON.

    Raises:
        UnusableInputError: no engine is named, or the session, an option or the output file cannot be used.
    """
    check_json(json_file)
    identified = run_identification(plan, Control())
    analysis, tests = identified.analysis, identified.residual_tests
    out = human_output(json_file)
    print_analysis(analysis, out)
    for finding in () if tests is None else tests.findings:
        out.print(f"on {analysis.validated_on}, {finding}", markup=False)
    warned = list(repeat_warnings(identified.session, analysis.tests))
    for line in warned:
        out.print(line, markup=False)
    if json_file is not None:
        write_json(
            json_file, analysis.as_answer() | {"residual_tests": _tests_answer(tests), "quality_warnings": warned}
        )


def _tests_answer(tests: ResidualTests | None) -> dict[str, Any] | None:
    if tests is None:
        return None
    p_values = {t.name: {"p_value": t.p_value, "adjusted_p_value": t.adjusted_p_value} for t in tests.tests}
    return {
        "n_samples": tests.n_samples,
        "tests": p_values,
        "findings": list(tests.findings),
        "finding_messages": list(map(stored, tests.findings)),
    }


def readable(name: str, found: Estimate) -> tuple[str, str, str]:
    """Return label, value with its deviation, and display unit of a parameter."""
    label, si_unit = label_and_unit(name)
    unit, scale = display_unit(si_unit)
    return label, plus_minus(found, scale), unit


def print_analysis(analysis: Analysis, out: Console) -> None:
    """Print the result of one engine: scores, parameters, depth profile, findings and warnings."""
    report = analysis.model.report
    tests = ", ".join(map(str, analysis.tests))
    rows = table(f"{report.engine} on test{'s' * (len(analysis.tests) > 1)} {tests}", "quantity", "value", "unit")
    rows.add_row("samples fitted", str(report.n_samples), "")
    rows.add_row("parameters", str(report.n_parameters), "")
    rows.add_row("VAF on the fitted samples", fixed(report.vaf_percent, 2), "%")
    if report.vaf_validation_percent is not None:
        style = "red" if report.predicts_nothing else ""
        rows.add_row(f"VAF on {analysis.validated_on}", fixed(report.vaf_validation_percent, 2), "%", style=style)
    if report.vaf_scheduled_percent is not None:
        label = f"the same, scheduled by measured {analysis.record.output_name}"
        rows.add_row(label, fixed(report.vaf_scheduled_percent, 2), "%")
    if report.aicc is not None:
        rows.add_row("AICc", fixed(report.aicc, 0), "")
    for name, estimate in report.reportable_parameters.items():
        rows.add_row(*readable(name, estimate))
    if report.seconds is not None:
        rows.add_row("computed in", fixed(report.seconds, 3), "s")
    out.print(rows)
    profile = analysis.depth_profile()
    if profile is not None and not report.predicts_nothing:
        out.print(depth_table(profile, travel_word(analysis.configuration)))
    for finding in report.findings:
        out.print(finding, markup=False)
    for warning in report.warnings:
        out.print(f"warning: {warning}", markup=False)


def depth_table(profile: DepthProfile, way: str = "depth") -> Table:
    """Return the table of mass, damping and stiffness against depth, or against ``way``, in display units."""
    directed = bool(np.any(profile.direction))
    columns = ("position mm", *["direction"] * directed, "mass g", "damping N·s/m", "stiffness N/m", "samples")
    step = -(-len(profile) // _MOST_DEPTHS)
    rows = table(f"Against {way}" if step == 1 else f"Against {way}, every {step} rows", *columns)
    for k in range(0, len(profile), step):
        direction = {1: "in", -1: "out"}.get(int(profile.direction[k]), "both")
        values = (
            (profile.mass[k], profile.mass_std[k], 1e3),
            (profile.damping[k], profile.damping_std[k], 1.0),
            (profile.stiffness[k], profile.stiffness_std[k], 1.0),
        )
        rows.add_row(
            fixed(1e3 * profile.position[k], 2),
            *[direction] * directed,
            *(plus_minus(Estimate(float(value), float(std)), scale) for value, std, scale in values),
            str(profile.support[k]),
        )
    return rows
