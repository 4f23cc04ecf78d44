"""The stop key of a test at a terminal, with a terminal: a pseudo-terminal of the child's own."""

import contextlib
import os
import select
import subprocess
import sys
import termios
import threading
import time
from contextlib import contextmanager

import pytest
from coded import coded

from tissueid.cli.stop_key import HINT, StopKey, stop_key
from tissueid.errors import CancelledError
from tissueid.procedures.control import BY_KEY
from tissueid.sessions import read_session

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo-terminals")

PREAMBLE = """
import fcntl, os, signal, sys, termios
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where the tests run in the background of a shell
if {foreground}: fcntl.ioctl(0, termios.TIOCSCTTY, 0)
"""
ONLY_THE_KEY = """
import json
from tissueid.cli.stop_key import stop_key
with stop_key() as key:
    print("READY", flush=True)
    stopped = key._pressed.wait(float(sys.argv[1]))
print("ANSWER", json.dumps(stopped), flush=True)
"""
COMMAND = """
from tissueid.cli import main
sys.exit(main(sys.argv[1:]))
"""
DEADLINE_S = 60.0


class Terminal:
    """The person's end of a terminal at which a child runs."""

    def __init__(self, code, arguments, environment, foreground):
        self.master, self.slave = os.openpty()
        self.before = termios.tcgetattr(self.slave)
        self.said = ""
        self.process = subprocess.Popen(
            [sys.executable, "-c", PREAMBLE.format(foreground=foreground) + code, *map(str, arguments)],
            stdin=self.slave,
            stdout=self.slave,
            stderr=self.slave,
            env=os.environ | environment | {"COLUMNS": "120", "TERM": "xterm"},
            start_new_session=True,
        )

    def wait_for(self, words):
        """Read until the child has said something."""
        end = time.monotonic() + DEADLINE_S
        while words not in self.said:
            ready, _, _ = select.select([self.master], [], [], 0.1)
            assert ready or self.process.poll() is None, self.said
            assert time.monotonic() < end, self.said
            if ready:
                self.said += os.read(self.master, 4096).decode(errors="replace")

    def type(self, keys):
        os.write(self.master, keys)

    def is_raw(self):
        return not termios.tcgetattr(self.slave)[3] & termios.ICANON

    def end(self):
        """The child's exit status; reads on meanwhile, or it could not write."""
        reading = threading.Thread(target=self._drain, daemon=True)
        reading.start()
        status = self.process.wait(DEADLINE_S)
        after = termios.tcgetattr(self.slave)
        os.close(self.slave)
        reading.join(DEADLINE_S)
        assert after == self.before
        return status

    def _drain(self):
        with contextlib.suppress(OSError):
            while data := os.read(self.master, 4096):
                self.said += data.decode(errors="replace")


@contextmanager
def at_a_terminal(code, *arguments, foreground=True, **environment):
    terminal = Terminal(code, arguments, environment, foreground)
    try:
        yield terminal
    finally:
        terminal.process.kill()
        terminal.process.wait()
        with contextlib.suppress(OSError):
            os.close(terminal.slave)
        os.close(terminal.master)


@pytest.mark.parametrize("keys", [b" ", b"\r", b"q", b"\x1b", b"abc\x1b[A"], ids=repr)
def test_each_key_stops_and_the_terminal_is_given_back(keys):
    with at_a_terminal(ONLY_THE_KEY, DEADLINE_S) as terminal:
        terminal.wait_for("READY")
        assert HINT in terminal.said
        assert terminal.is_raw()
        terminal.type(keys)
        assert terminal.end() == 0
        assert "ANSWER true" in terminal.said


def test_other_keys_and_what_was_typed_ahead_do_not_stop():
    with at_a_terminal(ONLY_THE_KEY, 0.2) as terminal:
        terminal.type(b"\r\r q")
        terminal.wait_for("READY")
        terminal.type(b"abc123")
        assert terminal.end() == 0
        assert "ANSWER false" in terminal.said


def test_a_terminal_that_belongs_to_another_program_is_left_alone():
    with at_a_terminal(ONLY_THE_KEY, 0.1, foreground=False) as terminal:
        terminal.wait_for("READY")
        assert HINT not in terminal.said
        assert not terminal.is_raw()
        assert terminal.end() == 0


TESTS = {
    "repeats": ("--repeats", 100, "--seconds", 25),
    "multistep": ("--multistep", 20, "--depth-range", "1:4", "--target", 0.0001, "--seconds", 25),
}


@pytest.mark.parametrize(
    ("which", "keys", "status", "reason"),
    [
        ("repeats", b" ", 130, "stopped by key; "),
        ("multistep", b"q", 130, "stopped by key; "),
        ("repeats", b"\x03", 130, "interrupted"),
    ],
)
def test_a_test_is_stopped_and_kept(tmp_path, which, keys, status, reason):
    out = tmp_path / "s.h5"
    arguments = ("test", "--device", "simulated://forearm", "--site", "arm", "--out", out, "--json", tmp_path / "j")
    with at_a_terminal(COMMAND, *arguments, *TESTS[which]) as terminal:
        terminal.wait_for("test 1 of" if which == "repeats" else "step 1 of")
        terminal.type(keys)
        assert terminal.end() == status, terminal.said
        assert "Traceback" not in terminal.said
        last = [line for line in terminal.said.splitlines() if line.startswith("tissueid: ")]
        assert len(last) == 1
        assert "is kept" in last[0]
    test = read_session(out).tests[-1]
    assert test.status == "aborted"
    assert test.notes["reason"].startswith(reason)
    assert not list(tmp_path.glob("*.journal"))


def test_without_a_terminal_no_key_is_read(monkeypatch):
    for nothing in (None, open(os.devnull)):  # noqa: PTH123, SIM115 - closed below
        monkeypatch.setattr(sys, "stdin", nothing)
        with stop_key() as key:
            assert not any(thread.name == "stop key" for thread in threading.enumerate())
            assert not key.check()
        if nothing is not None:
            nothing.close()
            with stop_key() as key:
                assert not key.check()


def test_what_a_pressed_key_says():
    key = StopKey()
    key.press()
    with pytest.raises(CancelledError, check=coded("stop.kept", cause=BY_KEY)):
        key.check()
