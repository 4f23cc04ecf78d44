"""Links: bytes to and from a device. The only module that uses serial ports and sockets."""

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
from tissueid.messages import Message

BAUD_RATE = 921_600
"""Bits per second: twice the rate of eight 16-bit channels at 2 kHz. USB and pseudo-terminal links ignore it."""

try:
    import termios
except ImportError:  # Windows
    _PORT_ERRORS: tuple[type[Exception], ...] = (OSError, ValueError)
else:
    _PORT_ERRORS = (OSError, ValueError, termios.error)

SCHEMES = ("socket", "rfc2217")
"""Supported URL schemes, in addition to the plain name of a port: TCP, and a serial port on the network."""

_SLICE_S = 0.01
"""Duration of one wait for the first byte, s: the timeout of a port cannot be changed for each read."""

_READ = 65536
_CONNECT_S = 5.0
_WRITE_S = 1.0
_SHORTEST_S = 1e-3
"""Shortest timeout of a socket, s: 0 would make it non-blocking."""


_CLOSED = Message("link.closed", "the other end closed the connection")


class Link(Protocol):
    """A bidirectional stream of bytes. Every failure raises LinkLostError."""

    name: str

    def read(self, timeout_s: float) -> bytes:
        """Return the bytes that have arrived; wait up to ``timeout_s`` for the first."""

    def write(self, data: bytes) -> None:
        """Send all of ``data``."""

    def close(self) -> None:
        """Close the port. Never raises."""


class _Port:
    """A port of pyserial.

    Raises:
        ValueError: the scheme of the URL is not one of ``SCHEMES``. Other schemes of pyserial write files or guess.
    """

    def __init__(self, url: str) -> None:
        scheme, separator, _ = url.partition("://")
        if separator and scheme.lower() not in SCHEMES:
            schemes = ", ".join(f"{name}://" for name in SCHEMES)
            raise ValueError(Message("link.scheme", "this kind of address is not supported ({known})", known=schemes))
        # Exclusive: a second program, or a search for instruments, must not take samples of a running test.
        self._port = serial.serial_for_url(
            url, baudrate=BAUD_RATE, timeout=_SLICE_S, write_timeout=_WRITE_S, exclusive=True
        )
        self._port.reset_input_buffer()

    def read(self, timeout_s: float) -> bytes:
        deadline = time.monotonic() + timeout_s
        while True:
            # A read of more bytes than have arrived would wait for the whole timeout.
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
    """A TCP connection. The one of pyserial does not know how many bytes have arrived, so it waits for its timeout."""

    def __init__(self, url: str) -> None:
        self._socket = socket.create_connection(_address(url), timeout=_CONNECT_S)
        # Send each block of set-points at once.
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def read(self, timeout_s: float) -> bytes:
        self._socket.settimeout(max(timeout_s, _SHORTEST_S))
        try:
            data = self._socket.recv(_READ)
        except TimeoutError:
            return b""
        if not data:
            raise ConnectionError(_CLOSED)
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
        try:
            self._pipe = _Socket(url) if url.startswith("socket://") else _Port(url)
        except _PORT_ERRORS as error:
            raise open_error(url, error) from error

    def read(self, timeout_s: float) -> bytes:  # noqa: D102
        try:
            return self._pipe.read(timeout_s)
        except (OSError, TypeError) as error:  # TypeError: pyserial reads a port that was just closed
            raise broken_error(self.name, error) from error

    def write(self, data: bytes) -> None:  # noqa: D102
        try:
            self._pipe.write(data)
        except (OSError, TypeError) as error:
            raise broken_error(self.name, error) from error

    def close(self) -> None:  # noqa: D102
        with contextlib.suppress(OSError):  # an unplugged port raises
            self._pipe.close()


def open_error(url: str, error: Exception) -> InstrumentError:
    """Return the error for a port that cannot be opened."""
    if getattr(error, "errno", None) == errno.EAGAIN:
        message = Message(
            "link.in_use",
            "cannot open {port}: another program is using it; close that program, and try again",
            port=url,
        )
    else:
        message = Message(
            "link.not_opened",
            "cannot open {port}: {why}; check the cable, the power and the name of the port",
            port=url,
            why=_reason(error),
        )
    return InstrumentError(message)


def broken_error(name: str, error: Exception) -> LinkLostError:
    """Return the error for a failed read or write on the port called ``name``."""
    message = Message(
        "link.broken",
        "the connection to {port} broke: {why}. Check the cable, and connect again",
        port=name,
        why=_reason(error),
    )
    return LinkLostError(message)


def _address(url: str) -> tuple[str, int]:
    """Return host and port of ``socket://HOST:PORT``."""
    with contextlib.suppress(ValueError):
        parts = urlsplit(url)
        if parts.hostname and parts.port is not None:
            return parts.hostname, parts.port
    raise ValueError(Message("link.address", "an address has the form socket://HOST:PORT"))


def _reason(error: Exception) -> str:
    """Return why a port failed: a message, or the text of the system without the name of the port."""
    if error.args and isinstance(error.args[0], Message):
        return error.args[0]
    number = getattr(error, "errno", None)
    if number == errno.EAGAIN:
        return Message("link.used", "another program is using it")
    if number and number > 0:  # errors of name resolution have negative numbers
        return os.strerror(number)
    if not isinstance(error, OSError | ValueError) or "configure port" in str(error):
        return Message("link.no_serial_port", "it is not a serial port")
    if "returned no data" in str(error):
        return _CLOSED
    return re.sub(r"^.*: |\[Errno -?\d+\] ", "", str(error).splitlines()[0])
