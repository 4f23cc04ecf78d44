"""The gap between simulated and recorded: where it lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

from tissueid.gap.answer import as_answer
from tissueid.gap.diagnosis import Diagnosis, diagnose
from tissueid.gap.observed import Observed
from tissueid.gap.observing import observe
from tissueid.gap.workers import crew

__all__ = ["Diagnosis", "Observed", "as_answer", "crew", "diagnose", "observe"]
