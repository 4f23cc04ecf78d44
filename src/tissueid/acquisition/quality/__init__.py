"""The quality gate: checks of a finished test, with findings and advice for the operator."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from tissueid.acquisition.quality import contact_checks, instrument_checks, signal_checks
from tissueid.acquisition.quality.prepared_test import PreparedTest
from tissueid.device import DeviceDescription
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.sessions import Session, Test
from tissueid.sessions.quality import HEADLINES, Quality, QualityFinding, Severity, Verdict, quality_of, worst_first

log = logging.getLogger(__name__)

Check = Callable[[PreparedTest], Iterable[QualityFinding]]

CHECKS: tuple[Check, ...] = (
    instrument_checks.check_completion,
    instrument_checks.check_sensors,
    instrument_checks.check_drive,
    contact_checks.check_contact,
    contact_checks.check_reference,
    contact_checks.check_disturbance,
    instrument_checks.check_saturation,
    instrument_checks.check_stroke,
    instrument_checks.check_lost_samples,
    signal_checks.check_noise,
    signal_checks.check_coherence,
    signal_checks.check_mains,
    contact_checks.check_settling,
    instrument_checks.check_linear_region,
    instrument_checks.check_temperature,
    instrument_checks.check_calibration,
)
"""Checks, most important first: findings of the same severity keep this order."""


COMPARED_SIGNALS = ("command", "force", "position")
"""Signals of earlier tests that are kept for comparison."""
MAX_SAMPLES = 500_000
"""Maximum number of samples of earlier tests that a gate stores: 12 MB."""


def judge(test: Test, device: DeviceDescription, earlier: Sequence[Test] = ()) -> Quality:
    """Judge a finished test by its signals, its calibration and the earlier tests at the same site.

    Checks of missing signals are skipped. ``earlier`` may contain any tests; those that are not comparable are ignored.
    """
    prepared = PreparedTest(test, device)
    findings: list[QualityFinding] = [finding for check in CHECKS for finding in check(prepared)]
    others = signal_checks.comparable_tests(test, earlier)
    surfaces = np.array([other.surface_position_m for other in others])
    findings += contact_checks.check_surface(prepared, surfaces[np.isfinite(surfaces)])
    findings += signal_checks.check_against_earlier(prepared, others)
    return worst_first(findings)


NOT_JUDGED = Quality(
    (
        QualityFinding(
            "not_judged",
            "look",
            Message("quality.not_judged", "The quality gate failed on this test: it was not judged."),
            marked("Check its signals before you use it."),
        ),
    )
)
"""Quality of a test on which a check raised an error. An error of the gate never loses a recorded test."""


class QualityGate:
    """Judges the tests of one sitting as they end, each against those before it."""

    def __init__(self, device: DeviceDescription) -> None:
        self._device = device
        self.earlier: list[Test] = []

    def judge(self, test: Test) -> Quality:
        """Judge the newest test."""
        quality = _judged(test, self._device, self.earlier)
        if quality is None:
            return NOT_JUDGED
        kept = {name: values for name, values in test.signals.items() if name in COMPARED_SIGNALS}
        self.earlier.append(replace(test, signals=kept))
        while sum(other.samples for other in self.earlier) > MAX_SAMPLES:
            self.earlier.pop(0)
        return quality


def judge_session(session: Session) -> Iterator[tuple[Test, Quality]]:
    """Judge the tests of a session again, each against those before it."""
    for index, test in enumerate(session.tests):
        yield test, _judged(test, session.instrument, session.tests[:index]) or NOT_JUDGED


def _judged(test: Test, device: DeviceDescription, earlier: Sequence[Test]) -> Quality | None:
    """Judge a test; return None if a check raised an error."""
    try:
        return judge(test, device, earlier)
    except Exception:
        log.exception("the quality gate failed on test %d", test.number)
        return None


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
