"""Localisation of the gap: stage of the chain, and regions of frequency, depth, direction and time."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from tissueid.gap.dataset import Dataset
from tissueid.gap.error_regions import ErrorRegions, find_error_regions
from tissueid.gap.evidence import Evidence, StageFinding, gather_evidence
from tissueid.gap.outliers import without_outliers
from tissueid.gap.scoring import Candidate
from tissueid.twin.effect import STAGES, Stage


@dataclass(frozen=True)
class Localisation:
    """Stage and regions in which a recording differs from the refitted baseline.

    ``stage`` has the largest of the ``shares``, which add up to 1. All shares are 0 where nothing is above the floor;
    ``stage`` is then the closest to it. ``findings`` give the reasons.
    """

    stage: Stage
    shares: dict[Stage, float]
    findings: tuple[StageFinding, ...]
    regions: ErrorRegions
    evidence: Evidence = field(repr=False)

    @property
    def above_floor(self) -> bool:
        """Whether any stage is above its floor."""
        return any(share > 0.0 for share in self.shares.values())

    def neutral(self) -> Localisation:
        """Return a copy without a stage at fault and without regions, for a recording that the whole twin explains.

        A stage alone is driven by measured signals, whose noise can cause a larger error than that of the whole twin.
        Insignificant shares would contradict the verdict.
        """
        return replace(self, shares=dict.fromkeys(STAGES, 0.0), findings=(), regions=self.regions.unmarked())

    def as_answer(self) -> dict[str, Any]:
        """Return plain values for JSON under the contract's names, SI, with the findings by stage."""
        return {
            "stage": self.stage,
            "stages": {stage: self.shares[stage] for stage in STAGES},
            **self.regions.as_answer(),
            "findings": [item.as_answer() for item in self.findings],
        }


def localise(dataset: Dataset, baseline: Candidate) -> Localisation:
    """Localise the gap of a refitted baseline, without any list of effects.

    Args:
        dataset: the tests.
        baseline: the refitted baseline with its errors on held-out data.
    """
    found = gather_evidence(without_outliers(dataset, baseline.fit), baseline.fit)
    weights = dict.fromkeys(STAGES, 0.0)
    for item in found.findings:
        weights[item.stage] = max(weights[item.stage], item.weight)
    total = sum(weights.values())
    shares = {stage: weight / total if total > 0.0 else 0.0 for stage, weight in weights.items()}
    blamed = max(STAGES, key=lambda stage: (weights[stage], found.nearest.get(stage, 0.0)))
    return Localisation(blamed, shares, found.findings, find_error_regions(dataset, baseline.fit), found)
