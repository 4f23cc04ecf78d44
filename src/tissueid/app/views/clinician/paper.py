"""The shown result as a PDF beside its session: one test, or the mean of its sitting. Nothing here knows Qt."""

from __future__ import annotations

from pathlib import Path

from tissueid.app.findings import Findings
from tissueid.app.views.clinician.comparing import Comparison
from tissueid.app.views.clinician.sitting import QUANTITIES, Sitting, rows_of
from tissueid.records import Estimate
from tissueid.wording import MISSING, named_unit, people_unit, plus_minus


def write_paper(findings: Findings, sitting: Sitting | None, comparison: Comparison) -> Path:
    """Write it; returns its path.

    Raises:
        OSError: it cannot be written.
        UnusableInputError: nothing could be identified.
    """
    from tissueid.reports.pdf import write_pdf

    path = findings.path.with_name(f"{findings.path.stem}-report.pdf")
    further: list[tuple[str, tuple[str, ...], list[tuple[str, ...]]]] = []
    if rows := rows_of(sitting):
        count = sitting.counted if sitting is not None else 0
        heads: tuple[str, ...] = ("", "Mean ± standard deviation", "Relative", "Two tests differ by less than")
        further.append((f"Mean of {count} repeats", heads, list(rows.values())))
    if len(comparison.sightings) > 1:
        names = [named_unit(name) for name in QUANTITIES]
        columns = ("Sitting", *(f"{name} ({people_unit(unit)[0]})" for name, unit in names))
        lines = []
        for one in comparison.sightings:
            texts = [
                _text(one.values.get(name), people_unit(unit)[1])
                for name, (_, unit) in zip(QUANTITIES, names, strict=True)
            ]
            lines.append((f"{one.label}{' (this sitting)' if one.this else ''}", *texts))
        further.append(("The subject's other sites and sittings", columns, lines))
    write_pdf(path, findings.session, findings.test, findings.analyses, further=further)
    return path


def _text(found: Estimate | None, scale: float) -> str:
    return MISSING if found is None else plus_minus(found, scale)
