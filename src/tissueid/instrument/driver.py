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
from tissueid.instrument.sample_stream import SampleStream, SetpointSender
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

    Its parts (``link``, ``handshake``, ``channel``, ``stream``, ``monitor``, ``sender``) are readable for diagnostics.

    Args:
        link: byte stream from and to the device; closed with the instrument.
        clock: monotonic time, s.

    Raises:
        ProtocolVersionError: the firmware uses other versions of the protocol.
        LinkLostError: no answer.
    """

    def __init__(self, link: Link, *, clock: Callable[[], float] = time.monotonic) -> None:
        self.stream = SampleStream()
        self.gaps = self.stream.gaps
        self.observer: Observer | None = None
        self.link = link
        self._clock = clock
        self.monitor = RunMonitor(self.stream, _weakly(self._ask_status), _weakly(self._run_ended))
        self.channel = RequestChannel(link, clock, _weakly(self.pump), self.monitor.take_error)
        self._corrections: Corrections = {}
        self._command = np.zeros(0)
        self._following = 0
        self._hold_v = 0.0
        self._overdue_s = self._overdue_at = 0.0
        self.sender = SetpointSender(link.write, clock)
        self._receiver = FrameReceiver(link.name, clock, self.stream, self.monitor, self.sender, self.channel.on_ack)
        self._stimulus_id = 0
        self._closed = False
        self._watchdog_s: float | None = None
        try:
            self.handshake = self._shake_hands()
            self._watchdog_s = self.handshake.watchdog_s
            self.device = self.nominal = self.handshake.device
            self.monitor.begin(self.handshake)
            self.channel.request(MessageType.CLEAR_FAULTS)
            self.channel.request(MessageType.RELEASE)
            self.channel.silent = False
            self.channel.request(MessageType.STREAM, wire.pack(wire.STREAM, on=1))
            self.stream.begin(self.handshake)
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
        codes = self.handshake.codes(command_v)
        self._wait_for_release()
        self._stimulus_id += 1
        self._following = 0
        send_stimulus(self.channel, self._stimulus_id, codes)
        self._command = np.asarray(command_v, np.float64)

    def follow(self, samples: int, hold_v: float) -> None:
        """Announce ``samples`` set-points that will be sent during the next run, after the loaded stimulus.

        Raises:
            LimitError: ``hold_v`` is outside the range of the converter.
            InstrumentError: nothing is loaded, there are too many set-points, or the firmware is too old.
        """
        if not self._command.size:
            raise nothing_loaded()
        hold = self.handshake.codes(np.array([hold_v]))
        self._wait_for_release()
        send_following(self.channel, self._stimulus_id, samples, int(hold[0]))
        self._following, self._hold_v = samples, hold_v

    def send(self, offset: int, command_v: NDArray[np.float64]) -> None:
        """Send set-points, shape (k,), V, for the samples of the run from ``offset``, after checking them.

        Raises:
            LimitError: a limit would be exceeded; none is sent.
            InstrumentError: these set-points were not announced by ``follow``.
        """
        if self.monitor.error is not None:
            return  # the next poll raises the error
        first, end = self._command.size, offset + command_v.size
        if self.monitor.limits is None or not first <= offset < end <= first + self._following:
            raise unexpected_set_points(offset, end)
        for description in checked_descriptions(self.nominal, self.device):
            check_command(command_v, description, self.monitor.limits)
        self.monitor.checks.expect_command(command_v)
        send_setpoints(self.channel, self.sender, self.token, offset, self.handshake.codes(command_v))

    def effective_limits(self, limits: Limits) -> Limits:
        """Return ``limits``, reduced to the fixed limits of the instrument."""
        return self.handshake.effective_limits(limits)

    def arm(self, limits: Limits) -> None:
        """Set the limits of the next run, here and in the firmware, reduced to the fixed limits of the device.

        Raises:
            LimitError: the stimulus would exceed them, or the coil is already too hot.
            InstrumentError: the temperature sensor gives no usable reading.
            TissueIDError: the error of the run before was not cleared.
        """
        if self.monitor.error is not None:
            raise self.monitor.error
        check_limits(limits, self.nominal)
        limits = self.effective_limits(limits)
        for description in checked_descriptions(self.nominal, self.device):
            check_stimulus(self._command, description, limits, self._following)
            if self._following:
                check_command(np.array([self._hold_v]), description, limits)
        self._expect_samples()
        newest = self.stream.newest
        self.monitor.checks.arm(np.zeros(0) if newest is None else newest["temperature"], limits)
        self.monitor.checks.expect_command(np.append(self._command, self._hold_v if self._following else 0.0))
        self.token = (self._stimulus_id << 8) ^ (self.channel.next_number() & 0xFF) ^ 0x5EED0000
        self.channel.send_heartbeat(force=True)
        send_limits(self.channel, self.token, self._stimulus_id, limits, self.device.sample_rate_hz)
        self.monitor.limits = limits
        self.sender.reset()
        self._receiver.forget_run()

    def start(self) -> Run:
        """Energise the coil and play.

        Raises:
            LinkLostError: no answer; the coil is released.
            InstrumentError: the answer contradicts the samples; the coil is released.
            TissueIDError: the firmware refuses, or a sample exceeded a limit before the answer came.
        """
        samples = self._command.size + self._following
        self.channel.send_heartbeat(force=True)
        self.monitor.expect_start(samples)
        try:
            run = Run(self.channel.request(MessageType.START, wire.pack(wire.START, token=self.token)), samples)
        except LinkLostError:
            self.release()  # the answers were lost; START may have arrived
            raise
        finally:
            self.monitor.end_of_start()
        self._overdue_s = OVERDUE_SHARE * samples / self.device.sample_rate_hz + OVERDUE_S
        self._overdue_at = self._clock() + self._overdue_s
        self._accept(self.monitor.on_started, run)
        if self.status is not None and self.status.faults:
            self.monitor.fail_by_fault(self.status.faults)  # reported before this answer was read
        return run

    def poll(self, timeout_s: float) -> NDArray[np.void]:
        """Return arrived samples, shape (k,) of SAMPLE, each checked on arrival, and send the heartbeat.

        Raises:
            LinkLostError, FirmwareFaultError, LimitError: the coil is released. Samples that arrived before are
                returned first; the next call raises the error.
        """
        monitor = self.monitor
        if monitor.error is None and not self.stream:
            try:
                self.pump(timeout_s)
            except TissueIDError as error:
                monitor.fail(error)
        if monitor.error is None and (refused := self.sender.refused) is not None:
            self.release()
            monitor.fail(refused)
        if monitor.error is not None and not self.stream:
            monitor.take_error()
            if isinstance(monitor.error, LinkLostError):
                raise self._with_watchdog(monitor.error)
            raise monitor.error
        samples = corrected(self.stream.drain(), self._corrections)
        if self.observer is not None and samples.size:
            self.observer(samples)
        return samples

    def finish(self) -> int:
        """End the run now by its soft release, and return the number of samples played.

        Raises:
            InstrumentError: the firmware is too old, or its answer contradicts the samples; then the coil is released.
        """
        self.monitor.finishing = True  # samples after the end may arrive before the answer
        try:
            played = self.channel.request(MessageType.FINISH)
        finally:
            self.monitor.finishing = False
        self.sender.stop()
        self._accept(self.monitor.on_finished, played)
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
        return send_stage(self.channel, position_m)

    def release(self) -> None:
        """Release the coil now. No heartbeat is sent until the firmware confirms the release.

        If it does not confirm, its watchdog releases the coil, and the next poll raises LinkLostError.
        """
        self.monitor.end()
        try:
            self.channel.stop(STOP_TRIES * self._last_tries())
        except LinkLostError as error:
            log.warning("%s", error)
            self.monitor.fail(error)
        self.monitor.stop_due = False
        self.monitor.expect_a_free_coil()  # samples from before the release have arrived by now

    def clear_faults(self) -> None:
        """Clear the latched faults and the error of the failed run. The next test must be armed again.

        Raises:
            LinkLostError: a release was not confirmed; connect again.
        """
        if self.channel.lost is not None:
            raise self.channel.lost
        self.monitor.error = None
        self.channel.request(MessageType.CLEAR_FAULTS)

    def close(self) -> None:
        """Release the coil, end the stream and close the port."""
        if self._closed:
            return
        self._closed = True
        if isinstance(self.monitor.error, LinkLostError):
            # The other direction of the link may still work.
            with contextlib.suppress(TissueIDError):
                self.channel.send(MessageType.STOP)
        else:
            self.release()
            try:
                self.channel.request(MessageType.STREAM, wire.pack(wire.STREAM, on=0), tries=self._last_tries())
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
        return self.channel.repeated

    @property
    def round_trip_s(self) -> float | None:
        """Median time from a request to its answer over the newest requests, s; None before the first."""
        times = self.channel.round_trips_s
        return float(np.median(times)) if times else None

    @property
    def setpoint_margin_s(self) -> float | None:
        """Least time between arrival and playing of a block of set-points of the newest run, s; None without."""
        margin = self.sender.margin_samples
        return None if margin is None else margin / self.device.sample_rate_hz

    def _accept(self, accept: Callable[[_Reply], None], reply: _Reply) -> None:
        """Pass a reply about a run to the monitor.

        Raises:
            InstrumentError: it contradicts the samples; the coil is released.
        """
        try:
            accept(reply)
        except InstrumentError as error:
            self.monitor.fail(error)
            self.release()
            self.monitor.take_error()
            raise

    def _busy(self) -> bool:
        """Return whether a test is armed or running. A run whose last sample has arrived ends with its soft release."""
        last = self.stream.next_index
        if self.monitor.run is not None and last is not None and last >= self.monitor.run.end_index:
            self._wait_for_release()
            self.monitor.end()
        return self.monitor.limits is not None

    def _wait_for_release(self) -> None:
        """Wait until the soft release after a run has ended."""
        deadline = self._clock() + ANSWER_S
        while self.status is not None and self.status.state is State.RUNNING and self._clock() < deadline:
            self.channel.send(MessageType.STATUS_REQUEST)
            self.pump(_PUMP_S)

    # -- requests -----------------------------------------------------------------------------------------

    def _shake_hands(self) -> Handshake:
        for _ in range(TRIES):
            send_hello(self.channel)
            deadline = self._clock() + ANSWER_S
            while self._receiver.hello is None and self._clock() < deadline:
                try:
                    self.pump(_HELLO_PUMP_S)
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

    def pump(self, timeout_s: float) -> None:
        """Read once and process every complete frame. During a run, heartbeats are sent here only.

        A heartbeat is sent only after new samples passed the checks. Without usable samples the watchdog therefore
        releases the coil.
        """
        try:
            checked = self._receiver.take(self.link.read(timeout_s))
        except LinkLostError as error:
            raise self._with_watchdog(error) from error
        if self.monitor.run is not None and self._clock() > self._overdue_at:
            self.monitor.stop_due = True
            self.monitor.fail(
                InstrumentError(
                    "instrument.overdue",
                    "the test did not end within {seconds:.1f} s as it should: connect again, and measure again",
                    seconds=self._overdue_s,
                )
            )
        if checked and self.monitor.error is None:
            self.channel.send_heartbeat()
        if self.monitor.stop_due and not self.channel.silent:
            self.release()
        if self.monitor.run is not None and self.stream.next_index is not None:
            self.sender.repeat(self.stream.next_index - self.monitor.run.first_index)
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
        return 1 if self.channel.unanswered else 2

    def _expect_samples(self) -> None:
        """Wait for new samples, and discard those that arrived while the stimulus was sent.

        These were checked on arrival; returning them would delay the samples of the run.

        Raises:
            LinkLostError: no samples arrive.
        """
        before, deadline = self.stream.next_index, self._clock() + ANSWER_S
        while self.stream.next_index == before and self.monitor.error is None:
            if self._clock() >= deadline:
                raise LinkLostError(
                    Message(
                        "link.no_samples",
                        "no samples arrive from {port}: check the cable, and connect again",
                        port=self.link.name,
                    )
                )
            self.pump(_PUMP_S)
        self.stream.drain()

    def _ask_status(self) -> None:
        self.channel.send(MessageType.STATUS_REQUEST)

    def _run_ended(self) -> None:
        """End the set-points: they are announced for one run only."""
        self._following = 0
        self.sender.stop()
