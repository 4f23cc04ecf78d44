"""Set-points of a stimulus that is generated while the test runs: made block by block, ahead of their time."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from functools import lru_cache

import numpy as np
import scipy
from numpy.typing import NDArray

from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.instrument import Instrument, Run, force
from tissueid.stimuli.base import GUIDED, Array, Stimulus, preload_values, to_voltage
from tissueid.stimuli.feedback import BLOCK, FeedbackKind
from tissueid.untrusted import MAX_TEXT

_REHEARSAL_S = 2.0
_REHEARSED_STIFFNESS = 1000.0
_REHEARSED_DAMPING = 10.0
_ROUNDING_N = 1e-9


def preload(kind: FeedbackKind, preload_s: float) -> Stimulus:
    """What is loaded before the set-points of a feedback stimulus: the rise to its load and the hold.

    Raises:
        UnusableInputError: the preload is shorter than its rise.
    """
    return Stimulus(
        values=preload_values(kind.preload_n, preload_s, kind.sample_rate),
        sample_rate_hz=kind.sample_rate,
        description={"type": GUIDED, "preload_s": preload_s, "stimulus": kind.describe()},
        seed=kind.seed,
        crest_factor=float("nan"),
        preload_s=preload_s,
    )


def set_point_count(kind: FeedbackKind) -> int:
    """How many set-points follow the preload."""
    return round(kind.seconds * kind.sample_rate)


@lru_cache(maxsize=8)
def rehearse(kind: FeedbackKind) -> None:
    """Go through a stimulus once against a spring and a dashpot, with nobody at the probe.

    What a source compiles or loads when it is first used is then there before the coil is energised, and what goes
    wrong in it does so before anybody is touched.

    Raises:
        UnusableInputError: it makes something else than forces in its range.
    """
    source = kind.start(0.0)
    decay = float(np.exp(-_REHEARSED_STIFFNESS / (_REHEARSED_DAMPING * kind.sample_rate)))
    blocks = min(set_point_count(kind), round(_REHEARSAL_S * kind.sample_rate)) // BLOCK + 1
    force_n = np.full(BLOCK, kind.preload_n)
    depth = force_n / _REHEARSED_STIFFNESS
    state = decay * depth[-1:]
    for block in range(-kind.lead, blocks):
        source.take(force_n, depth, block * BLOCK)
        force_n = checked(kind, source.next_block())
        depth, state = scipy.signal.lfilter([(1.0 - decay) / _REHEARSED_STIFFNESS], [1.0, -decay], force_n, zi=state)
    source.report()


def checked(kind: FeedbackKind, block: Array) -> Array:
    """A block of set-points (BLOCK,), N, when it is one.

    Raises:
        UnusableInputError: another shape, or not within the range of the kind.
    """
    whole = block.shape == (BLOCK,)
    if not whole or not np.all((block >= kind.force_min_n - _ROUNDING_N) & (block <= kind.force_max_n + _ROUNDING_N)):
        raise UnusableInputError(
            f"the stimulus {kind.name!r} left its range of {kind.force_min_n:g} to {kind.force_max_n:g} N: it is not "
            "fit to be played"
        )
    return block


class SetPoints:
    """The set-points of one test under way.

    The source gets the samples in pieces that end where the blocks begin, and block k is made when it has all of those
    up to ``lead`` blocks before the block's start and none beyond. However the samples came over the cable, the same
    answers therefore give the same set-points, and the recording is enough to make them again.

    ``surface_m`` is where the tissue begins; ``clock`` gives seconds that never go back.
    """

    def __init__(
        self,
        kind: FeedbackKind,
        device: DeviceDescription,
        surface_m: float,
        preload_samples: int,
        *,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self.samples = set_point_count(kind)
        self.hold_v = float(to_voltage(np.array([kind.preload_n]), device)[0])
        self._kind = kind
        self._device = device
        self._clock = clock
        self._source = kind.start(surface_m)
        self._preload = preload_samples
        self._taken = -preload_samples
        self._waiting: list[NDArray[np.float64]] = []  # each (2, k): force and position, from self._taken on
        self._received = -preload_samples
        self._made = 0
        self._seconds = self._longest = 0.0

    def take(self, samples: NDArray[np.void]) -> None:
        """Samples of the run, shape (k,) of SAMPLE, in order and without a gap: a lost one is there as NaN."""
        self._waiting.append(np.stack([force(samples, self._device), samples["position"]]))
        self._received += samples.size

    def send_due(self, instrument: Instrument) -> None:
        """Make and send the blocks whose time has come.

        Raises:
            UnusableInputError: the source made something else than forces in its range.
            InstrumentError, LimitError: as ``send`` says.
        """
        while self._made * BLOCK < self.samples and (due := (self._made - self._kind.lead) * BLOCK) <= self._received:
            begin = self._clock()
            self._hand_over(due)
            block = checked(self._kind, self._source.next_block())
            spent = self._clock() - begin
            self._seconds += spent
            self._longest = max(self._longest, spent)
            offset = self._made * BLOCK
            self._made += 1
            instrument.send(self._preload + offset, to_voltage(block[: self.samples - offset], self._device))

    def notes(self, run: Run, *, whole: bool) -> dict[str, str | float]:
        """What a session keeps of the generation, for a run as it was played.

        ``generating_share`` is the time spent in the source over that of the test, ``generating_longest_s`` that of the
        slowest block, ``stimulus_report`` what the source says came of a test that was played ``whole``, as JSON.
        """
        played_s = run.samples / self._device.sample_rate_hz
        notes: dict[str, str | float] = {
            "generating_share": self._seconds / played_s,
            "generating_longest_s": self._longest,
        }
        if whole:
            notes |= self._report()
        return notes

    def _report(self) -> dict[str, str | float]:
        """What the source says came of the test, as JSON; in its place, why there is nothing that can be kept."""
        try:
            self._hand_over(self._received)
            report = json.dumps(self._source.report())
        except Exception as error:  # noqa: BLE001 - a source may be anybody's, and the test was played whole
            return {"stimulus_report_failed": f"{type(error).__name__}: {error}"}
        if len(report) > MAX_TEXT:
            return {"stimulus_report_failed": f"{len(report)} characters, and {MAX_TEXT} is the most"}
        return {"stimulus_report": report}

    def _hand_over(self, end: int) -> None:
        """Hand over the samples before number ``end``, in pieces that end at multiples of a block."""
        if end <= self._taken:
            return
        signals = np.concatenate(self._waiting, axis=1)  # (2, received - taken)
        edges = [*range(self._taken // BLOCK * BLOCK + BLOCK, end, BLOCK), end]
        for edge in edges:
            piece = signals[:, : edge - self._taken]
            signals = signals[:, edge - self._taken :]
            self._source.take(piece[0].copy(), piece[1].copy(), self._taken)
            self._taken = edge
        self._waiting = [signals]
