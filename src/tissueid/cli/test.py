"""``tissueid test``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tissueid.acquisition import GuidedTest, Progress, SessionRecorder, run_guided_test
from tissueid.acquisition.guided import find_surface
from tissueid.cli.output import console, progress_bars, write_json
from tissueid.errors import TissueIDError, UnusableInputError
from tissueid.instrument import PROFILES, open_instrument
from tissueid.sessions import Session, Subject
from tissueid.stimuli.base import Stimulus, get_stimulus, guided


@dataclass(frozen=True)
class Plan:
    """What the options of ``tissueid test`` ask for."""

    distribution: str
    min_force_n: float
    max_force_n: float
    seconds: float
    seed: int
    repeats: int
    limits: str

    def stimulus(self, sample_rate_hz: float) -> Stimulus:
        """The stimulus with its preload.

        Raises:
            UnusableInputError: the options do not make one.
        """
        options = {
            "distribution": self.distribution,
            "force_min_n": self.min_force_n,
            "force_max_n": self.max_force_n,
            "seconds": self.seconds,
            "seed": self.seed,
            "sample_rate": sample_rate_hz,
        }
        return guided(get_stimulus("noise").from_options(options).build())


def show_progress(show: Callable[[str, float], None], label: str) -> Callable[[Progress], None]:
    """Progress of a test as one bar."""
    return lambda progress: show(label, progress.fraction)


def run_tests(url: str, site: str, out: Path, plan: Plan, pseudonym: str, json_file: Path | None) -> None:
    """Place once, then run the test as often as asked, all into one session."""
    if plan.limits not in PROFILES:
        raise UnusableInputError(f"limits are {' or '.join(PROFILES)}, not {plan.limits!r}")
    limits = PROFILES[plan.limits]
    instrument = open_instrument(url)
    try:
        stimulus = plan.stimulus(instrument.device.sample_rate_hz)
        recorder = SessionRecorder(out, instrument.device, Subject(pseudonym))
        try:
            with progress_bars() as show:
                surface = find_surface(instrument, limits, progress=show_progress(show, "placing the probe"))
                for repeat in range(plan.repeats):
                    test = GuidedTest(stimulus, site, limits=limits, repeat_of=1 if repeat else None)
                    label = f"test {repeat + 1} of {plan.repeats}"
                    run_guided_test(instrument, test, recorder, surface_m=surface, progress=show_progress(show, label))
        except (TissueIDError, KeyboardInterrupt):
            _keep(recorder)
            raise
        session = recorder.finish()
    finally:
        instrument.close()
    _tell(out, session)
    if json_file is not None:
        tests = [{"test": test.number, "status": test.status, "samples": test.samples} for test in session.tests]
        write_json(json_file, {"session": str(out), "session_id": session.session_id, "tests": tests})


def _keep(recorder: SessionRecorder) -> None:
    """Whatever was recorded before it went wrong becomes a session; an empty one leaves nothing."""
    session = recorder.finish_or_discard()
    if session is not None:
        _tell(recorder.path, session)


def _tell(path: Path, session: Session) -> None:
    console.print(f"session: {path}", markup=False)
    for test in session.tests:
        console.print(f"  test {test.number}: {test.status}, {test.samples} samples", markup=False)
        if lost := test.notes.get("samples_lost"):
            console.print(f"    {lost:.0f} samples were lost and are marked as such", markup=False)
