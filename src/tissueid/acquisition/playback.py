"""Playback of one stimulus: load, arm, poll to the end, and release the coil on every error."""

from __future__ import annotations

import gc
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from tissueid.acquisition.set_points import SetPoints
from tissueid.errors import CancelledError, LinkLostError
from tissueid.instrument import Instrument, Limits, Run, is_not_played
from tissueid.messages import Message

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
