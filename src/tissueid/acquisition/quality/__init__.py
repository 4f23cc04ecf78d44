"""The quality gate: checks of a finished test, with findings and advice for the operator."""

from tissueid.acquisition.quality.gate import QualityGate, judge, judge_session
from tissueid.sessions.quality import HEADLINES, Quality, QualityFinding, Severity, Verdict, quality_of

__all__ = [
    "HEADLINES",
    "Quality",
    "QualityFinding",
    "QualityGate",
    "Severity",
    "Verdict",
    "judge",
    "judge_session",
    "quality_of",
]
