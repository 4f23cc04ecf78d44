"""Standard output and error that never block a test: a separate thread writes them.

A terminal that accepts no output (Ctrl+S), or a program that does not read its pipe, would otherwise stop the control
loop of the coil or the writing of the session. Output to a closed stream is lost; it does not end the command.
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
"""Buffer of standard error in bytes; further output is dropped, because it is only progress."""
MAX_OUTPUT = 4 * 1024 * 1024
"""Buffer of standard output in bytes; a full buffer blocks, which is safe: results are printed after saving."""
FLUSH_TIMEOUT_S = 5.0
"""Time that the end of a command waits for a terminal that accepts no output, if no result is pending."""
_PIECE = 64 * 1024


class Writer:
    """Writes the output of all streams in order."""

    def __init__(self) -> None:
        self._change = threading.Condition()
        self._waiting: deque[tuple[Stream, bytes]] = deque()
        self._thread: threading.Thread | None = None

    def put(self, stream: Stream, data: bytes) -> None:
        """Queue output of a stream, or drop it if the stream has no room and no results."""
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
        """Wait until the output of a stream is written or lost."""
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
    """A standard stream whose ``write`` raises no errors and does not block.

    The output of a stream with ``results`` is not dropped.
    """

    def __init__(self, original: TextIO, writer: Writer, *, results: bool, broken: OSError | None) -> None:
        self._original = original
        self._writer = writer
        self.results = results
        self.most = MAX_OUTPUT if results else MAX_ERROR
        self.broken = broken
        """The error after which nothing is written any more."""
        self.waiting = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._original, name)

    def write(self, text: str) -> int:
        """Queue a text for writing; it is lost if the stream is closed."""
        data = text.encode(self._original.encoding or "utf-8", "backslashreplace")
        for first in range(0, len(data), _PIECE):
            self._writer.put(self, data[first : first + _PIECE])
        return len(text)

    def writelines(self, lines: Any) -> None:
        """Queue several texts for writing."""
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        """Do nothing: the thread writes without delay."""

    def deliver(self, timeout_s: float | None = None) -> None:
        """Wait until all output has left the program.

        Raises:
            OSError: the output could not be written.
        """
        self._writer.drain(self, timeout_s)
        if self.broken is not None:
            raise OSError(self.broken.errno, self.broken.strerror, "standard output")

    def write_through(self, data: bytes) -> None:
        """Write in the writer thread, which may block."""
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
    """Replace the standard streams by non-blocking ones while the context lasts; yield standard output."""
    _occupy_closed()
    before = sys.stdout, sys.stderr
    writer = Writer()
    with open(os.devnull, "w", encoding="utf-8") as nowhere:  # noqa: PTH123 - the null device
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
                output.deliver(FLUSH_TIMEOUT_S if interrupted else None)
            with contextlib.suppress(OSError):
                error.deliver(FLUSH_TIMEOUT_S)
            sys.stdout, sys.stderr = before
            for stream, original in zip(streams, before, strict=True):
                if stream.broken is not None and original is not None:
                    _forget(original)


def _occupy_closed() -> None:
    """Open the null device for each closed standard stream, so that no data file gets its file number."""
    with contextlib.suppress(OSError):
        for number in range(3):
            try:
                os.fstat(number)
            except OSError:
                if os.open(os.devnull, os.O_RDWR) != number:
                    return


def _forget(original: TextIO) -> None:
    """Redirect a stream whose reader is gone, so that Python prints no error at exit."""
    with contextlib.suppress(OSError, ValueError, AttributeError, io.UnsupportedOperation):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, original.fileno())
        os.close(nowhere)
