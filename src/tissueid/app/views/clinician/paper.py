"""PDF report of the shown test and of its sitting, next to the session. Independent of Qt."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tissueid.app.findings import Findings
from tissueid.app.views.clinician.comparing import Comparison
from tissueid.app.views.clinician.sitting import HEADS, QUANTITIES, VALUE_HEAD, Standing
from tissueid.atomic_write import unused_path
from tissueid.formatting import label_and_unit, plus_minus
from tissueid.language import _, marked
from tissueid.messages import MISSING
from tissueid.procedures.report import write_pdf
from tissueid.records import Estimate
from tissueid.units import display_unit

THIS = marked("This:")
"""What stands before the label of the sitting of the shown test: what follows may be cut off, this not."""
Table = tuple[str, Sequence[str], Sequence[Sequence[str]]]


def write_paper(findings: Findings, standing: Standing | None, comparison: Comparison) -> Path:
    """Write the PDF of a test under an unused name; return its path.

    Raises:
        UnusableInputError: nothing could be identified, or it cannot be written.
    """
    path = unused_path(findings.path.with_name(f"{findings.path.stem}-report.pdf"))
    further: list[Table] = []
    if len(comparison.sightings) > 1:
        names = [label_and_unit(name) for name in QUANTITIES]
        columns = (_("Sitting"), *(f"{_(name)} ({display_unit(unit)[0]})" for name, unit in names))
        lines = []
        for one in comparison.sightings:
            texts = [
                _text(one.values.get(name), display_unit(unit)[1])
                for name, (_, unit) in zip(QUANTITIES, names, strict=True)
            ]
            lines.append((f"{_(THIS)} {one.label}" if one.this else one.label, *texts))
        heading = _("The subject's other sites and sittings")
        if comparison.remark:
            heading = _("The subject's other sites and sittings († another instrument)")
        further.append((heading, columns, lines))
    result = None if standing is None else _result(standing)
    return write_pdf(path, findings.analysed, result, further)


def _result(standing: Standing) -> tuple[Table, tuple[str, ...]]:
    """What stands as the result, as a table, and the lines below it."""
    repeated = any(value.count > 1 for value in standing.values.values())
    heads = [_(head) if head else "" for head in (HEADS if repeated else ("", VALUE_HEAD))]
    rows = [row[: len(heads)] for row in standing.rows().values()]
    return (standing.heading, heads, rows), tuple(filter(None, [standing.tests, standing.remark]))


def _text(found: Estimate | None, scale: float) -> str:
    return MISSING if found is None else plus_minus(found, scale)
