"""A test that ends when enough is known: as long as what was played, and whole, in the session and in the journal."""

import numpy as np
import pytest
from coded import holding, says
from feedback_kinds import PushBack
from support import connect

from tissueid.acquisition import GuidedTest, SessionRecorder, recover, run_guided_test
from tissueid.acquisition.journal import Entry, encode_json, journal_path
from tissueid.errors import FirmwareFaultError
from tissueid.instrument import ReplayInstrument, SimulatedInstrument
from tissueid.sessions import read_session
from tissueid.stimuli import with_preload
from tissueid.stimuli.kinds.noise import Noise
from tissueid.test_settings import TestSettings

SURFACE = 0.01
PRELOAD = 1000


def noise(seconds=3.0):
    return with_preload(Noise(seconds=seconds, force_min_n=1.0, force_max_n=7.0, seed=4).build())


class After:
    """Return True when the given number of seconds of the test has been received."""

    def __init__(self, seconds):
        self.samples = seconds * 2000.0
        self.seen = self.asked = 0

    def progress(self, item):
        self.seen += item.samples.size

    def enough(self):
        self.asked += 1
        return self.seen >= self.samples


def run(instrument, stimulus, path, after, **arguments):
    recorder = SessionRecorder(path, instrument.device)
    test = GuidedTest(stimulus, TestSettings(site="x"))
    run_guided_test(
        instrument, test, recorder, surface_m=SURFACE, progress=after.progress, enough=after.enough, **arguments
    )
    recorder.finish()
    return read_session(path).test()


@pytest.mark.parametrize("make", [connect, SimulatedInstrument], ids=["firmware", "in process"])
@pytest.mark.parametrize("stimulus", [noise(), PushBack(seconds=3.0, lead=3)], ids=["open loop", "feedback"])
def test_it_is_completed_and_as_long_as_what_was_played(make, stimulus, tmp_path):
    instrument = make()
    after = After(2.0)
    test = run(instrument, stimulus, tmp_path / "s.h5", after, why=lambda: "stiffness known to 2 %")
    assert test.status == "completed"
    assert 4000 <= test.samples < 4400
    assert not np.isnan(test.signals["position"]).any()
    assert test.notes["ended_early_s"] == pytest.approx((test.samples - PRELOAD) / 2000.0)
    assert says(test.reason, "test.ended", seconds=test.notes["ended_early_s"], why="stiffness known to 2 %")
    if not isinstance(stimulus, PushBack):
        command = test.signals["command"] / instrument.device.voltage_for_force(1.0)
        np.testing.assert_allclose(command, stimulus.values[: test.samples], atol=1e-3)
    # The soft release runs out, and the next test begins as if nothing had been.
    second = run(instrument, stimulus, tmp_path / "t.h5", After(np.inf))
    assert "ended_early_s" not in second.notes
    assert second.samples == PRELOAD + 6000
    instrument.close()


def test_a_fault_at_the_moment_of_the_end_is_no_completed_test(tmp_path):
    instrument = connect()
    link, firmware = instrument.link, instrument.link.firmware
    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device)
    after = After(1.0)

    def enough():
        if not after.enough():
            return False
        firmware.bench.button = True
        link.tick()
        firmware.bench.button = False
        return True

    with pytest.raises(FirmwareFaultError, check=holding("fault.button")):
        run_guided_test(
            instrument,
            GuidedTest(noise(), TestSettings(site="x")),
            recorder,
            surface_m=SURFACE,
            progress=after.progress,
            enough=enough,
        )
    assert not firmware.energised
    assert recorder.finish().test().status == "aborted"


def test_what_is_enough_at_once_ends_after_the_preload(tmp_path):
    test = run(SimulatedInstrument(), noise(), tmp_path / "s.h5", After(0.0))
    assert PRELOAD < test.samples < PRELOAD + 100
    assert len(test.record()) > 0


def test_it_is_asked_no_more_once_it_was_enough(tmp_path):
    after = After(1.0)
    run(SimulatedInstrument(), noise(), tmp_path / "s.h5", after)
    assert after.asked < 60


def test_a_replay_ends_early_too(tmp_path):
    source = SimulatedInstrument()
    recorded = run(source, noise(), tmp_path / "a.h5", After(np.inf))
    test = run(ReplayInstrument(source.device, recorded.signals), noise(), tmp_path / "b.h5", After(1.5))
    assert 3000 <= test.samples < 3100
    np.testing.assert_array_equal(test.signals["position"], recorded.signals["position"][: test.samples])


def test_a_host_that_dies_after_an_early_end_leaves_just_what_was_played(tmp_path):
    instrument = connect()
    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device)
    after = After(2.0)
    run_guided_test(
        instrument,
        GuidedTest(noise(), TestSettings(site="x")),
        recorder,
        surface_m=SURFACE,
        progress=after.progress,
        enough=after.enough,
    )
    recorder.abandon()
    _, session = recover(tmp_path / "s.h5")
    assert session.test().status == "completed"
    assert 4000 <= session.test().samples < 4400
    assert not np.isnan(session.test().signals["position"]).any()


@pytest.mark.parametrize("samples", [0, -1, 10_000_000])
def test_an_end_with_an_impossible_length_is_skipped_and_reported(samples, tmp_path):
    instrument = SimulatedInstrument()
    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device)
    run_guided_test(instrument, GuidedTest(noise(0.5), TestSettings(site="x")), recorder, surface_m=SURFACE)
    recorder.abandon()
    with journal_path(tmp_path / "s.h5").open("ab") as file:
        file.write(encode_json(Entry.TEST_END, {"status": "completed", "notes": {}, "samples": samples}))
    reported: list[str] = []
    test = recover(tmp_path / "s.h5", report=reported.append)[1].test()
    assert (test.status, test.samples) == ("completed", recorder.samples_appended)
    assert says(reported[0], "recovery.damage", places=1)
