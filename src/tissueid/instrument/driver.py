"""Driver of a device on a link: handshake, requests with retries, decoding, heartbeat, limits, gaps."""

from __future__ import annotations

import contextlib
import logging
import time
import weakref
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

import tissueid.wire as wire
from tissueid.device import DeviceDescription
from tissueid.errors import InstrumentError, LinkLostError, TissueIDError
from tissueid.instrument.frame_receiver import FrameReceiver
from tissueid.instrument.handshake import Handshake, parse_hello
from tissueid.instrument.interface import (
    SIGNALS,
    Corrections,
    Observer,
    Run,
    calibration_while_running,
    check_corrections,
    checked_descriptions,
    corrected,
    nothing_loaded,
    stage_while_running,
    unexpected_set_points,
)
from tissueid.instrument.limits import Limits, check_command, check_limits, check_stimulus
from tissueid.instrument.link import Link
from tissueid.instrument.replies import Status
from tissueid.instrument.requests import (
    ANSWER_S,
    TRIES,
    RequestChannel,
    send_following,
    send_hello,
    send_limits,
    send_setpoints,
    send_stage,
    send_stimulus,
)
from tissueid.instrument.run_monitor import RunMonitor
from tissueid.instrument.sample_stream import SampleStream
from tissueid.instrument.setpoints import SetpointSender
from tissueid.messages import Message
from tissueid.wire import MessageType, State

log = logging.getLogger(__name__)

_Reply = TypeVar("_Reply")

OVERDUE_SHARE, OVERDUE_S = 1.25, 5.0
"""Maximum duration of a run by the host's clock: factor on its nominal duration, plus seconds. The clock of a device
deviates by at most 10 %; a simulated device stalls while its computer is busy.
"""

STOP_TRIES = 3
"""Attempts of STOP if the request before it was not answered; twice as many if it was."""
_PUMP_S = 0.02
_HELLO_PUMP_S = 0.05


_Arguments = ParamSpec("_Arguments")


def _weakly(method: Callable[_Arguments, object]) -> Callable[_Arguments, None]:
    """Return a caller of a method for a part of its object, which would else keep the object alive after its use."""
    reference = weakref.WeakMethod(method)

    def call(*arguments: _Arguments.args, **named: _Arguments.kwargs) -> None:
        alive = reference()
        if alive is not None:
            alive(*arguments, **named)

    return call


class SerialInstrument:
    """Instrument on a link. Opening it performs the handshake and starts the stream of samples.

    Args:
        link: byte stream from and to the device; closed with the instrument.
        clock: monotonic time, s.

    Raises:
        ProtocolVersionError: the firmware uses other versions of the protocol.
        LinkLostError: no answer.
    """

    def __init__(self, link: Link, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._stream = SampleStream()
        self.gaps = self._stream.gaps
        self.observer: Observer | None = None
        self.link = link
        self._clock = clock
        self._monitor = RunMonitor(self._stream, _weakly(self._ask_status), _weakly(self._run_ended))
        self._channel = RequestChannel(link, clock, _weakly(self._pump), self._monitor.take_error)
        self._corrections: Corrections = {}
        self._command = np.zeros(0)
        self._following = 0
        self._hold_v = 0.0
        self._overdue_s = self._overdue_at = 0.0
        self._sender = SetpointSender(link.write, clock)
        self._receiver = FrameReceiver(
            link.name, clock, self._stream, self._monitor, self._sender, self._channel.on_ack
        )
        self._stimulus_id = 0
        self._closed = False
        self._watchdog_s: float | None = None
        try:
            self._handshake = self._shake_hands()
            self._watchdog_s = self._handshake.watchdog_s
            self.device = self.nominal = self._handshake.device
            self._monitor.begin(self._handshake)
            self._channel.request(MessageType.CLEAR_FAULTS)
            self._channel.request(MessageType.RELEASE)
            self._channel.silent = False
            self._channel.request(MessageType.STREAM, wire.pack(wire.STREAM, on=1))
            self._stream.begin(self._handshake)
            self._receiver.stream_begins()
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
        self._receiver.calibrated = None if device is self.nominal else (self._corrections, device)
        self.device = device

    def load(self, command_v: NDArray[np.float64]) -> None:
        """Send a stimulus, shape (n,), V. Each chunk is acknowledged, and repeated if lost.

        Raises:
            LimitError: a voltage is outside the range of the converter.
            InstrumentError: the firmware rejects the stimulus.
        """
        codes = self._handshake.codes(command_v)
        self._wait_for_release()
        self._stimulus_id += 1
        self._following = 0
        send_stimulus(self._channel, self._stimulus_id, codes)
        self._command = np.asarray(command_v, np.float64)

    def follow(self, samples: int, hold_v: float) -> None:
        """Announce ``samples`` set-points that will be sent during the next run, after the loaded stimulus.

        Raises:
            LimitError: ``hold_v`` is outside the range of the converter.
            InstrumentError: nothing is loaded, there are too many set-points, or the firmware is too old.
        """
        if not self._command.size:
            raise nothing_loaded()
        hold = self._handshake.codes(np.array([hold_v]))
        self._wait_for_release()
        send_following(self._channel, self._stimulus_id, samples, int(hold[0]))
        self._following, self._hold_v = samples, hold_v

    def send(self, offset: int, command_v: NDArray[np.float64]) -> None:
        """Send set-points, shape (k,), V, for the samples of the run from ``offset``, after checking them.

        Raises:
            LimitError: a limit would be exceeded; none is sent.
            InstrumentError: these set-points were not announced by ``follow``.
        """
        if self._monitor.error is not None:
            return  # the next poll raises the error
        first, end = self._command.size, offset + command_v.size
        if self._monitor.limits is None or not first <= offset < end <= first + self._following:
            raise unexpected_set_points(offset, end)
        for description in checked_descriptions(self.nominal, self.device):
            check_command(command_v, description, self._monitor.limits)
        self._monitor.checks.expect_command(command_v)
        send_setpoints(self._channel, self._sender, self._token, offset, self._handshake.codes(command_v))

    def effective_limits(self, limits: Limits) -> Limits:
        """Return ``limits``, reduced to the fixed limits of the instrument."""
        return self._handshake.effective_limits(limits)

    def arm(self, limits: Limits) -> None:
        """Set the limits of the next run, here and in the firmware, reduced to the fixed limits of the device.

        Raises:
            LimitError: the stimulus would exceed them, or the coil is already too hot.
            InstrumentError: the temperature sensor gives no usable reading.
            TissueIDError: the error of the run before was not cleared.
        """
        if self._monitor.error is not None:
            raise self._monitor.error
        check_limits(limits, self.nominal)
        limits = self.effective_limits(limits)
        for description in checked_descriptions(self.nominal, self.device):
            check_stimulus(self._command, description, limits, self._following)
            if self._following:
                check_command(np.array([self._hold_v]), description, limits)
        self._expect_samples()
        newest = self._stream.newest
        self._monitor.checks.arm(np.zeros(0) if newest is None else newest["temperature"], limits)
        self._monitor.checks.expect_command(np.append(self._command, self._hold_v if self._following else 0.0))
        self._token = (self._stimulus_id << 8) ^ (self._channel.next_number() & 0xFF) ^ 0x5EED0000
        self._channel.send_heartbeat(force=True)
        send_limits(self._channel, self._token, self._stimulus_id, limits, self.device.sample_rate_hz)
        self._monitor.limits = limits
        self._sender.reset()
        self._receiver.forget_run()

    def start(self) -> Run:
        """Energise the coil and play.

        Raises:
            LinkLostError: no answer; the coil is released.
            InstrumentError: the answer contradicts the samples; the coil is released.
            TissueIDError: the firmware refuses, or a sample exceeded a limit before the answer came.
        """
        samples = self._command.size + self._following
        self._channel.send_heartbeat(force=True)
        self._monitor.expect_start(samples)
        try:
            run = Run(self._channel.request(MessageType.START, wire.pack(wire.START, token=self._token)), samples)
        except LinkLostError:
            self.release()  # the answers were lost; START may have arrived
            raise
        finally:
            self._monitor.end_of_start()
        self._overdue_s = OVERDUE_SHARE * samples / self.device.sample_rate_hz + OVERDUE_S
        self._overdue_at = self._clock() + self._overdue_s
        self._accept(self._monitor.on_started, run)
        if self.status is not None and self.status.faults:
            self._monitor.fail_by_fault(self.status.faults)  # reported before this answer was read
        return run

    def poll(self, timeout_s: float) -> NDArray[np.void]:
        """Return arrived samples, shape (k,) of SAMPLE, each checked on arrival, and send the heartbeat.

        Raises:
            LinkLostError, FirmwareFaultError, LimitError: the coil is released. Samples that arrived before are
                returned first; the next call raises the error.
        """
        monitor = self._monitor
        if monitor.error is None and not self._stream:
            try:
                self._pump(timeout_s)
            except TissueIDError as error:
                monitor.fail(error)
        if monitor.error is None and (refused := self._sender.refused) is not None:
            self.release()
            monitor.fail(refused)
        if monitor.error is not None and not self._stream:
            monitor.take_error()
            if isinstance(monitor.error, LinkLostError):
                raise self._with_watchdog(monitor.error)
            raise monitor.error
        samples = corrected(self._stream.drain(), self._corrections)
        if self.observer is not None and samples.size:
            self.observer(samples)
        return samples

    def finish(self) -> int:
        """End the run now by its soft release, and return the number of samples played.

        Raises:
            InstrumentError: the firmware is too old, or its answer contradicts the samples; then the coil is released.
        """
        self._monitor.finishing = True  # samples after the end may arrive before the answer
        try:
            played = self._channel.request(MessageType.FINISH)
        finally:
            self._monitor.finishing = False
        self._sender.stop()
        self._accept(self._monitor.on_finished, played)
        return played

    def move_stage(self, position_m: float | None) -> bool:
        """Move the fixture on a motorised stage to a position on the actuator, m; None moves it out of reach.

        Return False if the instrument has no stage.

        Raises:
            InstrumentError: a test is armed or running, or the stage cannot move there.
        """
        if self._busy():
            raise stage_while_running()
        self._wait_for_release()
        return send_stage(self._channel, position_m)

    def release(self) -> None:
        """Release the coil now. No heartbeat is sent until the firmware confirms the release.

        If it does not confirm, its watchdog releases the coil, and the next poll raises LinkLostError.
        """
        self._monitor.end()
        try:
            self._channel.stop(STOP_TRIES * self._last_tries())
        except LinkLostError as error:
            log.warning("%s", error)
            self._monitor.fail(error)
        self._monitor.stop_due = False
        self._monitor.expect_a_free_coil()  # samples from before the release have arrived by now

    def clear_faults(self) -> None:
        """Clear the latched faults and the error of the failed run. The next test must be armed again.

        Raises:
            LinkLostError: a release was not confirmed; connect again.
        """
        if self._channel.lost is not None:
            raise self._channel.lost
        self._monitor.error = None
        self._channel.request(MessageType.CLEAR_FAULTS)

    def close(self) -> None:
        """Release the coil, end the stream and close the port."""
        if self._closed:
            return
        self._closed = True
        if isinstance(self._monitor.error, LinkLostError):
            # The other direction of the link may still work.
            with contextlib.suppress(TissueIDError):
                self._channel.send(MessageType.STOP)
        else:
            self.release()
            try:
                self._channel.request(MessageType.STREAM, wire.pack(wire.STREAM, on=0), tries=self._last_tries())
            except TissueIDError as error:
                log.info("the stream was not ended: %s", error)
        self.link.close()

    def __enter__(self) -> SerialInstrument:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def statistics(self) -> wire.FrameStatistics:
        """Frames accepted and refused since the link was opened."""
        return self._receiver.statistics

    @property
    def status(self) -> Status | None:
        """The newest STATUS; None before the first."""
        return self._receiver.status

    @property
    def late_blocks(self) -> int:
        """Blocks of set-points of the newest run that arrived too late."""
        return self._receiver.late_blocks

    @property
    def held_samples(self) -> int:
        """Samples of the newest run that were held because their set-point was missing."""
        return self._receiver.held_samples

    @property
    def repeated_requests(self) -> int:
        """Attempts of requests after the first, because no answer came."""
        return self._channel.repeated

    @property
    def round_trip_s(self) -> float | None:
        """Median time from a request to its answer over the newest requests, s; None before the first."""
        times = self._channel.round_trips_s
        return float(np.median(times)) if times else None

    @property
    def setpoint_margin_s(self) -> float | None:
        """Least time between arrival and playing of a block of set-points of the newest run, s; None without."""
        margin = self._sender.margin_samples
        return None if margin is None else margin / self.device.sample_rate_hz

    def _accept(self, accept: Callable[[_Reply], None], reply: _Reply) -> None:
        """Pass a reply about a run to the monitor.

        Raises:
            InstrumentError: it contradicts the samples; the coil is released.
        """
        try:
            accept(reply)
        except InstrumentError as error:
            self._monitor.fail(error)
            self.release()
            self._monitor.take_error()
            raise

    def _busy(self) -> bool:
        """Return whether a test is armed or running. A run whose last sample has arrived ends with its soft release."""
        last = self._stream.next_index
        if self._monitor.run is not None and last is not None and last >= self._monitor.run.end_index:
            self._wait_for_release()
            self._monitor.end()
        return self._monitor.limits is not None

    def _wait_for_release(self) -> None:
        """Wait until the soft release after a run has ended."""
        deadline = self._clock() + ANSWER_S
        while self.status is not None and self.status.state is State.RUNNING and self._clock() < deadline:
            self._channel.send(MessageType.STATUS_REQUEST)
            self._pump(_PUMP_S)

    # -- requests -----------------------------------------------------------------------------------------

    def _shake_hands(self) -> Handshake:
        for _ in range(TRIES):
            send_hello(self._channel)
            deadline = self._clock() + ANSWER_S
            while self._receiver.hello is None and self._clock() < deadline:
                try:
                    self._pump(_HELLO_PUMP_S)
                except LinkLostError as error:
                    raise LinkLostError(
                        Message(
                            "link.maybe_in_use",
                            "{why}. Is the instrument in use by another program?",
                            why=error.message,
                        )
                    ) from error
            if self._receiver.hello is not None:
                return parse_hello(self._receiver.hello, self.link.name)
        raise LinkLostError(
            Message(
                "link.no_instrument",
                "no instrument answers on {port}; check the cable and the power, and that no other program uses it",
                port=self.link.name,
            )
        )

    # -- bytes in -----------------------------------------------------------------------------------------

    def _pump(self, timeout_s: float) -> None:
        """Read once and process every complete frame. During a run, heartbeats are sent here only.

        A heartbeat is sent only after new samples passed the checks. Without usable samples the watchdog therefore
        releases the coil.
        """
        try:
            checked = self._receiver.take(self.link.read(timeout_s))
        except LinkLostError as error:
            raise self._with_watchdog(error) from error
        if self._monitor.run is not None and self._clock() > self._overdue_at:
            self._monitor.stop_due = True
            self._monitor.fail(
                InstrumentError(
                    "instrument.overdue",
                    "the test did not end within {seconds:.1f} s as it should: connect again, and measure again",
                    seconds=self._overdue_s,
                )
            )
        if checked and self._monitor.error is None:
            self._channel.send_heartbeat()
        if self._monitor.stop_due and not self._channel.silent:
            self.release()
        if self._monitor.run is not None and self._stream.next_index is not None:
            self._sender.repeat(self._stream.next_index - self._monitor.run.first_index)
        try:
            self._receiver.check_heard()
        except LinkLostError as error:
            raise self._with_watchdog(error) from error

    def _with_watchdog(self, error: LinkLostError) -> LinkLostError:
        """Return the error with the timeout of the watchdog: the coil may still be energised."""
        if self._watchdog_s is None or error.watchdog_s is not None:
            return error
        return LinkLostError(
            Message(
                "link.lost_with_watchdog",
                "{why}. The instrument's own watchdog releases the coil within {seconds:g} s",
                why=error.message,
                seconds=self._watchdog_s,
            ),
            self._watchdog_s,
        )

    def _last_tries(self) -> int:
        """Return the attempts for the last requests on a link: fewer if the newest request was not answered."""
        return 1 if self._channel.unanswered else 2

    def _expect_samples(self) -> None:
        """Wait for new samples, and discard those that arrived while the stimulus was sent.

        These were checked on arrival; returning them would delay the samples of the run.

        Raises:
            LinkLostError: no samples arrive.
        """
        before, deadline = self._stream.next_index, self._clock() + ANSWER_S
        while self._stream.next_index == before and self._monitor.error is None:
            if self._clock() >= deadline:
                raise LinkLostError(
                    Message(
                        "link.no_samples",
                        "no samples arrive from {port}: check the cable, and connect again",
                        port=self.link.name,
                    )
                )
            self._pump(_PUMP_S)
        self._stream.drain()

    def _ask_status(self) -> None:
        self._channel.send(MessageType.STATUS_REQUEST)

    def _run_ended(self) -> None:
        """End the set-points: they are announced for one run only."""
        self._following = 0
        self._sender.stop()
