"""Estimates of a running test, one for every quarter second of samples."""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from tissueid.errors import TissueIDError, UnusableInputError
from tissueid.identification.live.live_view import LiveIdentifier, LiveView, Method, start_identifier, view
from tissueid.identification.live.precision import Precision, precision
from tissueid.identification.live.stopping import StopRule
from tissueid.identification.online.identifier import RECENT_S
from tissueid.messages import Message, Verbatim
from tissueid.records import Record

Array = NDArray[np.float64]

_INITIAL_BUFFER_S = 32.0
"""Initial size of the buffer, s: the longest test of a profile."""

_REHEARSAL_S = 1.0
"""Length of the rehearsal, s."""


class LiveSettings(BaseModel):
    """Settings of a live identification."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    sample_rate_hz: float = Field(gt=0.0, le=1e6, description="Sample rate, Hz")
    method: Method = Field("sliding", description="Method of the impulse response")
    memory: float = Field(0.125, gt=0.0, le=10.0, description="Length of the impulse response, s")
    window_s: float | None = Field(RECENT_S, gt=0.0, description="Length of the sliding window, s")
    estimate_every_s: float = Field(0.25, ge=0.05, le=5.0, description="Interval of the estimates, s")
    stop: StopRule | None = Field(None, description="Stop rule, with an interval of its own")

    @property
    def estimate_every(self) -> int:
        """Number of samples between two estimates."""
        every_s = self.estimate_every_s if self.stop is None else self.stop.look_every_s
        return max(1, round(every_s * self.sample_rate_hz))

    def start(self) -> LiveIdentifier:
        """Return a new identifier.

        Raises:
            UnusableInputError: invalid settings of the method.
        """
        return start_identifier(self.method, self.sample_rate_hz, self.memory, self.window_s)


@dataclass(frozen=True, eq=False)
class LiveUpdate:
    """Result of the estimates so far.

    ``enough`` is the reason why the stop rule is met, "" until then. ``busy_s`` is the processor time of all
    estimates. ``problem`` is the error that ended them, "" without one.
    """

    view: LiveView | None = None
    enough: str = ""
    busy_s: float = 0.0
    problem: str = ""


def problem_of(error: Exception) -> str:
    """Return the message of an error that ended the estimates."""
    if isinstance(error, TissueIDError):
        return error.message
    return Message(
        "live.defect",
        "live identification ended by a defect: {kind}: {error}",
        kind=type(error).__name__,
        error=Verbatim(" ".join(str(error).split())),
    )


class LiveEstimator:
    """Estimator of one test.

    Raises:
        UnusableInputError: invalid settings of the method.
    """

    def __init__(self, settings: LiveSettings) -> None:
        self._settings = settings
        self._identifier = settings.start()
        self._store = np.empty((2, round(_INITIAL_BUFFER_S * settings.sample_rate_hz)))  # force and position
        self._taken = self._looked = 0
        self._looks: list[Precision] = []
        self._busy_s = 0.0
        self._ended = False
        self.update = LiveUpdate()

    def take(self, force: Array, position: Array) -> None:
        """Add force (k,), N, and position (k,), m, in order; NaN for lost samples."""
        end = self._taken + force.size
        if end > self._store.shape[1]:
            store = np.empty((2, max(end, 2 * self._store.shape[1])))
            store[:, : self._taken] = self._store[:, : self._taken]
            self._store = store
        self._store[:, self._taken : end] = force, position
        self._taken = end

    def step(self, *, last: bool = False) -> bool:
        """Make an estimate if one is due, or from all samples if ``last``; return whether ``update`` is new.

        Estimates are due at fixed record lengths. If several are due, only the newest is made.
        """
        every = self._settings.estimate_every
        due = self._taken // every * every
        goal = self._taken if last else due
        if self.update.problem or self._ended or goal < (1 if last else self._looked + 1):
            return False
        self._ended = last
        begin = time.thread_time()
        seen, enough, problem = self.update.view, self.update.enough, ""
        try:
            seen = self._estimate(goal)
            rule = self._settings.stop
            if rule is not None and not enough and not last and rule.enough(self._looks):
                enough = rule.in_words(self._looks[-1])
        except Exception as error:  # noqa: BLE001 - an error here must not end the test
            problem = problem_of(error)
        self._looked = goal
        self._busy_s += time.thread_time() - begin
        self.update = LiveUpdate(seen, enough, self._busy_s, problem)
        return True

    def rehearse(self) -> None:
        """Make an estimate from noise, so that all code is compiled and loaded before the first real one."""
        rate = self._settings.sample_rate_hz
        noise = np.random.Generator(np.random.PCG64(0)).standard_normal((2, round(_REHEARSAL_S * rate)))
        identifier = self._settings.start()
        identifier.batch(noise[0], noise[1])
        with contextlib.suppress(UnusableInputError):  # the memory is too long for this short record
            view(identifier, [precision(Record(noise[0], np.cumsum(noise[0]), rate), self._settings.memory)])

    def _estimate(self, goal: int) -> LiveView:
        """Update identifier and parameters to the first ``goal`` samples."""
        force, position = self._store[:, self._looked : goal]
        self._identifier.batch(force, position)
        record = Record(self._store[0, :goal], self._store[1, :goal], self._settings.sample_rate_hz)
        with contextlib.suppress(UnusableInputError):  # the record is still too short; the view shows it
            look = precision(record, self._settings.memory)
            if self._looks and self._looks[-1].seconds == look.seconds:
                self._looks.pop()
            self._looks.append(look)
        return view(self._identifier, self._looks)
