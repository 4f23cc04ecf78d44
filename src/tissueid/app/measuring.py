"""One guided test from opening the instrument to the saved session: runs in a thread that alone touches it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tissueid.acquisition import GuidedTest, Phase, Progress, SessionRecorder, journal_path, run_guided_test
from tissueid.acquisition.guided import check_test
from tissueid.acquisition.live import LiveIdentification
from tissueid.app.live import LiveSignals
from tissueid.app.plan import Plan
from tissueid.app.words import in_words
from tissueid.errors import CancelledError
from tissueid.instrument import PROFILES, Instrument, Limits, Run, SimulatedInstrument
from tissueid.sessions import Session, Subject

Wait = Callable[[float], object]
"""Waits for so many seconds, or less when there is a reason to."""


@dataclass(frozen=True)
class Outcome:
    """How a test ended: what was saved, if anything, and what went wrong, in words."""

    path: Path
    session: Session | None
    problem: str = ""
    stopped: bool = False


class PacedInstrument:
    """An instrument without a clock of its own, held to real time so that people can watch.

    ``wait`` is called with the seconds by which the samples are ahead; ``clock`` gives seconds that never go back.
    """

    def __init__(self, paced: Instrument, wait: Wait, clock: Callable[[], float] = time.monotonic) -> None:
        self.device = paced.device
        self.gaps = paced.gaps
        self._paced = paced
        self._wait = wait
        self._clock = clock
        self._started = clock()
        self._delivered = 0

    def load(self, command_v: NDArray[np.float64]) -> None:
        """Pass the stimulus on."""
        self._paced.load(command_v)

    @property
    def late_blocks(self) -> int:
        """Blocks of set-points that came after their time."""
        return self._paced.late_blocks

    @property
    def held_samples(self) -> int:
        """Samples whose set-point was missing."""
        return self._paced.held_samples

    @property
    def setpoint_margin_s(self) -> float | None:
        """Least time by which a block was there before it was played."""
        return self._paced.setpoint_margin_s

    def follow(self, samples: int, hold_v: float) -> None:
        """Pass on that set-points will follow."""
        self._paced.follow(samples, hold_v)

    def send(self, offset: int, command_v: NDArray[np.float64]) -> None:
        """Pass set-points on."""
        self._paced.send(offset, command_v)

    def finish(self) -> int:
        """Pass on that the run ends here."""
        return self._paced.finish()

    def arm(self, limits: Limits) -> None:
        """Pass the limits on."""
        self._paced.arm(limits)

    def start(self) -> Run:
        """Play; from now on samples come in real time."""
        self._started, self._delivered = self._clock(), 0
        return self._paced.start()

    def poll(self, timeout_s: float) -> NDArray[np.void]:
        """The next samples, at the moment when the last of them is due."""
        samples = self._paced.poll(timeout_s)
        self._delivered += samples.size
        ahead = self._started + self._delivered / self.device.sample_rate_hz - self._clock()
        if ahead > 0.0:
            self._wait(ahead)
        return samples

    def release(self) -> None:
        """Free the coil."""
        self._paced.release()

    def close(self) -> None:
        """Release, and let go."""
        self._paced.close()


def measure(
    plan: Plan,
    live: LiveSignals,
    stop: threading.Event,
    opener: Callable[[str], Instrument],
    wait: Wait | None = None,
    apart: bool = True,
) -> Outcome:
    """Run the planned test. However it ends, the coil is released and what was recorded is kept.

    ``stop`` ends it within a poll. ``wait`` paces the simulation in this process: by the clock, cut short by
    ``stop``, unless another is given. ``apart`` lets a process of its own look at the test while it runs; without it
    the looks are made between the polls.

    Raises:
        TissueIDError, OSError: the test could not begin; there is no file.
    """
    recorder: SessionRecorder | None = None
    problem: Exception | None = None
    try:
        instrument = opener(plan.url)
        try:
            device, limits = instrument.device, PROFILES[plan.limits]
            stimulus = plan.stimulus(device.sample_rate_hz)
            test = GuidedTest(stimulus, plan.site, limits=limits)
            check_test(test, device)
            if stop.is_set():
                raise CancelledError("stopped before the coil was energised")
            recorder = SessionRecorder(plan.path, device, Subject(plan.pseudonym))
            if isinstance(instrument, SimulatedInstrument):
                instrument = PacedInstrument(instrument, wait or stop.wait)

            identification = LiveIdentification(device, preload_s=stimulus.preload_s, apart=apart)
            live.identification = identification

            def show(progress: Progress) -> None:
                live.add(progress, device)
                if progress.phase is not Phase.PLACE:
                    identification.feed(progress.samples)
                    identification.step()

            run_guided_test(instrument, test, recorder, progress=show, cancelled=stop.is_set)
        finally:
            try:
                instrument.close()
            finally:
                if live.identification is not None:
                    live.identification.close()
    except CancelledError as error:
        problem = error
    except Exception as error:
        if recorder is None:
            raise
        problem = error
    session, trouble = _keep(recorder)
    said = [in_words(problem)] if problem is not None else []
    return Outcome(plan.path, session, " ".join([*said, trouble]).strip(), isinstance(problem, CancelledError))


def _keep(recorder: SessionRecorder | None) -> tuple[Session | None, str]:
    """Turn what was recorded into a session; where that fails its journal stays, and the words say so."""
    if recorder is None:
        return None, ""
    try:
        return recorder.finish_or_discard(), ""
    except Exception as error:  # noqa: BLE001 - whatever it was, the journal must be let go of and mentioned
        recorder.abandon()
        kept = f"The recording stays in {journal_path(recorder.path)}; it is offered for recovery at the next start."
        return None, f"{in_words(error)} {kept}"
