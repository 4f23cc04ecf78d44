"""What a device says: frames become samples, answers and states, each handed to who waits for it."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

from tissueid import wire
from tissueid.device import DeviceDescription
from tissueid.errors import LinkLostError, ProtocolVersionError, TissueIDError
from tissueid.instrument.answers import Status, read_status
from tissueid.instrument.correction import Corrections, corrected
from tissueid.instrument.run_watch import RunWatch
from tissueid.instrument.sample_stream import SampleStream
from tissueid.instrument.setpoints import SetpointSender
from tissueid.wire import Fault, Frame, MessageType

log = logging.getLogger(__name__)

SILENCE_S = 1.0
"""A device that streams sends samples every 10 ms; so long without new ones that can be used is a lost link."""

UNJUDGED_S = 0.25
"""After so long without usable samples the heartbeat has stopped: a watchdog that trips says nothing of the host."""


class Incoming:
    """The frames of the link ``name``, dealt with as they come; samples are judged by the ``watch`` first of all.

    Answers to requests go to ``answered``. ``hello`` is the device's introduction, ``status`` the newest of its states;
    ``late_blocks`` and ``held_samples`` are what it said of the newest run's set-points. ``calibrated`` is by what
    samples are corrected and judged a second time; None where nominal figures are in force.
    """

    def __init__(
        self,
        name: str,
        clock: Callable[[], float],
        stream: SampleStream,
        watch: RunWatch,
        sender: SetpointSender,
        answered: Callable[[dict[str, Any]], None],
    ) -> None:
        self.hello: bytes | None = None
        self.status: Status | None = None
        self.late_blocks = self.held_samples = 0
        self.calibrated: tuple[Corrections, DeviceDescription] | None = None
        self._name = name
        self._clock = clock
        self._stream = stream
        self._watch = watch
        self._sender = sender
        self._answered = answered
        self._decoder = wire.FrameDecoder()
        self._last_heard = clock()
        self._unusable = self._streaming = False

    @property
    def statistics(self) -> wire.FrameStatistics:
        """Frames accepted and refused since the link was opened."""
        return self._decoder.statistics

    def stream_begins(self) -> None:
        """From now on samples arrive all the time."""
        self._streaming = True

    def forget_run(self) -> None:
        """A new run is about to begin: nothing of it was late or held yet."""
        self._stream.held_samples = 0
        self.late_blocks = self.held_samples = 0

    def take(self, data: bytes) -> bool:
        """Deal with every frame that these bytes complete. What goes wrong is told to the watch.

        Returns whether new samples were among them, which the watch has judged.
        """
        before = self._stream.received
        for frame in self._decoder.feed(data):
            received = self._stream.received
            try:
                self._dispatch(frame)
            except ValueError as error:  # a payload of the wrong length, or a state that nobody knows
                log.warning("ignored a frame of type 0x%02x: %s", frame.type, error)
            if not self._streaming or self._stream.received > received:
                self._last_heard = self._clock()  # answers alone are no measurement, nor is what cannot be used
                self._unusable = False
            elif frame.type == MessageType.DATA:
                self._unusable = True
        return self._stream.received > before

    def check_heard(self) -> None:
        """A device that streams sends samples that can be used.

        Raises:
            LinkLostError: it does not.
        """
        if self._streaming and self._clock() - self._last_heard > SILENCE_S:
            raise self._silence()

    def _silence(self) -> LinkLostError:
        """What to say of a device from which no usable samples come any more."""
        seconds = round(self._clock() - self._last_heard, 1)
        said = f"sent no usable samples for {seconds:g} s" if self._unusable else f"went silent for {seconds:g} s"
        return LinkLostError(f"{self._name} {said}. Check the cable and the power, and connect again")

    def _dispatch(self, frame: Frame) -> None:
        if self._streaming and frame.version != wire.PROTOCOL_VERSION:
            self._watch.fail(
                ProtocolVersionError(
                    f"the instrument went over to protocol {frame.version} in mid-conversation; "
                    f"this software speaks {wire.PROTOCOL_VERSION}. Connect again"
                )
            )
        elif frame.type == MessageType.DATA:
            self._take_data(frame)
        elif frame.type == MessageType.ACK:
            self._take_ack(frame)
        elif frame.type == MessageType.STATUS:
            self._take_status(frame)
        elif frame.type == MessageType.HELLO_ACK:
            self.hello = frame.payload

    def _take_ack(self, frame: Frame) -> None:
        ack, _ = wire.unpack(wire.ACK, frame.payload, tail=True)
        if ack["request_type"] != MessageType.SETPOINTS:
            self._answered(ack)
            return
        run = self._watch.run
        self._sender.acknowledge(ack, frame.sample_index - run.first_index if run else None)
        self.late_blocks = max(self.late_blocks, self._sender.late_blocks)

    def _take_status(self, frame: Frame) -> None:
        self.status = status = read_status(frame.payload)
        if not self._streaming:
            return
        self.late_blocks = max(self.late_blocks, status.late_blocks)
        self.held_samples = max(self.held_samples, status.held_samples)
        if (
            status.faults == Fault.WATCHDOG
            and self._watch.limits is not None
            and self._clock() - self._last_heard > UNJUDGED_S
        ):
            self._watch.fail(self._silence())
        self._watch.take_status(status, frame.sample_index)

    def _take_data(self, frame: Frame) -> None:
        try:
            samples = self._stream.take(frame)
            if samples.size:
                known = self.calibrated
                self._watch.take(samples, None if known is None else (corrected(samples, known[0]), known[1]))
        except TissueIDError as error:
            self._watch.fail(error)  # the coil is released as soon as the frames that came with it are read
        # What the firmware held in samples that were lost is in its STATUS at the end of the run.
        self.held_samples = max(self.held_samples, self._stream.held_samples)
