"""Attached tissue from the guided test to the identified stiffness, and tests that differ in their placement."""

from dataclasses import replace

import pytest
from coded import coded, holding
from support import LoopbackLink

from firmware_sim.firmware import Firmware
from firmware_sim.local_values import local_values
from firmware_sim.presets import load_preset
from firmware_sim.scenario import load_scenario
from tissueid.acquisition import GuidedTest, SessionRecorder, run_guided_test, usual_noise
from tissueid.acquisition.surface_detection import place
from tissueid.analysis import analyse
from tissueid.errors import LimitError, UnusableInputError
from tissueid.instrument import SerialInstrument
from tissueid.procedures.test_plan import TestPlan
from tissueid.sessions import read_session
from tissueid.test_settings import TestSettings

TISSUE = load_preset("forearm-attached")
ATTACHED = TestSettings(site="forearm", coupling="adhesive")


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """A session of two small tests on attached tissue: pulled by 3.5 N, pushed by 3.5 N."""
    path = tmp_path_factory.mktemp("attached") / "s.h5"
    link = LoopbackLink(Firmware(load_scenario(None, preset=TISSUE.name, seed=5).bench(), seed=5))
    with SerialInstrument(link, clock=link.clock) as instrument:
        recorder = SessionRecorder(path, instrument.device)
        placement = place(instrument)
        for mean_n in (-3.5, 3.5):
            noise = usual_noise(2000.0, force_min_n=mean_n - 0.75, force_max_n=mean_n + 0.75, seconds=1.5)
            test = GuidedTest(noise, ATTACHED)
            run_guided_test(instrument, test, recorder, surface_m=placement)
        beyond = usual_noise(2000.0, force_min_n=-13.0, force_max_n=-1.0, seconds=1.5)
        with pytest.raises(LimitError):  # the limits hold for pulling as well
            run_guided_test(instrument, GuidedTest(beyond, ATTACHED), recorder)
        recorder.write()
    return read_session(path)


def test_pulling_is_recorded_and_judged_as_such(session):
    assert [test.notes["coupling"] for test in session.tests] == ["adhesive", "adhesive"]
    for test in session.tests:
        assert test.status == "completed"
        assert "probe_lifted" not in str(test.notes["quality"])
    assert session.tests[0].signals["position"][1200:].max() < TISSUE.surface_m - 1e-3


def test_levels_find_the_stiffness_pulled_and_pushed(session):
    profile = analyse(session, "localized", test=1, also=(2,)).depth_profile()
    assert profile.position[0] < TISSUE.surface_m < profile.position[1]
    for position, stiffness in zip(profile.position, profile.stiffness, strict=True):
        true = local_values(TISSUE, float(position))["stiffness_n_per_m"]
        assert stiffness == pytest.approx(true, rel=0.04)


def test_tests_with_other_placements_are_not_fitted_together(session):
    other = replace(session.tests[1], notes=session.tests[1].notes | {"coupling": "tape"})
    with pytest.raises(UnusableInputError, check=coded("split.different_placements", first=1, second=2)):
        analyse(replace(session, tests=(session.tests[0], other)), "lms", test=1, also=(2,))


@pytest.mark.parametrize(
    ("values", "check"),
    [
        ({"orientation_deg": 90.0}, coded("configuration.not_here", name="indentation")),
        ({"configuration": "extension", "normal_preload_n": 1.0}, coded("configuration.not_here", name="extension")),
        ({"configuration": "extension", "initial_length_m": 1.0}, holding("option.most", limit=0.1)),
    ],
)
def test_a_plan_is_refused_before_an_instrument_is_opened(tmp_path, values, check):
    with pytest.raises(UnusableInputError, check=check):
        TestPlan(url="socket://nowhere:1", site="AP", out=tmp_path / "s.h5", **values)


def test_a_plan_hands_its_placement_on(tmp_path):
    values = {"coupling": "tape", "orientation_deg": 90.0, "initial_length_m": 0.01}
    plan = TestPlan(url="x", site="AP", out=tmp_path / "s.h5", configuration="extension", **values)
    plan.check()
    assert plan.as_notes().items() >= values.items()
