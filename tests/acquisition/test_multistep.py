"""The multistep test on the twin and on the simulated firmware: what each step brings, and what is kept."""

import json

import numpy as np
import pytest
from coded import coded, says
from support import connect

from tissueid.acquisition import MultistepTest, SessionRecorder, check_multistep, run_multistep
from tissueid.acquisition.multistep import fit_best_model
from tissueid.device import DeviceDescription
from tissueid.errors import CancelledError, LimitError, LinkLostError, UnusableInputError
from tissueid.instrument import SimulatedInstrument
from tissueid.records import Record
from tissueid.stimuli.depth_uniform import DepthDesign
from tissueid.test_settings import TestSettings

pytestmark = pytest.mark.usefixtures("long_frames")

RATE = 2000.0


def a_test(low=1.5e-3, high=4.5e-3, *, steps=3, target=0.0, seconds=2.0, **options):
    design = DepthDesign(depth_min_m=low, depth_max_m=high, seconds=seconds, force_max_n=11.0, **options)
    return MultistepTest(design, TestSettings(site="left forearm"), steps=steps, target=target)


def run(instrument, test, path, **arguments):
    recorder = SessionRecorder(path, instrument.device)
    try:
        steps = run_multistep(instrument, test, recorder, **arguments)
    except BaseException:
        recorder.finish_or_discard()
        raise
    return steps, recorder.finish()


def distance(test, low, high):
    """Kolmogorov distance of the depth after the preload from uniform, by its definition."""
    depth = np.sort(test.signals["position"][1000:] - test.surface_position_m)
    return np.abs(np.clip((depth - low) / (high - low), 0.0, 1.0) - np.arange(depth.size) / depth.size).max()


@pytest.mark.parametrize(
    ("make", "low", "high"),
    [(lambda: SimulatedInstrument("baseline"), 1.7e-3, 4.5e-3), (lambda: connect("wiener-demo"), 1e-3, 6e-3)],
    ids=["twin", "wiener-demo"],
)
def test_the_depth_grows_even_without_supervision(make, low, high, tmp_path):
    instrument = make()
    labels = []
    steps, session = run(
        instrument, a_test(low, high), tmp_path / "s.h5", progress=lambda label, _: labels.append(label)
    )
    instrument.close()
    assert [step.number for step in steps] == [test.number for test in session.tests] == [1, 2, 3]
    assert steps[0].distance > 0.2
    assert steps[1].distance < 0.06
    assert steps[2].distance < 0.04
    for step, test in zip(steps, session.tests, strict=True):
        assert (test.status, test.samples) == ("completed", 5000)
        assert step.distance == pytest.approx(distance(test, step.depth_min_m, step.depth_max_m), abs=1e-3)
        event = json.loads(test.notes["events"])[-1]
        assert (event["kind"], event["distance"]) == ("depth", step.distance)
    assert steps[0].predicted is steps[0].engine is None
    assert steps[2].predicted < 0.03
    assert steps[2].vaf_held_out_percent > 97.0
    notes = session.tests[2].notes
    assert (notes["multistep"], notes["designed_by"]) == (3.0, steps[2].engine)
    assert notes["distance_predicted"] == steps[2].predicted
    assert list(dict.fromkeys(labels)) == ["placing the probe", "step 1 of 3", "step 2 of 3", "step 3 of 3"]


def test_it_ends_as_soon_as_the_depth_is_even_enough(tmp_path):
    steps, session = run(SimulatedInstrument("baseline"), a_test(steps=10, target=0.1, seconds=1.0), tmp_path / "s.h5")
    assert len(steps) == len(session.tests) == 2
    assert steps[-1].distance <= 0.1


def test_what_is_out_of_reach_is_said_and_left_out(tmp_path):
    steps, session = run(SimulatedInstrument("baseline"), a_test(2e-3, 15e-3, steps=2, seconds=1.0), tmp_path / "s.h5")
    assert steps[1].depth_max_m < 8e-3
    assert session.tests[1].notes["depth_asked_max_m"] == 15e-3
    assert session.tests[1].notes["depth_max_m"] == steps[1].depth_max_m
    assert steps[1].distance < 0.1


def test_a_depth_that_no_force_reaches_keeps_the_first_test(tmp_path):
    recorder = SessionRecorder(tmp_path / "s.h5", (instrument := SimulatedInstrument()).device)
    with pytest.raises(UnusableInputError, check=coded("depth.out_of_reach")):
        run_multistep(instrument, a_test(20e-3, 25e-3), recorder)
    assert [test.status for test in recorder.finish().tests] == ["completed"]


@pytest.mark.parametrize(
    ("test", "error", "code"),
    [
        (
            MultistepTest(DepthDesign(depth_min_m=0.0, depth_max_m=1e-3, force_max_n=13.0), TestSettings(site="x")),
            LimitError,
            "test.stimulus_force",
        ),
        (
            MultistepTest(DepthDesign(depth_min_m=0.0, depth_max_m=1e-3, seconds=40.0), TestSettings(site="x")),
            LimitError,
            "",
        ),
        (
            MultistepTest(DepthDesign(depth_min_m=0.0, depth_max_m=0.04), TestSettings(site="x")),
            UnusableInputError,
            "multistep.depth",
        ),
        (
            MultistepTest(DepthDesign(depth_min_m=0.0, depth_max_m=1e-3, sample_rate=1000.0), TestSettings(site="x")),
            UnusableInputError,
            "test.sample_rate",
        ),
    ],
)
def test_an_unplayable_run_is_refused_before_the_coil_is_energised(test, error, code):
    with pytest.raises(error) as raised:
        check_multistep(test, DeviceDescription())
    assert not code or says(raised.value.message, code)


def test_cancelled_between_two_tests_it_keeps_what_was_recorded(tmp_path):
    instrument = connect()
    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device)
    seen = []

    def between():
        return bool(seen) and seen[-1] == "release"

    with pytest.raises(CancelledError, check=coded("test.cancelled_between")):
        run_multistep(
            instrument,
            a_test(seconds=1.0),
            recorder,
            surface_m=0.01,
            progress=lambda _, progress: seen.append(progress.phase.value),
            cancelled=between,
        )
    assert [test.status for test in recorder.finish().tests] == ["completed"]
    assert not instrument.link.firmware.energised


def test_unplugged_between_two_tests_it_keeps_what_was_recorded(tmp_path):
    instrument = connect()
    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device)

    def progress(_label, shown):
        instrument.link.plugged = shown.phase.value != "release"

    with pytest.raises(LinkLostError):
        run_multistep(instrument, a_test(seconds=1.0), recorder, surface_m=0.01, progress=progress)
    assert [test.status for test in recorder.finish().tests] == ["completed"]


def test_the_engine_that_foretells_best_is_taken():
    """Stiffness that grows with depth while mass and damping stay: no cascade, so that dpn must win."""
    rng = np.random.Generator(np.random.PCG64(3))
    force = 4.0 + np.convolve(rng.normal(0.0, 1.0, 9000), np.hanning(60) / 12.0, "same")[:8000]
    position = np.empty(8000)
    x, v, step = 0.004, 0.0, 1.0 / (20 * RATE)
    for k, load in enumerate(np.repeat(force, 20)):
        v += step * (load - 6.0 * v - 300.0 * x - 3e7 * x**3) / 0.2
        x += step * v
        if k % 20 == 19:
            position[k // 20] = x
    found = fit_best_model([Record(force, position, RATE)])
    assert found.engine == "dpn"
    assert found.vaf_held_out_percent > 99.0


def test_a_record_that_carries_no_fit_is_refused():
    with pytest.raises(UnusableInputError, check=coded("multistep.no_fit")):
        fit_best_model([Record(np.ones(4000), np.ones(4000), RATE)])
