"""Identification beside a running test: what it finds, when it says enough, and that it never disturbs."""

from __future__ import annotations

import pickle
import subprocess
import sys
import threading

import numpy as np
import pytest
from plant_support import bench_record
from pydantic import ValidationError

from tissueid.acquisition import GuidedTest, SessionRecorder, live_process, run_guided_test
from tissueid.acquisition.live import LiveIdentification
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.identification.engines.lms import Lms
from tissueid.identification.online.stopping import StopRule
from tissueid.instrument import SAMPLE, SimulatedInstrument
from tissueid.stimuli.base import guided
from tissueid.stimuli.kinds.noise import Noise

DEVICE = DeviceDescription()
PRELOAD_S = 0.5


@pytest.fixture(scope="module")
def samples() -> np.ndarray:
    """4.5 s of a run that begins at sample 700: a forearm preset, with a preload of nothing before it."""
    record = bench_record("left-posterior-forearm", "gaussian", 1)
    block = np.zeros(9000, SAMPLE)
    block["index"] = 700 + np.arange(9000)
    block["current"][1000:] = record.input / DEVICE.force_constant_n_per_a
    block["position"][1000:] = record.output
    return block


def stepped(samples: np.ndarray, poll: int = 100, **options) -> LiveIdentification:
    live = LiveIdentification(DEVICE, preload_s=PRELOAD_S, apart=False, **options)
    for first in range(0, samples.size, poll):
        live.feed(samples[first : first + poll])
        live.step()
    return live


@pytest.mark.parametrize("method", ["sliding", "rls", "als"])
def test_the_last_view_is_that_of_the_whole_record(samples, method):
    live = stepped(samples, method=method)
    assert live.latest().seconds == 4.0
    assert live.latest().course.seconds.tolist() == [0.25 * k for k in range(1, 17)]
    live.feed(np.zeros(0, SAMPLE))
    live.close()
    live.close()
    assert live.problem == ""
    assert not live.enough()
    assert live.reason == ""


def test_closing_looks_at_what_was_left(samples):
    live = stepped(samples[:8950])
    assert live.latest().seconds == 3.75
    live.close()
    assert live.latest().seconds == 3.975
    record = bench_record("left-posterior-forearm", "gaussian", 1)[:7950]
    expected = Lms().fit(record)
    assert live.latest().parameters["stiffness"].value == pytest.approx(
        expected.report.parameters["stiffness_n_per_m"].value, rel=1e-6
    )
    np.testing.assert_allclose(live.latest().impulse_response, expected.impulse_response, atol=1e-6)
    assert live.busy_s > 0.0


def test_nothing_but_the_preload_is_nothing(samples):
    live = stepped(samples[:1000])
    live.close()
    assert live.latest() is None
    assert live.problem == ""


def test_enough_is_said_once_the_rule_is_met_and_not_by_the_last_look(samples):
    rule = StopRule(targets={"damping": 0.06}, looks=3)
    live = LiveIdentification(DEVICE, preload_s=PRELOAD_S, stop=rule, apart=False)
    said = None
    for first in range(0, samples.size, 100):
        live.feed(samples[first : first + 100])
        live.step()
        if live.enough():
            said = live.latest()
            break
    assert said is not None
    shares = said.course.std[:, 1] / said.course.values[:, 1]
    assert 1.0 <= said.seconds < 4.0
    assert np.all(shares[-3:] <= 0.06)
    assert not (np.all(shares[-4:-1] <= 0.06) and said.seconds > 1.25)  # not a look sooner
    assert live.reason == f"damping known to {100.0 * shares[-1]:.2g} % (6 % was asked)"
    never = stepped(samples, stop=StopRule(targets={"stiffness": 0.001}))
    never.close()
    assert not never.enough()


def test_a_backlog_is_taken_at_once(samples):
    live = LiveIdentification(DEVICE, preload_s=PRELOAD_S, apart=False)
    live.feed(samples)
    assert live.step()
    assert not live.step()
    assert live.latest().course.seconds.tolist() == [4.0]
    whole = stepped(samples)
    np.testing.assert_array_equal(live.latest().impulse_response, whole.latest().impulse_response)


def test_samples_left_out_are_gaps_and_long_runs_find_room(samples):
    live = LiveIdentification(DEVICE, preload_s=PRELOAD_S, apart=False)
    live.feed(samples[:5000])
    live.feed(samples[5003:])
    live.feed(samples[5000:5003])  # too late
    long = samples[1000:].copy()
    for repeat in range(1, 10):
        long["index"] = 700 + 9000 + 8000 * (repeat - 1) + np.arange(8000)
        live.feed(long)
    live.close()
    assert live.latest().seconds == 40.0
    assert live.problem == ""
    assert live.latest().vaf_percent == pytest.approx(75.0, abs=3.0)


def test_what_goes_wrong_is_kept_and_ends_nothing(samples, monkeypatch):
    live = LiveIdentification(DEVICE, preload_s=PRELOAD_S, apart=False)

    def fails(*_):
        raise ZeroDivisionError("no such thing")

    monkeypatch.setattr("tissueid.acquisition.live_looks.view", fails)
    live.feed(samples)
    live.step()
    assert live.problem == "live identification ended by a defect: ZeroDivisionError: no such thing"
    live.feed(samples)
    assert not live.step()
    live.close()
    assert live.latest() is None
    assert not live.enough()


def test_a_process_of_its_own_finds_the_same(samples):
    rule = StopRule(targets={"damping": 0.06})
    live = LiveIdentification(DEVICE, preload_s=PRELOAD_S, stop=rule)
    for first in range(0, samples.size, 100):
        live.feed(samples[first : first + 100])
    assert not live.step()
    live.close()
    live.close()
    assert live.problem == ""
    whole = stepped(samples)
    whole.close()
    assert live.latest().seconds == 4.0
    np.testing.assert_array_equal(live.latest().impulse_response, whole.latest().impulse_response)
    assert live.busy_s > 0.0
    assert not any(thread.name == "live identification" for thread in threading.enumerate())


def test_a_process_that_dies_is_told_and_the_feeding_goes_on(samples):
    live = LiveIdentification(DEVICE, preload_s=PRELOAD_S)
    live._looks._process.kill()
    live._looks._threads[1].join()
    for first in range(0, samples.size, 100):
        live.feed(samples[first : first + 100])
    assert live.problem == "live identification ended unexpectedly"
    live.feed(samples)
    live.close()
    assert live.latest() is None
    assert not live.enough()


def test_a_process_that_cannot_be_started_is_told(samples, monkeypatch):
    monkeypatch.setattr("sys.executable", "/no/such/python")
    live = LiveIdentification(DEVICE, preload_s=PRELOAD_S)
    live.feed(samples)
    live.close()
    assert live.problem == "live identification could not be started: No such file or directory"


@pytest.mark.parametrize("apart", [False, True])
def test_options_that_do_not_hold_are_refused_before_a_process_is_started(apart, monkeypatch):
    monkeypatch.setattr("subprocess.Popen", None)
    with pytest.raises(UnusableInputError, match=r"a window of 10 s is shorter than two memories of 6 s: lengthen it"):
        LiveIdentification(DEVICE, memory=6.0, apart=apart)


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        (
            b'{"sample_rate_hz": 2000.0, "memory": 6.0}',
            "a window of 10 s is shorter than two memories of 6 s: lengthen",
        ),
        (b'{"memory": 6.0}', "live identification ended by a defect: ValidationError: 1 validation error"),
    ],
)
def test_the_process_tells_in_words_what_ends_it(settings, told):
    ended = subprocess.run(
        [sys.executable, "-P", "-c", live_process._COMMAND], input=settings + b"\n", capture_output=True, timeout=60.0
    )
    news = pickle.loads(ended.stdout)  # noqa: S301 - written by the process that was started above
    assert news.problem.startswith(told)
    assert "\n" not in news.problem
    assert ended.stderr == b""


def test_out_of_bounds():
    with pytest.raises(UnusableInputError, match=r"a window of 0\.2 s is shorter than two memories"):
        LiveIdentification(DEVICE, window_s=0.2, apart=False)
    with pytest.raises(ValidationError):
        LiveIdentification(DEVICE, memory=-1.0, apart=False)


def test_beside_a_guided_test_that_it_ends(tmp_path):
    noise = Noise(force_min_n=1.0, force_max_n=8.0, seconds=4.0, seed=3).build()
    test = GuidedTest(guided(noise, PRELOAD_S), "left forearm")
    instrument = SimulatedInstrument("baseline", seed=4)
    live = LiveIdentification(
        instrument.device, preload_s=PRELOAD_S, stop=StopRule.from_words(["stiffness=0.008"]), apart=False
    )
    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device)

    def progress(item):
        live.feed(item.samples)
        live.step()

    number = run_guided_test(
        instrument, test, recorder, surface_m=0.01, progress=progress, enough=live.enough, why=lambda: live.reason
    )
    live.close()
    recorded = recorder.finish().test(number)
    assert live.enough()
    assert recorded.status == "completed"
    assert "(0.8 % was asked)" in recorded.notes["reason"]
    assert 2000 < recorded.samples < 9000
    whole = Lms().fit(recorded.record()).report.parameters["stiffness_n_per_m"]
    assert live.latest().parameters["stiffness"].value == pytest.approx(whole.value, rel=1e-6)
