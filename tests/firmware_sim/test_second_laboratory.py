"""The second laboratory: its integrator against SciPy's, every effect, and the files of its scenarios."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from firmware_sim.second_laboratory import scenarios
from firmware_sim.second_laboratory.__main__ import main
from firmware_sim.second_laboratory.instruments import draw_machine, draw_truth
from firmware_sim.second_laboratory.integrator import LONGEST_STEP_S, simulate
from firmware_sim.second_laboratory.parameters import PlantModel
from firmware_sim.second_laboratory.recording import EFFECTS, LISTED, READINGS, Laboratory
from firmware_sim.second_laboratory.scenarios import draw_scenario, planned
from firmware_sim.second_laboratory.sizing import Sizer
from firmware_sim.second_laboratory.stimuli import KINDS, MOST, Stimulus
from tissueid.twin.catalogue import all_effects
from tissueid_lab.blind_check.answers import alone_sessions, read_scenario, scenario_names, unseal

SECONDS = 0.3
STIMULUS = Stimulus("gaussian", 120.0, 3, False)


def short_machine(random: np.random.Generator):
    return replace(draw_machine(random), duration_s=SECONDS, preload_s=0.1)


def bench(*, shallow: bool = False):
    """A laboratory with a test of noise; a shallow one lifts off."""
    random = np.random.default_rng(4)
    machine = short_machine(random)
    truth = draw_truth(random, machine, shallow=shallow)
    volts = (truth["force_n"] - truth["weight_n"]) * truth["resistance_ohm"] / truth["force_constant_n_per_a"]
    scale = (1.5 if shallow else 0.6) * abs(volts)
    return Laboratory(machine, truth), planned(machine, truth, 1, "stochastic", STIMULUS, volts, scale, 5)


@pytest.fixture(scope="module")
def sizers() -> dict[bool, Sizer]:
    return {shallow: Sizer(*bench(shallow=shallow)) for shallow in (False, True)}


def plant_of(**values: float) -> PlantModel:
    plant = PlantModel()
    base = {
        "resistance_ohm": 9.0,
        "inductance_h": 1.5e-3,
        "force_constant_n_per_a": 5.0,
        "mass_kg": 0.07,
        "damping_n_s_per_m": 3.0,
        "weight_n": 0.3,
        "stiffness_n_per_m": 600.0,
        "stiffness_rate_per_m": 200.0,
        "tissue_damping_n_s_per_m": 4.0,
        "damping_rate_per_m": 80.0,
        "tissue_mass_kg": 0.01,
    }
    for name, value in (base | values).items():
        plant.values[name] = value
    return plant


def by_scipy(times, volts, p, *, ring=(0.0, 1.0), friction=0.0, bristle=1.0, frame=(0.0, 1.0, 0.0)):
    """The same plant written as the textbooks have it: a shorted ring by mutual inductance, LuGre, and a frame."""
    v = p.values
    lossy, ring_s = ring
    ratio, rate, damping = frame

    def rates(t, y):
        x, speed, i, j, z, f, f_speed = y
        u = np.interp(t, times, volts)
        relative = speed - f_speed
        k = v["force_constant_n_per_a"]
        # A cell L_c parallel to R_c: its flux L_c j follows the current with the time constant.
        drop = lossy / ring_s * (i - j)
        di = (u - v["resistance_ohm"] * i - drop - k * relative) / v["inductance_h"]
        dz = relative - bristle * abs(relative) * z / friction if friction else 0.0
        inner = k * i - v["damping_n_s_per_m"] * relative - (bristle * z if friction else 0.0)
        tissue = v["stiffness_n_per_m"] * np.exp(v["stiffness_rate_per_m"] * x) * x
        tissue += v["tissue_damping_n_s_per_m"] * np.exp(v["damping_rate_per_m"] * x) * speed
        a = (inner + v["weight_n"] - tissue) / (v["mass_kg"] + v["tissue_mass_kg"])
        f_rate = -inner * ratio / v["mass_kg"] - rate**2 * f - 2.0 * damping * rate * f_speed if ratio else 0.0
        return [speed, a, di, (i - j) / ring_s, dz, f_speed, f_rate]

    i0 = volts[0] / v["resistance_ohm"]
    found = solve_ivp(
        rates, (0.0, times[-1]), [0, 0, i0, i0, 0, 0, 0], t_eval=times, rtol=1e-9, atol=1e-12, max_step=2e-4
    )
    return found.y[0] - found.y[5], found.y[2]


@pytest.mark.parametrize("effects", [False, True])
def test_the_integrator_agrees_with_scipy(effects: bool):
    step, steps = 25e-6, 1600
    times = np.arange(steps + 1) * step
    volts = 6.0 + 3.0 * np.sin(2.0 * np.pi * 40.0 * times) + 2.0 * np.sin(2.0 * np.pi * 170.0 * times)
    plant, others = plant_of(), {}
    if effects:
        lossy, ring_s, coulomb, bristle, frame = 1e-3, 5e-4, 0.4, 8e3, (0.05, 200.0, 0.05)
        plant.values["cells"] = 1
        plant.values["cell_h"][0], plant.values["cell_ohm"][0] = lossy, lossy / ring_s
        plant.values["coulomb_n"][:], plant.values["bristle_n_per_m"] = coulomb, bristle
        plant.values["frame_ratio"], plant.values["frame_rad_s"], plant.values["frame_damping_ratio"] = frame
        others = {"ring": (lossy, ring_s), "friction": coulomb, "bristle": bristle, "frame": frame}
    still = np.zeros(steps + 1)
    motion, current = simulate(plant, step, (volts[:-1], volts[1:]), still, still)
    for found, right in zip((motion, current), by_scipy(times, volts, plant, **others), strict=True):
        assert np.max(np.abs(found - right)) < 2e-4 * np.std(right)


def test_half_the_step_changes_hardly_anything():
    laboratory, test = bench()
    coarse, fine = laboratory.record(test), replace(laboratory, longest_step_s=0.5 * LONGEST_STEP_S).record(test)
    for channel in READINGS:
        assert np.max(np.abs(coarse[channel] - fine[channel])) < 1e-4 * np.std(fine[channel])


def test_the_names_are_those_of_the_candidates():
    assert {kind.name for kind in LISTED} == {name for name, effect in all_effects().items() if effect.in_laboratory}
    assert sum(not kind.listed for kind in EFFECTS.values()) == 5
    assert not {kind.name for kind in EFFECTS.values() if not kind.listed} & set(all_effects())
    assert {kind.name: kind.stage for kind in LISTED} == {
        name: all_effects()[name].stage for name in EFFECTS if EFFECTS[name].listed
    }


@pytest.mark.parametrize("name", list(EFFECTS))
def test_every_effect_shows_and_vanishes_with_its_size(name: str, sizers: dict[bool, Sizer]):
    shallow = name == "contact_loss"
    laboratory, test = bench(shallow=shallow)
    motion = sizers[shallow].motion()
    # Its step is that of the sizer, so that the same record serves all effects.
    laboratory = replace(laboratory, longest_step_s=2.0 * LONGEST_STEP_S)
    base = sizers[shallow].base
    for seed in (1, 2):
        effect = EFFECTS[name].draw(np.random.default_rng(seed), motion)
        json.dumps(effect.figures(), default=lambda item: item.item())
        shown = replace(laboratory, effects=(effect.sized(min(3.0, effect.largest)),)).record(test)
        excess = []
        for channel in READINGS:
            noise = laboratory.machine.noise[channel]
            finite = np.isfinite(shown[channel])
            assert finite[: finite.size // 2].all()
            excess.append(np.sqrt(np.mean((shown[channel] - base[channel])[finite] ** 2)) / noise)
        assert max(excess) > 1.0
        assert np.nanmax(np.abs(shown["position"])) < 10.0 * laboratory.machine.stroke_m
        assert np.array_equal(shown["command"], base["command"])
    gone = replace(laboratory, effects=(effect.sized(0.0),)).record(test)
    for channel in READINGS:
        np.testing.assert_allclose(
            gone[channel], base[channel], rtol=0.0, atol=0.05 * laboratory.machine.noise[channel]
        )


@pytest.mark.parametrize("name", ["dry_friction", "latency", "viscoelasticity", "sensor_backlash"])
def test_an_effect_gets_the_size_that_makes_the_wanted_gap(name: str, sizers: dict[bool, Sizer]):
    sizer = sizers[False]
    effect = EFFECTS[name].draw(np.random.default_rng(8), sizer.motion())
    sized, gap = sizer.sized(effect, 0.04)
    assert 0.02 < gap < 0.08
    assert gap == pytest.approx(sizer.gap(sized))


@pytest.mark.parametrize("kind", KINDS)
def test_a_course_has_unit_deviation_and_is_made_again_by_its_seed(kind: str):
    shape = Stimulus(kind, 60.0, 3, True)
    course = shape.course(4000, 1000.0, 3)
    assert abs(course.mean()) < 1e-9
    assert 0.9 < course.std() < 1.05
    assert np.abs(course).max() < MOST + 0.2
    assert np.array_equal(course, shape.course(4000, 1000.0, 3))
    assert not np.array_equal(course, shape.course(4000, 1000.0, 4))


@pytest.fixture
def _short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scenarios, "draw_machine", short_machine)


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.usefixtures("_short")
def test_the_same_seed_gives_the_same_bytes_and_the_diagnosis_can_read_them(tmp_path: Path, capsys):
    options = [
        "--n",
        "1",
        "--seed",
        "5",
        "--sets",
        "1",
        "--none-share",
        "0",
        "--unknown-share",
        "0",
        "--pairs-share",
        "0",
    ]
    options += ["--full-share", "0", "--clean"]
    for name in ("a", "b"):
        assert main([*options, "--out", str(tmp_path / name)]) == 0
    assert bytes_of(tmp_path / "a") == bytes_of(tmp_path / "b")
    folder = tmp_path / "a"
    assert scenario_names(folder) == ["scenario-0001"]
    label = unseal(folder)["scenario-0001"]
    assert not label.full
    assert 2 <= len(label.effects) == len(set(label.stages)) <= 4
    session, clean = read_scenario(folder, "scenario-0001"), read_scenario(folder, "scenario-0001", "clean")
    assert len(alone_sessions(folder, "scenario-0001")) == len(label.effects)
    for test in session.tests:
        assert np.array_equal(test.signals["command"], clean.test(test.number).signals["command"])
        assert np.nanmax(np.abs(test.signals["command"])) <= session.instrument.amplifier_limit_v
    with pytest.raises(SystemExit):
        main([*options, "--out", str(folder)])
    assert "not empty" in capsys.readouterr().err


@pytest.mark.usefixtures("_short")
@pytest.mark.parametrize("seed", [1, 2])
def test_a_scenario_without_effect_stays_in_the_stroke(seed: int):
    scenario = draw_scenario(seed, 1, scenarios.Shares(none=1.0, full=0.0))
    assert scenario.label()["effects"] == []
    (signals,) = scenario.record((), noisy=True)
    position = signals["position"]
    assert np.isfinite(position).all()
    assert position.min() > 0.0
    assert position.max() < scenario.machine.stroke_m


@pytest.mark.usefixtures("_short")
def test_a_full_session_has_all_kinds_of_tests():
    scenario = draw_scenario(3, 1, scenarios.Shares(none=1.0, full=1.0))
    tests = scenario.description()["tests"]
    kinds = ["quiet", "stochastic", "stochastic", "stochastic", "slow_ramp", "spring"]
    assert [test["kind"] for test in tests] == kinds
    assert tests[2]["repeat_of"] == "0002"
    assert np.array_equal(scenario.tests[1].command, scenario.tests[2].command)
    limit = scenario.machine.limit_v
    assert all(np.abs(test.command).max() <= limit for test in scenario.tests)
    ends = [test["first"] + 6 * test["samples"] for test in tests]
    assert [test["first"] for test in tests] == [0, *ends[:-1]]
    for signals in scenario.record((), noisy=False):
        assert all(np.isfinite(values).all() for values in signals.values())
