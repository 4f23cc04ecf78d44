"""Live identification in a process of its own: its numerics can never hold up the loop that polls.

A thread would share the interpreter's lock with that loop, and on a busy machine the loop waits whenever the thread
that holds the lock is put aside; the heartbeat would stop for as long (docs/decisions/0002-one-heartbeat-one-loop.md).
Force and position go to the process through its input, news come back through its output.
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

from tissueid.acquisition.live_looks import Array, LiveLooks, LiveSettings, News, in_words
from tissueid.children import start

MOST_SHARE = 0.2
"""Share of a core that the looking may take: where it would take more, it looks less often."""

LAST_LOOK_S = 10.0
"""How long the last look is waited for."""

_COUNT = struct.Struct("<q")
_CLOSING = -1
_NICENESS = 5
_COMMAND = "from tissueid.acquisition.live_process import serve; serve()"


class LiveProcess:
    """The process, as the loop that polls sees it: samples in, news out, and no call that waits but ``close``.

    Raises:
        UnusableInputError: the method cannot be started with these settings.
    """

    def __init__(self, settings: LiveSettings) -> None:
        settings.start()  # what does not hold is refused here, and not by a process that ends
        self.news = News()
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
                # In a group of its own Ctrl+C does not reach it: it ends when its input does.
                start_new_session=sys.platform != "win32",
                creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
            )
        except OSError as error:
            self._end(f"live identification could not be started: {error.strerror or error}")
            return
        self._threads = [
            threading.Thread(target=work, args=(stream,), name="live identification", daemon=True)
            for work, stream in ((self._tell, self._process.stdin), (self._hear, self._process.stdout))
        ]
        for thread in self._threads:
            thread.start()

    def take(self, force: Array, position: Array) -> None:
        """Hand over force (k,), N, and position (k,), m; never waits."""
        self._waiting.put(_COUNT.pack(force.size) + force.tobytes() + position.tobytes())

    def close(self) -> None:
        """Have a last look at all that was handed over, and end. May be called again."""
        if self._closing or self._process is None:
            return
        self._closing = True
        self._waiting.put(_COUNT.pack(_CLOSING))
        self._waiting.put(None)
        try:
            self._process.wait(LAST_LOOK_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
            self._end("live identification did not end in time and was stopped")
        for thread in self._threads:
            thread.join()

    def _tell(self, stream: IO[bytes]) -> None:
        """Send what waits; a pipe that is full holds up this thread alone."""
        with contextlib.suppress(OSError), stream:  # a process that is gone is told of by the other thread
            while (block := self._waiting.get()) is not None:
                stream.write(block)
                stream.flush()

    def _hear(self, stream: IO[bytes]) -> None:
        """Take the newest news as it comes, until the process ends."""
        with stream:
            while True:
                try:
                    news = pickle.load(stream)  # noqa: S301 - written by this program's own child
                except (EOFError, OSError, pickle.UnpicklingError):
                    break
                if isinstance(news, News):
                    self.news = news
        if not self._closing:
            self._end("live identification ended unexpectedly")

    def _end(self, problem: str) -> None:
        if not self.news.problem:
            self.news = replace(self.news, problem=problem)


def serve() -> None:
    """The process itself: look until the input ends. What ends it sooner is told as its last news."""
    incoming, outgoing = sys.stdin.buffer, sys.stdout.buffer
    sys.stdout = sys.stderr  # whatever else is printed must not mix with the news
    try:
        _look(incoming, outgoing)
    except Exception as error:  # noqa: BLE001 - nobody reads what this process prints; the test goes on beside it
        _publish(outgoing, News(problem=in_words(error)))


def _look(incoming: IO[bytes], outgoing: IO[bytes]) -> None:
    looks = LiveLooks(LiveSettings.model_validate_json(incoming.readline()))
    looks.rehearse()
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
                looks.take(*block)
                block = blocks.get_nowait()
            break
        except queue.Empty:
            pass
        busy_s = looks.news.busy_s
        if time.monotonic() >= resting_until and looks.step():
            _publish(outgoing, looks.news)
            resting_until = time.monotonic() + (looks.news.busy_s - busy_s) * (1.0 / MOST_SHARE - 1.0)
    if looks.step(last=True):
        _publish(outgoing, looks.news)


def _receive(incoming: IO[bytes], blocks: queue.SimpleQueue[tuple[Array, Array] | None]) -> None:
    """Read block after block; None when the other side closes or is gone."""
    try:
        while True:
            head = incoming.read(_COUNT.size)
            count = _COUNT.unpack(head)[0] if len(head) == _COUNT.size else _CLOSING
            body = b"" if count < 0 else incoming.read(16 * count)
            if count < 0 or len(body) < 16 * count:
                return
            force, position = np.frombuffer(body).reshape(2, count)
            blocks.put((force, position))
    finally:  # whatever ends the reading, the looking must not wait for more
        blocks.put(None)


def _publish(outgoing: IO[bytes], news: News) -> None:
    with contextlib.suppress(OSError):  # nobody listens any more; the end of the input follows
        pickle.dump(news, outgoing, protocol=pickle.HIGHEST_PROTOCOL)
        outgoing.flush()
