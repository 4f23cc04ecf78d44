"""The reference firmware on an emulated microcontroller: QEMU's mps2-an500, in real time or in lockstep with a test.

In lockstep the emulator's clock counts instructions, and the timers of the board run only for the samples that are
granted: the sample interrupt, the plant and the clock of the test advance together, however busy the computer is.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import select
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from types import TracebackType
from typing import Self

from firmware_sim.reference.build import QEMU, build
from firmware_sim.reference.lockstep import Disturbance
from firmware_sim.reference.tools import MissingToolError, tool

TICKS_PER_S = 25_000_000
"""Ticks of the board's timers per second."""

_SHIFT = 6
"""Two to this power are the nanoseconds of one instruction: 64 ns, 1.6 cycles of 25 MHz."""

INSTRUCTIONS_PER_TICK = 1e9 / TICKS_PER_S / (1 << _SHIFT)
"""Instructions in the time of one tick."""

_STRAPS = 0x203FFFF0
_LOCKSTEP = 1
_PLANTS = {"tissue": 0x000, "free": 0x100, "dummy": 0x200, "script": 0x300}
_ANSWER_S = 30.0
"""Longest real time of a grant; a busy computer may need a second."""


def emulator_command(program: Path, *options: str, straps: int = 0, boot_id: int = 0x51E3A) -> list[str]:
    """Return the command that runs the QEMU target.

    Args:
        program: built QEMU target.
        options: further options, with those of the serial ports: the first is the line to the host.
        straps: bits that the board reads at its start.
        boot_id: of this start.

    Raises:
        MissingToolError: QEMU is not installed.
    """
    emulator = tool("qemu: not run", "qemu-system-arm")
    words = ((_STRAPS, straps), (_STRAPS + 4, boot_id))
    loaders = [part for at, word in words for part in ("-device", f"loader,addr={at:#x},data={word:#x},data-len=4")]
    machine = [emulator, "-M", "mps2-an500", "-display", "none", "-monitor", "none", "-kernel", str(program)]
    return [*machine, *loaders, *options]


class EmulatedLockstep:
    """An emulated microcontroller that advances only on request.

    Args:
        program: built QEMU target.
        plant: as of the POSIX board: ``tissue``, ``free``, ``dummy`` or ``script``.
        boot_id: of this start.

    Raises:
        MissingToolError: QEMU is not installed.
        RuntimeError: the emulator ended; the message is its standard error.
    """

    def __init__(self, program: Path, plant: str = "free", boot_id: int = 0x51E3A) -> None:
        self.longest_interrupt_ticks = self.longest_mask_ticks = 0
        self._disturbance = Disturbance.NONE
        self._received = b""
        self._written = self._arrived = self._announced = 0
        with contextlib.ExitStack() as stack:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            self._line = _Pipe(folder / "line", stack)
            self._grants = _Pipe(folder / "grants", stack)
            command = emulator_command(
                program,
                *("-icount", f"shift={_SHIFT},sleep=off,align=off"),
                *(part for name in ("line", "grants") for part in ("-chardev", f"pipe,id={name},path={folder / name}")),
                *("-serial", "chardev:line", "-serial", "chardev:grants"),
                straps=_LOCKSTEP | _PLANTS[plant],
                boot_id=boot_id,
            )
            self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE)
            stack.callback(self._end)
            self.interrupts(0)
            self._stack = stack.pop_all()

    @property
    def counted_instructions(self) -> float:
        """Most instructions of a sample interrupt so far, without the plant."""
        return self.longest_interrupt_ticks * INSTRUCTIONS_PER_TICK

    @property
    def masked_instructions(self) -> float:
        """Most instructions for which the sample interrupt was masked so far."""
        return self.longest_mask_ticks * INSTRUCTIONS_PER_TICK

    def receive(self, data: bytes) -> None:
        """Give bytes of the host to the firmware; it processes them before the next sample."""
        self._line.write(data)
        self._written += len(data)

    def interrupts(self, samples: int) -> None:
        """Let the timers run for a number of samples, 0 to 65535, and the firmware finish its work.

        Raises:
            RuntimeError: the emulator ended, or does not answer.
        """
        self._grants.write(struct.pack("<BBHI", self._disturbance, 0, samples, self._written & 0xFFFFFFFF))
        answer = b""
        while len(answer) < 12:
            self._wait(self._grants)
            answer += self._grants.read(12 - len(answer))
        sent, ticks, masked = struct.unpack("<III", answer)
        self._announced += (sent - self._announced) & 0xFFFFFFFF
        self.longest_interrupt_ticks = max(self.longest_interrupt_ticks, ticks)
        self.longest_mask_ticks = max(self.longest_mask_ticks, masked)
        while self._arrived < self._announced:
            self._wait(self._line)
            data = self._line.read(65536)
            self._arrived += len(data)
            self._received += data

    def disturb(self, disturbance: Disturbance) -> None:
        """Set the disturbances of the plant."""
        self._disturbance = disturbance
        self.interrupts(0)

    def transmit(self) -> bytes:
        """Return the bytes that the firmware has sent."""
        data, self._received = self._received, b""
        return data

    def _wait(self, pipe: _Pipe) -> None:
        for _ in range(round(_ANSWER_S)):
            if pipe.arrives(1.0):
                return
            if self._process.poll() is not None:
                break
        self._process.kill()
        words = self._process.communicate()[1].decode(errors="replace")
        raise RuntimeError(words or f"the emulator does not answer within {_ANSWER_S:.0f} s")

    def _end(self) -> None:
        self._process.kill()
        self._process.communicate()

    def close(self) -> None:
        """End the emulator."""
        self._stack.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()


class _Pipe:
    """The two FIFOs of a character device of QEMU: ``path.in`` and ``path.out``."""

    def __init__(self, path: Path, stack: contextlib.ExitStack) -> None:
        self._files = []
        for ending in (".in", ".out"):
            name = f"{path}{ending}"
            os.mkfifo(name)
            # For reading and writing: the open does not wait for the other end.
            file = os.open(name, os.O_RDWR)
            stack.callback(os.close, file)
            self._files.append(file)

    def write(self, data: bytes) -> None:
        while data:
            data = data[os.write(self._files[0], data) :]

    def arrives(self, seconds: float) -> bool:
        return bool(select.select([self._files[1]], [], [], seconds)[0])

    def read(self, most: int) -> bytes:
        return os.read(self._files[1], most)


SAMPLE_RATE_HZ = 2000
_LAG_S = 0.1
"""Longest delay of this computer that is caught up; for longer ones the clock of the device stops."""
_UNREAD_BYTES = 1_000_000


def serve(emulator: EmulatedLockstep, listener: socket.socket) -> None:
    """Let the emulated device run in real time, with one host at a time on a TCP port; ends with an interrupt."""
    host: socket.socket | None = None
    pending = b""
    begin, granted = time.monotonic(), 0
    while True:
        ready, _, _ = select.select([host or listener], [], [], 1.0 / SAMPLE_RATE_HZ)
        if ready and host is None:
            host, pending = listener.accept()[0], b""
            host.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            host.setblocking(False)
        try:
            if ready and host is not None:
                with contextlib.suppress(BlockingIOError):
                    data = host.recv(4096)
                    if not data:
                        raise ConnectionError
                    emulator.receive(data)
            now = time.monotonic()
            begin = max(begin, now - granted / SAMPLE_RATE_HZ - _LAG_S)
            due = int((now - begin) * SAMPLE_RATE_HZ) - granted
            emulator.interrupts(due)
            granted += due
            pending += emulator.transmit()
            if host is None:
                pending = b""
            else:
                with contextlib.suppress(BlockingIOError):
                    pending = pending[host.send(pending) :] if pending else b""
                if len(pending) > _UNREAD_BYTES:
                    raise ConnectionError
        except ConnectionError:
            if host is not None:
                host.close()
            host = None


def main() -> int:
    """Serve the emulated device; return the exit status."""
    parser = argparse.ArgumentParser(description="the reference firmware on an emulated microcontroller, in real time")
    parser.add_argument("--tcp", type=int, default=0, metavar="PORT", help="of 127.0.0.1; default: a free one")
    parser.add_argument("--plant", choices=_PLANTS, default="tissue", help="behind the board")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that the emulator is ended, too
    try:
        boot_id = int.from_bytes(os.urandom(4), "little")
        with (
            socket.create_server(("127.0.0.1", options.tcp)) as listener,
            EmulatedLockstep(build(QEMU), options.plant, boot_id) as emulator,
        ):
            print(f"socket://127.0.0.1:{listener.getsockname()[1]}", flush=True)
            serve(emulator, listener)
    except (MissingToolError, OSError) as error:
        print(f"emulator: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 0
    return 0


if __name__ == "__main__":
    sys.exit(main())
