"""Links: bytes to and from a device. The only place that knows about ports."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import time
from typing import Protocol

import serial

from tissueid.errors import InstrumentError, LinkLostError

BAUD_RATE = 921_600
"""Twice what 2 kHz of eight 16-bit channels needs; a USB or pseudo-terminal link ignores it."""


try:
    import termios
except ImportError:  # Windows
    _PORT_ERRORS: tuple[type[Exception], ...] = (OSError, ValueError)
else:
    _PORT_ERRORS = (OSError, ValueError, termios.error)

_SLICE_S = 0.01
"""One data frame's worth: a read gathers what arrives in this time, on ports and sockets alike."""


class Link(Protocol):
    """A byte pipe. Every failure is a LinkLostError."""

    name: str

    def read(self, timeout_s: float) -> bytes:
        """Whatever has arrived; waits up to ``timeout_s`` for the first byte."""

    def write(self, data: bytes) -> None:
        """Send all of ``data``."""

    def close(self) -> None:
        """Let go of the port. Never raises."""


class SerialLink:
    """A real port, a pseudo-terminal, or TCP as ``socket://host:port`` (pyserial's URLs).

    Raises:
        InstrumentError: the port cannot be opened.
    """

    def __init__(self, url: str) -> None:
        self.name = url
        # pyserial says OSError for some unplugs and SerialException (an OSError too) for others.
        try:
            # Exclusive: a second program, or a search for instruments, must not read a running test's samples away.
            self._port = serial.serial_for_url(
                url, baudrate=BAUD_RATE, timeout=_SLICE_S, write_timeout=1.0, exclusive=True
            )
            self._port.reset_input_buffer()
        except _PORT_ERRORS as error:
            raise InstrumentError(f"cannot open {url}: {_reason(error)}") from error

    def read(self, timeout_s: float) -> bytes:  # noqa: D102
        deadline = time.monotonic() + timeout_s
        try:
            while True:
                data = bytes(self._port.read(65536))
                if data or time.monotonic() >= deadline:
                    return data
        except (OSError, TypeError) as error:  # TypeError: pyserial's read on a port closed meanwhile
            raise LinkLostError(f"the connection to {self.name} broke: {_reason(error)}") from error

    def write(self, data: bytes) -> None:  # noqa: D102
        try:
            self._port.write(data)
        except (OSError, TypeError) as error:
            raise LinkLostError(f"the connection to {self.name} broke: {_reason(error)}") from error

    def close(self) -> None:  # noqa: D102
        # pyserial forgets a socket whose other end hung up first.
        forgotten = getattr(self._port, "_socket", None)
        with contextlib.suppress(OSError):  # an unplugged port cannot be closed
            self._port.close()
        if forgotten is not None:
            forgotten.close()


def _reason(error: Exception) -> str:
    """Why, in the system's words; pyserial wraps them in its own, which name the port again."""
    number = getattr(error, "errno", None)
    if number == errno.EAGAIN:
        return "another program is using it"
    if number:
        return os.strerror(number)
    if not isinstance(error, OSError | ValueError) or "configure port" in str(error):
        return "it is not a serial port"
    if "not supported between" in str(error):
        return "an address has the form socket://HOST:PORT"
    if "returned no data" in str(error):
        return "the other end is gone"
    return re.sub(r"^.*: |\[Errno -?\d+\] ", "", str(error).splitlines()[0])
