"""The stream of samples: DATA frames become samples in physical units, and what was lost on the way is marked."""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import NDArray

from tissueid import wire
from tissueid.errors import LinkLostError
from tissueid.instrument.handshake import Introduction
from tissueid.instrument.interface import SAMPLE, SIGNALS, Gap, empty_samples
from tissueid.wire import Flag, Frame

log = logging.getLogger(__name__)

MAX_GAP_S = 5.0


class SampleStream:
    """Samples in the order of their index, each once. ``next_index`` is the next that is expected.

    ``received`` counts those that came, the lost ones not among them.
    """

    def __init__(self) -> None:
        self.gaps: list[Gap] = []
        self.next_index: int | None = None
        self.held_samples = self.received = 0
        self.newest: NDArray[np.void] | None = None
        """The samples of the newest frame; None until there was one."""
        self._hello: Introduction | None = None
        self._ready: list[NDArray[np.void]] = []

    def begin(self, hello: Introduction) -> None:
        """From now on. What was sent for a host before this one is not ours to miss."""
        self._hello = hello
        self.gaps.clear()
        self.next_index = self.newest = None
        self._ready.clear()

    def __bool__(self) -> bool:
        return bool(self._ready)

    def drain(self) -> NDArray[np.void]:
        """Everything that arrived since the last time, shape (k,) of SAMPLE; k may be 0."""
        # Laid out by hand: numpy would compare the fields of every block with those before it, and for what arrives
        # while a long stimulus is sent that takes longer than the watchdog's patience.
        samples = np.empty(sum(block.size for block in self._ready), SAMPLE)
        end = 0
        for block in self._ready:
            samples[end : end + block.size] = block
            end += block.size
        self._ready.clear()
        return samples

    def take(self, frame: Frame) -> NDArray[np.void]:
        """The new samples of one DATA frame, shape (k,) of SAMPLE, those that were lost before it among them.

        Raises:
            LinkLostError: too much is missing at once.
            PayloadError: it holds part of a sample, or none.
        """
        if self._hello is None:
            return empty_samples(0, 0)  # still streaming for a host that died: the scales are not known yet
        if self.next_index is not None and frame.sample_index < self.next_index:
            return empty_samples(0, 0)  # a duplicate, or late: its place is already taken
        if not frame.payload or len(frame.payload) % wire.SAMPLE.itemsize:
            raise wire.PayloadError("a data frame holds no sample, or part of one")
        lost = empty_samples(0, 0)
        if self.next_index is not None and frame.sample_index > self.next_index:
            missing = frame.sample_index - self.next_index
            if missing > MAX_GAP_S * self._hello.device.sample_rate_hz:
                raise LinkLostError(f"{missing} samples are missing at once; the link cannot be trusted")
            self.gaps.append(Gap(self.next_index, missing))
            log.warning("%d samples lost from sample %d on", missing, self.next_index)
            lost = empty_samples(self.next_index, missing)
            self._ready.append(lost)
        codes = np.frombuffer(frame.payload, wire.SAMPLE)
        samples = np.zeros(codes.size, SAMPLE)
        samples["index"] = frame.sample_index + np.arange(codes.size)
        samples["flags"] = codes["flags"]
        for channel, name in enumerate(SIGNALS):
            samples[name] = codes[name] * self._hello.gains[channel] + self._hello.offsets[channel]
        self._ready.append(samples)
        self.newest = samples
        self.held_samples += int(np.count_nonzero(codes["flags"] & Flag.HELD))
        self.next_index = frame.sample_index + codes.size
        self.received += codes.size
        return np.concatenate((lost, samples)) if lost.size else samples
