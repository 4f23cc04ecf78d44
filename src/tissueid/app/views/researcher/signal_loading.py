"""Load the signals of the selected tests in a thread."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.app.live_signals import decimated
from tissueid.app.views.researcher.background_work import BackgroundWork
from tissueid.app.views.researcher.selected_test import SelectedTest, signal_title
from tissueid.app.words import in_words
from tissueid.errors import CancelledError, TissueIDError
from tissueid.language import _, plural
from tissueid.sessions import read_test

Array = NDArray[np.float64]

_BLOCK = 256


@dataclass(frozen=True)
class IntervalStatistics:
    """Statistics of the received samples of an interval, in the unit of the signal; NaN if there are none."""

    mean: float
    std: float
    samples: int
    lost: int


class RecordedSignal:
    """A signal: ``values`` of shape (n,) in SI units, NaN for lost samples; ``sample_rate_hz`` is its sample rate.

    Sums and extremes of blocks are worked out once, so that twenty million samples take no longer to look at than some
    thousands.
    """

    def __init__(self, values: Array, sample_rate_hz: float) -> None:
        self.values = np.where(np.isfinite(values), values, np.nan)
        self.sample_rate_hz = sample_rate_hz
        known = np.isfinite(self.values)
        self._middle = float(self.values[known].mean()) if known.any() else 0.0
        padding = np.full(-self.values.size % _BLOCK, np.nan)
        whole = np.concatenate([self.values, padding]).reshape(-1, _BLOCK)  # (blocks, _BLOCK)
        self._low, self._high = np.fmin.reduce(whole, axis=1), np.fmax.reduce(whole, axis=1)
        centred = whole - self._middle
        self._count = np.isfinite(whole).sum(axis=1)
        self._sum, self._square = np.nansum(centred, axis=1), np.nansum(centred**2, axis=1)

    @property
    def seconds(self) -> float:
        """Duration, s."""
        return self.values.size / self.sample_rate_hz

    def places(self, low_s: float, high_s: float) -> tuple[int, int]:
        """Return the first sample at or after ``low_s``, and the first at or after ``high_s``."""
        first, last = (math.ceil(round(time * self.sample_rate_hz, 6)) for time in (low_s, high_s))
        return max(0, min(first, self.values.size)), max(0, min(last, self.values.size))

    def stretch(self, low_s: float, high_s: float) -> IntervalStatistics:
        """Return mean and standard deviation of the received samples from ``low_s`` to ``high_s``."""
        first, last = self.places(low_s, high_s)
        if last <= first:
            return IntervalStatistics(math.nan, math.nan, 0, 0)
        head, tail = min(last, -(-first // _BLOCK) * _BLOCK), max(first, last // _BLOCK * _BLOCK)
        loose = self.values[first:last]
        blocks = slice(0, 0)
        if head < tail:
            loose = np.concatenate([self.values[first:head], self.values[tail:last]])
            blocks = slice(head // _BLOCK, tail // _BLOCK)
        centred = loose[np.isfinite(loose)] - self._middle
        count = centred.size + int(self._count[blocks].sum())
        if not count:
            return IntervalStatistics(math.nan, math.nan, 0, last - first)
        mean = float(centred.sum() + self._sum[blocks].sum()) / count
        square = float((centred**2).sum() + self._square[blocks].sum()) / count
        return IntervalStatistics(
            self._middle + mean, math.sqrt(max(0.0, square - mean**2)), count, last - first - count
        )

    def outline(self, low_s: float, high_s: float, columns: int) -> tuple[Array, Array]:
        """Return times and values to draw: minimum and maximum in each of ``columns`` columns."""
        first, last = self.places(low_s, high_s)
        first, last = max(0, first - 1), min(self.values.size, last + 1)
        if last - first > 4 * _BLOCK * columns:
            rows = slice(first // _BLOCK, -(-last // _BLOCK))
            times = np.arange(rows.start, rows.stop) * (_BLOCK / self.sample_rate_hz)
            ends = np.stack([self._low[rows], self._high[rows]], axis=1).reshape(-1)
            return decimated(np.repeat(times, 2), ends, low_s, high_s, columns)
        times = np.arange(first, last) / self.sample_rate_hz
        return decimated(times, self.values[first:last], low_s, high_s, columns)


MOST_TESTS = 8
"""Maximum number of overlaid tests."""
_MOST_NUMBERS = 60_000_000

_FIRST = ("command", "voltage", "current", "force", "position", "input", "output", "temperature")


@dataclass(frozen=True)
class Channel:
    """A signal: name and SI unit ("" if it has none). Each channel has one plot."""

    name: str
    unit: str

    @property
    def title(self) -> str:
        """Title of the signal in the language of the window."""
        return signal_title(self.name)

    @property
    def rank(self) -> tuple[int, str]:
        """Sort key: from the command of the coil to its motion."""
        return _FIRST.index(self.name) if self.name in _FIRST else len(_FIRST), self.name


@dataclass(frozen=True)
class LoadedTest:
    """A test with its signals. ``preload_s`` is the end of its preload, s; 0 without preload."""

    chosen: SelectedTest
    preload_s: float
    tracks: Mapping[Channel, RecordedSignal]

    @property
    def seconds(self) -> float:
        """Duration, s."""
        return max(track.seconds for track in self.tracks.values())


class SignalLoading(BackgroundWork):
    """Loads tests; those in ``known`` are reused. Errors are added to ``problems``."""

    def __init__(self, chosen: Sequence[SelectedTest], known: Mapping[SelectedTest, LoadedTest]) -> None:
        super().__init__(plural("Reading {count} test", "Reading {count} tests", len(chosen)).format(count=len(chosen)))
        self.loaded: list[LoadedTest] = []
        self.problems: list[str] = []
        self._chosen = tuple(chosen)
        self._known = dict(known)

    def run(self) -> SignalLoading:
        """Load the tests."""
        numbers = 0
        try:
            for done, one in enumerate(self._chosen):
                self.tell(done / len(self._chosen))
                if (loaded := self._known.get(one) or self._load(one)) is None:
                    continue
                numbers += sum(track.values.size for track in loaded.tracks.values())
                if self.loaded and numbers > _MOST_NUMBERS:
                    self.problems.append(
                        _("These tests are too long to be shown together; {count} are shown.").format(
                            count=len(self.loaded)
                        )
                    )
                    break
                self.loaded.append(loaded)
        except CancelledError:
            pass  # what is read is shown
        return self

    def _load(self, one: SelectedTest) -> LoadedTest | None:
        try:
            test = read_test(one.path, one.number)
        except (TissueIDError, OSError) as error:
            self.problems.append(in_words(error))
            return None
        tracks = {
            Channel(name, test.unit(name)): RecordedSignal(values, test.sample_rate_hz)
            for name, values in test.signals.items()
            if name != "time"
        }
        return LoadedTest(one, test.preload_s, tracks)
