"""Commands on one saved test: quality, identify, engines, readings, report."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, get_args

import numpy as np
from rich.table import Table

from tissueid.acquisition.quality import Quality, quality_of
from tissueid.analysis import Analysis
from tissueid.analysis.device_readings import DeviceReadings
from tissueid.cli.output import Output, table
from tissueid.configuration import travel_word
from tissueid.formatting import fixed, label_and_unit, plain_text, plus_minus
from tissueid.identification import Engine
from tissueid.identification.depth_profile import DepthProfile
from tissueid.identification.validation.residual_tests import ResidualTests
from tissueid.messages import MISSING, Message, stored
from tissueid.procedures.control import Control
from tissueid.procedures.identification import EnginesPlan, IdentificationPlan, listed_engines, run_identification
from tissueid.procedures.saved_test import QualityPlan, ReadingsPlan, ReportPlan, judge_tests, run_readings, run_report
from tissueid.records import Estimate
from tissueid.sessions import Session, Test
from tissueid.units import display_unit

_MARKS = {"note": "note", "look": "look", "repeat": "REPEAT"}


def print_quality(plan: QualityPlan, out: Output) -> None:
    """Judge the tests of a session and print verdicts and findings.

    Raises:
        UnusableInputError: the file is not a session, or does not contain the test.
    """
    session, judged = judge_tests(plan)
    out.widen(120)
    rows = table("Quality", "test", "site", "kind", "verdict", "when it was recorded")
    answer = []
    for test, quality in judged:
        before = quality_of(test)
        recorded = "not judged" if before is None else before.headline
        rows.add_row(str(test.number), test.site, test.kind, quality.headline, recorded)
        about = {"test": test.number, "site": test.site, "kind": test.kind} | quality.as_dict()
        answer.append(about | {"verdict_when_recorded": None if before is None else before.verdict})
    out.print(rows)
    for test, quality in judged:
        out.print_lines(finding_lines(test.number, quality))
    out.write_json({"session": str(plan.session), "session_id": session.session_id, "tests": answer})


def finding_lines(number: int, quality: Quality) -> Iterator[str]:
    """Yield the verdict on a test and its findings, one line each."""
    yield f"test {number}: {quality.headline}"
    for finding, line in zip(quality.findings, quality.lines, strict=True):
        yield f"  {_MARKS[finding.severity]}: {line}"


def recorded_findings(test: Test) -> Iterator[str]:
    """Return the findings that were recorded with a test; none if it was not judged."""
    quality = quality_of(test)
    return iter(()) if quality is None else finding_lines(test.number, quality)


def repeat_warnings(session: Session, numbers: Iterable[int]) -> Iterator[str]:
    """Yield a warning for each of these tests whose verdict was to repeat it."""
    for test in session.tests:
        quality = quality_of(test)
        if test.number in set(numbers) and quality is not None and quality.verdict == "repeat":
            worst = quality.findings[0]
            yield Message(
                "quality.advised_repeat",
                "warning: the quality check advised to repeat test {test}: {finding}",
                test=test.number,
                finding=worst.message,
            )


_MOST_DEPTHS = 16
"""Largest number of rows of the table against depth; the JSON contains all."""


def print_identification(plan: IdentificationPlan, out: Output) -> None:
    """Fit and validate one engine, print the result and write the JSON.

    Raises:
        UnusableInputError: no engine is named, or the session, an option or the output file cannot be used.
    """
    session, analysis, tests = run_identification(plan, Control())
    print_analysis(analysis, out)
    warned = list(repeat_warnings(session, analysis.tests))
    out.print_lines(f"on {analysis.validated_on}, {finding}" for finding in (() if tests is None else tests.findings))
    out.print_lines(warned)
    out.write_json(analysis.as_answer() | {"residual_tests": _tests_answer(tests), "quality_warnings": warned})


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


def readable(name: str, estimate: Estimate) -> tuple[str, str, str]:
    """Return label, value with its deviation, and display unit of a parameter."""
    label, si_unit = label_and_unit(name)
    unit, scale = display_unit(si_unit)
    return label, plus_minus(estimate, scale), unit


def print_analysis(analysis: Analysis, out: Output) -> None:
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
    out.print_lines([*report.findings, *(f"warning: {warning}" for warning in report.warnings)])


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


def list_engines(plan: EnginesPlan, out: Output) -> None:
    """List all engines, or the options of one; write their declarations as JSON.

    Raises:
        UnusableInputError: there is no engine of that name, or the file cannot be written.
    """
    kinds = listed_engines(plan)
    if plan.engine is None:
        rows = [(kind.name, str(kind.family), kind.title) for kind in kinds]
        out.print(table("Engines", "Engine", "Family", "Description", rows=rows))
    else:
        out.print(f"{kinds[0].label}: {kinds[0].title}")
        options = _options(kinds[0]).items()
        rows = [(name, plain_text(declared["default"]), declared["description"]) for name, declared in options]
        out.print(table("Options", "Option", "Default", "Description", rows=rows))
    out.write_json(
        [
            {
                "engine": kind.name,
                "label": kind.label,
                "title": kind.title,
                "family": str(kind.family),
                "interpretability": kind.family.interpretability,
                "options": _options(kind),
            }
            for kind in kinds
        ]
    )


def _options(kind: type[Engine]) -> dict[str, dict[str, Any]]:
    defaults = kind().options()
    return {
        name: {
            "default": defaults[name],
            "title": info.title or "",
            "description": info.description or "",
            "choices": [item for item in get_args(info.annotation) if isinstance(item, str)],
        }
        for name, info in kind.model_fields.items()
    }


def print_readings(plan: ReadingsPlan, out: Output) -> None:
    """Compute the readings, print them and write the JSON and the page."""
    session, readings = out.run(run_readings, plan)
    out.widen(120)
    reasons: dict[str, int] = {}
    rows = table(_title(readings), "reading", "", "recorded step", "model", "unit", "notes")
    for recorded, model in readings.rows():
        definition = recorded.definition
        unit, scale = display_unit(definition.si_unit)
        marks = [
            str(reasons.setdefault(reading.reason, len(reasons) + 1)) for reading in (recorded, model) if reading.reason
        ]
        found_values = [reading.estimate for reading in (recorded, model)]
        cells = [MISSING if value is None else plus_minus(value, scale) for value in found_values]
        rows.add_row(definition.symbol, str(definition.meaning), *cells, unit, ",".join(dict.fromkeys(marks)))
    out.print(rows)
    out.print_lines([*(f"  {number}. {reason}" for reason, number in reasons.items()), *map(str, readings.notes)])
    out.print_files(report=plan.page)
    out.write_json({"session_id": session.session_id} | readings.as_answer())


def _title(readings: DeviceReadings) -> str:
    parts = []
    if readings.recorded is not None:
        parts.append(f"step test {readings.recorded.test.number}")
    if readings.analysis is not None:
        parts.append(f"{readings.analysis.model.report.engine} on test {readings.analysis.test}")
    step = readings.course
    force = "" if step is None else f", {step.low_n:.2f} to {step.high_n:.2f} N for {step.hold_s:.2f} s"
    return f"Readings: {', '.join(parts)}{force}"


def report_test(plan: ReportPlan) -> None:
    """Write the page of a test and optionally a short PDF; print the files and the engines that are left out.

    Raises:
        UnusableInputError: the test or an engine is unknown, no engine can use the test, or a file cannot be written.
    """
    out = Output()
    analysed = out.run(run_report, plan)
    count = len(analysed.session.tests)
    which = f", test {analysed.test.number} of {count}" if count > 1 else ""
    out.print_lines(f"report: {path}{which}" for path in (plan.page, plan.pdf) if path is not None)
    out.print_lines((f"without {name}: {why}" for name, why in analysed.refused.items()), soft_wrap=True)
