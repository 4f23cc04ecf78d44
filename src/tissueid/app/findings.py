"""The analysis of a saved test in the form in which the window shows it: verdict, numbers and curves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from tissueid.formatting import clean
from tissueid.language import _
from tissueid.procedures.saved_test import AnalysedTest
from tissueid.records import Estimate
from tissueid.sessions import Session, Test
from tissueid.sessions.quality import Quality

if TYPE_CHECKING:
    from tissueid.analysis import Analysis
    from tissueid.analysis.curves.results import RecordPlots, ResultPlots
    from tissueid.reports.verdict import Verdict
    from tissueid.sessions.accepted_result import AcceptedResult


LONGEST = 80
"""Maximum number of shown characters of a site or pseudonym."""


@dataclass(frozen=True)
class Number:
    """One number as text, with its deviation and unit; ``note`` says what it refers to.

    ``estimate`` is the same in SI, of ``si_unit``, where it has a unit that can be chosen.
    ``quantity`` names a parameter.
    """

    label: str
    value: str
    unit: str
    note: str
    estimate: Estimate | None = None
    si_unit: str = ""
    quantity: str = ""


@dataclass(frozen=True)
class Findings:
    """The analysis of one test of a session. ``cautions`` are refusals of engines, and ``refused`` the same by engine.

    ``quality`` is the judgement of the quality gate, None for a test that was not judged. ``accepted`` is the accepted
    result of its sitting, from the file next to the session.
    """

    path: Path
    session: Session
    test: Test
    analyses: dict[str, Analysis]
    quality: Quality | None
    verdict: Verdict
    numbers: tuple[Number, ...]
    ended: str
    visited: str
    cautions: tuple[str, ...]
    plots: ResultPlots
    recorded: RecordPlots
    accepted: AcceptedResult | None = None
    refused: Mapping[str, str] = field(default_factory=dict)
    unread: tuple[str, ...] = ()
    """Why the accepted result of the sitting cannot be read, where that is so."""
    repeats: tuple[Findings, ...] = ()
    """All tests of the sitting in their order, for a test that was opened again before a result was accepted."""
    readings: str = ""
    """Readings of a step test for comparison with other probes, as one line; empty for other tests."""

    @property
    def analysed(self) -> AnalysedTest:
        """The test with its analyses, as reports take it."""
        return AnalysedTest(self.session, self.test, self.analyses, dict(self.refused))


def whose(findings: Findings) -> str:
    """Return site and pseudonym of the test, which may differ from the form."""
    site = clean(findings.test.site)[:LONGEST] or _("Site not recorded")
    pseudonym = clean(findings.session.subject.pseudonym)[:LONGEST] or _("Subject not recorded")
    return f"{site}  ·  {pseudonym}"
