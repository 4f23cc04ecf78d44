"""Disks that are really full, and the memory that a long sitting takes."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from coded import coded
from failing_disk import (
    a_sitting,
    posix,
)

from tissueid.acquisition import JournalError, recover
from tissueid.sessions import read_session_head

# -- real file systems ---------------------------------------------------------------------------------------
_CHILD = """
import resource, signal, sys
from pathlib import Path
import numpy as np
from tissueid.acquisition import JournalError, SessionRecorder
from tissueid.device import DeviceDescription
from tissueid.instrument import SAMPLE, Run
limit, fill = int(sys.argv[2]), sys.argv[3] == "fill"
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
if limit:
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
recorder = SessionRecorder(Path(sys.argv[1]), DeviceDescription(), sync_s=0.0)
recorder.begin_test(Run(0, 400_000), kind="stochastic", site="forearm", sample_rate_hz=2000.0)

def fill_up():
    with (Path(sys.argv[1]).parent / "ballast").open("wb", buffering=0) as ballast:
        try:
            while ballast.write(bytes(65536)) == 65536:
                pass
        except OSError:
            pass

try:
    for first in range(0, 400_000, 1000):
        samples = np.zeros(1000, SAMPLE)
        samples["index"] = first + np.arange(1000)
        samples["flags"] = 2
        samples["position"] = samples["index"]
        recorder.add(samples)
        recorder.journal.sync()
        if fill and first == 10_000:
            fill_up()
    print("nothing failed")
except JournalError as error:
    print(recorder.samples_acknowledged, error)
"""


def in_a_child(path: Path, limit: int, fill: str) -> tuple[int, str]:
    command = [sys.executable, "-c", _CHILD, str(path), str(limit), fill]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    acknowledged, _, words = done.stdout.strip().partition(" ")
    return int(acknowledged), words


@posix
def test_a_file_that_the_system_lets_grow_no_further(tmp_path):
    acknowledged, words = in_a_child(tmp_path / "s.h5", 1_000_000, "no")
    assert words.startswith(f"cannot write {tmp_path / 's.h5.journal'}: File too large. ")
    assert acknowledged == 14_000  # 924 kB, and some 5 kB a second of whose they are
    position = recover(tmp_path / "s.h5")[1].test().signals["position"]
    np.testing.assert_array_equal(position, np.arange(acknowledged))


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 80 MB in memory, where this user may mount one."""
    place = tmp_path / "disk"
    place.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=80m", "tmpfs", str(place)]
    if (
        sys.platform != "linux"
        or os.geteuid() != 0
        or subprocess.run(command, capture_output=True, check=False).returncode
    ):
        pytest.skip("no file system can be mounted here")
    yield place
    subprocess.run(["umount", "--lazy", str(place)], check=True)  # a test that failed may still have files open


@pytest.mark.soak
def test_a_file_system_that_is_really_full(tmp_path, small_disk):
    acknowledged, words = in_a_child(small_disk / "s.h5", 0, "fill")
    assert "No space left on device. " in words
    out = tmp_path / "out.h5"
    with pytest.raises(OSError, match="No space left on device"):
        recover(small_disk / "s.h5")
    assert sorted(path.name for path in small_disk.iterdir()) == ["ballast", "s.h5.journal"]
    position = recover(small_disk / "s.h5", out)[1].test().signals["position"]
    np.testing.assert_array_equal(position, np.arange(position.size))
    assert position.size >= acknowledged >= 11_000


@pytest.mark.soak
def test_a_session_that_fills_the_file_system_leaves_no_half_of_it(small_disk):
    recorder = a_sitting(small_disk / "s.h5", tests=2, count=100_000)
    recorder.journal.sync()
    with (small_disk / "ballast").open("wb") as ballast:
        ballast.truncate(0)
        os.posix_fallocate(ballast.fileno(), 0, shutil.disk_usage(small_disk).free - 300_000)
    with pytest.raises(JournalError, check=coded("recording.kept", reason="No space left on device")):
        recorder.finish()
    assert sorted(path.name for path in small_disk.iterdir()) == ["ballast", "s.h5.journal"]
    (small_disk / "ballast").unlink()
    assert [test.samples for test in recover(small_disk / "s.h5")[1].tests] == [100_000, 100_000]


# -- memory --------------------------------------------------------------------------------------------------

_LONG = """
import resource, sys
from pathlib import Path
import numpy as np
from tissueid.acquisition import SessionRecorder
from tissueid.device import DeviceDescription
from tissueid.instrument import SAMPLE, Run
tests = int(sys.argv[2])
recorder = SessionRecorder(Path(sys.argv[1]), DeviceDescription())
samples = np.zeros(60_000, SAMPLE)
samples["flags"] = 2
for number in range(tests):
    samples["index"] = 100_000 * number + np.arange(60_000)
    recorder.begin_test(Run(100_000 * number, 60_000), kind="stochastic", site="x", sample_rate_hz=2000.0)
    recorder.add(samples)
    recorder.journal.sync()
    recorder.end_test("completed")
recorder.write()
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


@posix
@pytest.mark.soak
def test_a_long_sitting_is_written_in_the_memory_of_its_longest_test(tmp_path):
    most = []
    for tests in (4, 60):
        command = [sys.executable, "-c", _LONG, str(tmp_path / f"{tests}.h5"), str(tests)]
        most.append(int(subprocess.run(command, capture_output=True, text=True, check=True).stdout))
    assert most[1] - most[0] < 20_000, "kilobytes; the samples of the longer one alone are 240 MB"
    assert len(read_session_head(tmp_path / "60.h5").session_id) == 36
