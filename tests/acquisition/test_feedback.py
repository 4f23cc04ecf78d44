"""Feedback stimuli on every kind of instrument: what the source sees, what is played, and what mishaps leave."""

import json
from itertools import pairwise

import numpy as np
import pytest
from coded import coded, says
from feedback_kinds import PushBack, PushBackSource, Runaway
from support import connect

from tissueid.acquisition import GuidedTest, Phase, SessionRecorder, run_guided_test
from tissueid.errors import (
    FirmwareFaultError,
    InstrumentError,
    LimitError,
    TissueIDError,
    UnusableInputError,
)
from tissueid.instrument import ReplayInstrument, SimulatedInstrument
from tissueid.stimuli import get_stimulus
from tissueid.stimuli.base import BLOCK
from tissueid.test_settings import TestSettings
from tissueid.wire import Fault

PRELOAD = 1000
SURFACE = 0.01


def a_test(seconds=1.0, **options):
    return GuidedTest(PushBack(seconds=seconds, **options), TestSettings(site="left forearm"))


def run(instrument, test, path, **arguments):
    recorder = SessionRecorder(path, instrument.device)
    try:
        run_guided_test(instrument, test, recorder, surface_m=SURFACE, **arguments)
    except TissueIDError:
        session = recorder.finish_or_discard()
        raise
    else:
        session = recorder.finish()
    return session.test()


def replayed(test, kind, device):
    """The set-points, V, that the recorded answers ask for, one block after the other."""
    source = kind.start(SURFACE)
    force, position = test.signals["force"], test.signals["position"]
    volts, taken = [], -PRELOAD
    for block in range(-(-(test.samples - PRELOAD) // BLOCK)):
        due = (block - kind.lead) * BLOCK
        for first in range(taken, due, BLOCK):
            part = slice(PRELOAD + first, PRELOAD + min(first + BLOCK, due))
            source.take(force[part], position[part], first)
        taken = max(taken, due)
        volts.append(source.next_block() * device.voltage_for_force(1.0))
    return np.concatenate(volts)[: test.samples - PRELOAD]


@pytest.mark.parametrize("make", [connect, SimulatedInstrument], ids=["firmware", "in process"])
@pytest.mark.parametrize("lead", [1, 3])
def test_what_is_played_is_what_the_recorded_answers_ask_for(make, lead, tmp_path):
    instrument = make()
    lead = lead + (make is connect)  # a cable needs a block of its own
    test = a_test(seconds=1.015, lead=lead)
    seen = []
    played = run(instrument, test, tmp_path / "s.h5", progress=seen.append)
    instrument.close()
    assert (played.status, played.samples, played.preload_s, played.seed) == ("completed", PRELOAD + 2030, 0.5, 0)
    assert played.stimulus == {"type": "guided", "preload_s": 0.5, "stimulus": test.stimulus.describe()}
    assert not np.isnan(played.signals["position"]).any()
    wanted = replayed(played, test.stimulus, instrument.device)
    step = 48.0 / 32767  # of the converter
    np.testing.assert_allclose(played.signals["command"][PRELOAD:], wanted, atol=step)
    assert played.notes["late_blocks"] == played.notes["held_samples"] == 0
    assert json.loads(played.notes["stimulus_report"]) == {"blocks": 41, "samples": PRELOAD + 2030, "lost": 0}
    assert np.ptp(wanted) > 4.0
    phases = list(dict.fromkeys(item.phase for item in seen))
    assert phases == [Phase.PRELOAD, Phase.STIMULUS, Phase.RELEASE]
    fractions = [item.fraction for item in seen[:-1]]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0


def test_the_preload_rises_softly_to_the_load_of_the_kind(tmp_path):
    instrument = SimulatedInstrument()
    test = run(instrument, a_test(), tmp_path / "s.h5")
    newtons = test.signals["command"] / instrument.device.voltage_for_force(1.0)
    assert newtons[0] == 0.0
    assert np.abs(np.diff(newtons[:PRELOAD])).max() < 0.07
    np.testing.assert_allclose(newtons[100:PRELOAD], 4.0)


def test_the_source_gets_whole_blocks_in_order_and_none_that_is_not_due(tmp_path):
    sources = []

    class Watched(PushBack):
        def start(self, surface_m):
            sources.append(super().start(surface_m))
            return sources[-1]

    run(SimulatedInstrument(), GuidedTest(Watched(seconds=0.5, seed=11), TestSettings(site="x")), tmp_path / "s.h5")
    taken = sources[-1].taken
    assert taken[0] == (-PRELOAD, BLOCK)
    assert all(first + count == following for (first, count), (following, _) in pairwise(taken))
    assert {count for _, count in taken} == {BLOCK}
    assert sum(taken[-1]) == 1000


def test_lost_samples_reach_the_source_as_nan_and_are_told(tmp_path):
    instrument = connect()
    reads = iter(range(100_000))
    instrument.link.to_host = lambda data: b"" if next(reads) % 60 == 59 else data
    test = run(instrument, a_test(lead=4), tmp_path / "s.h5")
    lost = int(np.isnan(test.signals["position"]).sum())
    assert lost > 0
    assert json.loads(test.notes["stimulus_report"])["lost"] == lost
    assert test.notes["samples_lost"] == lost


def test_the_time_in_the_source_is_measured_by_the_clock_that_is_given(tmp_path):
    ticks = iter(range(100_000))
    test = run(SimulatedInstrument(), a_test(), tmp_path / "s.h5", clock=lambda: 1e-3 * next(ticks))
    assert test.notes["generating_longest_s"] == pytest.approx(1e-3)
    assert test.notes["generating_share"] == pytest.approx(40e-3 / 1.5)


def test_it_repeats_bit_by_bit_in_process(tmp_path):
    first, second = (
        run(SimulatedInstrument(seed=3), a_test(seed=5), tmp_path / f"{name}.h5").signals["command"] for name in "ab"
    )
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize(
    ("test", "error", "code", "values"),
    [
        (a_test(force_max_n=13.0), LimitError, "test.stimulus_force", {"force": 13.0, "limit": 12.0}),
        (a_test(force_min_n=-12.5), LimitError, "test.stimulus_force", {"force": 12.5, "limit": 12.0}),
        (a_test(seconds=29.6), LimitError, "", {}),
        (
            a_test(sample_rate=1000.0),
            UnusableInputError,
            "test.sample_rate",
            {"stimulus": 1000.0, "instrument": 2000.0},
        ),
        (GuidedTest(PushBack(), TestSettings(site="x"), preload_s=0.01), UnusableInputError, "", {}),
    ],
)
def test_an_unplayable_test_is_refused_before_the_coil_is_energised(test, error, code, values, tmp_path):
    instrument = SimulatedInstrument()
    with pytest.raises(error) as raised:
        run(instrument, test, tmp_path / "s.h5")
    assert not code or says(raised.value.message, code, **values)
    assert list(tmp_path.iterdir()) == []
    assert instrument.poll(0.0)["command"].max() == 0.0


def test_a_source_that_leaves_its_range_frees_the_coil(tmp_path):
    instrument = connect()
    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device)
    with pytest.raises(UnusableInputError, check=coded("stimulus.out_of_range", name="runaway", low=0.0, high=10.0)):
        run_guided_test(instrument, GuidedTest(Runaway(), TestSettings(site="x")), recorder, surface_m=SURFACE)
    assert not instrument.link.firmware.energised
    test = recorder.finish().test()
    assert test.status == "aborted"
    assert test.samples > PRELOAD + 10 * BLOCK
    assert says(test.reason, "stimulus.out_of_range", name="runaway")
    assert np.abs(test.signals["force"]).max() < 12.0


def test_a_replay_refuses_set_points_in_one_line(tmp_path):
    source = SimulatedInstrument()
    recorded = run(source, a_test(), tmp_path / "a.h5")
    with pytest.raises(InstrumentError, match=r"^[^\n]*$"):
        run(ReplayInstrument(source.device, recorded.signals), a_test(), tmp_path / "b.h5")


def test_a_host_that_stops_sending_is_held_and_then_released(tmp_path):
    instrument = connect()
    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device)
    send, sent = instrument.send, iter(range(1000))

    def fails_after_a_second(offset, command_v):
        if next(sent) < 40:
            send(offset, command_v)

    instrument.send = fails_after_a_second
    with pytest.raises(FirmwareFaultError) as raised:
        run_guided_test(instrument, a_test(3.0), recorder, surface_m=SURFACE)
    assert raised.value.faults == Fault.STARVED
    assert not instrument.link.firmware.energised
    test = recorder.finish().test()
    newtons = test.signals["command"] / instrument.device.voltage_for_force(1.0)
    np.testing.assert_allclose(newtons[PRELOAD + 2000 + 150 : PRELOAD + 2900], 4.0, atol=0.01)
    assert test.status == "aborted"
    assert test.notes["held_samples"] >= 500


def test_what_was_held_in_lost_samples_is_counted(tmp_path):
    instrument = connect()
    link = instrument.link
    begun = []

    def cut(data):
        if not begun and link.firmware.energised:
            begun.append(link.now)
        return b"" if begun and 1.0 < link.now - begun[0] < 1.2 else data

    link.to_host = link.to_device = cut
    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device)
    run_guided_test(instrument, a_test(1.5), recorder, surface_m=SURFACE)
    notes = recorder.finish().test().notes
    assert notes["samples_lost"] > 300
    assert notes["held_samples"] == link.firmware.player.held_samples > 200


class Unreportable(PushBackSource):
    """A plug-in source whose report cannot be stored as JSON."""

    def report(self):
        return {"kolmogorov_distance": np.int64(1)}


def test_a_report_that_cannot_be_kept_costs_no_test(tmp_path, monkeypatch):
    monkeypatch.setattr(PushBack, "start", lambda kind, surface_m: Unreportable(kind, surface_m))
    notes = run(SimulatedInstrument(), a_test(), tmp_path / "s.h5").notes
    assert "not JSON serializable" in notes["stimulus_report_failed"]
    assert "stimulus_report" not in notes


def test_a_defect_in_mid_feedback_frees_the_coil_and_closes_the_recording(tmp_path):
    instrument = connect()
    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device)

    def progress(item):
        if item.fraction > 0.6:
            raise ZeroDivisionError("a plug-in")

    with pytest.raises(ZeroDivisionError):
        run_guided_test(instrument, a_test(2.0), recorder, surface_m=SURFACE, progress=progress)
    assert not instrument.link.firmware.energised
    test = recorder.finish().test()
    assert test.status == "aborted"
    assert says(test.reason, "test.defect", kind="ZeroDivisionError", error="a plug-in")


@pytest.mark.parametrize(
    ("make", "depths"),
    [(SimulatedInstrument, (1.5e-3, 4.5e-3)), (lambda: connect("wiener-demo"), (1.0e-3, 6.0e-3))],
    ids=["twin", "wiener-demo"],
)
def test_real_time_input_generation_spreads_the_depth(make, depths, tmp_path):
    instrument = make()
    kind = get_stimulus("rtig")(depth_min_m=depths[0], depth_max_m=depths[1], force_max_n=11.0, seconds=5.0)
    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device)
    run_guided_test(instrument, GuidedTest(kind, TestSettings(site="x")), recorder)
    test = recorder.finish().test()
    depth = np.sort(test.record().output - test.surface_position_m)
    share = np.clip((depth - depths[0]) / (depths[1] - depths[0]), 0.0, 1.0)
    assert np.abs(share - np.arange(depth.size) / depth.size).max() < 0.08
    assert test.notes["late_blocks"] == test.notes["held_samples"] == 0
