"""Load the signals of the selected tests in a thread."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from tissueid.app.views.researcher.background_work import BackgroundWork
from tissueid.app.views.researcher.labels_of_tests import signal_title
from tissueid.app.views.researcher.recorded_signal import RecordedSignal
from tissueid.app.views.researcher.selected_test import SelectedTest
from tissueid.app.words import in_words
from tissueid.errors import CancelledError, TissueIDError
from tissueid.language import _, plural
from tissueid.sessions import read_test

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


__all__ = ["MOST_TESTS", "Channel", "LoadedTest", "SignalLoading"]
