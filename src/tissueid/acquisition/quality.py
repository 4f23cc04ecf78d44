"""The quality gate: whether a finished test can be believed, in words that somebody at the bedside can act on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from tissueid.device import DeviceDescription
from tissueid.sessions import Test

Severity = Literal["note", "look", "repeat"]
"""``note``: good to know; ``look``: read before you use it; ``repeat``: do the test again."""


@dataclass(frozen=True)
class QualityFinding:
    """One thing that was seen. ``code`` is for scripts; ``words`` say what happened, ``advice`` what to do."""

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
    def verdict(self) -> Literal["good", "look", "repeat"]:
        """``good`` where nothing asks to be looked at."""
        severities = {finding.severity for finding in self.findings}
        return "repeat" if "repeat" in severities else "look" if "look" in severities else "good"


def judge(test: Test, device: DeviceDescription, earlier: Sequence[Test] = ()) -> Quality:
    """Judge a finished test by its signals, by the calibration in force, and against earlier ones of the same site."""
    raise NotImplementedError
