"""The line to a device under test, its clock, and the person at the device."""

from __future__ import annotations

import time
from enum import Enum
from typing import Protocol

from tissueid.instrument.link import Link
from tissueid.language import marked


class Line(Protocol):
    """Bytes to and from the device, and the time in which they travel: real, or simulated in a test."""

    def read(self, timeout_s: float) -> bytes:
        """Return the bytes that have arrived; wait up to ``timeout_s`` for the first."""

    def write(self, data: bytes) -> None:
        """Send all of ``data``."""

    def clock(self) -> float:
        """Return the time in seconds."""

    def pause(self, seconds: float) -> None:
        """Let time pass without reading."""


class LinkLine:
    """A line over a port of this computer, in real time."""

    def __init__(self, link: Link) -> None:
        self._link = link

    def read(self, timeout_s: float) -> bytes:  # noqa: D102
        return self._link.read(timeout_s)

    def write(self, data: bytes) -> None:  # noqa: D102
        self._link.write(data)

    def clock(self) -> float:  # noqa: D102
        return time.monotonic()

    def pause(self, seconds: float) -> None:  # noqa: D102
        time.sleep(seconds)


class Act(Enum):
    """What a person does at the device for a clause; the value is the request to that person."""

    PRESS_BUTTON = marked("Press the button of the instrument, and hold it")
    RELEASE_BUTTON = marked("Release the button")
    LOWER_SUPPLY = marked("Switch the amplifier's supply off")
    RESTORE_SUPPLY = marked("Switch the amplifier's supply on")
    DISCONNECT_COIL = marked("Disconnect the coil")
    CONNECT_COIL = marked("Connect the coil")
    DISCONNECT_POSITION = marked("Disconnect the position sensor")
    CONNECT_POSITION = marked("Connect the position sensor")


class Attendant(Protocol):
    """The person at the device, or a test in place of one."""

    def perform(self, act: Act) -> float:
        """Request an act, and return the time in seconds within which it happens; 0: no person attends."""


class Unattended:
    """No person is at the device: clauses that need one are not begun."""

    def perform(self, act: Act) -> float:  # noqa: D102
        return 0.0
