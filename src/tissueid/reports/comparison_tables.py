"""Tables of a comparison of engines."""

from __future__ import annotations

from collections.abc import Iterator

from tissueid.analysis import EngineComparison, Entry
from tissueid.formatting import fixed, grouped
from tissueid.identification import engine_label
from tissueid.language import _
from tissueid.messages import MISSING, Message, translated
from tissueid.reports.tables import Table, held_out_cell, parameter_table

OWN_SAMPLES = Message(
    "report.own_samples",
    "scored on its own samples, because it needs more of the record than the others: not comparable",
)


def compared_scores(found: EngineComparison) -> Table:
    """Return scores, parameters and seconds of every engine (Chen 2010, Table 8.1); notes are given by number."""
    scheduled = any(a.model.report.vaf_scheduled_percent is not None for a in found.analyses.values())
    ceiling = found.ceiling
    head = [_("Engine"), _("VAF, fitted (%)"), _("VAF, held out (%)")]
    head += [_("VAF, held out, scheduled (%)")] if scheduled else []
    head += [_("Of the limit set by repeats (%)")] if ceiling is not None else []
    head += ["AICc", _("Parameters"), _("Seconds"), _("Interpretable"), _("Notes")]
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
        rows.append((*cells, translated(entry.family.interpretability), marks))
    return Table(
        _("Scores"),
        tuple(head),
        tuple(rows),
        _(
            "Held out: {part}. VAF is the variance accounted for by a free run, which uses the input alone. The lowest "
            "AICc is the best among engines scored on the same samples."
        ).format(part=translated(found.split.validated_on)),
    )


def notes_of(found: EngineComparison) -> tuple[str, ...]:
    """Return the notes on engines below their table, each once; the first is number 1."""
    return tuple(dict.fromkeys(note for entry in found.entries for note in _notes(entry)))


def _notes(entry: Entry) -> Iterator[str]:
    if entry.refused is not None:
        yield Message("report.refused", "refused: {why}", why=entry.refused)
    if entry.scored is not None:
        if entry.scored.own_samples:
            yield OWN_SAMPLES
        yield from dict.fromkeys(entry.scored.analysis.model.report.warnings)


def compared_parameters(found: EngineComparison) -> Table | None:
    """Return the parameters of all engines, one row for each quantity; None when there are none."""
    return parameter_table(found.analyses)
