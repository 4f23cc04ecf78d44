"""The simulated firmware at the end of a real cable, as a process of its own or in a thread of the test."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from firmware_sim.firmware import Firmware
from firmware_sim.scenario import Scenario
from firmware_sim.server import PseudoTerminal, Server, TcpPort


@contextmanager
def firmware_process(*arguments: str) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """Start it, give its URL, and end it."""
    process = subprocess.Popen(
        [sys.executable, "-m", "firmware_sim", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    try:
        url = process.stdout.readline().strip()
        if not url:
            raise AssertionError(process.communicate()[1])
        yield url, process
    finally:
        process.terminate()
        process.communicate(timeout=20)


@contextmanager
def firmware_thread(cable: str, **scenario: Any) -> Iterator[TcpPort | PseudoTerminal]:
    """Serve a scenario in a thread and give its end of the cable: much quicker to start than a process.

    Its ``url`` is another one when a pseudo-terminal was plugged in again.
    """
    described = Scenario.model_validate(scenario)
    bench = described.bench()
    bench.warm_up()
    port = PseudoTerminal() if cable == "--pty" else TcpPort(0)
    over = threading.Event()
    server = Server(Firmware(bench, described.identity(), seed=described.seed), port, described)
    thread = threading.Thread(target=lambda: server.run(until=over.is_set))
    thread.start()
    try:
        yield port
    finally:
        over.set()
        thread.join()
        port.unplug()
