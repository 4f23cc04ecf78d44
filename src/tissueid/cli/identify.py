"""``tissueid identify``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from tissueid.analysis import Analysis, analyse
from tissueid.cli.output import check_json, people_read, table, write_json
from tissueid.errors import UnusableInputError
from tissueid.records import Estimate
from tissueid.sessions import read_session
from tissueid.wording import named_unit, people_unit, plus_minus


def run_identify(
    path: Path,
    engine: str,
    test: int | None,
    validate: int | None,
    input_name: str,
    output_name: str,
    memory: float | None,
    options: Sequence[str],
    json_file: Path | None,
) -> None:
    """Fit, validate, print, and write the JSON of the contract."""
    check_json(json_file)
    chosen = parse_options(options)
    if memory is not None:
        if "memory" in chosen:
            raise UnusableInputError("the memory is given twice")
        chosen["memory"] = memory
    analysis = analyse(
        read_session(path),
        engine,
        chosen,
        test=test,
        validate=validate,
        input_name=input_name,
        output_name=output_name,
    )
    print_analysis(analysis, people_read(json_file))
    if json_file is not None:
        write_json(json_file, identify_answer(analysis))


def identify_answer(analysis: Analysis) -> dict[str, Any]:
    """The contract's keys, and which test was fitted and which part validated."""
    return analysis.model.report.as_dict() | {"test": analysis.test, "validated_on": analysis.validated_on}


def parse_options(options: Sequence[str]) -> dict[str, Any]:
    """NAME=VALUE pairs; a value is JSON where it reads as such (numbers, true), text otherwise.

    Raises:
        UnusableInputError: a pair without an equals sign.
    """
    parsed: dict[str, Any] = {}
    for pair in options:
        name, equals, value = pair.partition("=")
        if not equals or not name:
            raise UnusableInputError(f"an option is NAME=VALUE, not {pair!r}")
        try:
            parsed[name] = json.loads(value)
        except ValueError:
            parsed[name] = value
    return parsed


def readable(name: str, found: Estimate) -> tuple[str, str, str]:
    """A parameter as people read it: label, value with its deviation, unit."""
    label, si_unit = named_unit(name)
    unit, scale = people_unit(si_unit)
    return label, plus_minus(found, scale), unit


def print_analysis(analysis: Analysis, out: Console) -> None:
    """One engine's answer as a table."""
    report = analysis.model.report
    rows = table(f"{report.engine} on test {analysis.test}", "quantity", "value", "unit")
    rows.add_row("samples fitted", str(report.n_samples), "")
    rows.add_row("parameters", str(report.n_parameters), "")
    rows.add_row("VAF on the fitted samples", f"{report.vaf_percent:.2f}", "%")
    if report.vaf_validation_percent is not None:
        rows.add_row(f"VAF on {analysis.validated_on}", f"{report.vaf_validation_percent:.2f}", "%")
    if report.aicc is not None:
        rows.add_row("AICc", f"{report.aicc:.0f}", "")
    for name, estimate in report.parameters.items():
        rows.add_row(*readable(name, estimate))
    if report.seconds is not None:
        rows.add_row("computed in", f"{report.seconds:.3f}", "s")
    out.print(rows)
    for warning in report.warnings:
        out.print(f"warning: {warning}", markup=False)
