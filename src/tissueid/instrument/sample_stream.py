"""Stream of samples: DATA frames converted to physical units, with lost samples filled in as NaN."""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import NDArray

import tissueid.wire as wire
from tissueid.errors import LinkLostError
from tissueid.instrument.handshake import Handshake
from tissueid.instrument.interface import SAMPLE, SIGNALS, Gap, empty_samples, join_blocks
from tissueid.messages import Message
from tissueid.wire import Flag, Frame

log = logging.getLogger(__name__)

MAX_GAP_S = 5.0
"""Longest gap in the samples that the link may have, s; a longer one counts as a lost link."""

_HELD = int(Flag.HELD)


class SampleStream:
    """Samples in the order of their index, each once.

    ``next_index`` is the index of the next sample; None before the first. ``received`` counts received samples,
    ``held_samples`` those with the flag HELD. ``gaps`` lists lost samples.
    """

    def __init__(self) -> None:
        self.gaps: list[Gap] = []
        self.next_index: int | None = None
        self.held_samples = self.received = 0
        self.newest: NDArray[np.void] | None = None
        """The samples of the newest frame; None before the first."""
        self._hello: Handshake | None = None
        self._ready: list[NDArray[np.void]] = []

    def begin(self, hello: Handshake) -> None:
        """Begin the stream of a device: forget earlier samples and gaps."""
        self._hello = hello
        self.gaps.clear()
        self.next_index = self.newest = None
        self._ready.clear()

    def __bool__(self) -> bool:
        return bool(self._ready)

    def drain(self) -> NDArray[np.void]:
        """Return all samples since the last call, shape (k,) of SAMPLE, k >= 0."""
        samples = join_blocks(self._ready)
        self._ready.clear()
        return samples

    def take(self, frame: Frame) -> NDArray[np.void]:
        """Return the new samples of one DATA frame, shape (k,) of SAMPLE, with the lost ones before it.

        Raises:
            LinkLostError: the gap is longer than ``MAX_GAP_S``.
            PayloadError: the payload is empty or ends within a sample.
        """
        if self._hello is None:
            return empty_samples(0, 0)  # sent before the handshake: the scales are not known yet
        if self.next_index is not None and frame.sample_index < self.next_index:
            return empty_samples(0, 0)  # a duplicate, or late: already filled in
        if not frame.payload or len(frame.payload) % wire.SAMPLE.itemsize:
            raise wire.PayloadError("a data frame holds no sample, or part of one")
        lost: NDArray[np.void] | None = None
        if self.next_index is not None and frame.sample_index > self.next_index:
            missing = frame.sample_index - self.next_index
            if missing > MAX_GAP_S * self._hello.device.sample_rate_hz:
                raise LinkLostError(
                    Message(
                        "link.gap",
                        "{missing} samples are missing at once; the connection is not reliable: check the cable, and "
                        "connect again",
                        missing=missing,
                    )
                )
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
        self.held_samples += int(np.count_nonzero(codes["flags"] & _HELD))
        self.next_index = frame.sample_index + codes.size
        self.received += codes.size
        return samples if lost is None else np.concatenate((lost, samples))
