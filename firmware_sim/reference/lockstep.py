"""Client of the reference firmware in lockstep: the caller gives bytes and time, and reads what the firmware sends."""

from __future__ import annotations

import struct
import subprocess
from enum import IntFlag
from pathlib import Path
from types import TracebackType
from typing import Self


class Disturbance(IntFlag):
    """Disturbances of the plant behind the board layer."""

    NONE = 0
    BUTTON = 1
    SUPPLY_LOW = 2
    POSITION_STUCK = 4
    COIL_OPEN = 8


class Lockstep:
    """A process of the reference firmware that advances only on request.

    Args:
        program: built POSIX board.
        options: further options of it, such as ``("--plant", "dummy")``.
    """

    def __init__(self, program: Path, *options: str) -> None:
        self._process = subprocess.Popen(
            [program, "--lockstep", *options], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )

    def receive(self, data: bytes, now_us: int) -> None:
        """Give bytes of the host to the firmware, at a time of its clock in microseconds."""
        self._write(b"R" + struct.pack("<QI", now_us, len(data)) + data)

    def advance(self, samples: int, now_us: int) -> None:
        """Play and take samples, all at one time, in the order of the Python firmware."""
        self._write(b"A" + struct.pack("<QI", now_us, samples))

    def interrupts(self, samples: int) -> None:
        """Run the sample interrupt, each time one sample period later."""
        self._write(b"V" + struct.pack("<I", samples))

    def disturb(self, disturbance: Disturbance) -> None:
        """Set the disturbances of the plant."""
        self._write(b"W" + bytes((disturbance,)))

    def transmit(self) -> bytes:
        """Return the bytes that the firmware wants to send.

        Raises:
            RuntimeError: the process ended; the message is its standard error.
        """
        self._write(b"T")
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            self._process.stdin.flush()
        except BrokenPipeError:
            raise self._ended() from None
        head = self._process.stdout.read(4)
        if len(head) < 4:
            raise self._ended()
        return self._process.stdout.read(struct.unpack("<I", head)[0])

    def _write(self, data: bytes) -> None:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(data)
        except BrokenPipeError:
            raise self._ended() from None

    def _ended(self) -> RuntimeError:
        assert self._process.stderr is not None
        self._process.wait()
        return RuntimeError(self._process.stderr.read().decode(errors="replace") or "the firmware process ended")

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.communicate()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()
