"""What a comparison of engines recommends, ready to be shown."""

from __future__ import annotations

from dataclasses import dataclass

from tissueid.analysis import EngineComparison
from tissueid.app.views.researcher.chosen import Chosen
from tissueid.app.words import sentence
from tissueid.identification.recommendation import Standing
from tissueid.wording import MISSING, clean, engine_label, fixed, grouped


@dataclass(frozen=True)
class Verdict:
    """The recommendation for one test. ``rows`` are the standings, best first: see ``COLUMNS``."""

    label: str
    headline: str
    judged_on: str
    reasons: tuple[str, ...]
    doubts: tuple[str, ...]
    experiments: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


COLUMNS = ("Engine", "Verdict", "VAF held out (%)", "VAF fitted (%)", "Behind the best (points)", "AICc", "Kind")


def verdict_of(found: EngineComparison, tests: tuple[Chosen, ...]) -> Verdict:
    """Keep of a comparison what is shown; engines that were refused stand at the end with the reason."""
    said = found.recommendation
    recommended = (said.engine, said.second_order)
    rows = [_row(one, (one.engine, one.second_order) == recommended) for one in said.standings]
    rows += [
        (engine_label(entry.engine), "refused", MISSING, MISSING, MISSING, MISSING, sentence(entry.refused))
        for entry in found.entries
        if entry.refused
    ]
    headline, *reasons = said.sentences
    ceiling = found.ceiling
    if ceiling is not None:
        reasons.append(f"Repeats of the test allow {fixed(ceiling.vaf_percent.value, 2)} % at best.")
    label = clean(tests[0].label) if len(tests) == 1 else f"{clean(tests[0].label)} and {len(tests) - 1} more"
    return Verdict(
        label,
        sentence(headline),
        sentence(f"judged on {said.judged_on}"),
        tuple(map(sentence, reasons)),
        tuple(map(sentence, said.doubts)),
        tuple(map(sentence, said.experiments)),
        tuple(rows),
    )


def _row(one: Standing, recommended: bool) -> tuple[str, ...]:
    name = engine_label(one.engine) + (", mass, damping and stiffness" if one.second_order else "")
    behind = one.behind
    how = f"{fixed(behind.points, 2)} ± {fixed(behind.std_points, 2)}"
    return (
        name,
        "recommended" if recommended else "beaten" if one.beaten else "as good",
        fixed(one.vaf_percent, 2),
        fixed(one.vaf_fitted_percent, 2),
        how,
        grouped(one.aicc),
        str(one.family),
    )
