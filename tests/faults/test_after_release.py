"""What comes after a coil was released is no part of its test: not in the file, its verdict, or its message."""

import json

import numpy as np
import pytest
from coded import coded
from faults.cells import PRELOAD_S, SURFACE_M, feedback, open_loop
from faults.desk import Desk, virtual_time

from tissueid.acquisition import SessionRecorder, journal_path, recover, run_guided_test
from tissueid.errors import FirmwareFaultError
from tissueid.instrument.interface import empty_samples, trim_at_release
from tissueid.instrument.replies import describe_faults
from tissueid.sessions import read_session
from tissueid.wire import Fault, Flag

SECONDS = 4.0


def stopped_host(tmp_path, seconds, test=None):
    """A test whose host stands still for so long when half of it is over: its session, and the desk."""
    desk = Desk(seed=3)
    instrument = desk.open()
    recorder = SessionRecorder(tmp_path / "sitting.h5", instrument.device)
    waiting = [seconds]

    def progress(item):
        if item.fraction > 0.5 and waiting:
            desk.link.run_for(waiting.pop())

    with (
        virtual_time(),
        pytest.raises(FirmwareFaultError, check=coded("instrument.released", why=describe_faults(Fault.WATCHDOG))),
    ):
        run_guided_test(instrument, test or open_loop(SECONDS), recorder, surface_m=SURFACE_M, progress=progress)
    instrument.close()
    return recorder.finish().test(), desk, recorder


@pytest.mark.parametrize("seconds", [0.52, 0.7, 3.0])
def test_a_host_that_stands_still_keeps_what_was_played_and_no_more(tmp_path, seconds):
    test, desk, recorder = stopped_host(tmp_path, seconds)
    assert desk.firmware.faults == Fault.WATCHDOG
    assert test.status == "aborted"
    assert test.samples == desk.firmware.player.played
    assert test.notes["samples_after_release"] > 0
    assert recorder.samples_appended == test.samples
    command = np.asarray(test.signals["command"])
    assert np.isfinite(np.asarray(test.signals["position"])).all()
    assert np.abs(command[-20:]).min() > 0.1, "the coil was on to the last sample"
    findings = {item["code"]: item for item in json.loads(str(test.notes["quality"]))["findings"]}
    assert set(findings) == {"ended_early", "calibration_none"}
    played_s = test.samples / 2000 - PRELOAD_S
    assert f"after {played_s:.1f} s of its stimulus" in str(findings["ended_early"])


def test_set_points_of_a_host_that_stands_still(tmp_path):
    test, desk, _ = stopped_host(tmp_path, 3.0, feedback(SECONDS))
    assert test.samples == desk.firmware.player.played
    assert np.isfinite(np.asarray(test.signals["position"])).all()


def test_a_journal_with_samples_after_the_release_is_recovered_without_them(tmp_path):
    desk = Desk(seed=3)
    instrument = desk.open()
    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device)
    instrument.load(np.full(2000, 8.0))
    instrument.arm(open_loop().limits)
    recorder.begin_test(instrument.start(), kind="stochastic", site="x", sample_rate_hz=2000.0)
    for number in range(60):
        if number == 20:
            desk.firmware.brown_out()
            desk.link.to_host = lambda data: data
        instrument.pump(0.05)
        recorder.add(instrument.poll(0.05))
    played = desk.firmware.player.played
    recorder.abandon()
    assert journal_path(tmp_path / "s.h5").exists()
    _, session = recover(tmp_path / "s.h5")
    test = session.test()
    assert 300 < played < 500
    assert (test.status, test.samples) == ("recovered", played)
    assert test.notes["samples_after_release"] > 500
    assert "samples_lost" not in test.notes
    assert read_session(tmp_path / "s.h5").test().samples == played


def test_samples_that_were_lost_before_the_release_are_not_taken_for_played():
    def block(first, count, flags):
        samples = empty_samples(first, count)
        samples["flags"] = flags
        if flags:
            samples["position"] = 0.01
        return samples

    played, lost, free = block(0, 20, Flag.PLAYING), block(20, 20, 0), block(40, 20, Flag.ENERGISED)
    assert trim_at_release(np.concatenate([played, lost, free])).size == 20
    assert trim_at_release(np.concatenate([played, lost])).size == 40, "nothing says that it was released"
    assert trim_at_release(np.concatenate([played, lost, played, free])).size == 60
    assert trim_at_release(np.concatenate([free, played])).size == 0
