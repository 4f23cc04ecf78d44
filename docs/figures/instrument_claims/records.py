"""Reliability of records: disk failure at any moment, audit log, memory of a long sitting."""

from __future__ import annotations

import errno
import io
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from statistics import median

import pytest
from engine_claims.base import Claim
from failing_disk import calls_of_a_whole_sitting, check_failing_at

from tissueid.audit import AuditLog, last_lines, verify
from tissueid.audit.line import fields_of, make_line

FAILURES = {errno.ENOSPC: 1, errno.EIO: 4}
"""And at which of the calls: every one, every fourth."""
RELEASED_S = 0.06
LINES = 100_000
VERIFIED_S = 10.0
LONG_TESTS = 40
"""Of 30 s each: 20 minutes."""
EXTRA_MB = 20.0

_LONG = """
import resource, sys
from pathlib import Path
import numpy as np
from tissueid.acquisition import SessionRecorder
from tissueid.device import DeviceDescription
from tissueid.instrument import SAMPLE, Run
recorder = SessionRecorder(Path(sys.argv[1]), DeviceDescription())
samples = np.zeros(60_000, SAMPLE)
samples["flags"] = 2
for number in range(int(sys.argv[2])):
    samples["index"] = 100_000 * number + np.arange(60_000)
    recorder.begin_test(Run(100_000 * number, 60_000), kind="stochastic", site="x", sample_rate_hz=2000.0)
    recorder.add(samples)
    recorder._journal.sync()
    recorder.end_test("completed")
recorder.write()
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


class _InMemory:
    """A file that was never on a disk."""

    def __init__(self, raw: bytes) -> None:
        self._raw = raw

    def open(self, _mode: str) -> io.BytesIO:
        """Its bytes."""
        return io.BytesIO(self._raw)


def claims() -> Iterator[Claim]:
    """Disk, audit log, memory."""
    with tempfile.TemporaryDirectory() as folder:
        yield from _disk(Path(folder))
        yield from _audit(Path(folder))
        yield _memory(Path(folder))


def _disk(folder: Path) -> Iterator[Claim]:
    """A disk that fails at each of its calls of a sitting of two tests on the simulated firmware."""
    with pytest.MonkeyPatch.context() as patch:
        calls = calls_of_a_whole_sitting(folder, patch, guided=True)
        tried, lost, places, slowest = 0, 0, Counter[str](), 0.0
        for number, every in FAILURES.items():
            for call in range(1, calls + 1, every):
                tried += 1
                try:
                    place, seconds = check_failing_at(folder / f"{number}-{call}", patch, call, number, 13)
                except AssertionError:
                    lost += 1
                else:
                    places[place] += 1
                    slowest = max(slowest, seconds)
    counts = ", ".join(f"{count} {place}" for place, count in sorted(places.items()))
    yield Claim(
        f"disk full at each of the {calls} calls of a sitting of two tests, failing at every fourth, with half an "
        "entry written: sittings in which an acknowledged sample was lost, a coil stayed on, or the message did not "
        "say what is kept",
        "0",
        f"{lost} of {tried} ({counts})",
        lost == 0,
    )
    yield Claim(
        "longest time from the failure to the release of the coil, device time",
        f"{1e3 * RELEASED_S:.0f} ms",
        f"{1e3 * slowest:.0f} ms",
        slowest <= RELEASED_S,
    )


def _audit(folder: Path) -> Iterator[Claim]:
    """What verification finds, and how long it takes."""
    log = AuditLog(folder / "audit.jsonl")
    took = []
    for number in range(50):
        begin = time.perf_counter()
        log.record("clinician", "test.begun", subject=f"P{number}", new={"site": "forearm"})
        took.append(time.perf_counter() - begin)
    damages, found = _damages(b"".join(log.path.read_bytes().splitlines(keepends=True)[:4]))
    yield Claim(
        "audit log of four lines: each byte changed, removed, inserted; lines removed, swapped, copied: detected",
        "all",
        f"{found} of {damages}",
        found == damages,
    )
    last = last_lines(log.path, 1)[0]
    with log.path.open("ab") as file:
        while last.number < LINES:
            fields = fields_of(last) | {"number": last.number + 1, "previous": last.hash}
            del fields["hash"]
            last, raw = make_line(**fields)
            file.write(raw)
    begin = time.process_time()
    whole = verify(log.path).whole
    seconds = time.process_time() - begin
    yield Claim(
        f"{LINES:,} lines ({log.path.stat().st_size / 1e6:.0f} MB) verified; one line appended and synced (median)",
        f"{VERIFIED_S:.0f} s",
        f"{seconds:.1f} s of one core; {1e3 * median(took):.1f} ms",
        whole and seconds <= VERIFIED_S,
    )


def _damages(whole: bytes) -> tuple[int, int]:
    """How many things were done to a log, and how many of them verification told of."""
    lines = whole.splitlines(keepends=True)
    damaged = []
    for place in range(len(whole)):
        rest = whole[place + 1 :]
        damaged += [whole[:place] + bytes([whole[place] ^ bit]) + rest for bit in (1, 4, 32)]
        damaged += [whole[:place] + rest, whole[:place] + b"0" + whole[place:]]
    for first in range(len(lines)):
        if first < len(lines) - 1:  # a cut end is seen against a head alone
            damaged.append(b"".join(lines[:first] + lines[first + 1 :]))
        for second in range(first + 1, len(lines)):
            swapped = list(lines)
            swapped[first], swapped[second] = lines[second], lines[first]
            damaged.append(b"".join(swapped))
        damaged += [
            b"".join([*lines[:place], lines[first], *lines[place:]]) for place in range(first + 1, len(lines) + 1)
        ]
    results = [verify(_InMemory(raw)) for raw in damaged if raw != whole]  # type: ignore[arg-type]
    return len(results), sum(not result.whole or bool(result.remarks) for result in results)


def _memory(folder: Path) -> Claim:
    """How much more memory a long sitting takes to be written than a short one."""
    most = []
    for tests in (2, LONG_TESTS):
        command = [sys.executable, "-c", _LONG, str(folder / f"{tests}.h5"), str(tests)]
        done = subprocess.run(command, capture_output=True, text=True, check=True, env=os.environ)
        most.append(int(done.stdout) / 1024)
    extra = most[1] - most[0]
    minutes = LONG_TESTS * 0.5
    return Claim(
        f"memory to record and write {minutes:.0f} minutes ({LONG_TESTS * 0.06:.1f} million samples, "
        f"{LONG_TESTS * 60_000 * 66 / 1e6:.0f} MB of journal) beyond that for one minute",
        f"{EXTRA_MB:.0f} MB",
        f"{extra:.0f} MB beyond {most[0]:.0f} MB",
        extra <= EXTRA_MB,
    )
