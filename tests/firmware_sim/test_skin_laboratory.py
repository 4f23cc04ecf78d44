"""Scenarios on skin: reproducible, equal to the simulated instrument, and labelled by what is present."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from firmware_sim.bench import Bench
from firmware_sim.converters import CHANNELS
from firmware_sim.effects import EFFECTS
from firmware_sim.laboratory.scenario_generation import main
from firmware_sim.laboratory.skin import (
    HIDDEN,
    LATER_SESSIONS,
    SITES,
    draw_later_session,
    draw_later_sessions,
    draw_skin_scenario,
    draw_skin_scenarios,
)
from firmware_sim.plant import Plant
from tissueid.twin.catalogue import all_effects
from tissueid_lab.blind_check.answers import earlier_session, read_scenario, scenario_names, unseal

pytestmark = pytest.mark.timeout(600)  # the first test compiles the loop, on a busy machine for minutes

OF_THE_PRESET = {"directional_damping", "viscoelasticity", "added_mass"}


def names(scenario) -> list[str]:
    return [item["name"] for item in scenario.labels()["effects"]]


def test_equal_seeds_give_equal_files(tmp_path: Path):
    for name in ("one", "other"):
        arguments = ["--skin", "--clean", "--n", "1", "--seed", "5", "--full-share", "0", "--out"]
        assert main([*arguments, str(tmp_path / name)]) == 0
    files = sorted(path.name for path in (tmp_path / "one").iterdir())
    assert files == [
        "labels.json", "scenario-0001.base.f64", "scenario-0001.clean.f64", "scenario-0001.f64", "scenario-0001.json"
    ]  # fmt: skip
    for name in files:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "other" / name).read_bytes()
    (test,) = read_scenario(tmp_path / "one", "scenario-0001").tests
    assert test.notes["gravity_along_stroke_m_s2"] == pytest.approx(9.81, abs=0.5)
    assert test.notes["gravity_across_stroke_m_s2"] == pytest.approx(0.0, abs=0.5)
    assert read_scenario(tmp_path / "one", "scenario-0001").instrument.filter_corner_hz == 2000.0
    label = unseal(tmp_path / "one")["scenario-0001"]
    assert label.preset in SITES
    assert set(label.hidden) == set(label.effects) - OF_THE_PRESET - {"contact_loss"}
    assert label.preset not in (tmp_path / "one" / "scenario-0001.json").read_text()


def test_a_preset_without_hidden_effects_is_recorded_as_by_the_simulated_instrument():
    scenario = draw_skin_scenario(3, hidden=())
    (recording,) = scenario.record()
    bench = Bench(scenario.tissue, seed=1, parameters=scenario.parameters)
    block = bench.block(scenario.tests[0].command(scenario.number), energised=True)
    for k, channel in enumerate(CHANNELS[:5]):
        off = getattr(recording, channel.name) - channel.decode(block.codes[:, k])
        most = channel.noise_rms * np.sqrt(2.0) + channel.gain if channel.noise_rms else 0.0
        assert np.sqrt(np.mean(off**2)) <= most
        assert np.abs(np.mean(off)) <= 0.1 * most


def test_a_test_begins_at_rest_under_the_weight_of_the_probe():
    scenario = draw_skin_scenario(4, hidden=(), full=True)
    quiet = scenario.record(clean=True)[0]
    assert np.ptp(quiet.position) < 1e-9
    depth = quiet.position[0] - scenario.tissue.surface_m
    weight = scenario.parameters.gravity_force_n
    assert scenario.tissue.stiffness.at(depth) * depth == pytest.approx(weight, rel=1e-6)
    assert [test.kind for test in scenario.tests] == [
        "quiet", "stochastic", "stochastic", "stochastic", "slow_ramp", "spring"
    ]  # fmt: skip
    assert [test.repeats for test in scenario.tests] == [None, None, 2, None, None, None]


def test_contact_loss_is_a_label_only_where_the_probe_leaves_the_skin():
    drawn = draw_skin_scenario(3, hidden=("dry_friction",))
    (test,) = drawn.tests
    pressed = replace(drawn, tests=(replace(test, low_n=3.0, high_n=8.0),))
    lifted = replace(drawn, tests=(replace(test, low_n=-5.0, high_n=8.0),))
    assert pressed.lift_off_s == 0.0
    assert lifted.lift_off_s > 0.0
    assert set(names(pressed)) == OF_THE_PRESET | {"dry_friction"}
    assert set(names(lifted)) == OF_THE_PRESET | {"contact_loss", "dry_friction"}
    held_out = replace(drawn, tests=(replace(test, low_n=-5.0, high_n=8.0, fitted=False),))
    assert "contact_loss" not in names(held_out)
    hidden = [item["name"] for item in lifted.labels()["effects"] if item["hidden"]]
    assert hidden == ["dry_friction"]
    assert json.dumps(lifted.labels())


def test_labels_have_the_names_of_the_library():
    known = all_effects()
    assert {*HIDDEN, *OF_THE_PRESET, "contact_loss"} <= set(known)
    assert all(EFFECTS[name].stage != "tissue" for name in HIDDEN)


def test_sites_and_numbers_of_hidden_effects_are_drawn():
    drawn = draw_skin_scenarios(1, 60)
    assert {scenario.tissue.name for scenario in drawn} == set(SITES)
    counts = np.bincount([len(scenario.effects) for scenario in drawn])
    assert counts.size == 3
    assert counts.min() >= 10
    assert 15 < sum(scenario.full for scenario in drawn) < 45


@pytest.mark.parametrize(
    "wrong",
    [{"preset": "buna"}, {"hidden": ("added_mass",)}, {"hidden": ("nothing",)}, {"without": HIDDEN}],
)
def test_what_cannot_be_drawn_is_refused(wrong: dict):
    with pytest.raises(ValueError, match=r"effect|preset"):
        draw_skin_scenario(1, **wrong)


def test_a_later_session_has_the_same_person_and_instrument():
    earlier = draw_skin_scenario(3, hidden=())
    later = draw_later_session(earlier, 5, hidden=("sensor_lag",))
    assert later.earlier is earlier
    assert later.tissue.name == earlier.tissue.name
    assert replace(later.parameters, gravity_force_n=0.0) == replace(earlier.parameters, gravity_force_n=0.0)
    tilted = earlier.parameters.gravity_force_n * np.cos(later.tilt_rad)
    assert later.parameters.gravity_force_n == pytest.approx(tilted)
    assert later.tissue.stiffness.coefficient == pytest.approx(earlier.tissue.stiffness.coefficient, rel=0.25)
    assert later.tissue != earlier.tissue
    assert later.surface_errors_m != earlier.surface_errors_m
    assert not np.array_equal(later.tests[0].command(later.number), earlier.tests[0].command(earlier.number))
    assert max(test.high_n for test in later.tests) <= 12.0
    assert [item["name"] for item in later.labels()["effects"] if item["hidden"]] == ["sensor_lag"]
    with pytest.raises(ValueError, match="effect"):
        draw_later_session(earlier, 5, hidden=("added_mass",))


def test_later_sessions_of_one_person_share_an_earlier_one_without_hidden_effects():
    drawn = draw_later_sessions(1, 4 * LATER_SESSIONS + 1)
    assert len(drawn) == 4 * LATER_SESSIONS + 1
    people = [scenario.earlier for scenario in drawn]
    assert len({id(person) for person in people}) == 5
    assert all(person is not None and not person.effects for person in people)
    assert {len(scenario.effects) for scenario in drawn} == {0, 1}


def test_earlier_sessions_are_written_once_for_each_person(tmp_path: Path):
    arguments = ["--skin", "--later", "--n", "2", "--seed", "5", "--full-share", "0", "--out", str(tmp_path / "out")]
    assert main(arguments) == 0
    files = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert [name for name in files if name.startswith("earlier")] == ["earlier-0001.f64", "earlier-0001.json"]
    assert scenario_names(tmp_path / "out") == ["scenario-0001", "scenario-0002"]
    for name in scenario_names(tmp_path / "out"):
        assert earlier_session(tmp_path / "out", name) == "earlier-0001"
    (test,) = read_scenario(tmp_path / "out", "earlier-0001").tests
    assert test.samples == 9000


def test_a_frame_that_moves_lifts_the_probe_only_where_the_contact_force_ends():
    hidden = (EFFECTS["mount_resonance"](level=0.17, frequency_hz=64.0, damping_ratio=0.024),)
    scenario = replace(draw_skin_scenario(1, preset="left-distal-forearm", hidden=()), effects=hidden)
    attached = replace(scenario, tissue=scenario.tissue.with_extras(scenario.tissue.extras - {"contact"}))
    time = np.arange(3000) / 2000.0
    commands = 12.0 + 16.0 * np.sin(2 * np.pi * 64.0 * time) * np.minimum(2.0 * time, 1.0)
    lifted, held = (
        Plant(one.parameters, one.tissue, effects=one.effects).advance(commands) for one in (scenario, attached)
    )
    assert lifted["touching"].all()
    np.testing.assert_allclose(lifted["position"], held["position"], atol=1e-9)
    assert np.ptp(lifted["position"][1000:]) > 2e-4
