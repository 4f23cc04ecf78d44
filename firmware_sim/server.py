"""Server: runs the firmware on a pseudo-terminal or a TCP port in real time."""

from __future__ import annotations

import errno
import os
import select
import socket
import time
from collections.abc import Callable
from typing import Protocol

from firmware_sim.faults import FaultInjector
from firmware_sim.firmware import Firmware
from firmware_sim.scenario import Scenario

TICK_S = 0.01
"""Longest time between two checks of port and clock."""

LAG_S = 0.02
"""Longest delay of this process, s, that is caught up; for longer delays the device's clock is stopped.

A real device is never suspended. Up to this delay, due samples are played at once, so that the host gains no time.
"""

HOST_PATIENCE_S = 0.4
"""Time that an accelerated clock waits for set-points, s; below the timeout of the watchdog."""

_READ = 65536
_READS = 16
"""Largest number of reads at a time: the host may have disconnected after its last bytes."""
_BACKLOG_BYTES = 16 * 1024
_BURST_SAMPLES = 200
"""Samples after which an accelerated clock checks the port if this computer cannot keep up."""


class Port(Protocol):
    """The device's end of the cable."""

    url: str
    connected: Callable[[], None]
    """Called when a host connects, on a line that has connections."""

    def exchange(self, outgoing: bytes, timeout_s: float) -> tuple[bytes, int]:
        """Send as much as possible of ``outgoing``; return the received bytes and the number of bytes sent."""

    def unplug(self) -> None:
        """Unplug the cable."""

    def replug(self) -> None:
        """Plug the cable in again; ``url`` may change, as the name of a serial port may."""


class PseudoTerminal:
    """A pseudo-terminal, which the host uses as a serial port."""

    def __init__(self) -> None:
        self._master = -1
        self.connected: Callable[[], None] = lambda: None
        self.replug()

    def replug(self) -> None:  # noqa: D102
        import pty
        import tty

        if self._master >= 0:
            return
        # An open slave end keeps the terminal alive between hosts.
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.url = os.ttyname(self._slave)
        self.connected()

    def exchange(self, outgoing: bytes, timeout_s: float) -> tuple[bytes, int]:  # noqa: D102
        if self._master < 0:
            time.sleep(timeout_s)
            return b"", len(outgoing)
        ready, writable, _ = select.select([self._master], [self._master] if outgoing else [], [], timeout_s)
        data, sent = b"", 0
        try:
            if writable:
                sent = os.write(self._master, outgoing)
            if ready:
                data = os.read(self._master, _READ)
        except OSError as error:
            if error.errno not in (errno.EAGAIN, errno.EIO):
                raise
        return data, sent

    def unplug(self) -> None:  # noqa: D102
        if self._master >= 0:
            os.close(self._master)
            os.close(self._slave)
            self._master = -1


class TcpPort:
    """TCP on the loopback interface, one host at a time, for pyserial's ``socket://`` URLs."""

    def __init__(self, port: int) -> None:
        self._host: socket.socket | None = None
        self._new_host = False
        self.connected: Callable[[], None] = lambda: None
        self._listen(port)
        self._number = int(self._listener.getsockname()[1])
        self.url = f"socket://127.0.0.1:{self._number}"

    def _listen(self, port: int) -> None:
        self._listener = socket.create_server(("127.0.0.1", port))
        self._listener.setblocking(False)

    def exchange(self, outgoing: bytes, timeout_s: float) -> tuple[bytes, int]:  # noqa: D102
        if self._new_host:
            self._new_host = False
            self.connected()
        waiting: list[socket.socket] = [self._listener] if self._listener.fileno() >= 0 else []
        if self._host is not None:
            waiting.append(self._host)
        if not waiting:
            time.sleep(timeout_s)
            return b"", len(outgoing)
        writing = [self._host] if self._host is not None and outgoing else []
        ready, writable, _ = select.select(waiting, writing, [], timeout_s)
        data, sent = b"", len(outgoing)  # without a host the bytes are discarded
        if self._host is not None:
            data, sent = self._talk(self._host, outgoing if writable else b"")
        if self._listener in ready:
            newcomer, _ = self._listener.accept()
            if self._host is not None:
                newcomer.close()  # only one host at a time, as on a cable
            else:
                newcomer.setblocking(False)
                newcomer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._host = newcomer
                self._new_host = True  # reported after the last bytes of the previous one
                sent = len(outgoing)  # pending bytes were meant for the previous host
        return data, sent

    def _talk(self, host: socket.socket, outgoing: bytes) -> tuple[bytes, int]:
        """Return the bytes received from a host, and the number of bytes sent. A disconnected host may be followed by
        another.
        """
        data, sent = b"", 0
        try:
            if outgoing:
                sent = host.send(outgoing)
            for _ in range(_READS):
                if not (piece := host.recv(_READ)):
                    self._hang_up()
                    break
                data += piece
        except BlockingIOError:
            return data, sent
        except OSError:
            self._hang_up()
        return data, sent

    def _hang_up(self) -> None:
        if self._host is not None:
            self._host.close()
            self._host = None

    def unplug(self) -> None:  # noqa: D102
        self._hang_up()
        self._listener.close()

    def replug(self) -> None:  # noqa: D102
        if self._listener.fileno() < 0:
            self._listen(self._number)


class Server:
    """Runs the firmware in real time, transfers its bytes, and injects the planned faults.

    ``announce`` is called with the name of the port when the cable is reconnected. ``stopped_s`` is the total time for
    which the device's clock was stopped because the computer was too slow. ``clock`` is monotonic time, s.
    """

    def __init__(
        self,
        firmware: Firmware,
        port: Port,
        scenario: Scenario,
        announce: Callable[[str], None] = lambda _: None,
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._clock = clock
        self._firmware = firmware
        self._port = port
        port.connected = firmware.connected
        self._announce = announce
        self._nominal_rate = self._rate = firmware.sample_rate_hz * scenario.speed
        self._accelerated = scenario.speed > 1.0
        self._faults = FaultInjector(firmware, self, scenario.faults, seed=scenario.seed)
        self._samples = 0
        self.outgoing = b""
        self.stopped_s = 0.0
        self._begin = 0.0
        self._waiting_since: float | None = None

    def run(self, *, until: Callable[[], bool] = lambda: False) -> None:
        """Serve until ``until`` returns true, or the process is stopped."""
        self._begin = self._clock()
        while not until():
            now = self._clock()
            self.keep_up(now)
            if len(self.outgoing) <= _BACKLOG_BYTES:
                # If the host does not read, the queue of the firmware drops and counts frames.
                self.outgoing += self._faults.line.to_host(self._firmware.transmit(now))
            # Wake up when the last sample of the next frame is due.
            wake = self._begin + (self._samples + self._firmware.samples_to_frame) / self._rate
            timeout = min(TICK_S, max(0.0, wake - self._clock()))
            data, sent = self._port.exchange(self.outgoing, timeout)
            self.outgoing = self.outgoing[sent:]
            if data:
                # Samples due before these bytes arrived are played first.
                now = self._clock()
                self.keep_up(now)
                self._firmware.receive(self._faults.line.to_device(data), now)
                self._look(now)

    def unplug(self) -> None:
        """Unplug the cable; data in transit is lost."""
        self.outgoing = b""
        self._port.unplug()

    def replug(self) -> None:
        """Plug the cable in again."""
        self._port.replug()
        self._announce(self._port.url)

    def keep_up(self, now: float) -> None:
        """Advance the device to the present time."""
        due = int((now - self._begin) * self._rate) - self._samples
        if not self._accelerated:
            possible = min(due, max(1, round(LAG_S * self._rate)))
            self.stopped_s += (due - possible) / self._rate
        elif len(self.outgoing) > _BACKLOG_BYTES:
            possible = 0
        else:
            # An accelerated clock waits for its host and for this computer, unlike a real one.
            possible = min(due, _BURST_SAMPLES, self._known(now))
        self._begin += (due - possible) / self._rate
        if possible > 0:
            self._firmware.advance(possible, now)
            self._samples += possible
            self._faults.advance(possible, now)
            self._look(now)

    def _look(self, now: float) -> None:
        """Start due faults, and apply their effect on the clock."""
        self._faults.start_due(now)
        if (rate := self._nominal_rate * self._faults.clock_rate) != self._rate:
            # Device time continues from its present value at the new rate.
            self._begin = now - (now - self._begin) * self._rate / rate
            self._rate = rate

    def _known(self, now: float) -> int:
        """Return the samples that an accelerated clock may play before it has to wait for set-points."""
        known = self._firmware.samples_known
        if known:
            self._waiting_since = None
            return known
        if self._waiting_since is None:
            self._waiting_since = now
        return 0 if now - self._waiting_since < HOST_PATIENCE_S else _BURST_SAMPLES
