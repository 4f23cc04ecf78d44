"""The simulated firmware as a process of its own, for tests that want the real cable."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager


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
