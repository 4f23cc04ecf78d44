"""The guided test on every kind of instrument, and what is kept when it ends early."""

import json

import numpy as np
import pytest
from coded import coded, holding, says
from feedback_kinds import PushBack
from support import MISHAPS, connect, halfway, left_by_a_power_cut

from tissueid.acquisition import GuidedTest, Phase, SessionRecorder, recover, run_guided_test
from tissueid.acquisition.guided import find_surface
from tissueid.errors import (
    CancelledError,
    LimitError,
    TissueIDError,
    UnusableInputError,
)
from tissueid.instrument import Limits, ReplayInstrument, SimulatedInstrument
from tissueid.sessions import read_session
from tissueid.stimuli.base import Stimulus
from tissueid.test_settings import TestSettings

RATE = 2000.0


def guided(seconds=1.0, mean=4.0, swing=1.0, **changes):
    time = np.arange(round(seconds * RATE)) / RATE
    force = mean + swing * np.sin(2 * np.pi * 20 * time)
    preload = np.full(round(0.5 * RATE), mean)
    stimulus = Stimulus(np.concatenate((preload, force)), RATE, {"type": "sine"}, 7, 1.4, preload_s=0.5)
    return GuidedTest(stimulus, TestSettings(site="left forearm"), **changes)


def feedback(seconds=1.0, **changes):
    return GuidedTest(PushBack(seconds=seconds), TestSettings(site="left forearm"), **changes)


both_kinds = pytest.mark.parametrize("make", [guided, feedback], ids=["open loop", "feedback"])


@pytest.fixture(params=["firmware", "in process", "replay"])
def instrument(request, tmp_path):
    if request.param == "firmware":
        yield (device := connect())
    elif request.param == "in process":
        yield (device := SimulatedInstrument("forearm", seed=2))
    else:
        source = SimulatedInstrument("forearm")
        recorder = SessionRecorder(tmp_path / "source.h5", source.device)
        run_guided_test(source, guided(), recorder, surface_m=0.01)
        test = recorder.finish().test()
        yield (device := ReplayInstrument(source.device, test.signals))
    device.close()


def test_one_guided_test_from_start_to_file(instrument, tmp_path):
    phases = []
    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device)
    surface = None if not isinstance(instrument, ReplayInstrument) else 0.0101
    number = run_guided_test(instrument, guided(), recorder, surface_m=surface, progress=phases.append)
    recorder.finish()
    test = read_session(tmp_path / "s.h5").test(number)
    assert (test.status, test.site, test.seed, test.preload_s) == ("completed", "left forearm", 7, 0.5)
    assert test.samples == 3000
    assert not np.isnan(test.signals["position"]).any()
    # Motion brakes the force by back-EMF, so it follows the command without matching it.
    assert np.corrcoef(test.signals["force"][1100:], guided().stimulus.values[1100:])[0, 1] > 0.97
    assert test.surface_position_m == pytest.approx(0.010, abs=4e-4)
    order = list(dict.fromkeys(item.phase for item in phases))
    assert order[-3:] == [Phase.PRELOAD, Phase.STIMULUS, Phase.RELEASE]
    fractions = [item.fraction for item in phases if item.phase in (Phase.PRELOAD, Phase.STIMULUS)]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0


@both_kinds
def test_cancelling_keeps_what_was_recorded(tmp_path, make):
    instrument = connect()
    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device)
    seen = []
    with pytest.raises(CancelledError):
        run_guided_test(
            instrument,
            make(3.0),
            recorder,
            surface_m=0.01,
            progress=seen.append,
            cancelled=lambda: bool(seen) and seen[-1].fraction > 0.5,
        )
    assert not instrument.link.firmware.energised
    test = recorder.finish().test()
    assert test.status == "aborted"
    assert 3000 < test.samples < 7000
    assert says(test.reason, "test.cancelled")


@MISHAPS
@both_kinds
def test_a_mishap_in_mid_test_frees_the_coil_and_keeps_the_recorded_part(tmp_path, make, mishap, error):
    instrument = connect()
    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device)
    with pytest.raises(error):
        run_guided_test(instrument, make(3.0), recorder, surface_m=0.01, progress=halfway(instrument, mishap))
    instrument.link.run_for(1.0)
    assert not instrument.link.firmware.energised
    instrument.close()
    test = recorder.finish().test()
    assert test.status == "aborted"
    assert test.samples >= 3500
    assert not np.isnan(test.signals["position"]).any()
    assert test.notes.get("generating_share", 0.0) > 0.0 or make is guided
    assert "stimulus_report" not in test.notes


@both_kinds
def test_a_limit_broken_in_mid_test(tmp_path, make):
    instrument = SimulatedInstrument()
    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device)
    with pytest.raises(LimitError, check=coded("limit.position")):
        run_guided_test(instrument, make(limits=Limits(max_position_m=0.013)), recorder, surface_m=0.01)
    assert recorder.finish().test().status == "aborted"


def test_a_stimulus_beyond_the_limits_is_never_sent(tmp_path):
    instrument = connect()
    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device)
    with pytest.raises(LimitError, check=coded("test.stimulus_force", limit=8.0)):
        run_guided_test(instrument, guided(mean=10.0, limits=Limits(max_force_n=8.0)), recorder, surface_m=0.01)
    recorder.abandon()


def test_gaps_are_stored_in_the_session(tmp_path):
    instrument = connect()
    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device)
    reads = iter(range(100_000))
    instrument.link.to_host = lambda data: b"" if next(reads) % 60 == 59 else data
    run_guided_test(instrument, guided(), recorder, surface_m=0.01)
    test = recorder.finish().test()
    lost = int(np.isnan(test.signals["force"]).sum())
    assert lost > 0
    assert test.notes["samples_lost"] == lost
    assert any(event["kind"] == "gap" for event in json.loads(test.notes["events"]))


@both_kinds
def test_a_host_that_dies_leaves_a_session_to_recover(tmp_path, make):
    instrument = connect()
    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device)
    power_cut = left_by_a_power_cut(recorder, tmp_path / "left.h5")
    run_guided_test(instrument, make(2.0), recorder, surface_m=0.01, progress=power_cut)
    recorder.abandon()
    _, session = recover(tmp_path / "left.h5")
    assert session.test().status == "recovered"
    assert 2500 < session.test().samples < 5000
    assert session.test().stimulus["type"] == ("sine" if make is guided else "guided")


def test_a_probe_in_the_air_is_noticed():
    from support import LoopbackLink

    from firmware_sim.bench import Bench
    from firmware_sim.firmware import Firmware
    from tissueid.instrument import SerialInstrument

    for tilt in (0.0, 180.0):
        bench = Bench("left-posterior-forearm", tilt_deg=tilt)
        bench.place_fixture(None)
        link = LoopbackLink(Firmware(bench))
        with pytest.raises(TissueIDError, check=holding("fault.stroke")):
            find_surface(SerialInstrument(link, clock=link.clock))


def test_lost_samples_while_placing_are_reported():
    instrument = connect()
    reads = iter(range(100_000))
    instrument.link.to_host = lambda data: b"" if next(reads) % 40 == 39 else data
    with pytest.raises(UnusableInputError, check=coded("placing.samples_lost")):
        find_surface(instrument)
