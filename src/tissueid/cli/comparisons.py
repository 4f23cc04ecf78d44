"""Commands that fit several engines or several tests: compare, overlay, repeats."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from rich.table import Table

from tissueid.analysis import ComparisonEntry, EngineComparison, SweepRow
from tissueid.analysis.comparison import described_levels, distortion_of, is_multisine
from tissueid.analysis.overlay import Overlay, OverlayEntry, quantity_label, repeated_values
from tissueid.cli.output import Output, table
from tissueid.cli.saved_tests import repeat_warnings
from tissueid.errors import UnusableInputError
from tissueid.formatting import fixed, grouped, number
from tissueid.identification.recommendation import Recommendation
from tissueid.messages import MISSING, Message, stored
from tissueid.procedures.identification import ComparePlan, run_comparison
from tissueid.procedures.output_files import check_different
from tissueid.procedures.overlay import OverlayPlan, RepeatsPlan, run_overlay, run_repeats
from tissueid.sessions import Session
from tissueid.units import display_unit

_MOST_NAMES = 4
"""File names that are listed of pictures that belong to other comparisons."""


def compare_session(plan: ComparePlan, out: Output) -> None:
    """Compare the engines, print the table and the recommendation, and write the JSON, the page and the figures."""
    compared = out.run(run_comparison, plan)
    comparison = compared.comparison
    _print_result(comparison, compared.no_ceiling, out)
    warned = list(repeat_warnings(compared.session, comparison.split.tests))
    out.print_lines(filter(None, [*warned, _distortion(compared.session, comparison)]))
    out.write_json(compare_answer(comparison) | {"quality_warnings": warned})
    out.print_files(report=plan.page, figures=plan.figures)
    if plan.figures is not None and (others := _unrelated_pictures(plan.figures, compared.figures)):
        out.print(others)


def _unrelated_pictures(folder: Path, drawn: Sequence[Path]) -> str:
    """Return which pictures in the folder are not of this comparison as a sentence; no file is ever removed."""
    written = {path.name for path in drawn}
    pictures = sorted(path.name for path in folder.iterdir() if path.suffix in (".svg", ".png"))
    others = [name for name in pictures if name not in written]
    if not others:
        return ""
    names = ", ".join(others[:_MOST_NAMES]) + (", …" if len(others) > _MOST_NAMES else "")
    return Message(
        "compare.other_pictures",
        "{count} other pictures in that folder are not of this comparison: {names}",
        count=grouped(len(others)),
        names=names,
    )


def _distortion(session: Session, comparison: EngineComparison) -> str:
    """Return noise and distortion of a multisine as a sentence; "" for any other stimulus."""
    test = session.test(comparison.split.tests[0])
    if not is_multisine(test.stimulus):
        return ""
    record = comparison.split.record
    try:
        said = described_levels(distortion_of(test.record(record.input_name, record.output_name), test.stimulus))
    except UnusableInputError as error:
        return f"Noise and distortion of the multisine are not known: {error}."
    return f"Noise, even and odd distortion of the multisine relative to the output: {said}." if said else ""


def compare_answer(comparison: EngineComparison) -> dict[str, Any]:
    """Return the result for JSON: ``engines`` has the keys of ``identify``, and why an engine was refused."""
    return {
        "test": comparison.split.tests[0],
        "tests": list(comparison.split.tests),
        "validated_on": comparison.split.validated_on,
        "ceiling_vaf_percent": None if comparison.ceiling is None else comparison.ceiling.vaf_percent.value,
        "ceiling_vaf_std_percent": None if comparison.ceiling is None else comparison.ceiling.vaf_percent.std,
        "engines": [_entry_answer(entry) for entry in comparison.entries],
        "recommendation": comparison.recommendation.as_dict(),
        "memory_sweep": [_sweep_answer(row) for row in comparison.memory_sweep],
    }


def _entry_answer(entry: ComparisonEntry) -> dict[str, Any]:
    about = {
        "engine": entry.engine,
        "family": str(entry.family),
        "interpretability": entry.family.interpretability,
        "refused": entry.refused,
        "refused_message": stored(entry.refused),
    }
    if (scored := entry.scored) is None:
        return about
    compared = {
        "effective_parameters": scored.parameters,
        "n_samples_compared": scored.n_fitted,
        "shares_samples": not scored.own_samples,
    }
    return scored.analysis.as_answer() | about | compared


def _sweep_answer(row: SweepRow) -> dict[str, Any]:
    about: dict[str, Any] = {"engine": row.engine, "memory_s": row.memory, "refused": row.refused}
    if row.analysis is None:
        return about
    report = row.analysis.model.report.as_dict()
    scores = ("vaf_percent", "vaf_validation_percent", "vaf_scheduled_percent", "aicc", "n_parameters", "seconds")
    return about | {name: report[name] for name in scores} | {"effective_parameters": row.parameters}


def _print_result(comparison: EngineComparison, no_ceiling: str, out: Output) -> None:
    out.widen(120)
    notes: dict[str, int] = {}
    out.print(_score_table(comparison, notes))
    shared = max((e.scored.n_fitted for e in comparison.entries if e.scored and not e.scored.own_samples), default=0)
    out.print(
        f"held out: {comparison.split.validated_on}. VAF is of free runs, which use the input alone; scheduled: by the "
        f"measured output. VAF and AICc are over the {grouped(shared)} fitted samples that all engines share.",
        style="dim",
    )
    if comparison.ceiling is not None:
        best = fixed(comparison.ceiling.vaf_percent.value, 2)
        out.print(
            f"No model can exceed {best} % on held-out samples: "
            f"this is the agreement of {comparison.ceiling.repeats} repeats."
        )
        out.print_lines(f"  {line[:1].upper()}{line[1:]}." for line in comparison.ceiling.left_out)
    elif no_ceiling:
        out.print(f"The limit set by repeats is not known: {no_ceiling}.")
    out.print_lines(f"  {mark}. {note}" for note, mark in notes.items())
    if comparison.memory_sweep:
        out.print(_sweep_table(comparison.memory_sweep))
    out.print()
    out.print_lines(_recommendation_lines(comparison.recommendation))


def _score_table(comparison: EngineComparison, notes: dict[str, int]) -> Table:
    """Return the table of scores (Fig. 8.1, Table 8.1); ``notes`` collects its notes by number."""
    scheduled = any(a.model.report.vaf_scheduled_percent is not None for a in comparison.analyses.values())
    tests = ", ".join(map(str, comparison.split.tests))
    columns = ["engine", "fitted\nVAF %", "held out\nVAF %", *["scheduled\nVAF %"] * scheduled]
    columns += ["of the\nceiling"] * (comparison.ceiling is not None)
    columns += ["AICc", "para-\nmeters", "sec-\nonds", "inter-\npretable", "notes"]
    rows = table(f"Engines on test{'s' * (len(comparison.split.tests) > 1)} {tests}", *columns)
    rows.columns[0].no_wrap = True
    for entry in comparison.entries:
        marks = ",".join(str(notes.setdefault(note, len(notes) + 1)) for note in _notes(entry))
        style = "red" if entry.scored and entry.scored.analysis.model.report.predicts_nothing else ""
        if entry.scored is None:
            cells = [MISSING] * (len(columns) - 2)
        else:
            report = entry.scored.analysis.model.report
            cells = [fixed(report.vaf_percent, 1), fixed(report.vaf_validation_percent, 1)]
            cells += [fixed(report.vaf_scheduled_percent, 1)] * scheduled
            if comparison.ceiling is not None:
                cells.append(fixed(comparison.ceiling.explained_percent(report.vaf_validation_percent or 0.0), 1))
            cells += [fixed(report.aicc, 0), fixed(entry.scored.parameters, 0), fixed(report.seconds, 2)]
            cells.append(entry.family.interpretability)
        rows.add_row(entry.engine, *cells, marks, style=style)
    return rows


def _notes(entry: ComparisonEntry) -> Iterator[str]:
    if entry.refused is not None:
        yield f"refused: {entry.refused}"
    if entry.scored is None:
        return
    if entry.scored.own_samples:
        yield "scored on its own samples, because it needs more of the record than the others: not comparable"
    yield from entry.scored.analysis.model.report.warnings


def _sweep_table(sweep: Sequence[SweepRow]) -> Table:
    rows = table("Scores against memory", "engine", "memory s", "fitted VAF %", "held out VAF %", "AICc", "parameters")
    for row in sweep:
        if row.analysis is None:
            cells = [MISSING] * 4
        else:
            report = row.analysis.model.report
            cells = [fixed(report.vaf_percent, 1), fixed(report.vaf_validation_percent, 1)]
            cells += [fixed(report.aicc, 0), fixed(row.parameters, 0)]
        rows.add_row(row.engine, f"{row.memory:g}", *cells)
    return rows


def _recommendation_lines(recommendation: Recommendation) -> Iterator[str]:
    headline, *rest = recommendation.sentences
    yield f"Judged on: {recommendation.judged_on}"
    yield headline
    yield from (f"  {sentence}" for sentence in rest)
    for title, sentences in (("doubts", recommendation.doubts), ("suggested tests", recommendation.experiments)):
        if sentences:
            yield f"{title}:"
            yield from (f"  {sentence}" for sentence in sentences)


def overlay_tests(plan: OverlayPlan, out: Output) -> None:
    """Fit the tests, print their scores, and write the page, the figures, the numbers and the JSON."""
    check_different(plan.page, plan.csv, out.json_file)
    overlay = out.run(run_overlay, plan)
    out.widen(120)
    columns = ("fitted\nVAF %", "held out\nVAF %", "scheduled\nVAF %", "AICc", "para-\nmeters", "sec-\nonds")
    rows = table("Scores", "tests", "fit", *columns)
    for entry in overlay.entries:
        report = entry.analysis.model.report
        criterion = report.aicc if entry.scheduled_aicc is None else entry.scheduled_aicc
        rows.add_row(
            entry.source,
            entry.fit.label + ("" if entry.swept is None else f", {overlay.swept} {entry.swept:g}"),
            fixed(report.vaf_percent, 1),
            fixed(report.vaf_validation_percent, 1),
            fixed(entry.scheduled_percent, 1),
            grouped(criterion),
            grouped(report.n_parameters),
            fixed(report.seconds, 2),
        )
    out.print(rows)
    out.print_lines((f"left out: {line}" for line in overlay.refused), soft_wrap=True)
    out.print_files(report=plan.page, figures=plan.figures, numbers=plan.csv)
    out.write_json({"fits": [_overlaid_answer(overlay, entry) for entry in overlay.entries], **_refused(overlay)})


def repeated_tests(plan: RepeatsPlan, out: Output) -> None:
    """Fit the tests, print mean, standard deviation and coefficient of variation, and write the table and the JSON."""
    check_different(plan.csv, out.json_file)
    overlay = out.run(run_repeats, plan)
    out.widen(120)
    rows = table(
        "Mean and standard deviation over tests", "tests", "fit", "quantity", "unit", "count", "mean", "SD", "CV %"
    )
    values = repeated_values(overlay)
    for repeated in values:
        label, si_unit = quantity_label(repeated.quantity)
        unit, scale = display_unit(si_unit)
        single = repeated.count < 2
        rows.add_row(
            repeated.source,
            repeated.fit,
            label,
            unit,
            str(repeated.count),
            number(scale * repeated.mean),
            MISSING if single else number(scale * repeated.std, 3),
            MISSING if single else fixed(100.0 * repeated.cv, 2),
        )
    out.print(rows)
    out.print_lines((f"left out: {line}" for line in overlay.refused), soft_wrap=True)
    out.print_files(table=plan.csv)
    names = ("source", "fit", "quantity", "count", "mean", "std", "cv")
    answer = [{name: getattr(repeated, name) for name in names} for repeated in values]
    out.write_json({"repeats": answer, **_refused(overlay)})


def _overlaid_answer(overlay: Overlay, entry: OverlayEntry) -> dict[str, Any]:
    about: dict[str, Any] = {"source": entry.source, "fit": entry.fit.label}
    if entry.swept is not None:
        about[overlay.swept] = entry.swept
    scores = {"vaf_scheduled_fitted_percent": entry.scheduled_percent, "aicc_scheduled": entry.scheduled_aicc}
    return about | scores | entry.analysis.as_answer()


def _refused(overlay: Overlay) -> dict[str, Any]:
    return {"refused": list(overlay.refused), "refused_messages": list(map(stored, overlay.refused))}
