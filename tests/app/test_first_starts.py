"""The first test after a start of the program, in processes of their own: no stall of the window near its watchdog."""

import contextlib
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from tissueid.app.emergency import PATIENCE_S

SCRIPT = Path(__file__).with_name("first_test.py")


def first_test(folder, delay_s):
    """Start the program with settings of its own and measure once: the longest stall, s, and the error of the test."""
    folders = {f"XDG_{name}_{what}": str(folder) for name, what in (("CONFIG", "HOME"), ("DATA", "HOME"))}
    environment = os.environ | folders | {"XDG_DOCUMENTS_DIR": str(folder), "QT_QPA_PLATFORM": "offscreen"}
    answer = subprocess.run(
        [sys.executable, str(SCRIPT), str(delay_s)],
        capture_output=True,
        text=True,
        env=environment,
        timeout=300,
        check=False,
    )
    return json.loads(answer.stdout), answer.stderr


@contextlib.contextmanager
def busy_cores():
    """Two processes that do nothing but work."""
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2)]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()


@pytest.mark.skipif(sys.platform == "win32", reason="the folders of settings are named otherwise there")
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("starts", [pytest.param(50, marks=pytest.mark.soak)])
def test_no_first_test_is_ended_by_the_watchdog_of_the_window(starts):
    found = []
    with busy_cores():
        for number in range(starts):
            with tempfile.TemporaryDirectory() as folder:
                found.append(first_test(folder, 3.0 if number % 2 else 0.2))
    longest = sorted(answer["longest_s"] for answer, _ in found)
    sys.stdout.write(f"longest stalls of {starts} first tests, s: {longest[-5:]}\n")
    assert [(answer, said) for answer, said in found if answer["error"]] == []
    assert longest[-1] < PATIENCE_S
