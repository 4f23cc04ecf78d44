"""Standard output and error that never hold up a test: a thread of its own does the writing.

A terminal that does not take output (Ctrl+S), or a program that does not read its pipe, would otherwise stop the loop
that keeps the coil alive, or the writing of the session. A stream that is closed, or whose reader is gone, loses what
is printed; it does not end the command.
"""

from __future__ import annotations

import contextlib
import io
import os
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TextIO

MAX_ERROR = 256 * 1024
"""Bytes of standard error that may wait; what comes then is dropped: it is progress."""
MAX_OUTPUT = 4 * 1024 * 1024
"""Bytes of standard output that may wait; then whoever prints waits: results come after everything is saved."""
PATIENCE_S = 5.0
"""How long the end of a command waits for a terminal that takes nothing, where no result waits for it."""
_PIECE = 64 * 1024


class _Writer:
    """Writes what all streams were given, in their order."""

    def __init__(self) -> None:
        self._change = threading.Condition()
        self._waiting: deque[tuple[Stream, bytes]] = deque()
        self._thread: threading.Thread | None = None

    def put(self, stream: Stream, data: bytes) -> None:
        with self._change:
            if stream.broken is not None:
                return
            if stream.waiting + len(data) > stream.most and not stream.results:
                return
            while stream.waiting > stream.most and stream.broken is None:
                self._change.wait()
            stream.waiting += len(data)
            self._waiting.append((stream, data))
            if self._thread is None:
                self._thread = threading.Thread(target=self._write, name="standard streams", daemon=True)
                self._thread.start()
            self._change.notify_all()

    def drain(self, stream: Stream, timeout_s: float | None) -> None:
        """Wait until all of a stream is written, or was lost."""
        end = None if timeout_s is None else time.monotonic() + timeout_s
        with self._change:
            while stream.waiting and (end is None or time.monotonic() < end):
                self._change.wait(None if end is None else max(0.0, end - time.monotonic()))

    def _write(self) -> None:
        while True:
            with self._change:
                while not self._waiting:
                    self._change.wait()
                stream, data = self._waiting.popleft()
            stream.write_through(data)
            with self._change:
                stream.waiting -= len(data)
                self._change.notify_all()


class Stream:
    """One of the standard streams: as the original, but for ``write``, which never raises and does not wait.

    ``results`` are standard output's: they are not dropped.
    """

    def __init__(self, original: TextIO, writer: _Writer, *, results: bool, broken: OSError | None) -> None:
        self._original = original
        self._writer = writer
        self.results = results
        self.most = MAX_OUTPUT if results else MAX_ERROR
        self.broken = broken
        """Why nothing is written any more."""
        self.waiting = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._original, name)

    def write(self, text: str) -> int:
        """Have a text written; it is lost where the stream is closed."""
        data = text.encode(self._original.encoding or "utf-8", "backslashreplace")
        for first in range(0, len(data), _PIECE):
            self._writer.put(self, data[first : first + _PIECE])
        return len(text)

    def writelines(self, lines: Any) -> None:
        """Have texts written."""
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        """Do nothing: all is written at once, or as soon as it can be."""

    def deliver(self, timeout_s: float | None = None) -> None:
        """Wait until all that was written has left the program.

        Raises:
            OSError: it could not be.
        """
        self._writer.drain(self, timeout_s)
        if self.broken is not None:
            raise OSError(self.broken.errno, self.broken.strerror, "standard output")

    def write_through(self, data: bytes) -> None:
        """Write now, in the thread that may wait."""
        try:
            raw = getattr(getattr(self._original, "buffer", None), "raw", None)
            if raw is None:
                self._original.write(data.decode(self._original.encoding or "utf-8"))
                self._original.flush()
                return
            view = memoryview(data)
            while view:
                view = view[raw.write(view) or 0 :]
        except (OSError, ValueError) as error:
            self.broken = self.broken or (error if isinstance(error, OSError) else OSError(None, str(error)))


@contextmanager
def unblocked_streams() -> Iterator[Stream]:
    """Put a thread between the program and its standard streams for as long as the context lasts; gives the output."""
    _occupy_closed()
    before = sys.stdout, sys.stderr
    writer = _Writer()
    with open(os.devnull, "w", encoding="utf-8") as nowhere:  # noqa: PTH123 - it is no file
        streams = [
            Stream(original or nowhere, writer, results=number == 0, broken=None if original else OSError(9, "closed"))
            for number, original in enumerate(before)
        ]
        for original in before:
            with contextlib.suppress(OSError, ValueError, AttributeError):
                original.flush()
        sys.stdout, sys.stderr = streams  # type: ignore[assignment]
        interrupted = True
        try:
            yield streams[0]
            interrupted = False
        finally:
            output, error = streams
            with contextlib.suppress(OSError):
                output.deliver(PATIENCE_S if interrupted else None)
            with contextlib.suppress(OSError):
                error.deliver(PATIENCE_S)
            sys.stdout, sys.stderr = before
            for stream, original in zip(streams, before, strict=True):
                if stream.broken is not None and original is not None:
                    _forget(original)


def _occupy_closed() -> None:
    """Open the null device as each of the three standard files that is closed: no file of data may get its number."""
    with contextlib.suppress(OSError):
        for number in range(3):
            try:
                os.fstat(number)
            except OSError:
                if os.open(os.devnull, os.O_RDWR) != number:
                    return


def _forget(original: TextIO) -> None:
    """Have Python not complain at its end of a stream whose reader is gone."""
    with contextlib.suppress(OSError, ValueError, AttributeError, io.UnsupportedOperation):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, original.fileno())
        os.close(nowhere)
