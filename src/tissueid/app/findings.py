"""What a saved test says: verdict, numbers and curves, ready to be shown."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tissueid.language import _
from tissueid.records import Estimate
from tissueid.sessions import Session, Test, read_session
from tissueid.sessions.quality import Quality
from tissueid.wording import clean

if TYPE_CHECKING:
    from tissueid.analysis import Analysis
    from tissueid.reports.verdict import Verdict
    from tissueid.sessions.accepted import AcceptedResult

Array = NDArray[np.float64]
LONGEST = 80
"""Letters of a site or of a pseudonym that are shown."""


@dataclass(frozen=True)
class Curves:
    """One plot, in the units that are shown: what was measured, a model's line through it, an uncertainty band.

    Measured ``x`` and ``y`` have shape (n,), ``low`` and ``high`` too where there is a band; ``model_x`` and
    ``model_y`` (m,). Where there is nothing to draw, ``missing`` says why.
    """

    x: Array
    y: Array
    model_x: Array
    model_y: Array
    low: Array | None = None
    high: Array | None = None
    missing: str = ""


@dataclass(frozen=True)
class Number:
    """One number as people read it, its deviation and unit after it; ``note`` says of what it is.

    ``found`` is the same in SI, of ``si_unit``, where it has a unit that can be chosen.
    """

    label: str
    value: str
    unit: str
    note: str
    found: Estimate | None = None
    si_unit: str = ""


@dataclass(frozen=True)
class Findings:
    """One test of a session, analysed. ``cautions`` is what engines refused or warned of.

    ``quality`` is what the gate said when the test ended, None for a test that it never judged. ``accepted`` is the
    accepted result of its sitting, as the file next to the session has it.
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
    impulse: Curves
    bode: Curves
    phase: Curves
    nonlinearity: Curves
    prediction: Curves
    accepted: AcceptedResult | None = None


def whose(findings: Findings) -> str:
    """Site and pseudonym of what was measured, which may be another's than the form's."""
    site = clean(findings.test.site)[:LONGEST] or _("Site not recorded")
    pseudonym = clean(findings.session.subject.pseudonym)[:LONGEST] or _("Subject not recorded")
    return f"{site}  ·  {pseudonym}"


def find(path: Path, session: Session | None = None, number: int | None = None) -> Findings:
    """Analyse one test of a session, the first stochastic one unless ``number`` names another.

    An engine that cannot use the record costs only its own part of the answer.

    Raises:
        UnusableInputError: the file is not a session, or holds no such test.
    """
    from tissueid.app.identifying import identify  # engines and figures take longer to import than the window to open

    return identify(path, session or read_session(path), number)
