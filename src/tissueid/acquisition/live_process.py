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
from dataclasses import replace
from typing import IO

import numpy as np

from tissueid.acquisition.live_estimator import Array, LiveEstimator, LiveSettings, LiveUpdate, problem_of
from tissueid.child_process import start
from tissueid.messages import Message

MAX_CPU_SHARE = 0.2
"""Maximum share of a core; slower estimates are made less often."""

FINAL_ESTIMATE_S = 10.0
"""Timeout of the final estimate, s."""

_COUNT = struct.Struct("<q")
_CLOSING = -1
_NICENESS = 5
_COMMAND = "from tissueid.acquisition.live_process import serve; serve()"


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
        self._process: subprocess.Popen[bytes] | None = None
        self._threads: list[threading.Thread] = []
        try:
            self._process = start(
                "-c",
                _COMMAND,
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
        self._threads = [
            threading.Thread(target=work, args=(stream,), name="live identification", daemon=True)
            for work, stream in (
                (self._send_blocks, self._process.stdin),
                (self._receive_updates, self._process.stdout),
            )
        ]
        for thread in self._threads:
            thread.start()

    def take(self, force: Array, position: Array) -> None:
        """Pass on force (k,), N, and position (k,), m; never waits."""
        self._waiting.put(_COUNT.pack(force.size) + force.tobytes() + position.tobytes())

    def close(self) -> None:
        """Wait for a final estimate from all samples, and end the process. May be called more than once."""
        if self._closing or self._process is None:
            return
        self._closing = True
        self._waiting.put(_COUNT.pack(_CLOSING))
        self._waiting.put(None)
        try:
            self._process.wait(FINAL_ESTIMATE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
            self._end(Message("live.stopped", "live identification did not end in time and was stopped"))
        for thread in self._threads:
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
