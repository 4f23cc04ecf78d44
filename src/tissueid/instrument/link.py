"""Links: bytes to and from a device. The only place that knows about ports."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import socket
import time
from typing import Protocol
from urllib.parse import urlsplit

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

SCHEMES = ("socket", "rfc2217")
"""Kinds of address besides the name of a port: TCP, and a serial port on the network."""

_SLICE_S = 0.01
"""How long one wait for the first byte lasts: a port's own timeout cannot be changed for every read."""

_READ = 65536
_CONNECT_S = 5.0
_WRITE_S = 1.0
_SHORTEST_S = 1e-3
"""A socket takes a timeout of nothing for another mode."""


class Link(Protocol):
    """A byte pipe. Every failure is a LinkLostError."""

    name: str

    def read(self, timeout_s: float) -> bytes:
        """Whatever has arrived; waits up to ``timeout_s`` for the first byte."""

    def write(self, data: bytes) -> None:
        """Send all of ``data``."""

    def close(self) -> None:
        """Let go of the port. Never raises."""


class _Port:
    """A port as pyserial knows it.

    Raises:
        ValueError: an address of a kind that is none of ``SCHEMES``: pyserial has some that write files, or guess.
    """

    def __init__(self, url: str) -> None:
        scheme, separator, _ = url.partition("://")
        if separator and scheme.lower() not in SCHEMES:
            raise ValueError(f"it is no kind of address that is known ({', '.join(f'{name}://' for name in SCHEMES)})")
        # Exclusive: a second program, or a search for instruments, must not read a running test's samples away.
        self._port = serial.serial_for_url(
            url, baudrate=BAUD_RATE, timeout=_SLICE_S, write_timeout=_WRITE_S, exclusive=True
        )
        self._port.reset_input_buffer()

    def read(self, timeout_s: float) -> bytes:
        deadline = time.monotonic() + timeout_s
        while True:
            # Asked for more than is there, a port waits for the rest until its timeout is over.
            data = bytes(self._port.read(1))
            if data:
                return data + bytes(self._port.read(min(self._port.in_waiting, _READ)))
            if time.monotonic() >= deadline:
                return data

    def write(self, data: bytes) -> None:
        self._port.write(data)

    def close(self) -> None:
        self._port.close()


class _Socket:
    """A TCP connection: pyserial's own cannot say how much has arrived, and so gives nothing before its timeout."""

    def __init__(self, url: str) -> None:
        self._socket = socket.create_connection(_address(url), timeout=_CONNECT_S)
        # A block of set-points must not wait until there are more.
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def read(self, timeout_s: float) -> bytes:
        self._socket.settimeout(max(timeout_s, _SHORTEST_S))
        try:
            data = self._socket.recv(_READ)
        except TimeoutError:
            return b""
        if not data:
            raise ConnectionError("the other end is gone")
        return data

    def write(self, data: bytes) -> None:
        self._socket.settimeout(_WRITE_S)
        self._socket.sendall(data)

    def close(self) -> None:
        self._socket.close()


class SerialLink:
    """A real port, a pseudo-terminal, ``rfc2217://host:port``, or TCP as ``socket://host:port``.

    Raises:
        InstrumentError: the port cannot be opened.
    """

    def __init__(self, url: str) -> None:
        self.name = url
        # pyserial says OSError for some unplugs and SerialException (an OSError too) for others.
        try:
            self._pipe = _Socket(url) if url.startswith("socket://") else _Port(url)
        except _PORT_ERRORS as error:
            raise unopened(url, error) from error

    def read(self, timeout_s: float) -> bytes:  # noqa: D102
        try:
            return self._pipe.read(timeout_s)
        except (OSError, TypeError) as error:  # TypeError: pyserial's read on a port closed meanwhile
            raise broken(self.name, error) from error

    def write(self, data: bytes) -> None:  # noqa: D102
        try:
            self._pipe.write(data)
        except (OSError, TypeError) as error:
            raise broken(self.name, error) from error

    def close(self) -> None:  # noqa: D102
        with contextlib.suppress(OSError):  # an unplugged port cannot be closed
            self._pipe.close()


def unopened(url: str, error: Exception) -> InstrumentError:
    """What to say of a port that cannot be opened."""
    taken = getattr(error, "errno", None) == errno.EAGAIN
    advice = "close it, and try again" if taken else "check the cable, the power and the name of the port"
    return InstrumentError(f"cannot open {url}: {_reason(error)}; {advice}")


def broken(name: str, error: Exception) -> LinkLostError:
    """What to say of the connection called ``name`` when a read or a write failed."""
    return LinkLostError(f"the connection to {name} broke: {_reason(error)}. Check the cable, and connect again")


def _address(url: str) -> tuple[str, int]:
    """Host and port of ``socket://HOST:PORT``."""
    with contextlib.suppress(ValueError):
        parts = urlsplit(url)
        if parts.hostname and parts.port is not None:
            return parts.hostname, parts.port
    raise ValueError("an address has the form socket://HOST:PORT")


def _reason(error: Exception) -> str:
    """Why, in the system's words; pyserial wraps them in its own, which name the port again."""
    number = getattr(error, "errno", None)
    if number == errno.EAGAIN:
        return "another program is using it"
    if number and number > 0:  # a name that cannot be resolved has a number of another kind
        return os.strerror(number)
    if not isinstance(error, OSError | ValueError) or "configure port" in str(error):
        return "it is not a serial port"
    if "returned no data" in str(error):
        return "the other end is gone"
    return re.sub(r"^.*: |\[Errno -?\d+\] ", "", str(error).splitlines()[0])
