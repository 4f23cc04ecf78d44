"""Sender of set-points: repeats blocks until they are acknowledged or too late, and counts late ones."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

import tissueid.wire as wire
from tissueid.device import DeviceDescription
from tissueid.errors import LinkLostError, ProtocolVersionError, TissueIDError
from tissueid.instrument.interface import Corrections, corrected
from tissueid.instrument.replies import Status, parse_status
from tissueid.instrument.run_monitor import RunMonitor
from tissueid.instrument.sample_stream import SampleStream, SetpointSender
from tissueid.messages import Message
from tissueid.wire import Fault, Frame, MessageType

log = logging.getLogger(__name__)


SILENCE_S = 1.0
"""Time without new usable samples after which the link counts as lost, s. A device sends samples every 10 ms."""

UNJUDGED_S = 0.25
"""Time without usable samples after which no heartbeat is sent and a watchdog fault is attributed to the link, s."""


class FrameReceiver:
    """Processes the frames of one link in order. Samples are checked by ``monitor`` first.

    Args:
        name: of the port, for messages.
        clock: monotonic time, s.
        stream: collects the samples.
        monitor: checks samples and STATUS messages, and takes errors.
        sender: takes the acknowledgements of set-points.
        on_ack: takes all other ACK messages.

    ``hello`` is the payload of the HELLO_ACK, ``status`` the newest STATUS. ``late_blocks`` and ``held_samples`` count
    for the newest run. ``calibrated`` holds the corrections and description of the active calibration, by which samples
    are checked a second time; None without a calibration.
    """

    def __init__(
        self,
        name: str,
        clock: Callable[[], float],
        stream: SampleStream,
        monitor: RunMonitor,
        sender: SetpointSender,
        on_ack: Callable[[dict[str, Any]], None],
    ) -> None:
        self.hello: bytes | None = None
        self.status: Status | None = None
        self.late_blocks = self.held_samples = 0
        self.calibrated: tuple[Corrections, DeviceDescription] | None = None
        self._name = name
        self._clock = clock
        self._stream = stream
        self._monitor = monitor
        self._sender = sender
        self._on_ack = on_ack
        self._decoder = wire.FrameDecoder()
        self._last_heard = clock()
        self._unusable = self._streaming = False

    @property
    def statistics(self) -> wire.FrameStatistics:
        """Frames accepted and refused since the link was opened."""
        return self._decoder.statistics

    def stream_begins(self) -> None:
        """Expect samples from now on."""
        self._streaming = True

    def forget_run(self) -> None:
        """Reset the counts of a run."""
        self._stream.held_samples = 0
        self.late_blocks = self.held_samples = 0

    def take(self, data: bytes) -> bool:
        """Process every frame that these bytes complete; errors go to the monitor.

        Return whether new samples were among them and passed to the checks.
        """
        before = self._stream.received
        for frame in self._decoder.feed(data):
            received = self._stream.received
            try:
                self._dispatch(frame)
            except ValueError as error:  # wrong length of a payload, or an unknown state
                log.warning("ignored a frame of type 0x%02x: %s", frame.type, error)
            if not self._streaming or self._stream.received > received:
                self._last_heard = self._clock()  # answers and unusable samples do not count
                self._unusable = False
            elif frame.type == MessageType.DATA:
                self._unusable = True
        return self._stream.received > before

    def check_heard(self) -> None:
        """Check that usable samples arrived recently.

        Raises:
            LinkLostError: none arrived for ``SILENCE_S``.
        """
        if self._streaming and self._clock() - self._last_heard > SILENCE_S:
            raise self._silence()

    def _silence(self) -> LinkLostError:
        seconds = round(self._clock() - self._last_heard, 1)
        if self._unusable:
            message = Message(
                "link.unusable",
                "{port} sent no usable samples for {seconds:g} s. Check the cable and the power, and connect again",
                port=self._name,
                seconds=seconds,
            )
        else:
            message = Message(
                "link.silent",
                "{port} went silent for {seconds:g} s. Check the cable and the power, and connect again",
                port=self._name,
                seconds=seconds,
            )
        return LinkLostError(message)

    def _dispatch(self, frame: Frame) -> None:
        if self._streaming and frame.version != wire.PROTOCOL_VERSION:
            self._monitor.fail(
                ProtocolVersionError(
                    "link.version_changed",
                    "the instrument changed to protocol {version} during operation; this software speaks {own}. "
                    "Connect again",
                    version=frame.version,
                    own=wire.PROTOCOL_VERSION,
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
            self._on_ack(ack)
            return
        run = self._monitor.run
        self._sender.acknowledge(ack, frame.sample_index - run.first_index if run else None)
        self.late_blocks = max(self.late_blocks, self._sender.late_blocks)

    def _take_status(self, frame: Frame) -> None:
        self.status = status = parse_status(frame.payload)
        if not self._streaming:
            return
        self.late_blocks = max(self.late_blocks, status.late_blocks)
        self.held_samples = max(self.held_samples, status.held_samples)
        if (
            status.faults == Fault.WATCHDOG
            and self._monitor.limits is not None
            and self._clock() - self._last_heard > UNJUDGED_S
        ):
            self._monitor.fail(self._silence())
        self._monitor.take_status(status, frame.sample_index)

    def _take_data(self, frame: Frame) -> None:
        try:
            samples = self._stream.take(frame)
            if samples.size:
                known = self.calibrated
                self._monitor.take(samples, None if known is None else (corrected(samples, known[0]), known[1]))
        except TissueIDError as error:
            self._monitor.fail(error)  # the coil is released as soon as the frames that arrived with it are read
        # Held samples among the lost ones are counted by the STATUS at the end of the run.
        self.held_samples = max(self.held_samples, self._stream.held_samples)
