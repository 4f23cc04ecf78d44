"""Looks at a test that runs: samples in, and at every quarter of a second of record a view out. Waits for nothing."""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from tissueid.errors import TissueIDError, UnusableInputError
from tissueid.identification.online.identifier import RECENT_S
from tissueid.identification.online.live_view import LiveIdentifier, LiveView, Method, start_identifier, view
from tissueid.identification.online.precision import Precision, precision
from tissueid.identification.online.stopping import StopRule
from tissueid.records import Record

Array = NDArray[np.float64]

_FIRST_ROOM_S = 32.0
"""Seconds that there is room for at first: what a profile allows at most fits."""

_REHEARSAL_S = 1.0


class LiveSettings(BaseModel):
    """What a live identification is to find, of which samples, and when it is enough."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    sample_rate_hz: float = Field(gt=0.0, le=1e6, description="Samples a second")
    method: Method = Field("sliding", description="How the response is found; the parameters are found alike for all")
    memory: float = Field(0.125, gt=0.0, le=10.0, description="How long the impulse response lasts, s")
    window_s: float | None = Field(RECENT_S, gt=0.0, description="Latest samples that the sliding method counts, s")
    look_every_s: float = Field(0.25, ge=0.05, le=5.0, description="Record from one look to the next, s")
    stop: StopRule | None = Field(None, description="When it is enough; its looks are this often")

    @property
    def look_every(self) -> int:
        """Samples from one look to the next."""
        every_s = self.look_every_s if self.stop is None else self.stop.look_every_s
        return max(1, round(every_s * self.sample_rate_hz))

    def start(self) -> LiveIdentifier:
        """An identifier that knows nothing yet.

        Raises:
            UnusableInputError: the method cannot be started with these settings.
        """
        return start_identifier(self.method, self.sample_rate_hz, self.memory, self.window_s)


@dataclass(frozen=True, eq=False)
class News:
    """What came of the looks so far.

    ``enough`` says in words why it is, and is empty while it is not. ``busy_s`` is the processor time of all looks.
    ``problem`` is one line on what went wrong; nothing comes after.
    """

    view: LiveView | None = None
    enough: str = ""
    busy_s: float = 0.0
    problem: str = ""


def in_words(error: Exception) -> str:
    """What ended the looking, in one line."""
    if isinstance(error, TissueIDError):
        return str(error)
    return f"live identification ended by a defect: {type(error).__name__}: {' '.join(str(error).split())}"


class LiveLooks:
    """The looks at one test.

    Raises:
        UnusableInputError: the method cannot be started with these settings.
    """

    def __init__(self, settings: LiveSettings) -> None:
        self._settings = settings
        self._identifier = settings.start()
        self._store = np.empty((2, round(_FIRST_ROOM_S * settings.sample_rate_hz)))  # force and position
        self._taken = self._looked = 0
        self._looks: list[Precision] = []
        self._busy_s = 0.0
        self._ended = False
        self.news = News()

    def take(self, force: Array, position: Array) -> None:
        """Take force (k,), N, and position (k,), m, in the order of time; NaN where a sample was lost."""
        end = self._taken + force.size
        if end > self._store.shape[1]:
            store = np.empty((2, max(end, 2 * self._store.shape[1])))
            store[:, : self._taken] = self._store[:, : self._taken]
            self._store = store
        self._store[:, self._taken : end] = force, position
        self._taken = end

    def step(self, *, last: bool = False) -> bool:
        """Look, if a look is due, or at all that was taken if this is the last; True when ``news`` are new.

        Looks are due at fixed lengths of record. Where several have become due only the newest is made.
        """
        every = self._settings.look_every
        due = self._taken // every * every
        goal = self._taken if last else due
        if self.news.problem or self._ended or goal < (1 if last else self._looked + 1):
            return False
        self._ended = last
        begin = time.thread_time()
        seen, enough, problem = self.news.view, self.news.enough, ""
        try:
            seen = self._look(goal)
            rule = self._settings.stop
            if rule is not None and not enough and not last and rule.enough(self._looks):
                enough = rule.in_words(self._looks[-1])
        except Exception as error:  # noqa: BLE001 - a defect here must not end the test; it is told beside it
            problem = in_words(error)
        self._looked = goal
        self._busy_s += time.thread_time() - begin
        self.news = News(seen, enough, self._busy_s, problem)
        return True

    def rehearse(self) -> None:
        """Do everything once on noise, so that nothing is compiled or loaded at the first look."""
        rate = self._settings.sample_rate_hz
        noise = np.random.Generator(np.random.PCG64(0)).standard_normal((2, round(_REHEARSAL_S * rate)))
        identifier = self._settings.start()
        identifier.batch(noise[0], noise[1])
        with contextlib.suppress(UnusableInputError):  # a memory too long for so short a record
            view(identifier, [precision(Record(noise[0], np.cumsum(noise[0]), rate), self._settings.memory)])

    def _look(self, goal: int) -> LiveView:
        """Bring identifier and parameters up to so many samples."""
        force, position = self._store[:, self._looked : goal]
        self._identifier.batch(force, position)
        record = Record(self._store[0, :goal], self._store[1, :goal], self._settings.sample_rate_hz)
        with contextlib.suppress(UnusableInputError):  # too little yet, which the view says of itself
            look = precision(record, self._settings.memory)
            if self._looks and self._looks[-1].seconds == look.seconds:
                self._looks.pop()
            self._looks.append(look)
        return view(self._identifier, self._looks)
