"""Playback of one stimulus: load, arm, poll to the end, and release the coil on every error."""

from __future__ import annotations

import gc
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache

import numpy as np
import scipy
from numpy.typing import NDArray

from tissueid.device import DeviceDescription
from tissueid.errors import CancelledError, LinkLostError, UnusableInputError
from tissueid.instrument import Instrument, Limits, Run, is_not_played
from tissueid.instrument.force_profile import recorded_force
from tissueid.messages import Message
from tissueid.stimuli.base import BLOCK, GUIDED, Array, FeedbackKind, Stimulus, preload_values, to_voltage
from tissueid.untrusted_input import MAX_TEXT

_REHEARSAL_S = 2.0
"""Maximum simulated time of the rehearsal, s."""
_REHEARSED_STIFFNESS = 1000.0
"""Stiffness of the rehearsal, N/m."""
_REHEARSED_DAMPING = 10.0
"""Damping of the rehearsal, N s/m."""
_ROUNDING_N = 1e-9
"""Tolerance of the force range, N."""


def preload_stimulus(kind: FeedbackKind, preload_s: float) -> Stimulus:
    """Return the preload of a feedback stimulus: the rise to its load and the hold.

    Raises:
        UnusableInputError: the preload is shorter than its rise.
    """
    return Stimulus(
        values=preload_values(kind.preload_n, preload_s, kind.sample_rate),
        sample_rate_hz=kind.sample_rate,
        description={"type": GUIDED, "preload_s": preload_s, "stimulus": kind.describe()},
        seed=kind.seed,
        crest_factor=float("nan"),
        preload_s=preload_s,
    )


def set_point_count(kind: FeedbackKind) -> int:
    """Return the number of set-points after the preload."""
    return round(kind.seconds * kind.sample_rate)


@lru_cache(maxsize=8)
def rehearse(kind: FeedbackKind) -> None:
    """Run a feedback stimulus against a simulated spring and damper before the coil is energised.

    This compiles and loads the code of the source and detects its errors.

    Raises:
        UnusableInputError: the source generates invalid set-points.
    """
    source = kind.start(0.0)
    decay = float(np.exp(-_REHEARSED_STIFFNESS / (_REHEARSED_DAMPING * kind.sample_rate)))
    blocks = min(set_point_count(kind), round(_REHEARSAL_S * kind.sample_rate)) // BLOCK + 1
    force_n = np.full(BLOCK, kind.preload_n)
    depth = force_n / _REHEARSED_STIFFNESS
    state = decay * depth[-1:]
    for block in range(-kind.lead, blocks):
        source.take(force_n, depth, block * BLOCK)
        force_n = validated(kind, source.next_block())
        depth, state = scipy.signal.lfilter([(1.0 - decay) / _REHEARSED_STIFFNESS], [1.0, -decay], force_n, zi=state)
    source.report()


def validated(kind: FeedbackKind, block: Array) -> Array:
    """Return a block of set-points, shape (BLOCK,), N, after validation.

    Raises:
        UnusableInputError: wrong shape, or outside the force range of the kind.
    """
    whole = block.shape == (BLOCK,)
    if not whole or not np.all((block >= kind.force_min_n - _ROUNDING_N) & (block <= kind.force_max_n + _ROUNDING_N)):
        raise UnusableInputError(
            "stimulus.out_of_range",
            "the stimulus '{name}' left its range of {low:g} to {high:g} N and cannot be played",
            name=kind.name,
            low=kind.force_min_n,
            high=kind.force_max_n,
        )
    return block


class SetPoints:
    """Set-points of a running test.

    The source gets the samples in pieces that end at block boundaries. Block k is generated when the source has exactly
    the samples up to ``lead`` blocks before the start of the block. The set-points therefore depend on the measurement
    alone, not on transport timing, and can be reproduced from the recording.

    ``surface_m`` is the position of the tissue surface; ``clock`` is a monotonic clock, s.
    """

    def __init__(
        self,
        kind: FeedbackKind,
        device: DeviceDescription,
        surface_m: float,
        preload_samples: int,
        *,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self.samples = set_point_count(kind)
        self.hold_v = float(to_voltage(np.array([kind.preload_n]), device)[0])
        self._kind = kind
        self._device = device
        self._clock = clock
        self._source = kind.start(surface_m)
        self._preload = preload_samples
        self._taken = -preload_samples
        self._waiting: list[NDArray[np.float64]] = []  # each (2, k): force and position, from self._taken on
        self._received = -preload_samples
        self._made = 0
        self._seconds = self._longest = 0.0

    def take(self, samples: NDArray[np.void]) -> None:
        """Add samples of the run, shape (k,) of SAMPLE, in order; lost ones are NaN."""
        self._waiting.append(np.stack([recorded_force(samples, self._device), samples["position"]]))
        self._received += samples.size

    def send_due(self, instrument: Instrument) -> None:
        """Generate and send the blocks that are due.

        Raises:
            UnusableInputError: the source generated invalid set-points.
            InstrumentError, LimitError: see ``Instrument.send``.
        """
        while self._made * BLOCK < self.samples and (due := (self._made - self._kind.lead) * BLOCK) <= self._received:
            begin = self._clock()
            self._pass_to_source(due)
            block = validated(self._kind, self._source.next_block())
            spent = self._clock() - begin
            self._seconds += spent
            self._longest = max(self._longest, spent)
            offset = self._made * BLOCK
            self._made += 1
            instrument.send(self._preload + offset, to_voltage(block[: self.samples - offset], self._device))

    def notes(self, run: Run, *, whole: bool) -> dict[str, str | float]:
        """Return the notes about the generation, for a run as played.

        ``generating_share`` is the computing time relative to the duration of the test, ``generating_longest_s`` the
        time of the slowest block, ``stimulus_report`` the report of the source as JSON, for a test that was played
        ``whole``.
        """
        played_s = run.samples / self._device.sample_rate_hz
        notes: dict[str, str | float] = {
            "generating_share": self._seconds / played_s,
            "generating_longest_s": self._longest,
        }
        if whole:
            notes |= self._report()
        return notes

    def _report(self) -> dict[str, str | float]:
        """Return the report of the source as JSON, or the reason why there is none."""
        try:
            self._pass_to_source(self._received)
            report = json.dumps(self._source.report())
        except Exception as error:  # noqa: BLE001 - a plug-in may raise anything, and the test was played
            return {"stimulus_report_failed": f"{type(error).__name__}: {error}"}
        if len(report) > MAX_TEXT:
            return {"stimulus_report_failed": f"{len(report)} characters; at most {MAX_TEXT} are stored"}
        return {"stimulus_report": report}

    def _pass_to_source(self, end: int) -> None:
        """Pass the samples before ``end`` to the source, in pieces that end at multiples of a block."""
        if end <= self._taken:
            return
        signals = np.concatenate(self._waiting, axis=1)  # (2, received - taken)
        edges = [*range(self._taken // BLOCK * BLOCK + BLOCK, end, BLOCK), end]
        for edge in edges:
            piece = signals[:, : edge - self._taken]
            signals = signals[:, edge - self._taken :]
            self._source.take(piece[0].copy(), piece[1].copy(), self._taken)
            self._taken = edge
        self._waiting = [signals]


POLL_S = 0.05
"""Maximum wait of one poll, s."""
_RELEASE_S = 0.08
"""Time after a run until the frames of its release (a ramp of 50 ms) have arrived, s."""
_RELEASE_POLLS = 40
"""Maximum number of polls for the end of the release."""
CANCELLED = Message("test.cancelled", "cancelled; the coil is released and the recording is kept")
CANCELLED_BETWEEN = Message(
    "test.cancelled_between", "cancelled between two tests; the coil is free and the recordings are kept"
)


class Phase(Enum):
    """Phase of a guided test."""

    PLACE = "place"
    PRELOAD = "preload"
    STIMULUS = "stimulus"
    RELEASE = "release"


@dataclass(frozen=True)
class Progress:
    """Progress of a running test: its phase, the fraction played (0 to 1) and the newest samples."""

    phase: Phase
    fraction: float
    samples: NDArray[np.void]


def ignore_progress(_: Progress) -> None:
    """Ignore the progress: the default callback."""


def never_stop() -> bool:
    """Return False: the default stop callback."""
    return False


def play(
    instrument: Instrument,
    command_v: NDArray[np.float64],
    limits: Limits,
    *,
    started: Callable[[Run], None] | None = None,
    on_samples: Callable[[NDArray[np.void], float], None],
    cancelled: Callable[[], bool] = never_stop,
    set_points: SetPoints | None = None,
    enough: Callable[[], bool] = never_stop,
) -> Run:
    """Play one stimulus, shape (n,), V, and return the run as played.

    ``on_samples`` receives the samples as they arrive and the fraction played. ``set_points`` follow the stimulus and
    are computed from the measurement. ``enough`` is called after every poll; when it returns True, the run ends with a
    soft release. On any error the coil is released before the exception propagates.

    Raises:
        CancelledError: ``cancelled`` returned True.
        LimitError, InstrumentError: as raised by ``Instrument``.
        UnusableInputError: invalid set-points.
    """
    instrument.load(command_v)
    # Set-points have deadlines: collecting all objects that exist before the run would take 100 ms or more.
    gc.freeze()
    try:
        if set_points is not None:
            instrument.follow(set_points.samples, set_points.hold_v)
        _raise_if_cancelled(cancelled)
        instrument.arm(limits)
        planned = run = instrument.start()
        if started is not None:
            started(run)
        last, whole, seen_to = run.first_index, True, run.first_index
        while last < run.end_index:
            samples = instrument.poll(POLL_S)
            if samples.size:
                last = int(samples["index"][-1]) + 1
                inside = samples[(samples["index"] >= run.first_index) & (samples["index"] < run.end_index)]
                whole = whole and not is_not_played(inside).any()
                received = inside["index"][np.isfinite(inside["position"])]
                seen_to = int(received[-1]) + 1 if received.size else seen_to
                if set_points is not None:
                    set_points.take(inside)
                    if run is planned and last < run.end_index:  # a device that stalled may resume after the end
                        set_points.send_due(instrument)
                on_samples(inside, min(1.0, (last - run.first_index) / run.samples))
            _raise_if_cancelled(cancelled)
            if run is planned and last < run.end_index and enough():
                run = Run(run.first_index, min(run.samples, instrument.finish()))
        if set_points is not None or run is not planned or not whole or seen_to < run.end_index:
            _drain_release(instrument, run, all_seen=seen_to >= run.end_index)
    except BaseException:
        instrument.release()
        raise
    finally:
        gc.unfreeze()
    return run


def _raise_if_cancelled(cancelled: Callable[[], bool]) -> None:
    if cancelled():
        raise CancelledError(CANCELLED)


def _drain_release(instrument: Instrument, run: Run, *, all_seen: bool) -> None:
    """Poll until the release of a run is over, so that late faults and late samples of the run are received.

    Raises:
        FirmwareFaultError: the run ended with a fault that was reported after the last sample.
        InstrumentError: not ``all_seen``: the last samples never arrived.
    """
    over = run.end_index + round(_RELEASE_S * instrument.device.sample_rate_hz)
    at_last = False
    try:
        for _ in range(_RELEASE_POLLS):
            samples = instrument.poll(POLL_S)
            if at_last:
                break
            at_last = bool(samples.size and samples["index"][-1] >= over)  # a fault is raised by the next poll
    except LinkLostError:
        if not all_seen:
            raise
        # The whole run was received; the error is raised at the next use of the instrument.
