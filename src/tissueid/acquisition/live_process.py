"""Live identification in a separate process, so that its computations do not delay the polling loop.

A thread would share the interpreter lock with that loop; on a busy machine the heartbeat would stop while the thread
holding the lock is preempted (docs/decisions/0002-heartbeat-from-the-sample-loop.md). The process receives force and
position on its standard input and returns updates on its standard output.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import queue
import struct
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, replace
from typing import IO

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from tissueid.child_process import start
from tissueid.errors import TissueIDError, UnusableInputError
from tissueid.identification.live.live_view import LiveIdentifier, LiveView, Method, start_identifier, view
from tissueid.identification.live.stopping import Precision, StopRule, precision
from tissueid.identification.online_identifier import RECENT_S
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


MAX_CPU_SHARE = 0.2
"""Maximum share of a core; slower estimates are made less often."""

FINAL_ESTIMATE_S = 10.0
"""Timeout of the final estimate, s."""

_COUNT = struct.Struct("<q")
_CLOSING = -1
_NICENESS = 5
COMMAND = "from tissueid.acquisition.live_process import serve; serve()"


class LiveProcess:
    """Interface of the polling loop to the process. Only ``close`` waits.

    Raises:
        UnusableInputError: invalid settings of the method.
    """

    def __init__(self, settings: LiveSettings) -> None:
        settings.start()  # invalid settings are refused here
        self.update = LiveUpdate()
        self._waiting: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._waiting.put(settings.model_dump_json().encode() + b"\n")
        self._closing = False
        self.process: subprocess.Popen[bytes] | None = None
        self.threads: list[threading.Thread] = []
        try:
            self.process = start(
                "-c",
                COMMAND,
                environment={"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                # In a separate group, Ctrl+C does not reach it: it ends when its input ends.
                start_new_session=sys.platform != "win32",
                creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
            )
        except OSError as error:
            self._end(
                Message(
                    "live.not_started",
                    "live identification could not be started: {reason}",
                    reason=str(error.strerror or error),
                )
            )
            return
        self.threads = [
            threading.Thread(target=work, args=(stream,), name="live identification", daemon=True)
            for work, stream in (
                (self._send_blocks, self.process.stdin),
                (self._receive_updates, self.process.stdout),
            )
        ]
        for thread in self.threads:
            thread.start()

    def take(self, force: Array, position: Array) -> None:
        """Pass on force (k,), N, and position (k,), m; never waits."""
        self._waiting.put(_COUNT.pack(force.size) + force.tobytes() + position.tobytes())

    def close(self) -> None:
        """Wait for a final estimate from all samples, and end the process. May be called more than once."""
        if self._closing or self.process is None:
            return
        self._closing = True
        self._waiting.put(_COUNT.pack(_CLOSING))
        self._waiting.put(None)
        try:
            self.process.wait(FINAL_ESTIMATE_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            self._end(Message("live.stopped", "live identification did not end in time and was stopped"))
        for thread in self.threads:
            thread.join()

    def _send_blocks(self, stream: IO[bytes]) -> None:
        """Send queued blocks; a full pipe blocks only this thread."""
        with contextlib.suppress(OSError), stream:  # the other thread reports an ended process
            while (block := self._waiting.get()) is not None:
                stream.write(block)
                stream.flush()

    def _receive_updates(self, stream: IO[bytes]) -> None:
        """Receive updates until the process ends."""
        with stream:
            while True:
                try:
                    update = pickle.load(stream)  # noqa: S301 - written by this program's own child
                except (EOFError, OSError, pickle.UnpicklingError):
                    break
                if isinstance(update, LiveUpdate):
                    self.update = update
        if not self._closing:
            self._end(Message("live.ended", "live identification ended unexpectedly"))

    def _end(self, problem: str) -> None:
        if not self.update.problem:
            self.update = replace(self.update, problem=problem)


def serve() -> None:
    """Entry point of the process: make estimates until the input ends. An error is sent as the last update."""
    incoming, outgoing = sys.stdin.buffer, sys.stdout.buffer
    sys.stdout = sys.stderr  # other output must not mix with the updates
    try:
        _estimate(incoming, outgoing)
    except Exception as error:  # noqa: BLE001 - the test continues; the parent shows the error
        _publish(outgoing, LiveUpdate(problem=problem_of(error)))


def _estimate(incoming: IO[bytes], outgoing: IO[bytes]) -> None:
    estimator = LiveEstimator(LiveSettings.model_validate_json(incoming.readline()))
    estimator.rehearse()
    if hasattr(os, "nice"):
        os.nice(_NICENESS)
    blocks: queue.SimpleQueue[tuple[Array, Array] | None] = queue.SimpleQueue()
    threading.Thread(target=_receive, args=(incoming, blocks), daemon=True).start()
    resting_until = 0.0
    while True:
        rest = resting_until - time.monotonic()
        try:
            block = blocks.get(timeout=rest) if rest > 0.0 else blocks.get()
            while block is not None:
                estimator.take(*block)
                block = blocks.get_nowait()
            break
        except queue.Empty:
            pass
        busy_s = estimator.update.busy_s
        if time.monotonic() >= resting_until and estimator.step():
            _publish(outgoing, estimator.update)
            resting_until = time.monotonic() + (estimator.update.busy_s - busy_s) * (1.0 / MAX_CPU_SHARE - 1.0)
    if estimator.step(last=True):
        _publish(outgoing, estimator.update)


def _receive(incoming: IO[bytes], blocks: queue.SimpleQueue[tuple[Array, Array] | None]) -> None:
    """Read blocks; put None when the input ends."""
    try:
        while True:
            head = incoming.read(_COUNT.size)
            count = _COUNT.unpack(head)[0] if len(head) == _COUNT.size else _CLOSING
            body = b"" if count < 0 else incoming.read(16 * count)
            if count < 0 or len(body) < 16 * count:
                return
            force, position = np.frombuffer(body).reshape(2, count)
            blocks.put((force, position))
    finally:  # the estimator must not wait for more
        blocks.put(None)


def _publish(outgoing: IO[bytes], update: LiveUpdate) -> None:
    with contextlib.suppress(OSError):  # the parent has ended; the end of the input follows
        pickle.dump(update, outgoing, protocol=pickle.HIGHEST_PROTOCOL)
        outgoing.flush()
