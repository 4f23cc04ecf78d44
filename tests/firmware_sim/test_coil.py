"""The force constant along the stroke: one profile for force and for back-EMF, and none at all unless asked for."""

import json

import numpy as np
import pytest
from plant_support import VOLTS_PER_NEWTON, standard_force
from scipy import integrate

from firmware_sim.__main__ import main
from firmware_sim.bench import Bench
from firmware_sim.coil import IDEAL, CoilProfile, coil_profile, finite_coil, profile_values
from firmware_sim.plant import SUBSTEPS, Plant, PlantParameters
from firmware_sim.presets import load_preset
from firmware_sim.tissue import FREE_AIR

STROKE = 0.032


def printed(capsys, *options):
    assert main(["--coil-profile", *options]) == 0
    return json.loads(capsys.readouterr().out)


def spring_at(surface_m, **options):
    bench = Bench("calibration-spring", surface_m=surface_m, coil="finite", **options)
    return bench.plant


def test_the_finite_coil_is_the_thesis_s(capsys):
    values = printed(capsys, "--coil", "finite")
    position, constant = np.array(values["position_m"]), np.array(values["force_constant_n_per_a"])
    assert (position[0], position[-1]) == (0.0, STROKE)
    length = values["linear_region_max_m"] - values["linear_region_min_m"]
    assert 0.020 <= length <= 0.025
    inside = (position >= values["linear_region_min_m"]) & (position <= values["linear_region_max_m"])
    plateau = np.median(constant[(position >= 0.25 * STROKE) & (position <= 0.75 * STROKE)])
    assert plateau == pytest.approx(values["plateau_n_per_a"], rel=1e-3)
    assert values["plateau_n_per_a"] == pytest.approx(3.0, rel=1e-6)
    assert np.array_equal(inside, np.abs(constant / plateau - 1.0) <= 0.05)
    assert 0.7 * plateau < constant[0] < 0.9 * plateau
    assert constant[-1] < constant[0]  # more is lost at the far end
    assert constant.max() < 1.01 * plateau


def test_the_ideal_coil_is_linear_all_along(capsys):
    values = printed(capsys)
    assert set(values["force_constant_n_per_a"]) == {3.0}
    assert (values["linear_region_min_m"], values["linear_region_max_m"]) == (0.0, STROKE)


def test_the_profile_follows_the_true_figures(tmp_path, capsys):
    path = tmp_path / "scenario.toml"
    path.write_text('coil = "finite"\n[truth]\nforce_constant_n_per_a = 2.93\n', encoding="utf-8")
    values = printed(capsys, "--scenario", str(path))
    assert values["plateau_n_per_a"] == pytest.approx(2.93, rel=1e-6)
    nominal = printed(capsys, "--coil", "finite")
    for name in ("linear_region_min_m", "linear_region_max_m"):
        assert values[name] == nominal[name]
    shares = np.divide(values["force_constant_n_per_a"], nominal["force_constant_n_per_a"])
    assert shares == pytest.approx(2.93 / 3.0, rel=1e-12)


@pytest.mark.parametrize("surface_m", [0.001, 0.016, 0.027])
def test_force_and_back_emf_follow_the_profile(surface_m):
    """The textbook's equations with the table that the command prints, solved by other means."""
    values = profile_values(finite_coil(STROKE), 3.0, STROKE)
    table = values["position_m"], values["force_constant_n_per_a"]
    plant = spring_at(surface_m)
    start = plant.state[1]
    at_start = np.interp(start, *table)
    volts = 4.0 * np.sin(2 * np.pi * 30.0 * np.arange(200) / 2000.0)
    trace = plant.advance(volts)

    def rates(_, state, v):
        current, position, speed = state
        k = np.interp(position, *table)
        force = k * current + 0.588399 - 3.6 * speed - 1000.0 * (position - surface_m)
        return [(v - 12.0 * current - k * speed) / 1e-3, speed, force / 0.066]

    state, expected = [0.0, start, 0.0], []
    for v in volts:
        solved = integrate.solve_ivp(rates, (0.0, 5e-4), state, args=(v,), rtol=1e-7, atol=1e-10)
        state = solved.y[:, -1]
        expected.append(state[:2])
    current, position = np.array(expected).T
    # The table is read by straight lines here: over a quarter of a millimetre the curve is within 1e-4 of them.
    assert np.abs(trace["position"] - position).max() < 3e-4 * np.ptp(position)
    assert np.abs(trace["current"] - current).max() < 3e-4 * np.ptp(current)
    if surface_m != 0.016:
        assert at_start < 0.97 * 3.0  # the ends are where it matters


def test_what_the_coil_takes_up_it_gives_out():
    """Force and back-EMF alike: electrical power less heat and field is mechanical power, everywhere on the stroke."""
    plant = Plant(PlantParameters(gravity_force_n=0.0), FREE_AIR, coil=finite_coil(STROKE), substeps=400)
    plant.state[1] = 0.029
    volts = np.full(20, -20.0)
    last = plant.advance(volts)[-1]
    # The integrals by Simpson's rule on a finer run of the same plant.
    fine = Plant(
        PlantParameters(gravity_force_n=0.0),
        FREE_AIR,
        coil=finite_coil(STROKE),
        sample_rate_hz=400_000.0,
        substeps=2,
    )
    fine.state[1] = 0.029
    steps = fine.advance(np.repeat(volts, 200))
    current = np.concatenate([[0.0], steps["current"]])
    speed = np.concatenate([[0.0], steps["velocity"]])
    supplied = -20.0 * integrate.simpson(current, dx=1 / 400_000)
    heat = integrate.simpson(12.0 * current**2 + 3.5 * speed**2, dx=1 / 400_000)
    stored = 0.5 * 1e-3 * last["current"] ** 2 + 0.5 * 0.060 * last["velocity"] ** 2
    assert supplied == pytest.approx(heat + stored, rel=1e-6)
    assert last["position"] < 0.0285
    assert steps["position"][-1] == pytest.approx(last["position"], abs=1e-9)


def test_halving_the_step_changes_nothing_with_the_finite_coil():
    volts = standard_force("uniform")[:4000] * VOLTS_PER_NEWTON
    traces = []
    for factor in (1, 2):
        plant = Plant(
            PlantParameters(),
            load_preset("left-posterior-forearm"),
            coil=finite_coil(STROKE),
            substeps=factor * SUBSTEPS,
        )
        traces.append(plant.advance(volts))
    for name in ("position", "velocity", "current"):
        error = traces[0][name] - traces[1][name]
        assert error.std() < 1e-4 * traces[1][name].std()


@pytest.mark.parametrize("volts", [-8.0, 0.0, 12.0])
def test_rest_is_rest_where_the_coil_leaves_the_field(volts):
    plant = spring_at(0.026)
    plant.rest(volts)
    before = plant.state[1]
    force = plant.force_constant_at(before) * volts / 12.0 + 0.588399
    assert before == pytest.approx(0.026 + force / 1000.0, abs=1e-9)
    assert np.abs(plant.advance(np.full(400, volts))["position"] - before).max() < 1e-9


def test_an_ideal_profile_changes_no_bit():
    volts = standard_force()[:2000] * VOLTS_PER_NEWTON
    flat = CoilProfile(tuple(np.linspace(-0.001, 0.033, 18)), (1.0,) * 18)
    plain, ideal, level = (
        Plant(PlantParameters(), load_preset("left-posterior-forearm"), **options).advance(volts)
        for options in ({}, {"coil": IDEAL}, {"coil": flat})
    )
    assert plain.tobytes() == ideal.tobytes()
    assert np.abs(plain["position"] - level["position"]).max() < 1e-12


def test_the_compiled_profile_is_the_spline():
    """Force at standstill, read off the plant all along the stroke."""
    profile = finite_coil(STROKE)
    parameters = PlantParameters(gravity_force_n=0.0, resistance_ohm=1e6, inductance_h=1e6)  # the current stays 1 A
    plant = Plant(parameters, FREE_AIR, coil=profile, sample_rate_hz=1e6, substeps=1)
    where = np.linspace(0.0, STROKE, 333)[1:-1]
    found = []
    for position in where:
        plant.state[:-1] = 0.0
        plant.state[0], plant.state[1] = 1.0, position
        found.append(plant.advance(np.array([0.0]))["acceleration"][0] * 0.060)
    # In a microsecond the bearing takes 30 ppm.
    assert found == pytest.approx(3.0 * profile.along(where), rel=1e-4)


def test_beyond_the_table_the_last_value_holds():
    profile = finite_coil(STROKE)
    assert profile.at(0.05) == profile.at(0.033)
    assert profile.at(-0.05) == profile.at(-0.001)


@pytest.mark.parametrize(
    ("position", "relative", "words"),
    [
        ((0.0, 0.01, 0.02), (1.0, 1.0, 1.0), "four positions or more, and a value for each"),
        ((0.0, 0.01, 0.02, 0.03), (1.0, 1.0, 1.0), "four positions or more, and a value for each"),
        ((0.0, 0.01, 0.02, 0.04), (1.0, 1.0, 1.0, 1.0), "must rise in equal steps"),
        ((0.03, 0.02, 0.01, 0.0), (1.0, 1.0, 1.0, 1.0), "must rise in equal steps"),
        ((0.0, 0.01, 0.02, 0.03), (1.0, 1.0, -1.0, 1.0), "must be positive all along the stroke"),
        ((0.0, 0.01, 0.02, 0.03), (1.0, 1.0, np.nan, 1.0), "must be positive all along the stroke"),
    ],
)
def test_an_unsound_profile_is_refused(position, relative, words):
    with pytest.raises(ValueError, match=words):
        CoilProfile(position, relative)


def test_an_unknown_coil_is_refused_by_name(capsys):
    with pytest.raises(ValueError, match="unknown coil 'crooked'; known: ideal, finite"):
        coil_profile("crooked", STROKE)
    assert main(["--coil", "crooked"]) == 2
    assert "coil cannot be used: it must be 'ideal' or 'finite'" in capsys.readouterr().err
