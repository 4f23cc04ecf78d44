"""Playing one stimulus: loading, arming, polling to the end, and letting go whatever goes wrong."""

from __future__ import annotations

import gc
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from tissueid.acquisition.feedback import SetPoints
from tissueid.errors import CancelledError, LinkLostError
from tissueid.instrument import Instrument, Limits, Run, not_played

POLL_S = 0.05
_RELEASE_S = 0.08
"""The ramp of 50 ms at the end of a run, and the frames that tell of it."""
_RELEASE_POLLS = 40


class Phase(Enum):
    """Where a guided test stands."""

    PLACE = "place"
    PRELOAD = "preload"
    STIMULUS = "stimulus"
    RELEASE = "release"


@dataclass(frozen=True)
class Progress:
    """What a running test tells: its phase, how much of the run is played (0 to 1), and the newest samples."""

    phase: Phase
    fraction: float
    samples: NDArray[np.void]


def ignore(_: Progress) -> None:
    """Nobody wants to know."""


def never() -> bool:
    """Nobody wants to stop."""
    return False


def play(
    instrument: Instrument,
    command_v: NDArray[np.float64],
    limits: Limits,
    *,
    started: Callable[[Run], None] | None = None,
    on_samples: Callable[[NDArray[np.void], float], None],
    cancelled: Callable[[], bool] = never,
    set_points: SetPoints | None = None,
    enough: Callable[[], bool] = never,
) -> Run:
    """Play one stimulus, shape (n,), V, and hand over its samples as they come, with the fraction played.

    ``set_points`` follow the stimulus, made from what it measures. ``enough`` is asked after every poll; when it says
    so, the run ends there by a soft release. Returns the run as it was played. Whatever goes wrong, the coil is
    released before the error leaves this function.

    Raises:
        CancelledError: ``cancelled`` said so.
        LimitError, InstrumentError: as the instrument says.
        UnusableInputError: set-points that are none.
    """
    instrument.load(command_v)
    # Set-points have a date to keep: what is there before the run is left out of the garbage collections during it,
    # one of which takes 100 ms and more otherwise.
    gc.freeze()
    try:
        if set_points is not None:
            instrument.follow(set_points.samples, set_points.hold_v)
        _heed(cancelled)
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
                whole = whole and not not_played(inside).any()
                received = inside["index"][np.isfinite(inside["position"])]
                seen_to = int(received[-1]) + 1 if received.size else seen_to
                if set_points is not None:
                    set_points.take(inside)
                    if run is planned and last < run.end_index:  # a device that hung may come back after the end
                        set_points.send_due(instrument)
                on_samples(inside, min(1.0, (last - run.first_index) / run.samples))
            _heed(cancelled)
            if run is planned and last < run.end_index and enough():
                run = Run(run.first_index, min(run.samples, instrument.finish()))
        if set_points is not None or run is not planned or not whole or seen_to < run.end_index:
            _see_off(instrument, run, all_seen=seen_to >= run.end_index)
    except BaseException:
        instrument.release()
        raise
    finally:
        gc.unfreeze()
    return run


def _heed(cancelled: Callable[[], bool]) -> None:
    """Go on only where nobody wants to stop.

    Raises:
        CancelledError: somebody does.
    """
    if cancelled():
        raise CancelledError("cancelled; the coil is released and what was recorded is kept")


def _see_off(instrument: Instrument, run: Run, *, all_seen: bool) -> None:
    """Read on until the release of a run is over: only then has the instrument said all that there is to say of it.

    Raises:
        FirmwareFaultError: it did not end as it was told to; what it says came after the last sample.
        InstrumentError: not ``all_seen``: its last samples never arrived, and it never said that they were played.
    """
    over = run.end_index + round(_RELEASE_S * instrument.device.sample_rate_hz)
    at_last = False
    try:
        for _ in range(_RELEASE_POLLS):
            samples = instrument.poll(POLL_S)
            if at_last:
                break
            at_last = bool(samples.size and samples["index"][-1] >= over)  # what is wrong comes with the next poll
    except LinkLostError:
        if not all_seen:
            raise
        # All of the run was received; whoever uses the instrument next is told.
