"""A disk that fails before a sitting begins, or when its session is written."""

from __future__ import annotations

import errno
import os
import shutil
from collections import namedtuple
from pathlib import Path

import numpy as np
import pytest
from coded import coded, says
from failing_disk import (
    ATTRIBUTES,
    Disk,
    Sitting,
    a_sitting,
    batch,
    check_one_line,
    guided,
)
from support import connect

from tissueid import atomic_write
from tissueid.acquisition import JournalError, SessionRecorder, journal_path, recover, recovery, run_guided_test
from tissueid.acquisition import recorder as recording
from tissueid.device import DeviceDescription
from tissueid.errors import LinkLostError, SessionFormatError
from tissueid.instrument import SAMPLE, Run
from tissueid.sessions import read_session, write_session


# -- the end of a sitting ------------------------------------------------------------------------------------
@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO, errno.EDQUOT, errno.EROFS])
@pytest.mark.parametrize(
    "place",
    [
        "h5py.File",
        "tissueid.sessions.hdf5_session.write_test",
        "tissueid.atomic_write.os.fsync",
        "tissueid.atomic_write.os.link",
    ],
)
def test_a_session_that_cannot_be_written_leaves_its_journal_and_nothing_else(tmp_path, monkeypatch, place, number):
    recorder = a_sitting(tmp_path / "s.h5")
    recorder.journal.sync()
    kept = journal_path(tmp_path / "s.h5")

    def fails(*_, **__):
        if place.endswith("fsync") and not list(tmp_path.glob(".s.h5*")):
            return  # that of the journal
        raise OSError(number, f"[Errno {number}] Unable to write (errno = {number}, error message = 'x')")

    with monkeypatch.context() as patch:
        patch.setattr(place, fails)
        with pytest.raises(JournalError) as raised:
            recorder.finish()
    check_one_line(raised.value)
    assert says(raised.value.message, "recording.kept", path=str(tmp_path / "s.h5"), journal=str(kept))
    if place.startswith(("h5py", "tissueid.sessions")):
        assert os.strerror(number) in str(raised.value)
    assert list(tmp_path.iterdir()) == [kept]
    _, session = recover(tmp_path / "s.h5")
    assert [test.samples for test in session.tests] == [500, 500]
    assert [test.status for test in session.tests] == ["completed", "completed"]
    assert not kept.exists()


def test_a_name_that_could_not_be_synced_keeps_the_journal(tmp_path, monkeypatch):
    recorder = a_sitting(tmp_path / "s.h5")
    recorder.journal.sync()

    def fails(_):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    with monkeypatch.context() as patch:
        patch.setattr(atomic_write, "sync_folder", fails)
        with pytest.raises(JournalError, check=coded("recording.kept", reason="Input/output error")):
            recorder.finish()
    assert journal_path(tmp_path / "s.h5").exists()
    assert len(recover(tmp_path / "s.h5")[1].tests) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["s.h5"]


def test_a_journal_that_cannot_be_removed_does_not_cost_the_session(tmp_path, monkeypatch):
    recorder = a_sitting(tmp_path / "s.h5")

    def fails(*_, **__):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    with monkeypatch.context() as patch:
        patch.setattr(Path, "unlink", fails)
        assert len(recorder.finish().tests) == 2
    assert len(recover(tmp_path / "s.h5")[1].tests) == 2


def test_a_journal_that_cannot_be_read_back_is_not_removed(tmp_path, monkeypatch):
    recorder = a_sitting(tmp_path / "s.h5")

    def fails(*_):
        raise OSError(errno.EIO, os.strerror(errno.EIO))
        yield

    with monkeypatch.context() as patch:
        patch.setattr(recovery, "read_entries", fails)
        with pytest.raises(JournalError, check=coded("recording.kept", reason="Input/output error")):
            recorder.finish()
    assert len(recover(tmp_path / "s.h5")[1].tests) == 2


def test_another_failure_is_not_hidden_by_that_of_the_disk(tmp_path, monkeypatch):
    """The cable breaks, and the disk is full as well: the test ends for the first reason."""
    sitting = Sitting(tmp_path)
    disk = Disk(monkeypatch, journal_path(sitting.path))

    def unplug(progress):
        if progress.fraction > 0.5:
            sitting.instrument.link.plugged = False
            disk.fails_at = disk.calls + 1

    recorder = SessionRecorder(sitting.path, sitting.instrument.device)
    with pytest.raises(LinkLostError):
        run_guided_test(sitting.instrument, guided(), recorder, surface_m=0.01, progress=unplug)
    with pytest.raises(JournalError):
        recorder.finish_or_discard()


def test_write_session_and_the_recorder_agree(tmp_path):
    """Streamed or whole, a session is the same."""
    recorder = a_sitting(tmp_path / "s.h5")
    session = recorder.finish()
    write_session(tmp_path / "t.h5", session)
    again = read_session(tmp_path / "t.h5")
    assert [test.samples for test in again.tests] == [test.samples for test in session.tests]
    assert (again.session_id, again.created) == (session.session_id, session.created)


# -- before it begins ----------------------------------------------------------------------------------------
Usage = namedtuple("Usage", "total used free")


def test_a_full_disk_is_reported_before_the_coil_is_energised(tmp_path, monkeypatch):
    instrument = connect()
    free = [50_000_000]
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(0, 0, free[0]))
    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device)
    free[0] = 32_100_000
    energised = []
    with pytest.raises(JournalError, check=coded("disk.full", folder=str(tmp_path), free=32.1)) as raised:
        run_guided_test(
            instrument,
            guided(),
            recorder,
            surface_m=0.01,
            progress=lambda _: energised.append(instrument.link.firmware.energised),
        )
    check_one_line(raised.value)
    assert energised == []
    assert recorder.finish_or_discard() is None
    free[0] = 1_000_000
    with pytest.raises(JournalError, check=coded("disk.full", free=1.0)):
        SessionRecorder(tmp_path / "s.h5", instrument.device)
    assert list(tmp_path.iterdir()) == []


def test_what_is_wanted_is_more_than_is_taken(tmp_path, monkeypatch):
    """The worst case: signals that no compression makes smaller."""
    asked = []
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(0, 0, 10**12))
    monkeypatch.setattr(recording, "MIN_FREE_BYTES", 0)
    recorder = SessionRecorder(tmp_path / "s.h5", DeviceDescription())
    noise = np.random.default_rng(1).standard_normal(20_000)
    samples = batch(0, 20_000)
    for name in SAMPLE.names[1:-1]:
        samples[name] = noise * (1 + len(name))
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(0, 0, 0))
    with pytest.raises(JournalError, check=coded("disk.full")) as raised:
        recorder.prepare(20_000)
    asked.append(raised.value.message.values["wanted"] * 1e6)
    recorder.begin_test(Run(0, 20_000), **ATTRIBUTES)
    recorder.add(samples)
    recorder.end_test("completed")
    recorder.journal.sync()
    taken = journal_path(recorder.path).stat().st_size
    recorder.write()
    taken += recorder.path.stat().st_size
    assert 0.8 * asked[0] < taken < asked[0] + 0.5e6


def test_a_sitting_that_is_too_large_to_read_is_refused(tmp_path):
    recorder = SessionRecorder(tmp_path / "s.h5", DeviceDescription())
    recorder.samples_appended = 22_000_000
    with pytest.raises(SessionFormatError, check=coded("session.too_large")):
        recorder.prepare(1_000_000)
    recorder.samples_appended = 0
    recorder.finish_or_discard()


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EROFS, errno.EACCES])
def test_a_journal_that_cannot_be_begun_leaves_nothing(tmp_path, monkeypatch, number):
    def fails(*_):
        raise OSError(number, os.strerror(number))

    with monkeypatch.context() as patch:
        patch.setattr(os, "write", fails)
        with pytest.raises(JournalError, check=coded("journal.not_begun", reason=os.strerror(number))):
            SessionRecorder(tmp_path / "s.h5", DeviceDescription())
    assert list(tmp_path.iterdir()) == []
