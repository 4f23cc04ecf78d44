"""The watch over a run: by every sample and STATUS that arrives, whether it goes on, has ended, or must end."""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tissueid.device import DeviceDescription
from tissueid.errors import FirmwareFaultError, InstrumentError, TissueIDError
from tissueid.instrument.answers import Status, describe_faults
from tissueid.instrument.handshake import Introduction
from tissueid.instrument.interface import Run, not_played
from tissueid.instrument.judge import Judge
from tissueid.instrument.limits import Limits
from tissueid.instrument.sample_stream import MAX_GAP_S, SampleStream
from tissueid.wire import Fault, Flag, State

log = logging.getLogger(__name__)

FREE_S = 0.1
"""Twice the soft release: so long after a run the coil must be free."""

UNTOLD_S = 0.06
"""So long after a run whose last samples were lost the device has to say whether it played them."""

STOPPED = "the instrument stopped the test by itself; the coil is free: measure again"
CONTRADICTION = "the instrument contradicts itself about which samples it played: connect again, or update its firmware"


class RunWatch:
    """Judges what arrives, and sends nothing itself but, by ``ask_status``, the question how the device is.

    ``limits`` are those of the test that is armed or running, ``run`` the one that runs; without ``limits`` the coil
    has to be free. ``error`` is the first thing that went wrong, ``stop_due`` says that the coil is to be released as
    soon as the frames that came together are read. ``finishing`` says that the run may end early because it was asked
    to. ``ended`` is called whenever a run is over, however it ended.
    """

    def __init__(self, stream: SampleStream, ask_status: Callable[[], None], ended: Callable[[], None]) -> None:
        self.limits: Limits | None = None
        self.run: Run | None = None
        self.error: TissueIDError | None = None
        self.stop_due = self.finishing = False
        self._told: TissueIDError | None = None
        self._stream = stream
        self._ask_status = ask_status
        self._ended = ended
        self._stopped_at: int | None = None
        self._starting: int | None = None
        self._seen_first: int | None = None
        self._earliest = 0
        self._received_to = self._played_to = 0
        self._unseen_end: Run | None = None
        self._free_from = 0

    def begin(self, hello: Introduction) -> None:
        """From now on, for the device that introduced itself so."""
        self.judge = Judge(hello.device)
        self._boot_id = hello.boot_id
        self._reach = round(MAX_GAP_S * hello.device.sample_rate_hz)
        self._free_samples = round(FREE_S * hello.device.sample_rate_hz)
        self._untold_samples = round(UNTOLD_S * hello.device.sample_rate_hz)

    def expect(self, samples: int) -> None:
        """START is about to be sent for so many samples: its answer may come after the first of them."""
        self._stopped_at = None
        self._starting, self._seen_first = samples, None
        self._earliest = self._stream.next_index or 0
        self._unseen_end = None

    def answered(self) -> None:
        """START was answered, or will not be."""
        self._starting = None

    def started(self, run: Run) -> None:
        """Believe the device that this run began.

        Raises:
            InstrumentError: it cannot have: samples that arrived say otherwise.
        """
        latest = self._seen_first if self._seen_first is not None else (self._stream.next_index or 0) + self._reach
        if not self._earliest <= run.first_index <= latest:
            raise InstrumentError(CONTRADICTION)
        self._played_to = run.first_index
        if self.limits is not None:
            self.run = run

    def cut(self, played: int) -> None:
        """Believe the device that the run was ended early, after so many of its samples.

        Raises:
            InstrumentError: it cannot have been: more of them arrived, or fewer were asked for.
        """
        if self.run is None:
            self.end()
        elif self._played_to - self.run.first_index <= played <= self.run.samples:
            self.run = Run(self.run.first_index, played)
        else:
            raise InstrumentError(CONTRADICTION)

    def end(self) -> None:
        """Nothing is running any more."""
        self.run = None
        self.limits = None
        self.expect_a_free_coil()
        self._ended()

    def expect_a_free_coil(self) -> None:
        """From now on the coil is free, but for the soft release of a run that has just ended."""
        self._free_from = (self._stream.next_index or 0) + self._free_samples

    def fail(self, error: TissueIDError) -> None:
        """Something went wrong, and the run is over. Only the first of several is remembered."""
        if self.error is None:
            self.error = error
            self.end()

    def untold(self) -> TissueIDError | None:
        """What went wrong and has not been raised yet; from now on it has."""
        untold = None if self.error is self._told else self.error
        self._told = self.error
        return untold

    def take(
        self, read: NDArray[np.void], calibrated: tuple[NDArray[np.void], DeviceDescription] | None = None
    ) -> None:
        """Judge samples, shape (k,), as they were read and as they are corrected; see whether they end the run.

        Raises:
            LimitError, InstrumentError: ``stop_due``: a sample breaks a limit, or cannot be.
        """
        self._see_whether_it_is_told(int(read["index"][-1]))
        run = self.run or self._begun(read)
        try:
            self.judge.take(read, self.limits, run, calibrated)
        except TissueIDError:
            self.stop_due = True
            raise
        energised = read["index"][(read["flags"] & Flag.ENERGISED) > 0]
        if self.limits is None:
            if energised.size and energised[-1] >= self._free_from:
                self._free_again("its samples show it")
        elif self.run is not None:
            self._see_whether_it_plays(read, self.run)

    def _see_whether_it_plays(self, read: NDArray[np.void], run: Run) -> None:
        """A run of which a sample was not played has been stopped, even where the rest was sampled to its end.

        Raises:
            InstrumentError: samples were played that are none of the run, or after it was stopped; ``stop_due``.
        """
        inside = (read["index"] >= run.first_index) & (read["index"] < run.end_index) & np.isfinite(read["position"])
        idle = inside & not_played(read)
        if inside.any():
            self._received_to = int(read["index"][inside][-1]) + 1
        played = (read["flags"] & Flag.PLAYING) > 0
        if not self.finishing and self._stopped_at is None and idle.any():
            self._stopped_at = int(read["index"][idle][0])
        if played.any():
            self._played_to = int(read["index"][played][-1]) + 1
            stopped_at = run.end_index if self._stopped_at is None else self._stopped_at
            if np.any(played & ~inside) or self._played_to > stopped_at:
                self.stop_due = True
                raise InstrumentError(CONTRADICTION)
        over = read["index"][-1] >= run.end_index
        if self._stopped_at is not None and over:
            self.fail(FirmwareFaultError(STOPPED))
        elif self._stopped_at is not None:
            self._ask_status()  # the message that says why was lost, and its repetition may be: with every frame
        elif over:
            self.end()
            if self._received_to < run.end_index:
                self._unseen_end = run
                self._ask_status()

    def _see_whether_it_is_told(self, newest: int) -> None:
        """A run whose last samples were lost was played to its end only where the device says so."""
        run = self._unseen_end
        if run is None or newest < run.end_index + self._untold_samples:
            if run is not None:
                self._ask_status()
            return
        self._unseen_end = None
        missing = run.end_index - max(run.first_index, self._received_to)
        self.fail(
            InstrumentError(
                f"the last {missing} samples of the test never arrived, and nobody knows whether they were played: "
                "check the cable, then measure again"
            )
        )

    def _end_is_told(self, status: Status, run: Run) -> None:
        """What the device says of a run whose last samples were lost."""
        self._unseen_end = None
        if status.faults:
            self.fail_by_fault(status.faults)
        elif status.state is not State.ARMED and status.played_samples < run.samples:
            self.fail(FirmwareFaultError(STOPPED))

    def take_status(self, status: Status, sample_index: int) -> None:
        """See whether what the device says of itself, at that sample, ends the run."""
        if status.boot_id != self._boot_id:
            self.fail(FirmwareFaultError("the instrument restarted by itself; the coil is free. Connect again"))
        elif self._unseen_end is not None and sample_index >= self._unseen_end.end_index:
            self._end_is_told(status, self._unseen_end)
        elif self.limits is not None and status.faults:
            self.fail_by_fault(status.faults)
        elif self.run is not None and self._stopped_at is not None and status.state is not State.RUNNING:
            self.fail(FirmwareFaultError(STOPPED))
        elif self.limits is None and status.state is State.RUNNING and sample_index >= self._free_from:
            self._free_again("it says so")

    def fail_by_fault(self, faults: Fault) -> None:
        """The firmware has released the coil, and says why."""
        self.fail(FirmwareFaultError(f"the instrument released the coil: {describe_faults(faults)}"))

    def _begun(self, samples: NDArray[np.void]) -> Run | None:
        """The run that these samples, shape (k,), show to have begun, while the answer to START is waited for."""
        if self._starting is None:
            return None
        playing = samples["index"][(samples["flags"] & Flag.PLAYING) > 0]
        if self._seen_first is None and playing.size:
            self._seen_first = int(playing[0])
        return None if self._seen_first is None else Run(self._seen_first, self._starting)

    def _free_again(self, why: str) -> None:
        """The coil is on although no run is: whatever kept it on, it is to be free."""
        log.warning("the coil is on although nothing runs (%s): released again", why)
        self.stop_due = True
