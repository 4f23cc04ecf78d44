"""A disk that fails at a chosen call of the system, and sittings that are recorded on it."""

from __future__ import annotations

import errno
import math
import os
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from coded import says
from support import connect

from tissueid.acquisition import GuidedTest, JournalError, SessionRecorder, journal_path, recover, run_guided_test
from tissueid.audit import AuditTrail
from tissueid.device import DeviceDescription
from tissueid.errors import TissueIDError, UnusableInputError
from tissueid.instrument import SAMPLE, Run
from tissueid.sessions import read_session
from tissueid.stimuli.base import Stimulus
from tissueid.test_settings import TestSettings
from tissueid.wire import Flag

posix = pytest.mark.skipif(sys.platform == "win32", reason="needs limits and signals of POSIX")

FULL = os.strerror(errno.ENOSPC)
SECONDS = 0.5
TESTS = 2
ATTRIBUTES = dict(kind="stochastic", site="forearm", sample_rate_hz=2000.0)


def guided(seconds: float = SECONDS) -> GuidedTest:
    force = 3.0 * np.minimum(1.0, np.arange(round(2000 * seconds)) / 100.0)
    return GuidedTest(Stimulus(force, 2000.0, {"type": "hold"}, 0, 1.4, preload_s=0.1), TestSettings(site="forearm"))


def batch(first: int, count: int) -> np.ndarray:
    samples = np.zeros(count, SAMPLE)
    samples["index"] = first + np.arange(count)
    samples["position"] = 0.01 + 1e-6 * samples["index"]
    samples["flags"] = Flag.PLAYING
    return samples


class Disk:
    """The system's calls for one file, counted, of which one and all after it fail in a way."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, path: Path, fails_at: int | None = None) -> None:
        self.calls = 0
        self.after = 0
        self.fails_at = fails_at
        self.number = errno.ENOSPC
        self.coil_on_at: Callable[[], float] = lambda: math.inf
        """The time, or infinity where no coil is on."""
        self.failed_s = math.inf
        self.part = 0
        """Bytes of the write that fails which get there all the same."""
        self.on = ("write", "fsync")
        self._path = path
        self._sound = {"write": os.write, "fsync": os.fsync}
        for name in self._sound:
            monkeypatch.setattr(os, name, lambda *arguments, name=name: self.call(name, *arguments))

    def call(self, name: str, descriptor: int, *data: bytes) -> int | None:
        sound = self._sound[name]
        if name not in self.on or not self._is_it(descriptor):
            return sound(descriptor, *data)
        self.calls += 1
        if self.fails_at is None or self.calls < self.fails_at:
            return sound(descriptor, *data)
        self.after += self.calls > self.fails_at
        self.failed_s = min(self.failed_s, self.coil_on_at())
        if data and self.part:
            sound(descriptor, bytes(data[0])[: self.part])
        raise OSError(self.number, os.strerror(self.number))

    def _is_it(self, descriptor: int) -> bool:
        try:
            return os.path.samestat(os.fstat(descriptor), self._path.stat())
        except OSError:
            return False


class Sitting:
    """Guided tests on the simulated firmware, and what was handed to their recorder and acknowledged by it."""

    def __init__(self, folder: Path, *, in_step: bool = True, guided: bool = True) -> None:
        self.path = folder / "s.h5"
        if guided:
            self.instrument = connect()
            self.firmware = self.instrument.link.firmware
            self.go = self.run
        else:
            self.go = self.feed
        self.added = np.zeros(0, SAMPLE)
        self.acknowledged = 0
        self.error: JournalError | None = None
        self.released = True
        self.ended_s = 0.0
        self.free_s = math.inf
        self.recorder: SessionRecorder | None = None
        self._in_step = in_step

    def run(self, tests: int = TESTS, seconds: float = SECONDS) -> None:
        try:
            self.recorder = recorder = SessionRecorder(self.path, self.instrument.device, sync_s=0.0)

            def watch(progress) -> None:
                self.added = np.concatenate([self.added, progress.samples])
                self.keep_in_step()

            for _ in range(tests):
                run_guided_test(self.instrument, guided(seconds), recorder, surface_m=0.01, progress=watch)
        except JournalError as error:
            self.error = error
            self.released = not self.firmware.energised
            self.ended_s = self.instrument.link.now

    def feed(self, batches: int = 2) -> None:
        """As ``run``, without an instrument: only the calls of the recorder."""
        try:
            self.recorder = SessionRecorder(self.path, DeviceDescription(), sync_s=0.0)
            self.keep_in_step()
            for test in range(TESTS):
                self.recorder.prepare(10 * batches)
                self.recorder.begin_test(Run(1000 * test, 10 * batches), **ATTRIBUTES)
                for number in range(batches):
                    samples = batch(1000 * test + 10 * number, 10)
                    self.recorder.add(samples)
                    self.added = np.concatenate([self.added, samples])
                    self.keep_in_step()
                self.recorder.end_test("completed")
        except JournalError as error:
            self.error = error

    def watch_release(self, disk: Disk) -> None:
        """Keep when the coil was first free after the disk failed: the end of a run frees it as well as an error."""

        def look(data: bytes) -> bytes:
            if disk.failed_s < math.inf and not self.firmware.energised:
                self.free_s = min(self.free_s, self.instrument.link.now)
            return data

        self.instrument.link.to_host = look

    def coil_on_at(self) -> float:
        return self.instrument.link.now if self.firmware.energised else math.inf

    def keep_in_step(self) -> None:
        """Wait for the thread that writes: what fails, fails at the same sample."""
        if self._in_step:
            self.recorder.journal.drain()
        self.acknowledged = max(self.acknowledged, self.recorder.samples_acknowledged)

    def check_recovery(self, found: Path) -> None:
        """What is found again begins with everything that was acknowledged, and holds nothing else than was added."""
        positions = [test.signals["position"] for test in read_session(found).tests]
        position = np.concatenate([np.zeros(0), *positions])
        assert position.size >= self.acknowledged
        np.testing.assert_array_equal(position, self.added["position"][: position.size])


def calls_of_a_whole_sitting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, guided: bool) -> int:
    with monkeypatch.context() as patch:
        disk = Disk(patch, journal_path(tmp_path / "s.h5"))
        sitting = Sitting(tmp_path, guided=guided)
        sitting.go()
        sitting.recorder.finish()
        assert sitting.error is None
        assert sum(test.samples for test in read_session(sitting.path).tests) == sitting.added.size > 0
    sitting.path.unlink()
    return disk.calls


def check_one_line(error: TissueIDError, code: str = "", **values: object) -> None:
    """Check that an error is one line and, with ``code``, that it has this code and these values."""
    assert "\n" not in str(error)
    assert not code or says(error.message, code, **values)


def check_failing_at(
    folder: Path, monkeypatch: pytest.MonkeyPatch, call: int, number: int, part: int, *, guided: bool = True
) -> tuple[str, float]:
    """A sitting whose disk fails at one call and stays so; returns where that was, and seconds until the coil was free.

    Seconds are those of the device's clock; 0 where no coil was on.
    """
    folder.mkdir()
    with monkeypatch.context() as patch:
        disk = Disk(patch, journal_path(folder / "s.h5"), fails_at=call)
        disk.number, disk.part = number, part
        sitting = Sitting(folder, guided=guided)
        if guided:
            disk.coil_on_at = sitting.coil_on_at
            sitting.watch_release(disk)
        sitting.go()
        assert sitting.released
        seconds = max(0.0, min(sitting.free_s, sitting.ended_s) - disk.failed_s)
        assert disk.after == 0, "nothing is written after what failed"
        if sitting.recorder is None:
            check_one_line(sitting.error, "journal.not_begun", reason=os.strerror(number))
            assert list(folder.iterdir()) == []
            return "before", 0.0
        if sitting.error is not None:
            check_one_line(sitting.error, "journal.failed", reason=os.strerror(number))
        if sitting.recorder.samples_appended == 0:
            assert sitting.recorder.finish_or_discard() is None
            assert list(folder.iterdir()) == []
            return "before the first sample", seconds
        with pytest.raises(JournalError) as caught:
            sitting.recorder.finish_or_discard()
        check_one_line(caught.value, "journal.failed", reason=os.strerror(number))
    assert [path.name for path in folder.iterdir()] == ["s.h5.journal"]
    if sitting.acknowledged == 0:
        try:
            recover(sitting.path)
        except UnusableInputError:
            return "before the first sample", seconds
    else:
        recover(sitting.path)
    sitting.check_recovery(sitting.path)
    return ("at the end", 0.0) if sitting.error is None else ("during a test", seconds)


def a_sitting(path: Path, tests: int = 2, count: int = 500, trail: AuditTrail | None = None) -> SessionRecorder:
    recorder = SessionRecorder(path, DeviceDescription(), trail=trail)
    for number in range(tests):
        recorder.prepare(count)
        recorder.begin_test(Run(1000 * number, count), **ATTRIBUTES)
        recorder.add(batch(1000 * number, count))
        recorder.end_test("completed")
    return recorder
