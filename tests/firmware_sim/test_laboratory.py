"""The laboratory: tests as a rig records them, and scenarios drawn for a sealed check."""

import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from firmware_sim.effects import EFFECTS, LISTED, UNLISTED
from firmware_sim.laboratory import SIGNALS, BaselineParameters, Laboratory, PlannedTest, plan
from firmware_sim.laboratory.scenario_generation import draw_many, draw_scenario, main
from firmware_sim.laboratory.session_content import NOMINAL

pytestmark = pytest.mark.timeout(600)  # the first test compiles the loop, on a busy machine for minutes

FIGURES = BaselineParameters(weight_n=0.4, tissue_mass_kg=0.02)


def integrated(command, spring=False):
    """The baseline's equations by another solver: coil, moving part and tissue on both sides of the surface."""
    f = FIGURES
    mass = f.moving_mass_kg + (f.spring_mass_kg if spring else f.tissue_mass_kg)
    first = 0.012 if spring else f.surface_m

    def slope(_, state, volts):
        i, x, v = state
        d = x - first
        if spring:
            resists = f.spring_n_per_m * d + f.spring_damping_n_s_per_m * v
        else:
            resists = f.stiffness_n_per_m * np.exp(f.stiffness_rate_per_m * d) * d
            resists += f.damping_n_s_per_m * np.exp(f.damping_rate_per_m * d) * v
        pushes = f.force_constant_n_per_a * i + f.weight_n - f.bearing_damping_n_s_per_m * v
        electric = volts - f.resistance_ohm * i - f.force_constant_n_per_a * v
        return [electric / f.inductance_h, v, (pushes - resists) / mass]

    state, found = [command[0] / f.resistance_ohm, first, 0.0], []
    for volts in command:
        state = solve_ivp(slope, (0, 5e-4), state, args=(volts,), method="RK45", rtol=1e-9, atol=1e-12).y[:, -1]
        found.append(state)
    return np.array(found).T


@pytest.mark.parametrize("kind", ["stochastic", "spring"])
def test_the_baseline_obeys_its_equations(kind):
    command = np.random.default_rng(1).normal(6.0, 8.0, 120)
    recording = Laboratory((), figures=FIGURES, clean=True).record(kind, command)
    current, position, _ = integrated(command, kind == "spring")
    np.testing.assert_allclose(recording.current, current, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(recording.position, position, atol=1e-10)
    np.testing.assert_array_equal(recording.voltage, command)
    np.testing.assert_allclose(recording.time, np.arange(120) * 5e-4)


def test_a_test_starts_at_rest_at_the_surface_under_its_first_command():
    recording = Laboratory((), figures=FIGURES, clean=True).record("stochastic", np.full(2000, 15.0))
    assert recording.position[0] - FIGURES.surface_m < 15e-6
    assert recording.current[0] == pytest.approx(15.0 / 12.0, rel=0.02)
    depth = replace(FIGURES, mean_v=15.0).depth_m
    assert recording.position[-1] - FIGURES.surface_m == pytest.approx(depth, rel=1e-4)
    assert np.all(recording.temperature == 25.0)


def test_nothing_stops_the_coil_and_tissue_pulls_too():
    pulled = Laboratory((), figures=BaselineParameters(weight_n=-0.5)).record("quiet", np.zeros(3000))
    assert pulled.position[-1] < -0.003  # beyond the stroke's beginning
    held = Laboratory((), figures=BaselineParameters(weight_n=-0.2)).record("quiet", np.zeros(3000))
    assert 0.008 < held.position[-1] < held.surface_m


def test_noise_and_steps_are_those_of_the_converters():
    command = np.full(3000, 15.0)
    noisy = Laboratory((), 4, figures=FIGURES).record("stochastic", command)
    clean = Laboratory((), 4, figures=FIGURES, clean=True).record("stochastic", command)
    for name, rms, step in (
        ("voltage", 2e-3, 50 / 32768),
        ("current", 0.95e-3, 5 / 32768),
        ("position", 1.9e-6, 0.032 / 65536),
    ):
        error = getattr(noisy, name) - getattr(clean, name)
        assert np.std(error) == pytest.approx(np.hypot(rms, step / 12**0.5), rel=0.06)
        codes = getattr(noisy, name) / step
        np.testing.assert_allclose(codes, np.rint(codes), atol=1e-6)


def test_the_same_calls_give_the_same_records_and_each_test_its_own_noise():
    command = np.full(500, 15.0)
    effects = [EFFECTS["mains_hum"](level=0.1)]
    one, other = Laboratory(effects, 9), Laboratory(effects, 9)
    first = one.record("stochastic", command)
    np.testing.assert_array_equal(first.stacked(), other.record("stochastic", command).stacked())
    assert not np.array_equal(first.stacked(), one.record("stochastic", command).stacked())


@pytest.mark.parametrize(
    ("kind", "command", "words"),
    [
        ("hold", np.zeros(10), "unknown kind of test 'hold'"),
        ("quiet", np.zeros(0), "one or more"),
        ("quiet", np.zeros((2, 2)), "one dimension"),
        ("quiet", np.array([0.0, np.nan]), "finite"),
    ],
)
def test_nonsense_is_not_recorded(kind, command, words):
    with pytest.raises(ValueError, match=words):
        Laboratory().record(kind, command)


@pytest.mark.parametrize("figures", [{"moving_mass_kg": 0.0}, {"weight_n": np.nan}, {"damping_n_s_per_m": -1.0}])
def test_figures_that_no_device_has_are_refused(figures):
    with pytest.raises(ValueError, match=next(iter(figures))):
        BaselineParameters(**figures)


def test_a_full_session_has_the_rigs_tests():
    tests = plan(FIGURES, full=True)
    assert [t.kind for t in tests] == ["quiet", "stochastic", "stochastic", "stochastic", "slow_ramp", "spring"]
    commands = [t.command(7) for t in tests]
    assert [c.size for c in commands] == [3000, *[9000] * 5]
    np.testing.assert_array_equal(commands[1], commands[2])
    assert tests[2].repeats == 2
    for test, command in zip(tests[1:], commands[1:], strict=True):
        assert np.all(command[:1000] == test.mean_v)
        assert np.abs(command).max() <= 46.0
    assert np.std(commands[3][1000:]) == pytest.approx(0.6 * FIGURES.spread_v, rel=0.01)
    assert commands[4].max() - FIGURES.mean_v == pytest.approx(1.6 * FIGURES.spread_v, rel=1e-3)
    assert plan(FIGURES, full=False) == (tests[1],)


def test_the_stimulus_ends_at_200_hz():
    command = PlannedTest("stochastic", 1, 15.0, 10.0).command(3)[1000:]
    power = np.abs(np.fft.rfft((command - command.mean()) * np.hanning(8000))) ** 2
    hertz = np.fft.rfftfreq(8000, 5e-4)
    assert power[hertz > 260].sum() < 5e-3 * power.sum()
    assert power[hertz < 180].sum() > 0.85 * power.sum()


# -- drawing --------------------------------------------------------------------------------------------------------


def test_scenarios_are_drawn_evenly_and_the_same_for_the_same_seed():
    drawn = [draw_scenario(seed) for seed in range(400)]
    names = [s.effects[0].name for s in drawn]
    assert set(names) == set(LISTED)
    assert max(names.count(name) for name in LISTED) < 30  # of 12 expected
    assert [s.labels() for s in drawn[:20]] == [draw_scenario(seed).labels() for seed in range(20)]
    for s in drawn:
        f = s.figures
        assert 0.0007 <= f.depth_m <= 0.0056
        assert 4.0 <= f.mean_v <= 18.0
        assert f.mean_v < 9.0 or s.effects[0].name != "contact_loss"
        assert -0.6 <= f.weight_n <= 0.6
    off = np.array([s.figures.resistance_ohm / 12.0 - 1.0 for s in drawn])
    assert np.std(off) == pytest.approx(0.015, rel=0.15)
    assert sum(s.figures.mean_v < 9.0 for s in drawn if s.effects[0].name != "contact_loss") > 20


def test_shares_and_exclusions_are_kept():
    drawn = draw_many(1, 400, without=("dry_friction", "slew_rate"))
    count = [len(s.effects) for s in drawn]
    unknown = [s for s in drawn if any(not e.listed for e in s.effects)]
    assert 20 < count.count(0) < 65
    assert 20 < count.count(2) < 65
    assert 20 < len(unknown) < 65
    assert {e.name for s in unknown for e in s.effects} == set(UNLISTED) - {"slew_rate"}
    assert "dry_friction" not in {e.name for s in drawn for e in s.effects}
    assert 160 < sum(s.full for s in drawn) < 240


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"without": ["magic"]}, "no effect 'magic'"),
        ({"effects": 40}, "40 effects cannot be drawn"),
        ({"without": LISTED}, "1 effects cannot be drawn from 0"),
    ],
)
def test_what_cannot_be_drawn_is_said(more, words):
    with pytest.raises(ValueError, match=words):
        draw_scenario(0, **more)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drawn") / "out"
    status = main(
        ["--seed", "3", "--n", "3", "--full-share", "0", "--none-share", "0.34", "--clean", "--out", str(folder)]
    )
    assert status == 0
    return folder


def signals(folder, name, kind=""):
    described = json.loads((folder / f"{name}.json").read_text())
    numbers = np.frombuffer((folder / f"{name}{kind}.f64").read_bytes(), dtype="<f8")
    found = []
    for test in described["tests"]:
        block = numbers[test["first"] : test["first"] + 6 * test["samples"]]
        found.append(dict(zip(described["signals"], block.reshape(6, -1), strict=True)))
    assert sum(6 * test["samples"] for test in described["tests"]) == numbers.size
    return described, found


def test_records_are_written_as_they_are_described(written):
    for number, scenario in enumerate(draw_many(3, 3, full_share=0.0, none_share=0.34), 1):
        described, found = signals(written, f"scenario-{number:04d}")
        assert described["signals"] == list(SIGNALS)
        assert described["instrument"] == NOMINAL
        recording = scenario.record()[0]
        np.testing.assert_array_equal(np.stack(list(found[0].values())), recording.stacked())
        assert described["tests"][0]["surface_position_m"] == scenario.figures.surface_m
        assert described["tests"][0]["preload_s"] == 0.5


def test_what_is_withheld_is_in_the_labels_alone(written, capsys):
    labels = json.loads((written / "labels.json").read_text())
    assert list(labels) == ["scenario-0001", "scenario-0002", "scenario-0003"]
    for name, label in labels.items():
        text = (written / f"{name}.json").read_text()
        assert not any(word in text for word in ("effect", "stiffness", "weight", *EFFECTS))
        _, (clean,) = signals(written, name, ".clean")
        _, (base,) = signals(written, name, ".base")
        same = all(np.array_equal(clean[s], base[s]) for s in SIGNALS)
        assert same is (not label["effects"])
        np.testing.assert_array_equal(clean["command"], base["command"])


def test_the_labels_seal_is_printed(tmp_path, capsys):
    assert main(["--n", "1", "--full-share", "0", "--none-share", "1", "--pairs-share", "0", "--unknown-share", "0",
                 "--out", str(tmp_path / "new")]) == 0  # fmt: skip
    digest = hashlib.sha256((tmp_path / "new" / "labels.json").read_bytes()).hexdigest()
    assert digest in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--n", "0"], "--n 1 to"),
        (["--seed", "-1"], "--seed must be 0"),
        (["--without", "magic"], "no effect 'magic'"),
        (["--none-share", "0.9", "--pairs-share", "0.9"], "must not exceed 1"),
        (["--full-share", "nan"], "between 0 and 1"),
    ],
)
def test_a_command_with_nonsense_ends_with_2_and_one_line(tmp_path, capsys, arguments, words):
    assert main([*arguments, "--out", str(tmp_path / "new")]) == 2
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1
    assert not (tmp_path / "new").exists()


def test_a_folder_that_holds_something_is_left_alone(tmp_path, capsys):
    (tmp_path / "mine.txt").write_text("mine")
    assert main(["--n", "1", "--out", str(tmp_path)]) == 2
    assert "is not empty" in capsys.readouterr().err
    assert main(["--n", "1", "--out", str(tmp_path / "mine.txt")]) == 2
    assert "cannot write" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]
