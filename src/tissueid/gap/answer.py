"""The diagnosis as plain values for JSON, under the contract's names, SI."""

from __future__ import annotations

from typing import Any

from tissueid.gap.diagnosis import Diagnosis
from tissueid.gap.statement import alternatives_of, headline_of, members_of, ordered_candidates
from tissueid.messages import stored


def as_answer(found: Diagnosis) -> dict[str, Any]:
    """Return the JSON of ``tissueid gap diagnose``."""
    figures = found.gap
    return {
        "verdict": found.verdict,
        "gap": {
            "before": figures.before,
            "after": figures.after,
            "floor": figures.floor,
            "closed": figures.closed,
            "closed_ci": list(figures.closed_ci),
            "announced": figures.predicted_closed,
        },
        "where": found.where.as_answer(),
        "ranking": [
            {
                "effect": item.effect,
                "stage": item.stage,
                "probability": item.probability,
                "closed": item.closed,
                "closed_ci": list(item.closed_ci),
                "indistinguishable": list(item.indistinguishable),
                "parameters": item.parameters,
            }
            for item in (ordered_candidates(found) if found.combination else found.ranking)
        ],
        "combination": list(found.combination),
        "budget": _budget(found),
        "remains": None if found.budget is None else {"share": found.budget.remains, "stage": found.budget.remains_in},
        "detection_limits": {
            name: None if limit is None else dict(vars(limit)) for name, limit in found.detection_limits.items()
        },
        "members": [
            {
                "effect": item.effect,
                "probability": item.probability,
                "rivals": [{"effect": name, "probability": share} for name, share in item.rivals],
            }
            for item in members_of(found)
        ],
        "next_experiment": None
        if found.next_experiment is None
        else {
            "kind": found.next_experiment.kind,
            "why": str(found.next_experiment.why),
            "message": stored(found.next_experiment.why),
            "separates": list(found.next_experiment.separates),
            "gain_nats": found.next_experiment.gain_nats,
            "separation": found.next_experiment.separation,
            "gains": found.next_experiment.gains,
            "command_line": found.next_experiment.command_line,
        },
        "ceiling": found.ceiling,
        "remarks": [str(remark) for remark in found.remarks],
        "remark_messages": list(map(stored, found.remarks)),
        "statement": stored(headline_of(found)[0]),
        "seconds": found.seconds,
    }


def _budget(found: Diagnosis) -> list[dict[str, Any]]:
    # In the order of adding; empty where nothing is named.
    alternatives = alternatives_of(found)
    return [
        {
            "effect": step.effect,
            "stage": step.stage,
            "closed_when_added": step.added,
            "closed_when_added_ci": list(step.added_ci),
            "closed_when_removed": step.removed,
            "closed_when_removed_ci": list(step.removed_ci),
            "gap_after": step.gap_after,
            "alternatives": list(alternatives[step.effect]),
        }
        for step in (() if found.budget is None else found.budget.steps)
    ]
