"""Standard streams that are closed, full or stand still: the test is recorded and saved all the same."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
import termios
import threading
from pathlib import Path

import pytest

from tissueid.cli import streams
from tissueid.cli.streams import Stream, Writer
from tissueid.sessions import read_session

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="streams of POSIX")

DEADLINE_S = 60.0
TEST = ("test", "--device", "simulated://forearm?seed=1", "--seconds", "1", "--site", "arm", "--out", "s.h5")


def run(folder: Path, shell: str, *more: str) -> subprocess.CompletedProcess[str]:
    command = ["sh", "-c", f'"$@" {shell}', "sh", sys.executable, "-m", "tissueid", *TEST, *more]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=DEADLINE_S)


@pytest.mark.parametrize(
    ("shell", "more", "status"),
    [
        (">&- 2>&- <&-", (), 0),
        pytest.param(">&-", ("--json", "-"), 2, marks=pytest.mark.soak),
        pytest.param(">/dev/full", (), 2, marks=pytest.mark.skipif(not Path("/dev/full").exists(), reason="no such")),
        pytest.param("", ("--json", "-"), 0, marks=pytest.mark.soak),
    ],
)
def test_a_test_whose_output_is_lost_is_saved(tmp_path, shell, more, status):
    done = run(tmp_path, shell, *more)
    assert done.returncode == status
    assert read_session(tmp_path / "s.h5").test().status == "completed"
    if status:
        assert done.stderr.splitlines()[-1].startswith("tissueid: ")
    elif more:
        assert json.loads(done.stdout)["session"] == "s.h5"


def test_a_reader_that_left_costs_nothing(tmp_path):
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [sys.executable, "-m", "tissueid", *TEST], cwd=tmp_path, stdout=writer, stderr=subprocess.PIPE, check=False
    )
    os.close(writer)
    assert done.returncode == 0
    assert b"Traceback" not in done.stderr
    assert b"BrokenPipe" not in done.stderr
    assert read_session(tmp_path / "s.h5").test().status == "completed"


def test_a_terminal_that_takes_no_output_holds_nothing_up(tmp_path):
    """Ctrl+S before the test begins; the session is there before anything is shown."""
    master, slave = os.openpty()
    termios.tcflow(slave, termios.TCOOFF)
    process = subprocess.Popen(
        [sys.executable, "-m", "tissueid", *TEST, "--live", "--repeats", "2"],
        cwd=tmp_path,
        stdin=slave,
        stdout=slave,
        stderr=slave,
        start_new_session=True,
        env=os.environ | {"TERM": "xterm"},
    )
    saved = threading.Event()

    def look() -> None:
        while process.poll() is None and not saved.is_set():
            if (tmp_path / "s.h5").exists() and not (tmp_path / "s.h5.journal").exists():
                saved.set()
            threading.Event().wait(0.02)

    watcher = threading.Thread(target=look)
    watcher.start()
    try:
        assert saved.wait(DEADLINE_S)
        assert process.poll() is None, "it waits for the terminal, with everything saved"
        termios.tcflow(slave, termios.TCOON)
        said = b""
        while b"test 2: " not in said:
            said += os.read(master, 65536)
        assert process.wait(DEADLINE_S) == 0
    finally:
        saved.set()
        process.kill()
        process.wait()
        watcher.join()
        os.close(master)
        os.close(slave)
    assert [test.status for test in read_session(tmp_path / "s.h5").tests] == ["completed"] * 2


# -- the thread between -----------------------------------------------------------------------------------------


class Gate:
    """A stream that takes nothing until it is let go."""

    encoding = "utf-8"

    def __init__(self) -> None:
        self.open = threading.Event()
        self.taken = ""

    def write(self, text: str) -> int:
        self.open.wait()
        self.taken += text
        return len(text)

    def flush(self) -> None:
        pass


def test_progress_that_nobody_takes_is_dropped_and_results_are_not(monkeypatch):
    gate, writer = Gate(), Writer()
    error = Stream(gate, writer, results=False, broken=None)
    output = Stream(gate, writer, results=True, broken=None)
    for _ in range(100):
        error.write("x" * 10_000)
    output.write("y" * 100_000)
    assert error.waiting <= streams.MAX_ERROR
    gate.open.set()
    output.deliver()
    assert 0 < gate.taken.count("x") <= streams.MAX_ERROR
    assert gate.taken.endswith("y" * 100_000)


def test_text_that_the_terminal_has_no_letters_for_is_written_in_others():
    gate = Gate()
    gate.encoding = "ascii"
    gate.open.set()
    output = Stream(gate, Writer(), results=True, broken=None)
    output.write("5 µm \udce9")
    output.deliver()
    assert gate.taken == "5 \\xb5m \\udce9"


def test_a_stream_that_broke_says_why_to_who_asks():
    class Full(Gate):
        def write(self, text: str) -> int:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    output = Stream(Full(), Writer(), results=True, broken=None)
    for _ in range(3):
        output.write("x" * 5_000_000)  # does not wait for what can never be written
    with pytest.raises(OSError, match="No space left") as told:
        output.deliver()
    assert told.value.filename == "standard output"
