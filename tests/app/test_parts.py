"""What lies under the window and needs no Qt: the ring buffer, the pace, the plan, the measurement."""

import threading
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from coded import made
from failing_disk import FULL
from hypothesis import given
from hypothesis import strategies as st

from tissueid.acquisition import PRELOAD_S, Phase, Progress, journal_path, recovery
from tissueid.app.emergency import EmergencyStop
from tissueid.app.form import longest_stimulus_s
from tissueid.app.live_signals import LiveSignals, decimated
from tissueid.app.live_test import LiveTest
from tissueid.app.user_files import dated_path
from tissueid.app.words import in_words, outcome_text, sentence
from tissueid.device import DeviceDescription
from tissueid.errors import LimitError, LinkLostError, UnusableInputError
from tissueid.instrument import PROFILES, SAMPLE, SimulatedInstrument
from tissueid.procedures.test_plan import TestPlan
from tissueid.procedures.test_run import run_test
from tissueid.sessions import read_session
from tissueid.stimuli.base import with_preload

DEVICE = DeviceDescription()


CABLE_OUT = "the cable is out"


def samples(first, count):
    block = np.zeros(count, SAMPLE)
    block["index"] = first + np.arange(count)
    block["current"] = block["index"]
    block["position"] = 0.01
    block["voltage"] = 2.0 * block["index"]
    return block


def test_time_is_that_of_the_session_and_negative_while_placing():
    live = LiveSignals()
    live.add(Progress(Phase.PLACE, 0.5, samples(1000, 20)), DEVICE)
    live.add(Progress(Phase.PRELOAD, 0.1, samples(9000, 20)), DEVICE)
    live.add(Progress(Phase.RELEASE, 1.0, samples(0, 0)), DEVICE)
    snapshot = live.snapshot()
    assert snapshot.phase is Phase.RELEASE
    assert snapshot.time_s[[0, 19, 20, 39]] == pytest.approx([-1.2, -1.1905, 0.0, 0.0095])
    assert snapshot.force_n[20] == 3.0 * 9000
    assert snapshot.voltage_v[[20, 39]].tolist() == [18000.0, 18038.0]


@given(st.lists(st.integers(1, 70), min_size=1, max_size=12))
def test_the_ring_holds_the_newest_samples_in_order(counts):
    live = LiveSignals(capacity=50)
    first = 0
    for count in counts:
        live.add(Progress(Phase.STIMULUS, 0.5, samples(first, count)), DEVICE)
        first += count
    expected = np.arange(first)[-50:]
    assert np.array_equal(live.snapshot().force_n / 3.0, expected)


@given(st.integers(1, 5000), st.integers(1, 300), st.integers(0, 2**32 - 1))
def test_decimation_keeps_every_extreme_and_the_width_of_the_plot(n, columns, seed):
    values = np.random.default_rng(seed).standard_normal(n)
    time_s = np.arange(n) / 2000.0
    x, y = decimated(time_s, values, 0.0, n / 2000.0, columns)
    assert x.size == y.size <= max(2 * columns + 2, n if n <= 2 * columns else 0)
    assert (y.min(), y.max()) == (values.min(), values.max())
    assert np.all(np.diff(x) >= 0)


def test_decimation_breaks_the_line_where_samples_are_lost():
    values = np.ones(4000)
    values[1000:2000] = np.nan
    x, y = decimated(np.arange(4000) / 2000.0, values, 0.0, 2.0, 100)
    assert np.isnan(y[(x > 0.52) & (x < 0.97)]).all()
    assert np.isfinite(y[(x < 0.48) | (x > 1.02)]).all()


def plan(tmp_path, **changes):
    return TestPlan(**({"url": "x", "site": "here", "out": tmp_path / "s.h5", "seconds": 1.0, "live": True} | changes))


def run(chosen, instrument, stop=None, separate_process=False):
    control = LiveTest(LiveSignals(), stop or EmergencyStop())
    return run_test(
        chosen, control, None, opener=lambda _: instrument, pace=lambda _: None, separate_process=separate_process
    )


class Spy(SimulatedInstrument):
    """A simulation that notes what was asked of it."""

    def __init__(self, **failures):
        super().__init__()
        self.asked = []
        self.failures = failures
        self.polls = 0

    def start(self):
        self.asked.append("start")
        return super().start()

    def poll(self, timeout_s):
        self.polls += 1
        if self.polls == self.failures.get("lost_at"):
            raise LinkLostError(CABLE_OUT)
        return super().poll(timeout_s)

    def close(self):
        self.asked.append("close")
        super().close()
        if "close" in self.failures:
            raise OSError(5, "Input/output error")


def test_a_test_from_start_to_file(tmp_path):
    outcome = run(plan(tmp_path), Spy())
    assert outcome.error is None
    assert outcome_text(outcome) == ("", False)
    assert read_session(outcome.path).test().status == "completed"


def test_a_lost_link_keeps_the_recorded_part(tmp_path):
    instrument = Spy(lost_at=200)
    outcome = run(plan(tmp_path), instrument)
    assert outcome_text(outcome)[0].startswith(f"{sentence(CABLE_OUT)} ")
    assert outcome.session.test().status == "aborted"
    assert instrument.asked[-1] == "close"


def test_a_port_that_cannot_be_closed_costs_no_data(tmp_path):
    outcome = run(plan(tmp_path), Spy(close=True), separate_process=True)
    assert not any(thread.name == "live identification" for thread in threading.enumerate())
    assert outcome_text(outcome)[0].startswith("Input/output error. ")
    assert outcome.session.test().status == "completed"


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        ({"max_force_n": 13.0}, LimitError, "the stimulus reaches 13.0 N; the limit is 12 N"),
        ({"seconds": 40.0}, LimitError, "lasts 40.5 s"),
        ({"min_force_n": 11.0}, UnusableInputError, "least force"),
        ({"min_force_n": 5.0, "max_force_n": 4.0}, UnusableInputError, "lowest force"),
    ],
)
def test_what_the_limits_forbid_never_energises_the_coil(tmp_path, changes, error, words):
    instrument = Spy()
    with pytest.raises(error, match=words):
        run(plan(tmp_path, **changes), instrument)
    assert "start" not in instrument.asked
    assert list(tmp_path.iterdir()) == []


def test_stopped_before_the_beginning(tmp_path):
    stop = EmergencyStop()
    stop.press("stopped")
    instrument = Spy()
    outcome = run(plan(tmp_path), instrument, stop)
    assert outcome.cancelled
    assert outcome.session is None
    assert instrument.asked == ["close"]
    assert list(tmp_path.iterdir()) == []


def test_a_session_that_cannot_be_written_leaves_its_journal(tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(28, FULL)

    monkeypatch.setattr(recovery, "write_session", full)
    outcome = run(plan(tmp_path), Spy())
    assert outcome.session is None
    assert outcome_text(outcome)[0].startswith(
        f"{FULL}. {made('outcome.recording_stays', path=journal_path(outcome.path))}"
    )
    assert journal_path(outcome.path).exists()


def test_dated_files_never_meet(tmp_path):
    moment = datetime(2026, 3, 4, 5, 6, 7)
    names = []
    for leave in ("{}", "{}.journal", "{}"):
        path = dated_path(tmp_path, moment)
        names.append(path.name)
        Path(leave.format(path)).touch()
    assert names == ["2026-03-04_05-06-07.h5", "2026-03-04_05-06-07_2.h5", "2026-03-04_05-06-07_3.h5"]


def test_the_longest_stimulus_leaves_room_for_the_preload(tmp_path):
    seconds = longest_stimulus_s("clinical")
    limits = PROFILES["clinical"]
    stimulus = with_preload(plan(tmp_path, seconds=seconds).specification(2000.0).build(), PRELOAD_S)
    assert stimulus.seconds == pytest.approx(limits.max_seconds)


@pytest.mark.parametrize(("text", "said"), [("a  b\nc", "A b c."), ("Done!", "Done!"), ("", ""), ("x.", "X.")])
def test_sentences(text, said):
    assert sentence(text) == said


def test_errors_in_words():
    missing = "No such file"
    assert in_words(LimitError("too far")) == "Too far."
    assert in_words(FileNotFoundError(2, missing, "/nowhere")) == f"/nowhere: {missing}."
