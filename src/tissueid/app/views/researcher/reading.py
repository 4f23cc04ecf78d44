"""The signals of the selected tests, read in a thread."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from tissueid.app.views.researcher.chosen import Chosen
from tissueid.app.views.researcher.errand import Errand
from tissueid.app.views.researcher.track import Track
from tissueid.app.words import in_words
from tissueid.errors import CancelledError, TissueIDError
from tissueid.language import _
from tissueid.sessions import read_test
from tissueid.wording import clean

MOST_TESTS = 8
"""That are overlaid: more cannot be told apart."""
_MOST_NUMBERS = 60_000_000
_LONGEST_NAME = 40

_FIRST = ("command", "voltage", "current", "force", "position", "input", "output", "temperature")


@dataclass(frozen=True)
class Channel:
    """Which signal: its name, and its SI unit, "" where it has none. Tests of one are drawn in one plot."""

    name: str
    unit: str

    @property
    def title(self) -> str:
        """As people read it."""
        plain = clean(self.name).replace("_", " ")[:_LONGEST_NAME]
        return plain[:1].upper() + plain[1:]

    @property
    def rank(self) -> tuple[int, str]:
        """Where it stands among others: from what is asked of the coil to what it does."""
        return _FIRST.index(self.name) if self.name in _FIRST else len(_FIRST), self.name


@dataclass(frozen=True)
class Loaded:
    """A test with its signals. ``preload_s`` is where its preload ends; 0 where it has none."""

    chosen: Chosen
    preload_s: float
    tracks: Mapping[Channel, Track]

    @property
    def seconds(self) -> float:
        """How long it is, s."""
        return max(track.seconds for track in self.tracks.values())


class Reading(Errand):
    """Reads tests; those in ``known`` are there already. What cannot be read is said in ``problems``."""

    def __init__(self, chosen: Sequence[Chosen], known: Mapping[Chosen, Loaded]) -> None:
        super().__init__(f"Reading {len(chosen)} test{'' if len(chosen) == 1 else 's'}")
        self.loaded: list[Loaded] = []
        self.problems: list[str] = []
        self._chosen = tuple(chosen)
        self._known = dict(known)

    def run(self) -> Reading:
        """Do it."""
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

    def _load(self, one: Chosen) -> Loaded | None:
        try:
            test = read_test(one.path, one.number)
        except (TissueIDError, OSError) as error:
            self.problems.append(in_words(error))
            return None
        tracks = {
            Channel(name, test.unit(name)): Track(values, test.sample_rate_hz)
            for name, values in test.signals.items()
            if name != "time"
        }
        return Loaded(one, test.preload_s, tracks)


__all__ = ["MOST_TESTS", "Channel", "Loaded", "Reading"]
