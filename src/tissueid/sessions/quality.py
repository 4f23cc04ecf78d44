"""Results of the quality gate (``acquisition.quality``) and their form in a session file."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from math import isfinite
from typing import Any, Literal, get_args

from tissueid.language import marked
from tissueid.messages import Message, message_from, sentences
from tissueid.sessions.model import Test

Severity = Literal["note", "look", "repeat"]
"""``note``: information only; ``look``: read before the test is used; ``repeat``: repeat the test."""

Verdict = Literal["good", "look", "repeat"]

SEVERITIES: tuple[Severity, ...] = get_args(Severity)
NOTE = "quality"
"""Name of the note of a test, an attribute in its file, that holds the result as JSON."""

HEADLINES: dict[Verdict, str] = {
    "good": marked("Good test"),
    "look": marked("Read this before you use the test"),
    "repeat": marked("Do the test again"),
}
"""Verdicts as headlines."""

ENDED_EARLY = ("aborted", "recovered")
"""Statuses of tests that do not count as a repeat."""

_MOST_FINDINGS = 50
_LONGEST_TEXT = 1000


@dataclass(frozen=True)
class QualityFinding:
    """A finding of the quality gate.

    ``code`` is for scripts; ``message`` says what happened, ``advice`` what to do: both are messages or texts that a
    catalogue translates. ``value`` is the figure behind the finding, SI or a share from 0 to 1, or None.
    """

    code: str
    severity: Severity
    message: str
    advice: str
    value: float | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return the finding for JSON; under ``messages``, the code, template and values of its texts."""
        texts = {"words": self.message, "advice": self.advice}
        return {
            "code": self.code,
            "severity": self.severity,
            **{name: str(text) for name, text in texts.items()},
            "value": self.value,
            "messages": {name: text.as_dict() for name, text in texts.items() if isinstance(text, Message)},
        }


@dataclass(frozen=True)
class Quality:
    """All findings about one test, worst first."""

    findings: tuple[QualityFinding, ...]

    @property
    def verdict(self) -> Verdict:
        """``good`` if no finding is worse than a note."""
        severities = {finding.severity for finding in self.findings}
        return "repeat" if "repeat" in severities else "look" if "look" in severities else "good"

    @property
    def headline(self) -> str:
        """The verdict as a headline."""
        return HEADLINES[self.verdict]

    @property
    def lines(self) -> tuple[str, ...]:
        """Each finding with its advice, one line each."""
        return tuple(sentences(finding.message, finding.advice) for finding in self.findings)

    def as_dict(self) -> dict[str, Any]:
        """Return the verdict and the findings for JSON."""
        return {"verdict": self.verdict, "findings": [finding.as_dict() for finding in self.findings]}

    def as_notes(self) -> dict[str, str | float]:
        """Return the note that is stored with the test."""
        return {NOTE: json.dumps(self.as_dict(), allow_nan=False)}


def worst_first(findings: list[QualityFinding]) -> Quality:
    """Return findings in order of severity; those of the same severity keep their order."""
    finite = [
        replace(item, value=None) if item.value is not None and not isfinite(item.value) else item for item in findings
    ]
    return Quality(tuple(sorted(finite, key=lambda finding: -SEVERITIES.index(finding.severity))))


def quality_of(test: Test) -> Quality | None:
    """Return the stored result of the quality gate; None if the test was never checked.

    The note may be damaged or malicious: entries that are not findings are left out, and long texts are truncated.
    """
    note = test.notes.get(NOTE)
    if not isinstance(note, str):
        return None
    try:
        items = list(json.loads(note)["findings"])[:_MOST_FINDINGS]
    except (ValueError, TypeError, KeyError, RecursionError):
        return None
    findings = [finding for item in items if (finding := _finding(item)) is not None]
    if test.status in ENDED_EARLY:
        findings = [replace(item, severity="repeat") if item.code == "ended_early" else item for item in findings]
    return worst_first(findings)


def verdict_of(test: Test) -> Verdict | None:
    """Return the verdict on a test by its recording; None if it is not known. A test that ended early is to repeat.

    Every page, list, command and report takes it from here or from ``quality_of``.
    """
    if test.status in ENDED_EARLY:
        return "repeat"
    quality = quality_of(test)
    return None if quality is None else quality.verdict


def _finding(item: object) -> QualityFinding | None:
    if not isinstance(item, dict) or item.get("severity") not in SEVERITIES:
        return None
    texts = [item.get(name) for name in ("code", "words", "advice")]
    if not all(isinstance(text, str) for text in texts):
        return None
    code, message, advice = (str(text)[:_LONGEST_TEXT] for text in texts)
    messages = item.get("messages")
    if isinstance(messages, dict):
        message, advice = _restored(messages.get("words"), message), _restored(messages.get("advice"), advice)
    value = item.get("value")
    number = float(value) if isinstance(value, int | float) and abs(value) < 1e300 else None
    return QualityFinding(code, item["severity"], message, advice, number)


def _restored(stored: object, text: str) -> str:
    message = message_from(stored, text)
    return message if len(message) <= _LONGEST_TEXT else text
