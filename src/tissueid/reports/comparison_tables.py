"""Tables of a comparison of engines."""

from __future__ import annotations

from collections.abc import Iterator

from tissueid.analysis import EngineComparison, Entry
from tissueid.reports.tables import Table, held_out_cell, parameter_table
from tissueid.wording import MISSING, engine_label, fixed, grouped


def compared_scores(found: EngineComparison) -> Table:
    """Scores, parameters and seconds of every engine (Chen 2010, Table 8.1); notes are told by number."""
    scheduled = any(a.model.report.vaf_scheduled_percent is not None for a in found.analyses.values())
    ceiling = found.ceiling
    head = ["Engine", "VAF, fitted (%)", "VAF, held out (%)"]
    head += ["Held out, told the depth (%)"] if scheduled else []
    head += ["Of what repeats allow (%)"] if ceiling is not None else []
    head += ["AICc", "Parameters", "Seconds", "Interpretable", "Notes"]
    numbers = {note: str(place) for place, note in enumerate(notes_of(found), start=1)}
    rows = []
    for entry in found.entries:
        marks = ", ".join(numbers[note] for note in _notes(entry))
        label = engine_label(entry.engine)
        if entry.scored is None:
            rows.append((label, *[MISSING] * (len(head) - 2), marks))
            continue
        report = entry.scored.analysis.model.report
        cells = [label, fixed(report.vaf_percent, 2), held_out_cell(report)]
        cells += [fixed(report.vaf_scheduled_percent, 2)] if scheduled else []
        if ceiling is not None:
            cells.append(fixed(ceiling.explained_percent(report.vaf_validation_percent or 0.0), 1))
        cells += [grouped(report.aicc), grouped(entry.scored.parameters), fixed(report.seconds, 2)]
        rows.append((*cells, entry.family.interpretability, marks))
    return Table(
        "Scores",
        tuple(head),
        tuple(rows),
        f"Held out: {found.split.validated_on}. VAF is the variance accounted for by a free run, which sees the input "
        "alone. The lowest AICc is the best among engines scored on the same samples.",
    )


def notes_of(found: EngineComparison) -> tuple[str, ...]:
    """What is told of engines below their table, once each; the first is number 1."""
    return tuple(dict.fromkeys(note for entry in found.entries for note in _notes(entry)))


def _notes(entry: Entry) -> Iterator[str]:
    if entry.refused is not None:
        yield f"refused: {entry.refused}"
    if entry.scored is not None:
        if entry.scored.own_samples:
            yield "scored on samples of its own, as it needs more of the record than the others: not comparable"
        yield from dict.fromkeys(entry.scored.analysis.model.report.warnings)


def compared_parameters(found: EngineComparison) -> Table | None:
    """Parameters of all engines, one row each quantity; None when there are none."""
    return parameter_table(found.analyses)
