import itertools
import time

import numpy as np
import pytest
from plant_support import VOLTS_PER_NEWTON, plant, standard_force
from scipy import integrate, linalg

from firmware_sim.plant import SAMPLE_RATE_HZ, SUBSTEPS, Plant, PlantParameters
from firmware_sim.presets import load_preset, preset_names

OBSERVED = ("position", "velocity", "current", "filtered_position", "filtered_current")


@pytest.mark.parametrize("preset", preset_names())
def test_halving_the_step_changes_nothing(preset):
    volts = standard_force("uniform") * VOLTS_PER_NEWTON
    coarse, fine = (plant(preset, substeps=k * SUBSTEPS).advance(volts) for k in (1, 2))
    figures = {}
    for name in OBSERVED:
        error = coarse[name] - fine[name]
        figures[name] = error.std() / fine[name].std(), np.abs(error).max() / np.ptp(fine[name])
    lifted = 100 * (1 - fine["touching"].mean())
    text = ", ".join(f"{name} {rms:.1e} / {peak:.1e}" for name, (rms, peak) in figures.items())
    print(f"{preset}: rms / peak error {text}; {lifted:.1f} % lifted off")
    assert max(max(pair) for pair in figures.values()) < 1e-4


def test_skin_is_left_in_the_standard_test():
    trace = plant("left-posterior-forearm").advance(standard_force() * VOLTS_PER_NEWTON)
    assert 0.01 < 1 - trace["touching"].mean() < 0.2


@pytest.mark.parametrize("preset", ["left-posterior-forearm", "wiener-demo"])
def test_blocks_of_any_length_give_the_same_trace(preset):
    volts = standard_force()[:3000] * VOLTS_PER_NEWTON
    whole = plant(preset).advance(volts)
    other = plant(preset)
    cut = np.concatenate([other.advance(part) for part in np.split(volts, [1, 20, 1111, 1112])])
    assert np.array_equal(whole, cut)


@pytest.mark.parametrize("preset", preset_names())
@pytest.mark.parametrize("force", [0.0, 4.0])
def test_rest_is_rest(preset, force):
    p = plant(preset)
    p.rest(force * VOLTS_PER_NEWTON)
    before = p.state.copy()
    trace = p.advance(np.full(200, force * VOLTS_PER_NEWTON))
    assert np.abs(trace["position"] - before[1]).max() < 1e-9
    assert trace["position"][-1] == pytest.approx(p.static_position(force + 0.588399), abs=1e-9)


@pytest.mark.parametrize("preset", preset_names())
def test_nothing_ever_runs_away(preset):
    p = plant(preset)
    rough = 48.0 * np.sign(np.random.default_rng(1).standard_normal(200))
    slow = np.repeat([48.0, -48.0, 48.0, 0.0], 400)
    for volts in (np.repeat(rough, 9), slow, 1e6 * slow):
        trace = p.advance(volts)
        assert np.all(np.isfinite(trace["position"]))
        assert trace["position"].min() > -0.5e-3
        assert trace["position"].max() < 32.5e-3
        assert np.abs(trace["velocity"]).max() < 8.0


@pytest.mark.parametrize("preset", ["left-posterior-forearm", "latex", "calibration-spring"])
def test_a_released_coil_comes_to_rest_where_gravity_leaves_it(preset):
    p = plant(preset)
    p.advance(np.full(2000, 40.0))
    p.energised = False
    trace = p.advance(np.full(16_000, 40.0))
    assert np.abs(trace["velocity"][-100:]).max() < 1e-6
    assert trace["position"][-1] == pytest.approx(p.static_position(0.588399), abs=2e-6)
    assert np.all(trace["voltage"] == 0.0)


def test_a_released_coil_loses_its_current_with_l_over_r():
    p = plant("linear-demo")
    p.rest(24.0)
    p.energised = False
    trace = p.advance(np.zeros(4))
    assert abs(trace["current"][0]) < 2.0 * np.exp(-6.0) + 0.06  # the rest is back-EMF


def test_gravity_turned_round_takes_the_probe_off():
    p = Plant(PlantParameters(gravity_force_n=-0.588399), load_preset("left-posterior-forearm"))
    assert p.state[1] < 0.0
    assert p.advance(np.zeros(100))["touching"].max() == 0.0


def test_the_amplifier_stops_at_its_limit():
    trace = plant("linear-demo").advance(np.array([47.0, 60.0, -1000.0]))
    assert list(trace["voltage"]) == [47.0, 48.0, -48.0]


def test_the_linear_preset_is_the_textbook_system():
    volts = standard_force()[:4000] * VOLTS_PER_NEWTON
    p = plant("linear-demo")
    start = p.state[1]
    trace = p.advance(volts)
    mass, damping, stiffness = 0.0912, 22.77, 4670.0
    system = np.zeros((4, 4))  # current, position, velocity, held voltage
    system[0] = [-12.0e3, 0.0, -3.0e3, 1.0e3]
    system[1, 2] = 1.0
    system[2] = [3.0 / mass, -stiffness / mass, -damping / mass, 0.0]
    step = linalg.expm(system / SAMPLE_RATE_HZ)
    state, expected = np.zeros(4), []
    for v in volts:
        state[3] = v
        state = step @ state
        expected.append(state[:3])
    current, position, velocity = np.array(expected).T
    assert np.abs(trace["position"] - start - position).max() < 1e-6 * np.ptp(position)
    assert np.abs(trace["velocity"] - velocity).max() < 1e-6 * np.ptp(velocity)
    assert np.abs(trace["current"] - current).max() < 2e-5 * np.ptp(current)


@pytest.mark.parametrize("force", [-2.0, 1.0, 4.0, 9.0])
def test_the_static_curves_of_the_cascades(force):
    total = force + 0.588399
    for preset, expected in {
        "wiener-demo": 9.77e-3 * (1 - np.exp(-0.154 * total)),
        "hammerstein-demo": 12.0 * (1 - np.exp(-0.12 * total)) / 2000.0,
    }.items():
        trace = plant(preset).advance(np.full(3000, force * VOLTS_PER_NEWTON))
        assert trace["position"][-1] - 0.010 == pytest.approx(expected, rel=1e-5)


def test_the_wiener_preset_is_the_thesis_equations():
    volts = standard_force()[1000:1300] * VOLTS_PER_NEWTON
    p = plant("wiener-demo")
    trace = p.advance(volts)

    def rates(_, state, v):
        current, z, speed = state  # A, N, N/s: the linear block in newtons, M z'' + B z' + z = force
        probe = 9.77e-3 * 0.154 * np.exp(-0.154 * z) * speed
        force = 3.0 * current + 0.588399
        return [(v - 12.0 * current - 3.0 * probe) / 1e-3, speed, (force - 5.22e-3 * speed - z) / 2.59e-5]

    state, expected = [0.0, 0.588399, 0.0], []
    for v in volts:
        solved = integrate.solve_ivp(rates, (0.0, 1 / SAMPLE_RATE_HZ), state, args=(v,), rtol=1e-9, atol=1e-12)
        state = solved.y[:, -1]
        expected.append(0.010 + 9.77e-3 * (1 - np.exp(-0.154 * state[1])))
    assert np.abs(trace["position"] - expected).max() < 1e-6 * np.ptp(expected)


def test_the_coil_heats_up_as_one_body():
    parameters = PlantParameters(thermal_resistance_k_per_w=2.0, heat_capacity_j_per_k=0.5)
    p = Plant(parameters, load_preset("linear-demo"))
    p.rest(12.0)
    trace = p.advance(np.full(4000, 12.0))
    t = np.arange(1, 4001) / SAMPLE_RATE_HZ
    assert trace["temperature"] - 23.0 == pytest.approx(24.0 * (1 - np.exp(-t)), rel=1e-4)


def test_a_standard_test_warms_the_coil_by_a_few_kelvin():
    trace = plant("left-posterior-forearm").advance(standard_force() * VOLTS_PER_NEWTON)
    assert 1.0 < trace["temperature"][-1] - 23.0 < 20.0


def test_a_surface_left_behind_recovers_on_its_own():
    p = plant("left-posterior-forearm")
    p.rest(20.0)
    pressed = p.state[3] - 0.010
    p.advance(np.full(20, -48.0))
    assert p.state[1] < p.state[3] - 1e-4  # the probe is off and the surface lags behind it
    depths = []
    for _ in range(4):
        p.advance(np.full(400, -20.0))
        depths.append(p.state[3] - 0.010)
    assert pressed > depths[0]
    assert all(b < a for a, b in itertools.pairwise(depths))
    assert 0 <= depths[-1] < 0.02 * pressed


def test_commands_must_be_finite_and_flat():
    p = plant("linear-demo")
    for bad in (np.array([np.nan]), np.array([np.inf]), np.zeros((2, 2))):
        with pytest.raises(ValueError, match="finite volts in one dimension"):
            p.advance(bad)


def test_parameters_must_make_sense():
    with pytest.raises(ValueError, match="inductance_h must be finite and positive, not 0"):
        PlantParameters(inductance_h=0.0)
    with pytest.raises(ValueError, match="substeps must be 1 or more"):
        plant("linear-demo", substeps=0)


def test_twenty_times_faster_than_real_time():
    p = plant("left-posterior-forearm")
    volts = standard_force() * VOLTS_PER_NEWTON
    p.advance(volts[:10])
    best = np.inf
    for _ in range(3):
        start = time.process_time()
        p.advance(volts)
        best = min(best, time.process_time() - start)
    ratio = volts.size / SAMPLE_RATE_HZ / best
    print(f"{ratio:.0f} times real time")
    assert ratio > 20
