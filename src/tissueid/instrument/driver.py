"""The driver of a device on a link: handshake, requests with retries, decoding, heartbeat, limits, gaps."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from tissueid import wire
from tissueid.device import DeviceDescription
from tissueid.errors import InstrumentError, LinkLostError, TissueIDError
from tissueid.instrument.answers import Status
from tissueid.instrument.conversation import ANSWER_S, TRIES, Conversation
from tissueid.instrument.correction import Corrections, check_corrections, corrected, most_cautious
from tissueid.instrument.handshake import Introduction, read_hello
from tissueid.instrument.incoming import Incoming
from tissueid.instrument.interface import SIGNALS, Observer, Run
from tissueid.instrument.limits import Limits, check_command, check_limits, check_stimulus
from tissueid.instrument.link import Link
from tissueid.instrument.outgoing import (
    send_following,
    send_hello,
    send_limits,
    send_setpoints,
    send_stage,
    send_stimulus,
)
from tissueid.instrument.run_watch import RunWatch
from tissueid.instrument.sample_stream import SampleStream
from tissueid.instrument.setpoints import SetpointSender
from tissueid.wire import MessageType, State

log = logging.getLogger(__name__)

_Said = TypeVar("_Said")

OVERDUE_SHARE, OVERDUE_S = 1.25, 5.0
"""By the host's own clock a run may last so much longer than its samples should: a device's clock is off by a tenth at
most, and a simulated one stands still while its machine is busy."""

STOP_TRIES = 3
"""A STOP that is not answered is sent again so often, and twice as often where the request before it was answered."""


class SerialInstrument:
    """An instrument at the other end of a link. Opening it shakes hands and starts the stream.

    ``clock`` gives seconds that never go back; tests hand in their own.

    Raises:
        ProtocolVersionError: the firmware speaks other versions.
        LinkLostError: nothing answers.
    """

    def __init__(self, link: Link, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._stream = SampleStream()
        self.gaps = self._stream.gaps
        self.observer: Observer | None = None
        self._link = link
        self._clock = clock
        self._watch = RunWatch(self._stream, lambda: self._talk.send(MessageType.STATUS_REQUEST), self._run_ended)
        self._talk = Conversation(link, clock, self._pump, self._watch.untold)
        self._corrections: Corrections = {}
        self._command = np.zeros(0)
        self._following = 0
        self._hold_v = 0.0
        self._overdue_s = self._overdue_at = 0.0
        self._sender = SetpointSender(link.write, clock)
        self._incoming = Incoming(link.name, clock, self._stream, self._watch, self._sender, self._talk.take)
        self._stimulus_id = 0
        self._closed = False
        self._watchdog_s: float | None = None
        try:
            self._hello = self._shake_hands()
            self._watchdog_s = self._hello.watchdog_s
            self.device = self.nominal = self._hello.device
            self._watch.begin(self._hello)
            self._talk.request(MessageType.CLEAR_FAULTS)
            self._talk.request(MessageType.RELEASE)
            self._talk.silent = False
            self._talk.request(MessageType.STREAM, wire.pack(wire.STREAM, on=1))
            self._stream.begin(self._hello)
            self._incoming.stream_begins()
        except BaseException:
            link.close()
            raise

    # -- the Instrument interface -------------------------------------------------------------------------

    def use_calibration(self, device: DeviceDescription, corrections: Corrections) -> None:
        """From now on go by ``device``, and correct what is read.

        Raises:
            InstrumentError: a test is armed or running, or there is no such channel.
        """
        if self._busy():
            raise InstrumentError("a calibration is put in force between two tests, not while one runs")
        self._corrections = check_corrections(corrections, SIGNALS)
        self._incoming.calibrated = None if device is self.nominal else (self._corrections, device)
        self.device = device

    def load(self, command_v: NDArray[np.float64]) -> None:
        """Send a stimulus, shape (n,), V; chunks are acknowledged one by one and repeated when lost.

        Raises:
            LimitError: the voltage cannot be expressed by the converter.
            InstrumentError: the firmware refuses it.
        """
        codes = self._hello.codes(command_v)
        self._wait_for_release()
        self._stimulus_id += 1
        self._following = 0
        send_stimulus(self._talk, self._stimulus_id, codes)
        self._command = np.asarray(command_v, np.float64)

    def follow(self, samples: int, hold_v: float) -> None:
        """While the next run goes on, ``samples`` set-points will be sent after what was loaded.

        Raises:
            LimitError: the level to hold cannot be expressed by the converter.
            InstrumentError: nothing is loaded, they are too many, or the firmware is too old for it.
        """
        if not self._command.size:
            raise InstrumentError("load what comes before the set-points first")
        hold = self._hello.codes(np.array([hold_v]))
        self._wait_for_release()
        send_following(self._talk, self._stimulus_id, samples, int(hold[0]))
        self._following, self._hold_v = samples, hold_v

    def send(self, offset: int, command_v: NDArray[np.float64]) -> None:
        """Set-points, shape (k,), V, for the run's samples from ``offset`` on; judged here, and by the firmware.

        Raises:
            LimitError: they would break a limit; nothing of them is sent.
            InstrumentError: nobody asked for these.
        """
        if self._watch.error is not None:
            return  # the next poll says what happened
        first, end = self._command.size, offset + command_v.size
        if self._watch.limits is None or not first <= offset < end <= first + self._following:
            raise InstrumentError(f"set-points {offset} to {end} are none that were asked for: follow and arm first")
        for figures in most_cautious(self.nominal, self.device):
            check_command(command_v, figures, self._watch.limits)
        self._watch.judge.ask(command_v)
        send_setpoints(self._talk, self._sender, self._token, offset, self._hello.codes(command_v))

    def narrowed(self, limits: Limits) -> Limits:
        """These limits, or the instrument's own where it goes less far."""
        return self._hello.narrowed(limits)

    def arm(self, limits: Limits) -> None:
        """Agree on the limits, here and in the firmware; where the device goes less far, its own hold.

        Raises:
            LimitError: the stimulus would break them, or the coil is too hot already.
            InstrumentError: the coil's temperature cannot be told.
            TissueIDError: what ended the run before has not been cleared.
        """
        if self._watch.error is not None:
            raise self._watch.error
        check_limits(limits, self.nominal)
        limits = self.narrowed(limits)
        for figures in most_cautious(self.nominal, self.device):
            check_stimulus(self._command, figures, limits, self._following)
            if self._following:
                check_command(np.array([self._hold_v]), figures, limits)
        self._expect_samples()
        newest = self._stream.newest
        self._watch.judge.arm(np.zeros(0) if newest is None else newest["temperature"], limits)
        self._watch.judge.ask(np.append(self._command, self._hold_v if self._following else 0.0))
        self._token = (self._stimulus_id << 8) ^ (self._talk.number() & 0xFF) ^ 0x5EED0000
        self._talk.beat(force=True)
        send_limits(self._talk, self._token, self._stimulus_id, limits, self.device.sample_rate_hz)
        self._watch.limits = limits
        self._sender.reset()
        self._incoming.forget_run()

    def start(self) -> Run:
        """Energise the coil and play.

        Raises:
            LinkLostError: no answer; the coil is released.
            InstrumentError: the answer cannot be true; the coil is released.
            TissueIDError: it is refused, or a sample broke a limit before the answer came.
        """
        samples = self._command.size + self._following
        self._talk.beat(force=True)
        self._watch.expect(samples)
        try:
            run = Run(self._talk.request(MessageType.START, wire.pack(wire.START, token=self._token)), samples)
        except LinkLostError:
            self.release()  # the answers were lost, and maybe no START was
            raise
        finally:
            self._watch.answered()
        self._overdue_s = OVERDUE_SHARE * samples / self.device.sample_rate_hz + OVERDUE_S
        self._overdue_at = self._clock() + self._overdue_s
        self._believe(self._watch.started, run)
        if self.status is not None and self.status.faults:
            self._watch.fail_by_fault(self.status.faults)  # it tripped before this answer was read
        return run

    def poll(self, timeout_s: float) -> NDArray[np.void]:
        """Samples that arrived, shape (k,) of SAMPLE, each judged on arrival; keeps the watchdog quiet.

        Raises:
            LinkLostError, FirmwareFaultError, LimitError: the coil is released. What arrived before is
                delivered first; the error comes with the next call.
        """
        watch = self._watch
        if watch.error is None and not self._stream:
            try:
                self._pump(timeout_s)
            except TissueIDError as error:
                watch.fail(error)
        if watch.error is None and (refused := self._sender.refused) is not None:
            self.release()
            watch.fail(refused)
        if watch.error is not None and not self._stream:
            watch.untold()  # it is told now
            if isinstance(watch.error, LinkLostError):
                raise self._known_of_coil(watch.error)
            raise watch.error
        samples = corrected(self._stream.drain(), self._corrections)
        if self.observer is not None and samples.size:
            self.observer(samples)
        return samples

    def finish(self) -> int:
        """End the run now by the soft release of its end; returns how many of its samples were played.

        Raises:
            InstrumentError: the firmware is too old for it, or its answer cannot be true; then the coil is released.
        """
        self._watch.finishing = True  # samples after the end may come before the answer
        try:
            played = self._talk.request(MessageType.FINISH)
        finally:
            self._watch.finishing = False
        self._sender.stop()
        self._believe(self._watch.cut, played)
        return played

    def move_stage(self, position_m: float | None) -> bool:
        """Bring the fixture on a motorised stage to a position on the actuator, m; None takes it out of reach.

        Returns False where the instrument has no such stage.

        Raises:
            InstrumentError: a test is armed or running, or the stage cannot go there.
        """
        if self._busy():
            raise InstrumentError("the stage moves only while the coil is free: end the test first")
        self._wait_for_release()
        return send_stage(self._talk, position_m)

    def release(self) -> None:
        """Free the coil now. There is no heartbeat from here until the firmware confirms it.

        Where it does not, its watchdog frees the coil, and the next poll says that the link is lost.
        """
        self._watch.end()
        try:
            self._talk.stop(STOP_TRIES * self._last_tries())
        except LinkLostError as error:
            log.warning("%s", error)
            self._watch.fail(error)
        self._watch.stop_due = False
        self._watch.expect_a_free_coil()  # what was measured before the firmware heard of it has come by now

    def clear_faults(self) -> None:
        """Unlatch the firmware's faults and forget the failed run; the next test must be armed anew.

        Raises:
            LinkLostError: a release was not confirmed: connect again.
        """
        if self._talk.lost is not None:
            raise self._talk.lost
        self._watch.error = None
        self._talk.request(MessageType.CLEAR_FAULTS)

    def close(self) -> None:
        """Release, end the stream, let go of the port."""
        if self._closed:
            return
        self._closed = True
        if isinstance(self._watch.error, LinkLostError):
            # A line that brings nothing may still carry something the other way.
            with contextlib.suppress(TissueIDError):
                self._talk.send(MessageType.STOP)
        else:
            self.release()
            try:
                self._talk.request(MessageType.STREAM, wire.pack(wire.STREAM, on=0), tries=self._last_tries())
            except TissueIDError as error:
                log.info("the stream was not ended: %s", error)
        self._link.close()

    def __enter__(self) -> SerialInstrument:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def statistics(self) -> wire.FrameStatistics:
        """Frames accepted and refused since the link was opened."""
        return self._incoming.statistics

    @property
    def status(self) -> Status | None:
        """What the firmware said of itself the last time; None before it did."""
        return self._incoming.status

    @property
    def late_blocks(self) -> int:
        """Blocks of set-points of the newest run that came after their time."""
        return self._incoming.late_blocks

    @property
    def held_samples(self) -> int:
        """Samples of the newest run whose command was held, because its set-point was missing."""
        return self._incoming.held_samples

    @property
    def repeated_requests(self) -> int:
        """Requests that were sent again because no answer came."""
        return self._talk.repeated

    @property
    def round_trip_s(self) -> float | None:
        """The usual time from a request to its answer, the median of the newest; None before there was one."""
        times = self._talk.round_trips_s
        return float(np.median(times)) if times else None

    @property
    def setpoint_margin_s(self) -> float | None:
        """The least time by which a block of set-points of the newest run was ahead of being played."""
        margin = self._sender.margin_samples
        return None if margin is None else margin / self.device.sample_rate_hz

    def _believe(self, take: Callable[[_Said], None], said: _Said) -> None:
        """Have the watch take what the device said of a run.

        Raises:
            InstrumentError: it cannot be true; the coil is released.
        """
        try:
            take(said)
        except InstrumentError as error:
            self._watch.fail(error)
            self.release()
            self._watch.untold()  # it is told now
            raise

    def _busy(self) -> bool:
        """Whether a test is armed or running. One whose last sample is here is over as soon as its release is."""
        last = self._stream.next_index
        if self._watch.run is not None and last is not None and last >= self._watch.run.end_index:
            self._wait_for_release()
            self._watch.end()
        return self._watch.limits is not None

    def _wait_for_release(self) -> None:
        """Let the firmware's ramp down after a run come to its end."""
        deadline = self._clock() + ANSWER_S
        while self.status is not None and self.status.state is State.RUNNING and self._clock() < deadline:
            self._talk.send(MessageType.STATUS_REQUEST)
            self._pump(0.02)

    # -- requests -----------------------------------------------------------------------------------------

    def _shake_hands(self) -> Introduction:
        for _ in range(TRIES):
            send_hello(self._talk)
            deadline = self._clock() + ANSWER_S
            while self._incoming.hello is None and self._clock() < deadline:
                try:
                    self._pump(0.05)
                except LinkLostError as error:
                    raise LinkLostError(f"{error}. Is the instrument in use by another program?") from error
            if self._incoming.hello is not None:
                return read_hello(self._incoming.hello, self._link.name)
        raise LinkLostError(
            f"no instrument answers on {self._link.name}; check the cable and the power, and that no other program "
            "uses it"
        )

    # -- bytes in -----------------------------------------------------------------------------------------

    def _pump(self, timeout_s: float) -> None:
        """Read once, and deal with every frame that came. The only place that keeps the watchdog quiet during a run.

        A heartbeat follows samples that were judged here and nothing else, whatever it was that read: where none come
        that can be, the watchdog frees the coil.
        """
        try:
            judged = self._incoming.take(self._link.read(timeout_s))
        except LinkLostError as error:
            raise self._known_of_coil(error) from error
        if self._watch.run is not None and self._clock() > self._overdue_at:
            self._watch.stop_due = True
            self._watch.fail(
                InstrumentError(
                    f"the test has not ended after {self._overdue_s:.1f} s, and ought to have: connect again, and "
                    "measure again"
                )
            )
        if judged and self._watch.error is None:
            self._talk.beat()
        if self._watch.stop_due and not self._talk.silent:
            self.release()
        if self._watch.run is not None and self._stream.next_index is not None:
            self._sender.repeat(self._stream.next_index - self._watch.run.first_index)
        try:
            self._incoming.check_heard()
        except LinkLostError as error:
            raise self._known_of_coil(error) from error

    def _known_of_coil(self, error: LinkLostError) -> LinkLostError:
        """Return the error with what is known of a coil that may be on: nothing can be asked any more."""
        if self._watchdog_s is None or error.watchdog_s is not None:
            return error
        return LinkLostError(
            f"{error}. The instrument's own watchdog releases the coil within {self._watchdog_s:g} s", self._watchdog_s
        )

    def _last_tries(self) -> int:
        """How often to say what ends a conversation: who has just not answered will hardly do so now."""
        return 1 if self._talk.unanswered else 2

    def _expect_samples(self) -> None:
        """Nothing is played before samples are seen to arrive.

        What came while the stimulus was sent was judged on arrival and is let go here: a pile of it would keep whoever
        polls from the samples of the run.

        Raises:
            LinkLostError: none does.
        """
        before, deadline = self._stream.next_index, self._clock() + ANSWER_S
        while self._stream.next_index == before and self._watch.error is None:
            if self._clock() >= deadline:
                raise LinkLostError(f"no samples arrive from {self._link.name}: check the cable, and connect again")
            self._pump(0.02)
        self._stream.drain()

    def _run_ended(self) -> None:
        """Set-points are agreed on for one run alone."""
        self._following = 0
        self._sender.stop()
