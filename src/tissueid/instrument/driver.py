"""Driver of a device on a link: the loop around the state machine of a run, and its calls for the program."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

import tissueid.wire as wire
from tissueid.device import DeviceDescription
from tissueid.errors import LinkLostError, TissueIDError
from tissueid.instrument import run_machine as machine
from tissueid.instrument.handshake import parse_hello
from tissueid.instrument.interface import (
    SIGNALS,
    Corrections,
    Gap,
    Observer,
    Run,
    calibration_while_running,
    check_corrections,
    corrected,
    join_blocks,
    stage_while_running,
)
from tissueid.instrument.limits import Limits
from tissueid.instrument.link import Link
from tissueid.instrument.replies import Status
from tissueid.instrument.run_machine import ANSWER_S, STAGE_TRIES, TRIES, Mode, RunEvent, RunState
from tissueid.messages import Message
from tissueid.wire import MessageType, Result, State

log = logging.getLogger(__name__)

_PUMP_S = 0.02
_HELLO_PUMP_S = 0.05


class SerialInstrument:
    """Instrument on a link. Opening it performs the handshake and starts the stream of samples.

    ``state`` is the state of the machine (:mod:`tissueid.instrument.run_machine`), readable for diagnostics.

    Args:
        link: byte stream from and to the device; closed with the instrument.
        clock: monotonic time, s.

    Raises:
        ProtocolVersionError: the firmware uses other versions of the protocol.
        LinkLostError: no answer.
    """

    def __init__(self, link: Link, *, clock: Callable[[], float] = time.monotonic) -> None:
        self.link = link
        self.state = RunState(link.name, heartbeat_s=clock())
        self.gaps: list[Gap] = []
        self.observer: Observer | None = None
        self._clock = clock
        self._decoder = wire.FrameDecoder()
        self._ready: list[NDArray[np.void]] = []
        self._answer: machine.GiveAnswer | None = None
        self._hello: bytes | None = None
        self._raised: TissueIDError | None = None
        self._corrections: Corrections = {}
        self._closed = False
        try:
            self._shake_hands()
            self.device = self.nominal = self.state.nominal
            for kind in (MessageType.RELEASE, MessageType.CLEAR_FAULTS):
                self._request(kind)
            self._request(MessageType.STREAM, wire.pack(wire.STREAM, on=1))
        except BaseException:
            link.close()
            raise

    # -- the Instrument interface -------------------------------------------------------------------------

    def use_calibration(self, device: DeviceDescription, corrections: Corrections) -> None:
        """Use the device description and channel corrections of a calibration.

        Raises:
            InstrumentError: a test is armed or running, or a channel does not exist.
        """
        if self._busy():
            raise calibration_while_running()
        self._corrections = check_corrections(corrections, SIGNALS)
        self._do(machine.CalibrationChosen(self._clock(), device, self._corrections))
        self.device = device

    def load(self, command_v: NDArray[np.float64]) -> None:
        """Send a stimulus, shape (n,), V. Each chunk is acknowledged, and repeated if lost.

        Raises:
            LimitError: a voltage is outside the range of the converter.
            InstrumentError: the firmware rejects the stimulus.
        """
        self._wait_for_release()
        self._ask(machine.LoadAsked(self._clock(), np.asarray(command_v, np.float64)))

    def follow(self, samples: int, hold_v: float) -> None:
        """Announce ``samples`` set-points that will be sent during the next run, after the loaded stimulus.

        Raises:
            LimitError: ``hold_v`` is outside the range of the converter.
            InstrumentError: nothing is loaded, there are too many set-points, or the firmware is too old.
        """
        self._wait_for_release()
        self._ask(machine.FollowAsked(self._clock(), samples, hold_v))

    def send(self, offset: int, command_v: NDArray[np.float64]) -> None:
        """Send set-points, shape (k,), V, for the samples of the run from ``offset``, after checking them.

        Raises:
            LimitError: a limit would be exceeded; none is sent.
            InstrumentError: these set-points were not announced by ``follow``.
        """
        self._answer = None
        self._do(machine.SetPointsGiven(self._clock(), offset, command_v))
        if self._answer is not None and self._answer.error is not None:
            raise self._answer.error

    def effective_limits(self, limits: Limits) -> Limits:
        """Return ``limits``, reduced to the fixed limits of the instrument."""
        return self.state.effective_limits(limits)

    def arm(self, limits: Limits) -> None:
        """Set the limits of the next run, here and in the firmware, reduced to the fixed limits of the device.

        Raises:
            LimitError: the stimulus would exceed them, or the coil is already too hot.
            InstrumentError: the temperature sensor gives no usable reading.
            TissueIDError: the error of the run before was not cleared.
        """
        if self.state.error is None:
            self._expect_samples()
        self._ask(machine.ArmAsked(self._clock(), limits))

    def start(self) -> Run:
        """Energise the coil and play.

        Raises:
            LinkLostError: no answer; the coil is released.
            InstrumentError: the answer contradicts the samples; the coil is released.
            TissueIDError: the firmware refuses, or a sample exceeded a limit before the answer came.
        """
        samples = self.state.command_v.size + self.state.following
        return Run(self._ask(machine.StartAsked(self._clock())).detail, samples)

    def poll(self, timeout_s: float) -> NDArray[np.void]:
        """Return arrived samples, shape (k,) of SAMPLE, each checked on arrival, and send the heartbeat.

        Raises:
            LinkLostError, FirmwareFaultError, LimitError: the coil is released. Samples that arrived before are
                returned first; the next call raises the error.
        """
        if self.state.error is None and not self._ready:
            self.pump(timeout_s)
        if self.state.error is not None and not self._ready:
            self._raised = self.state.error
            raise self.state.error
        samples = corrected(join_blocks(self._ready), self._corrections)
        self._ready.clear()
        if self.observer is not None and samples.size:
            self.observer(samples)
        return samples

    def finish(self) -> int:
        """End the run now by its soft release, and return the number of samples played.

        Raises:
            InstrumentError: the firmware is too old, or its answer contradicts the samples; then the coil is released.
        """
        return self._ask(machine.FinishAsked(self._clock())).detail

    def move_stage(self, position_m: float | None) -> bool:
        """Move the fixture on a motorised stage to a position on the actuator, m; None moves it out of reach.

        Return False if the instrument has no stage.

        Raises:
            InstrumentError: a test is armed or running, or the stage cannot move there.
        """
        if self._busy():
            raise stage_while_running()
        self._wait_for_release()
        payload = wire.pack(wire.STAGE, position_m=np.nan if position_m is None else position_m)
        answer = self._outcome(machine.RequestAsked(self._clock(), MessageType.STAGE, payload, STAGE_TRIES))
        if answer.error is not None and answer.result != Result.UNKNOWN:
            raise answer.error
        return answer.result == Result.OK

    def release(self) -> None:
        """Release the coil now. No heartbeat is sent until the firmware confirms the release.

        If it does not confirm, its watchdog releases the coil, and the next poll raises LinkLostError.
        """
        self._do(machine.StopAsked(self._clock()))
        self._await_release()

    def clear_faults(self) -> None:
        """Clear the latched faults and the error of the failed run. The next test must be armed again.

        Raises:
            LinkLostError: a release was not confirmed; connect again.
        """
        self._raised = self.state.error
        self._ask(machine.ClearAsked(self._clock()))

    def close(self) -> None:
        """Release the coil, end the stream and close the port."""
        if self._closed:
            return
        self._closed = True
        if isinstance(self.state.error, LinkLostError):
            # The other direction of the link may still work.
            self._do(machine.StopAsked(self._clock()))
        else:
            self.release()
            self._raised = self.state.error
            try:
                tries = 1 if self.state.unanswered else 2
                self._request(MessageType.STREAM, wire.pack(wire.STREAM, on=0), tries)
            except TissueIDError as error:
                log.info("the stream was not ended: %s", error)
        self.link.close()

    def __enter__(self) -> SerialInstrument:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def request_status(self) -> None:
        """Request STATUS; ``status`` changes when it arrives."""
        self._do(machine.StatusAsked(self._clock()))

    @property
    def statistics(self) -> wire.FrameStatistics:
        """Frames accepted and refused since the link was opened."""
        return self._decoder.statistics

    @property
    def status(self) -> Status | None:
        """The newest STATUS; None before the first."""
        return self.state.status

    @property
    def late_blocks(self) -> int:
        """Blocks of set-points of the newest run that arrived too late."""
        return self.state.late_blocks

    @property
    def held_samples(self) -> int:
        """Samples of the newest run that were held because their set-point was missing."""
        return self.state.held_samples

    @property
    def repeated_requests(self) -> int:
        """Attempts of requests after the first, because no answer came."""
        return self.state.repeated_requests

    @property
    def round_trip_s(self) -> float | None:
        """Median time from a request to its answer over the newest requests, s; None before the first."""
        times = self.state.round_trips_s
        return float(np.median(times)) if times else None

    @property
    def setpoint_margin_s(self) -> float | None:
        """Least time between arrival and playing of a block of set-points of the newest run, s; None without."""
        margin = self.state.margin_samples
        return None if margin is None else margin / self.device.sample_rate_hz

    # -- the loop -----------------------------------------------------------------------------------------

    def pump(self, timeout_s: float) -> None:
        """Read once, process every complete frame, and wait for the end of a release that began meanwhile."""
        self._read(timeout_s)
        self._await_release()

    def _await_release(self) -> None:
        while self.state.mode is Mode.RELEASING:
            self._read(_PUMP_S)

    def _read(self, timeout_s: float) -> None:
        try:
            data = self.link.read(timeout_s)
        except LinkLostError as error:
            self._do(machine.PortFailed(self._clock(), error))
            return
        now, refused = self._clock(), self._decoder.statistics.refused
        for frame in self._decoder.feed(data):
            self._do(machine.FrameReceived(now, frame))
        if self._decoder.statistics.refused > refused:
            self._do(machine.BytesRefused(now))
        self._do(machine.ClockTick(now))

    def _do(self, event: RunEvent) -> None:
        """Let an event happen, and carry out the actions that follow from it."""
        self.state, actions = machine.step(self.state, event)
        failed: LinkLostError | None = None
        for action in actions:
            match action:
                case machine.SendFrame() | machine.ReleaseCoil():
                    frame = action.stop if isinstance(action, machine.ReleaseCoil) else action
                    if frame is None or failed is not None:
                        continue
                    try:
                        self.link.write(frame.data)
                    except LinkLostError as error:
                        failed = error
                case machine.DeliverSamples():
                    self._ready.append(action.samples)
                    if action.gap is not None:
                        self.gaps.append(action.gap)
                        log.warning("%d samples lost from sample %d on", action.gap.count, action.gap.first_index)
                case machine.GiveAnswer():
                    self._answer = action
                case machine.Greet():
                    self._hello = action.payload
                case machine.WriteLine():
                    log.warning("%s", action.text)
        if failed is not None:
            self._do(machine.PortFailed(self._clock(), failed))

    # -- requests -----------------------------------------------------------------------------------------

    def _shake_hands(self) -> None:
        for _ in range(TRIES):
            self._do(machine.HelloAsked(self._clock()))
            deadline = self._clock() + ANSWER_S
            while self._hello is None and self.state.error is None and self._clock() < deadline:
                self.pump(_HELLO_PUMP_S)
            if self.state.error is not None:
                raise LinkLostError(
                    Message(
                        "link.maybe_in_use",
                        "{why}. Is the instrument in use by another program?",
                        why=self.state.error.message,
                    )
                ) from self.state.error
            if self._hello is not None:
                self._do(machine.Greeted(self._clock(), parse_hello(self._hello, self.link.name)))
                return
        raise LinkLostError(
            Message(
                "link.no_instrument",
                "no instrument answers on {port}; check the cable and the power, and that no other program uses it",
                port=self.link.name,
            )
        )

    def _request(self, kind: MessageType, payload: bytes = b"", tries: int = TRIES) -> None:
        self._ask(machine.RequestAsked(self._clock(), kind, payload, tries))

    def _ask(self, event: RunEvent) -> machine.GiveAnswer:
        """Ask for something that must succeed, wait for its answer and return it.

        Raises:
            TissueIDError: it is not possible, the device refuses it, or the run failed meanwhile.
        """
        answer = self._outcome(event)
        if answer.error is not None:
            raise answer.error
        return answer

    def _outcome(self, event: RunEvent) -> machine.GiveAnswer:
        """As ``_ask``; an error of the request itself is returned."""
        self._raise_new_error()
        self._answer = None
        self._do(event)
        while self._answer is None:
            self.pump(_PUMP_S)
        answer: machine.GiveAnswer = self._answer
        self._await_release()
        if answer.error is not None:
            self._raise_new_error()
        return answer

    def _raise_new_error(self) -> None:
        """Raise the error of the run, once."""
        error, raised = self.state.error, self._raised
        self._raised = error
        if error is not None and error is not raised:
            raise error

    def _busy(self) -> bool:
        """Return whether a test is armed or running. A run whose last sample has arrived ends with its soft release."""
        run, last = self.state.run, self.state.next_index
        if run is not None and last is not None and last >= run.end_index:
            self._wait_for_release()
        return self.state.limits is not None

    def _wait_for_release(self) -> None:
        """Wait until the soft release after a run has ended."""
        deadline = self._clock() + ANSWER_S
        while self.status is not None and self.status.state is State.RUNNING and self._clock() < deadline:
            self.request_status()
            self.pump(_PUMP_S)

    def _expect_samples(self) -> None:
        """Wait for new samples, and discard those that arrived while the stimulus was sent.

        These were checked on arrival; returning them would delay the samples of the run.

        Raises:
            LinkLostError: no samples arrive.
        """
        before, deadline = self.state.next_index, self._clock() + ANSWER_S
        while self.state.next_index == before or self.state.mode is Mode.UNSEEN_END:
            if self.state.error is not None:
                break
            if self._clock() >= deadline:
                raise LinkLostError(
                    Message(
                        "link.no_samples",
                        "no samples arrive from {port}: check the cable, and connect again",
                        port=self.link.name,
                    )
                )
            self.pump(_PUMP_S)
        self._ready.clear()
