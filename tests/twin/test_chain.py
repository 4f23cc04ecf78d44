"""The twin's baseline chain: equilibria, a closed form, and the step that it integrates with."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from tissueid import twin
from tissueid.twin import State, TwinParameters, chain

RATE = 2000.0
SPRING = TwinParameters(stiffness_growth_per_m=0.0, damping_growth_per_m=0.0, stiffness_n_per_m=1000.0)


def settle(parameters, volts, seconds=3.0):
    start = State(0.0, parameters.surface_m + 0.001, 0.0)
    _, end = twin.simulate(np.full(round(seconds * RATE), volts), parameters, RATE, start)
    return end


def test_it_comes_to_rest_where_forces_balance():
    end = settle(SPRING, 12.0)
    assert end.current_a == pytest.approx(1.0, rel=1e-6)
    assert end.velocity_m_s == pytest.approx(0.0, abs=1e-9)
    assert end.position_m == pytest.approx(SPRING.surface_m + (3.0 + SPRING.weight_n) / 1000.0, abs=1e-8)


def test_a_linear_chain_matches_its_transfer_function():
    p = SPRING
    damping = p.damping_n_s_per_m + p.bearing_damping_n_s_per_m
    electrical, mechanical = [p.inductance_h, p.resistance_ohm], [p.mass_kg, damping, p.stiffness_n_per_m]
    kf = p.force_constant_n_per_a
    denominator = np.polyadd(np.polymul(electrical, mechanical), [kf**2, 0.0])
    volts = 8.0 + signal.sosfilt(
        signal.butter(8, 200, fs=RATE, output="sos"), np.random.default_rng(1).standard_normal(4000)
    )
    rest = settle(p, 8.0)
    (_, _, position), _ = twin.simulate(volts, p, RATE, rest)
    discrete = signal.cont2discrete(([kf], denominator), 1 / RATE, method="zoh")
    b, a = np.ravel(discrete[0]), discrete[1]
    # The twin tells a sample at the end of the period in which its command was held; lfilter at the beginning.
    expected = signal.lfilter(b, a, np.append(volts - 8.0, 0.0))[1:] + rest.position_m
    np.testing.assert_allclose(position, expected, atol=2e-4 * np.ptp(expected))


def test_halving_the_step_changes_next_to_nothing(monkeypatch):
    parameters = TwinParameters()
    volts = 20.0 + 18.0 * np.sin(2 * np.pi * 40 * np.arange(4000) / RATE)
    start = State(0.0, 0.011, 0.0)
    coarse = twin.simulate(volts, parameters, RATE, start)[0][2]
    finer = replace(parameters)
    fine_volts = np.repeat(volts, 2)  # the same command at twice the rate halves every step
    fine = twin.simulate(fine_volts, finer, 2 * RATE, start)[0][2][1::2]
    assert np.sqrt(np.mean((coarse - fine) ** 2)) < 1e-4 * np.std(fine)
    assert chain.SUBSTEPS == 20


def test_the_amplifier_stops_at_its_limit():
    (voltage, _, _), _ = twin.simulate(np.array([100.0, -100.0]), TwinParameters(), RATE, State(0, 0.01, 0))
    assert voltage.tolist() == [48.0, -48.0]


def test_the_tissue_only_pushes():
    end = settle(replace(SPRING, weight_n=-0.6), 0.0)
    assert end.position_m < 0.001, "pulled away by its weight, it ends at the stop"


def test_cutting_a_command_in_two_changes_nothing():
    volts = np.random.default_rng(2).uniform(0, 40, 400)
    start = State(0.0, 0.012, 0.0)
    whole, end = twin.simulate(volts, TwinParameters(), RATE, start)
    first, middle = twin.simulate(volts[:150], TwinParameters(), RATE, start)
    second, end_2 = twin.simulate(volts[150:], TwinParameters(), RATE, middle)
    np.testing.assert_array_equal(whole, np.hstack((first, second)))
    assert end == end_2
