"""The quality gate: all checks on one finished test, or on those of a session one after another."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from tissueid.acquisition.quality import apparatus, contact, noise, repeats
from tissueid.acquisition.quality.evidence import Evidence
from tissueid.device import DeviceDescription
from tissueid.sessions import Session, Test
from tissueid.sessions.quality import Quality, QualityFinding, worst_first

log = logging.getLogger(__name__)

Check = Callable[[Evidence], Iterable[QualityFinding]]

CHECKS: tuple[Check, ...] = (
    apparatus.ended,
    apparatus.stuck,
    apparatus.driven,
    contact.lifted,
    contact.moved,
    contact.shaken,
    apparatus.saturated,
    apparatus.at_the_end,
    apparatus.lost,
    noise.noisy,
    noise.incoherent,
    noise.mains,
    contact.unsettled,
    apparatus.outside,
    apparatus.warm,
    apparatus.calibrated,
)
"""In the order in which findings of the same severity are told: what spoils most comes first."""


COMPARED_SIGNALS = ("command", "force", "position")
MOST_SAMPLES = 500_000
"""In all the tests that a gate remembers: 12 MB."""


def judge(test: Test, device: DeviceDescription, earlier: Sequence[Test] = ()) -> Quality:
    """Judge a finished test by its signals, by the calibration in force, and against earlier ones of the same site.

    A signal that the test lacks is not judged. Earlier tests may be any: those that cannot be compared are left out.
    """
    evidence = Evidence(test, device)
    found: list[QualityFinding] = [finding for check in CHECKS for finding in check(evidence)]
    others = repeats.comparable(test, earlier)
    surfaces = np.array([other.surface_position_m for other in others])
    found += contact.surface_changed(evidence, surfaces[np.isfinite(surfaces)])
    found += repeats.compared(evidence, others)
    return worst_first(found)


NOT_JUDGED = Quality(
    (
        QualityFinding(
            "not_judged",
            "look",
            "The quality gate failed on this test: it was not judged.",
            "Look at its signals before you use it.",
        ),
    )
)
"""A defect of the gate, or a file whose figures make no sense, never costs a test that was recorded."""


class QualityGate:
    """Judges the tests of one sitting as they end. Of those before it keeps what later ones are compared with."""

    def __init__(self, device: DeviceDescription) -> None:
        self._device = device
        self._earlier: list[Test] = []

    def judge(self, test: Test) -> Quality:
        """Judge the newest test."""
        found = _judged(test, self._device, self._earlier)
        if found is None:
            return NOT_JUDGED
        kept = {name: values for name, values in test.signals.items() if name in COMPARED_SIGNALS}
        self._earlier.append(replace(test, signals=kept))
        while sum(other.samples for other in self._earlier) > MOST_SAMPLES:
            self._earlier.pop(0)
        return found


def judge_session(session: Session) -> Iterator[tuple[Test, Quality]]:
    """Judge the tests of a session anew, each against those before it."""
    for place, test in enumerate(session.tests):
        yield test, _judged(test, session.instrument, session.tests[:place]) or NOT_JUDGED


def _judged(test: Test, device: DeviceDescription, earlier: Sequence[Test]) -> Quality | None:
    """Judge a test, whatever it holds; None where the gate could not."""
    try:
        return judge(test, device, earlier)
    except Exception:
        log.exception("the quality gate failed on test %d", test.number)
        return None
