"""Where the gap lies: which stage of the chain, and in which regions of frequency, depth, direction and time."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from tissueid.gap.evidence import Evidence, StageFinding, evidence
from tissueid.gap.impulses import cleaned
from tissueid.gap.observed import Observed
from tissueid.gap.regions import Regions, regions
from tissueid.gap.scoring import Candidate
from tissueid.twin.effect import STAGES, Stage


@dataclass(frozen=True)
class Where:
    """Where a recording differs from the refitted baseline.

    ``stage`` is the one blamed: that with the largest of the ``shares``, which add up to 1 (or are all 0 where nothing
    stands above the floor; the stage is then the one nearest to it). ``findings`` say in figures and words why.
    """

    stage: Stage
    shares: dict[Stage, float]
    findings: tuple[StageFinding, ...]
    regions: Regions
    evidence: Evidence = field(repr=False)

    @property
    def above_floor(self) -> bool:
        """Whether any stage stands above its floor."""
        return any(share > 0.0 for share in self.shares.values())

    def neutral(self) -> Where:
        """Return a copy that blames no stage and no region: for a recording that the whole twin explains.

        A stage by itself is driven by measured signals, and their noise can move it further than the whole twin errs.
        Shares of what is insignificant would contradict the verdict.
        """
        return replace(self, shares=dict.fromkeys(STAGES, 0.0), findings=(), regions=self.regions.unmarked())

    def as_answer(self) -> dict[str, Any]:
        """Plain values under the contract's names, SI, with the findings by stage."""
        return {
            "stage": self.stage,
            "stages": {stage: self.shares[stage] for stage in STAGES},
            **self.regions.as_answer(),
            "findings": [item.as_answer() for item in self.findings],
        }


def where(observed: Observed, baseline: Candidate) -> Where:
    """Tell where the gap of a refitted baseline lies, without recourse to any list of effects.

    Args:
        observed: the tests.
        baseline: fitted to them, with its errors on what was held out.
    """
    found = evidence(cleaned(observed, baseline.fit), baseline.fit)
    weights = dict.fromkeys(STAGES, 0.0)
    for item in found.findings:
        weights[item.stage] = max(weights[item.stage], item.weight)
    total = sum(weights.values())
    shares = {stage: weight / total if total > 0.0 else 0.0 for stage, weight in weights.items()}
    blamed = max(STAGES, key=lambda stage: (weights[stage], found.nearest.get(stage, 0.0)))
    return Where(blamed, shares, found.findings, regions(observed, baseline.fit), found)
