"""Trial of a feedback stimulus on a simulated tissue, which has no samples before its test."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tissueid.acquisition import GuidedTest, SessionRecorder, run_guided_test
from tissueid.acquisition.guided import check_test
from tissueid.analysis.curves.feedback import FeedbackRun
from tissueid.errors import UnusableInputError
from tissueid.formatting import fixed, grouped
from tissueid.instrument import Limits, open_instrument
from tissueid.instrument.discovery import IN_PROCESS
from tissueid.language import marked
from tissueid.messages import Verbatim
from tissueid.procedures.control import Control
from tissueid.procedures.depth_coverage import out_of_reach
from tissueid.reports.stimulus_page import feedback_run
from tissueid.sessions import Test
from tissueid.stimuli import FeedbackKind
from tissueid.test_settings import TestSettings

_PLAYING = marked("Playing the stimulus")
_TISSUE = f"{IN_PROCESS}baseline?seed=0"
"""Simulated tissue on which a stimulus is tried by default."""


@dataclass(frozen=True)
class FeedbackTrial:
    """A feedback stimulus, the address of the tissue, the test, and its run with the report of the stimulus."""

    kind: FeedbackKind
    url: str
    test: Test
    run: FeedbackRun

    def rows(self) -> tuple[tuple[str, str], ...]:
        """Return the result as labels and values."""
        return tuple(_rows(self))

    def note(self, name: str) -> float:
        """Return a number that the test noted; NaN if it did not."""
        return float(self.test.notes.get(name, float("nan")))


def try_on_tissue(kind: FeedbackKind, url: str | None, limits: Limits, control: Control) -> FeedbackTrial:
    """Run one test of a feedback stimulus on a simulated tissue; nothing is saved.

    Raises:
        UnusableInputError: a real instrument was named.
        LimitError: the stimulus could exceed the limits of the instrument, or did.
    """
    url = url or _TISSUE
    test = play_on_tissue(kind, url, limits, control)
    return FeedbackTrial(kind, url, test, feedback_run(test, url.removeprefix(IN_PROCESS)))


def play_on_tissue(kind: FeedbackKind, url: str, limits: Limits, control: Control) -> Test:
    """Run one test on a simulated tissue and return it; nothing is saved.

    Raises:
        UnusableInputError: a real instrument was named.
        LimitError: the stimulus could exceed the limits of the instrument, or did.
    """
    if not url.startswith(IN_PROCESS):
        raise UnusableInputError(
            "stimulus.feedback_on_instrument",
            "a feedback stimulus is designed on {tissue}; 'tissueid test --stimulus {kind}' plays it on an instrument",
            tissue=Verbatim(f"{IN_PROCESS}TISSUE"),
            kind=Verbatim(kind.name),
        )
    instrument = open_instrument(url)
    guided = GuidedTest(kind, TestSettings(site=url), limits=limits)
    try:
        check_test(guided, instrument.device)
        with tempfile.TemporaryDirectory() as folder:
            recorder = SessionRecorder(Path(folder) / "designed.h5", instrument.device)
            try:
                run_guided_test(
                    instrument, guided, recorder, progress=lambda step: control.progress(step.fraction, _PLAYING)
                )
            except BaseException:
                recorder.finish_or_discard()
                raise
            return recorder.finish().tests[0]
    finally:
        instrument.close()


def _rows(trial: FeedbackTrial) -> Iterator[tuple[str, str]]:
    test, run = trial.test, trial.run
    force, depth = run.force, run.depth
    yield "Length", f"{fixed(force.size / run.sample_rate_hz, 2)} s"
    yield "Range of force", f"{fixed(float(force.min()), 2)} to {fixed(float(force.max()), 2)} N"
    yield "Range of depth", f"{fixed(1e3 * float(depth.min()), 2)} to {fixed(1e3 * float(depth.max()), 2)} mm"
    yield (
        "Desired range of depth",
        f"{fixed(1e3 * float(run.edges[0]), 2)} to {fixed(1e3 * float(run.edges[-1]), 2)} mm",
    )
    if short := out_of_reach(test):
        yield "Reachable depth", short
    yield "Distance of depth from the desired distribution", fixed(run.distance, 3)
    yield "Computing time relative to test time", f"{fixed(100.0 * trial.note('generating_share'), 1)} %"
    yield "Late blocks", grouped(trial.note("late_blocks"))
