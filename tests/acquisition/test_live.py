"""Identification during a test: its results, its stop rule, and that it never delays the test."""

from __future__ import annotations

import pickle
import subprocess
import sys
import threading

import numpy as np
import pytest
from coded import coded, says
from plant_support import bench_record
from pydantic import ValidationError

from tissueid.acquisition import GuidedTest, SessionRecorder, live_process, run_guided_test
from tissueid.acquisition.live import LiveIdentification
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.identification.engines.lms import Lms
from tissueid.identification.live.stopping import StopRule
from tissueid.instrument import SAMPLE, SimulatedInstrument
from tissueid.messages import code_of
from tissueid.stimuli.base import with_preload
from tissueid.stimuli.kinds.noise import Noise
from tissueid.test_settings import TestSettings

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
    live = LiveIdentification(DEVICE, preload_s=PRELOAD_S, separate_process=False, **options)
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
    live = LiveIdentification(DEVICE, preload_s=PRELOAD_S, stop=rule, separate_process=False)
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
    (known,) = live.reason.values["found"].items
    assert says(known, "stop_rule.known", name="damping", target=6.0)
    assert known.values["percent"] == pytest.approx(100.0 * shares[-1])
    never = stepped(samples, stop=StopRule(targets={"stiffness": 0.001}))
    never.close()
    assert not never.enough()


def test_a_backlog_is_taken_at_once(samples):
    live = LiveIdentification(DEVICE, preload_s=PRELOAD_S, separate_process=False)
    live.feed(samples)
    assert live.step()
    assert not live.step()
    assert live.latest().course.seconds.tolist() == [4.0]
    whole = stepped(samples)
    np.testing.assert_array_equal(live.latest().impulse_response, whole.latest().impulse_response)


def test_samples_left_out_are_gaps_and_long_runs_find_room(samples):
    live = LiveIdentification(DEVICE, preload_s=PRELOAD_S, separate_process=False)
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


def test_an_error_is_kept_and_does_not_end_the_test(samples, monkeypatch):
    live = LiveIdentification(DEVICE, preload_s=PRELOAD_S, separate_process=False)

    def fails(*_):
        raise ZeroDivisionError("no such thing")

    monkeypatch.setattr(live_process, "view", fails)
    live.feed(samples)
    live.step()
    assert says(live.problem, "live.defect", kind="ZeroDivisionError", error="no such thing")
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


def test_a_process_that_dies_is_reported_and_feeding_continues(samples):
    live = LiveIdentification(DEVICE, preload_s=PRELOAD_S)
    live.estimator.process.kill()
    live.estimator.threads[1].join()
    for first in range(0, samples.size, 100):
        live.feed(samples[first : first + 100])
    assert says(live.problem, "live.ended")
    live.feed(samples)
    live.close()
    assert live.latest() is None
    assert not live.enough()


def test_a_process_that_cannot_be_started_is_reported(samples, monkeypatch):
    monkeypatch.setattr(sys, "executable", "/no/such/python")
    live = LiveIdentification(DEVICE, preload_s=PRELOAD_S)
    live.feed(samples)
    live.close()
    assert says(live.problem, "live.not_started", reason="No such file or directory")


@pytest.mark.parametrize("separate_process", [False, True])
def test_invalid_settings_are_refused_before_a_process_is_started(separate_process, monkeypatch):
    monkeypatch.setattr(subprocess, "Popen", None)
    with pytest.raises(UnusableInputError, check=coded("online.short_window", window=10.0, memory=6.0)):
        LiveIdentification(DEVICE, memory=6.0, separate_process=separate_process)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (
            b'{"sample_rate_hz": 2000.0, "memory": 6.0}',
            "a window of 10 s is shorter than two memories of 6 s: lengthen",
        ),
        (b'{"memory": 6.0}', "live.defect"),
    ],
)
def test_the_process_reports_the_error_that_ends_it(settings, said):
    ended = subprocess.run(
        [sys.executable, "-P", "-c", live_process.COMMAND], input=settings + b"\n", capture_output=True, timeout=60.0
    )
    update = pickle.loads(ended.stdout)  # noqa: S301 - written by the process that was started above
    assert code_of(update.problem) == said or update.problem.startswith(said)
    assert "\n" not in update.problem
    assert ended.stderr == b""


def test_out_of_bounds():
    with pytest.raises(UnusableInputError, check=coded("online.short_window", window=0.2)):
        LiveIdentification(DEVICE, window_s=0.2, separate_process=False)
    with pytest.raises(ValidationError):
        LiveIdentification(DEVICE, memory=-1.0, separate_process=False)


def test_beside_a_guided_test_that_it_ends(tmp_path):
    noise = Noise(force_min_n=1.0, force_max_n=8.0, seconds=4.0, seed=3).build()
    test = GuidedTest(with_preload(noise, PRELOAD_S), TestSettings(site="left forearm"))
    instrument = SimulatedInstrument("baseline", seed=4)
    live = LiveIdentification(
        instrument.device, preload_s=PRELOAD_S, stop=StopRule.from_words(["stiffness=0.008"]), separate_process=False
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
    assert "(target 0.8 %)" in recorded.notes["reason"]
    assert 2000 < recorded.samples < 9000
    whole = Lms().fit(recorded.record()).report.parameters["stiffness_n_per_m"]
    assert live.latest().parameters["stiffness"].value == pytest.approx(whole.value, rel=1e-6)
