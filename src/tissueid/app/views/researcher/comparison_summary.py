"""Summary of a comparison of engines, as it is shown."""

from __future__ import annotations

from dataclasses import dataclass

from tissueid.analysis import EngineComparison
from tissueid.app.views.researcher.selected_test import SelectedTest
from tissueid.app.words import sentence
from tissueid.formatting import clean, fixed, grouped
from tissueid.identification import engine_label
from tissueid.identification.candidates import ModelStanding
from tissueid.language import _, marked
from tissueid.messages import MISSING, translated


@dataclass(frozen=True)
class ComparisonSummary:
    """The recommendation for one test. ``rows`` are the standings, best first: see ``COLUMNS``."""

    label: str
    headline: str
    judged_on: str
    reasons: tuple[str, ...]
    doubts: tuple[str, ...]
    experiments: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


COLUMNS = (
    marked("Engine"),
    marked("Verdict"),
    marked("VAF held out (%)"),
    marked("VAF fitted (%)"),
    marked("Below the best (points)"),
    "AICc",
    marked("Kind"),
)


def summary_of(found: EngineComparison, tests: tuple[SelectedTest, ...]) -> ComparisonSummary:
    """Return the summary of a comparison; refused engines come last, with the reason."""
    said = found.recommendation
    recommended = (said.engine, said.second_order)
    rows = [_row(one, (one.engine, one.second_order) == recommended) for one in said.standings]
    rows += [
        (
            engine_label(entry.engine),
            _("refused"),
            MISSING,
            MISSING,
            MISSING,
            MISSING,
            sentence(translated(entry.refused)),
        )
        for entry in found.entries
        if entry.refused
    ]
    headline, *reasons = map(translated, said.sentences)
    ceiling = found.ceiling
    if ceiling is not None:
        reasons.append(_("Repeats of the test allow {vaf} % at best.").format(vaf=fixed(ceiling.vaf_percent.value, 2)))
    label = (
        clean(tests[0].label)
        if len(tests) == 1
        else _("{first} and {count} more").format(first=clean(tests[0].label), count=len(tests) - 1)
    )
    return ComparisonSummary(
        label,
        sentence(headline),
        sentence(_("judged on {data}").format(data=translated(said.judged_on))),
        tuple(map(sentence, reasons)),
        tuple(sentence(translated(doubt)) for doubt in said.doubts),
        tuple(sentence(translated(words)) for words in said.experiments),
        tuple(rows),
    )


def _row(one: ModelStanding, recommended: bool) -> tuple[str, ...]:
    name = engine_label(one.engine) + (_(", mass, damping and stiffness") if one.second_order else "")
    behind = one.behind
    how = fixed(behind.points, 2) + (f" ± {fixed(behind.std_points, 2)}" if behind.points else "")
    return (
        name,
        _("recommended") if recommended else _("clearly worse") if one.beaten else _("as good"),
        fixed(one.vaf_percent, 2),
        fixed(one.vaf_fitted_percent, 2),
        how,
        grouped(one.aicc),
        _(str(one.family)),
    )
