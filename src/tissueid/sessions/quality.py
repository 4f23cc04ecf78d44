"""What the quality gate says of a test (``acquisition.quality``), and how a session keeps it."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from math import isfinite
from typing import Any, Literal, get_args

from tissueid.sessions.model import Test

Severity = Literal["note", "look", "repeat"]
"""``note``: good to know; ``look``: read before you use it; ``repeat``: do the test again."""

Verdict = Literal["good", "look", "repeat"]

SEVERITIES: tuple[Severity, ...] = get_args(Severity)
NOTE = "quality"
"""The note of a test, and so the attribute in its file, that holds the gate's answer as JSON."""

HEADLINES: dict[Verdict, str] = {
    "good": "Good test",
    "look": "Read this before you use the test",
    "repeat": "Do the test again",
}

_MOST_FINDINGS = 50
_LONGEST_TEXT = 1000


@dataclass(frozen=True)
class QualityFinding:
    """One thing that was seen. ``code`` is for scripts; ``words`` say what happened, ``advice`` what to do.

    ``value`` is the figure behind it, SI or a share from 0 to 1, where there is one.
    """

    code: str
    severity: Severity
    words: str
    advice: str
    value: float | None = None


@dataclass(frozen=True)
class Quality:
    """All that was seen in one test, worst first."""

    findings: tuple[QualityFinding, ...]

    @property
    def verdict(self) -> Verdict:
        """``good`` where nothing asks to be looked at."""
        severities = {finding.severity for finding in self.findings}
        return "repeat" if "repeat" in severities else "look" if "look" in severities else "good"

    @property
    def headline(self) -> str:
        """The verdict in words."""
        return HEADLINES[self.verdict]

    @property
    def lines(self) -> tuple[str, ...]:
        """The findings as people read them, one line each."""
        return tuple(f"{finding.words} {finding.advice}".strip() for finding in self.findings)

    def as_dict(self) -> dict[str, Any]:
        """The verdict and the findings, fit for JSON."""
        return {"verdict": self.verdict, "findings": [asdict(finding) for finding in self.findings]}

    def as_notes(self) -> dict[str, str | float]:
        """What goes into the session with the test."""
        return {NOTE: json.dumps(self.as_dict(), allow_nan=False)}


def worst_first(findings: list[QualityFinding]) -> Quality:
    """Findings in order of severity; of the same one as they were found."""
    told = [
        replace(item, value=None) if item.value is not None and not isfinite(item.value) else item for item in findings
    ]
    return Quality(tuple(sorted(told, key=lambda finding: -SEVERITIES.index(finding.severity))))


def quality_of(test: Test) -> Quality | None:
    """What the gate said when the test ended; None for a test from before there was a gate, or from elsewhere.

    Files come from anywhere: what is not a finding is left out, and what is too long is cut off.
    """
    note = test.notes.get(NOTE)
    if not isinstance(note, str):
        return None
    try:
        kept = json.loads(note)["findings"]
        items = list(kept)[:_MOST_FINDINGS]
    except (ValueError, TypeError, KeyError, RecursionError):
        return None
    return worst_first([finding for item in items if (finding := _finding(item)) is not None])


def _finding(item: object) -> QualityFinding | None:
    if not isinstance(item, dict) or item.get("severity") not in SEVERITIES:
        return None
    texts = [item.get(name) for name in ("code", "words", "advice")]
    if not all(isinstance(text, str) for text in texts):
        return None
    code, words, advice = (str(text)[:_LONGEST_TEXT] for text in texts)
    value = item.get("value")
    number = float(value) if isinstance(value, int | float) and abs(value) < 1e300 else None
    return QualityFinding(code, item["severity"], words, advice, number)
