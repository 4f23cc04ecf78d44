"""Monitor of a run: decides from arriving samples and STATUS messages whether it continues, has ended or must end."""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tissueid.device import DeviceDescription
from tissueid.errors import FirmwareFaultError, InstrumentError, TissueIDError
from tissueid.instrument.handshake import Handshake
from tissueid.instrument.interface import Run
from tissueid.instrument.limits import Limits
from tissueid.instrument.replies import Status, released_by_faults
from tissueid.instrument.sample_monitor import SampleMonitor
from tissueid.instrument.sample_stream import MAX_GAP_S, SampleStream
from tissueid.messages import Message
from tissueid.wire import Fault, Flag, State

log = logging.getLogger(__name__)

_PLAYING, _ENERGISED = int(Flag.PLAYING), int(Flag.ENERGISED)

FREE_S = 0.1
"""Time after the end of a run until the coil must be free, s: twice the soft release."""

UNSEEN_END_S = 0.06
"""Time that the device has to report whether it played the last samples of a run, if these were lost, s."""

STOPPED = Message("instrument.stopped", "the instrument stopped the test by itself; the coil is free: measure again")
CONTRADICTION = Message(
    "instrument.contradiction",
    "the instrument contradicts itself about which samples it played: connect again, or update its firmware",
)


class RunMonitor:
    """Checks samples and STATUS messages. Sends nothing but a request for STATUS, by ``ask_status``.

    ``limits`` are those of the armed or running test, ``run`` the running one; without ``limits`` the coil must be
    free. ``error`` is the first failure. ``stop_due`` is true when the coil must be released as soon as the frames that
    arrived together are processed. ``finishing`` is true while the run may end early on request. ``ended`` is called
    at the end of every run.
    """

    def __init__(self, stream: SampleStream, ask_status: Callable[[], None], ended: Callable[[], None]) -> None:
        self.limits: Limits | None = None
        self.run: Run | None = None
        self.error: TissueIDError | None = None
        self.stop_due = self.finishing = False
        self._raised: TissueIDError | None = None
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

    def begin(self, hello: Handshake) -> None:
        """Begin monitoring the device of this handshake."""
        self.checks = SampleMonitor(hello.device)
        self._boot_id = hello.boot_id
        self._reach = round(MAX_GAP_S * hello.device.sample_rate_hz)
        self._free_samples = round(FREE_S * hello.device.sample_rate_hz)
        self._unseen_end_samples = round(UNSEEN_END_S * hello.device.sample_rate_hz)

    def expect_start(self, samples: int) -> None:
        """Expect the first samples of a run of this length, possibly before the answer to its START."""
        self._stopped_at = None
        self._starting, self._seen_first = samples, None
        self._earliest = self._stream.next_index or 0
        self._unseen_end = None

    def end_of_start(self) -> None:
        """Stop waiting for the answer to START."""
        self._starting = None

    def on_started(self, run: Run) -> None:
        """Accept the device's answer that this run began.

        Raises:
            InstrumentError: the answer contradicts the samples that arrived.
        """
        latest = self._seen_first if self._seen_first is not None else (self._stream.next_index or 0) + self._reach
        if not self._earliest <= run.first_index <= latest:
            raise InstrumentError(CONTRADICTION)
        self._played_to = run.first_index
        if self.limits is not None:
            self.run = run

    def on_finished(self, played: int) -> None:
        """Accept the device's answer that the run ended early after ``played`` of its samples.

        Raises:
            InstrumentError: more samples arrived, or the run has fewer.
        """
        if self.run is None:
            self.end()
        elif self._played_to - self.run.first_index <= played <= self.run.samples:
            self.run = Run(self.run.first_index, played)
        else:
            raise InstrumentError(CONTRADICTION)

    def end(self) -> None:
        """End the run, if one is armed or running."""
        self.run = None
        self.limits = None
        self.expect_a_free_coil()
        self._ended()

    def expect_a_free_coil(self) -> None:
        """Require a free coil from now on, except during the soft release of a run that has just ended."""
        self._free_from = (self._stream.next_index or 0) + self._free_samples

    def fail(self, error: TissueIDError) -> None:
        """End the run with an error. Only the first of several errors is kept."""
        if self.error is None:
            self.error = error
            self.end()

    def take_error(self) -> TissueIDError | None:
        """Return the error if it has not been raised yet, and mark it as raised; else None."""
        error = None if self.error is self._raised else self.error
        self._raised = self.error
        return error

    def take(
        self, read: NDArray[np.void], calibrated: tuple[NDArray[np.void], DeviceDescription] | None = None
    ) -> None:
        """Check samples, shape (k,), as read and as corrected, and whether they end the run.

        Raises:
            LimitError, InstrumentError: a sample exceeds a limit or is implausible; ``stop_due`` is set.
        """
        self._check_unseen_end(int(read["index"][-1]))
        run = self.run or self._run_begun(read)
        try:
            self.checks.check(read, self.limits, run, calibrated)
        except TissueIDError:
            self.stop_due = True
            raise
        if self.limits is None:
            energised = read["index"][(read["flags"] & _ENERGISED) > 0]
            if energised.size and energised[-1] >= self._free_from:
                self._release_again("its samples show it")
        elif self.run is not None:
            self._check_playing(read, self.run)

    def _check_playing(self, read: NDArray[np.void], run: Run) -> None:
        """Check which samples were played. A run with an idle sample inside was stopped by the device.

        Raises:
            InstrumentError: samples outside the run, or after its stop, were played; ``stop_due`` is set.
        """
        index = read["index"]
        inside = (index >= run.first_index) & (index < run.end_index) & np.isfinite(read["position"])
        played = (read["flags"] & _PLAYING) > 0
        if inside.any():
            self._received_to = int(index[inside][-1]) + 1
        if not self.finishing and self._stopped_at is None:
            idle = inside & ~played
            if idle.any():
                self._stopped_at = int(index[idle][0])
        if played.any():
            self._played_to = int(index[played][-1]) + 1
            stopped_at = run.end_index if self._stopped_at is None else self._stopped_at
            if (played & ~inside).any() or self._played_to > stopped_at:
                self.stop_due = True
                raise InstrumentError(CONTRADICTION)
        over = index[-1] >= run.end_index
        if self._stopped_at is not None and over:
            self.fail(FirmwareFaultError(STOPPED))
        elif self._stopped_at is not None:
            self._ask_status()  # the STATUS with the reason was lost; ask with every frame, as answers may be lost too
        elif over:
            self.end()
            if self._received_to < run.end_index:
                self._unseen_end = run
                self._ask_status()

    def _check_unseen_end(self, newest: int) -> None:
        """Fail a run whose last samples were lost if the device does not report in time that it played them."""
        run = self._unseen_end
        if run is None or newest < run.end_index + self._unseen_end_samples:
            if run is not None:
                self._ask_status()
            return
        self._unseen_end = None
        missing = run.end_index - max(run.first_index, self._received_to)
        self.fail(
            InstrumentError(
                "instrument.end_unseen",
                "the last {missing} samples of the test never arrived, and it is unknown whether they were played: "
                "check the cable, then measure again",
                missing=missing,
            )
        )

    def _end_by_status(self, status: Status, run: Run) -> None:
        """End a run whose last samples were lost by what the device reports of it."""
        self._unseen_end = None
        if status.faults:
            self.fail_by_fault(status.faults)
        elif status.state is not State.ARMED and status.played_samples < run.samples:
            self.fail(FirmwareFaultError(STOPPED))

    def take_status(self, status: Status, sample_index: int) -> None:
        """Check whether the STATUS at a sample ends the run."""
        if status.boot_id != self._boot_id:
            self.fail(
                FirmwareFaultError(
                    Message(
                        "instrument.restarted", "the instrument restarted by itself; the coil is free. Connect again"
                    )
                )
            )
        elif self._unseen_end is not None and sample_index >= self._unseen_end.end_index:
            self._end_by_status(status, self._unseen_end)
        elif self.limits is not None and status.faults:
            self.fail_by_fault(status.faults)
        elif self.run is not None and self._stopped_at is not None and status.state is not State.RUNNING:
            self.fail(FirmwareFaultError(STOPPED))
        elif self.limits is None and status.state is State.RUNNING and sample_index >= self._free_from:
            self._release_again("its STATUS shows it")

    def fail_by_fault(self, faults: Fault) -> None:
        """End the run because the firmware released the coil."""
        self.fail(released_by_faults(faults))

    def _run_begun(self, samples: NDArray[np.void]) -> Run | None:
        """Return the run that these samples, shape (k,), show to have begun while the answer to START is awaited."""
        if self._starting is None:
            return None
        playing = samples["index"][(samples["flags"] & _PLAYING) > 0]
        if self._seen_first is None and playing.size:
            self._seen_first = int(playing[0])
        return None if self._seen_first is None else Run(self._seen_first, self._starting)

    def _release_again(self, why: str) -> None:
        """Release a coil that is energised although no run is armed."""
        log.warning("the coil is on although nothing runs (%s): released again", why)
        self.stop_due = True
