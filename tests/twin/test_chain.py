"""The chain in real time: equilibria, a closed form, the integration step, and the end bumpers."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from tissueid.twin import InstrumentParameters, Player, Start, Tissue, bus
from tissueid.twin.effects.contact_loss import EFFECT as CONTACT_LOSS
from tissueid.twin.effects.dry_friction import EFFECT as DRY_FRICTION
from tissueid.twin.effects.quantization import EFFECT as QUANTIZATION
from tissueid.twin.simulation import ActiveEffect, simulate

RATE = 2000.0
DEVICE = InstrumentParameters()
TISSUE = Tissue()
SPRING = Tissue(stiffness_growth_per_m=0.0, damping_growth_per_m=0.0, stiffness_n_per_m=1000.0)


def player(tissue=TISSUE, device=DEVICE, start=None, acting=(), rate=RATE):
    return Player(device, tissue, start or Start(0.0, tissue.surface_m + 0.001), acting, sample_rate_hz=rate)


def settled(tissue, volts, device=DEVICE, seconds=3.0):
    under_way = player(tissue, device)
    under_way.play(np.full(round(seconds * RATE), volts))
    return under_way


def test_it_comes_to_rest_where_forces_balance():
    end = settled(SPRING, 12.0).state
    assert end.current_a == pytest.approx(1.0, rel=1e-6)
    assert end.velocity_m_s == pytest.approx(0.0, abs=1e-9)
    assert end.position_m == pytest.approx(SPRING.surface_m + (3.0 + DEVICE.weight_n) / 1000.0, abs=1e-8)


def test_a_linear_chain_matches_its_transfer_function():
    damping = SPRING.damping_n_s_per_m + DEVICE.bearing_damping_n_s_per_m
    electrical = [DEVICE.inductance_h, DEVICE.resistance_ohm]
    mechanical = [DEVICE.moving_mass_kg + SPRING.mass_kg, damping, SPRING.stiffness_n_per_m]
    kf = DEVICE.force_constant_n_per_a
    denominator = np.polyadd(np.polymul(electrical, mechanical), [kf**2, 0.0])
    volts = 8.0 + signal.sosfilt(
        signal.butter(8, 200, fs=RATE, output="sos"), np.random.default_rng(1).standard_normal(4000)
    )
    under_way = settled(SPRING, 8.0)
    rest = under_way.state
    _, _, position = under_way.play(volts)
    discrete = signal.cont2discrete(([kf], denominator), 1 / RATE, method="zoh")
    b, a = np.ravel(discrete[0]), discrete[1]
    # The twin reads at the end of the hold of a command, lfilter at its start.
    expected = signal.lfilter(b, a, np.append(volts - 8.0, 0.0))[1:] + rest.position_m
    np.testing.assert_allclose(position, expected, atol=2e-4 * np.ptp(expected))


def test_halving_the_step_changes_next_to_nothing():
    volts = 20.0 + 18.0 * np.sin(2 * np.pi * 40 * np.arange(4000) / RATE)
    start = Start(0.0, 0.011)
    coarse = player(start=start).play(volts)[2]
    # The same command at twice the rate halves every step.
    fine = player(start=start, rate=2 * RATE).play(np.repeat(volts, 2))[2][1::2]
    assert np.sqrt(np.mean((coarse - fine) ** 2)) < 1e-4 * np.std(fine)


def test_the_amplifier_stops_at_its_limit():
    voltage = player().play(np.array([100.0, -100.0]))[0]
    assert voltage.tolist() == [48.0, -48.0]


def test_the_tissue_only_pushes():
    end = settled(SPRING, 0.0, replace(DEVICE, weight_n=-0.6)).state
    assert end.position_m < 0.001, "pulled away by its weight, it ends at the stop"


def test_the_far_end_of_the_stroke_holds_it():
    under_way = player()
    under_way.set_surface(1.0)
    under_way.play(np.full(2000, 40.0))
    assert under_way.state.position_m == pytest.approx(DEVICE.stroke_m, abs=2e-4)


def test_a_twin_with_lift_off_gets_no_one_sided_contact():
    sticking = ActiveEffect(CONTACT_LOSS, np.array([0.1, 1.0]))
    device = replace(DEVICE, weight_n=-0.6)
    under_way = player(SPRING, device, acting=[sticking])
    under_way.play(np.zeros(6000))
    assert under_way.state.position_m == pytest.approx(SPRING.surface_m - 0.6 / 1000.0, abs=1e-5)


@pytest.mark.parametrize(
    "acting",
    [
        (),
        (ActiveEffect(DRY_FRICTION, np.array(DRY_FRICTION.starts[0])),),
        (ActiveEffect(QUANTIZATION, np.array(QUANTIZATION.starts[0])),),
    ],
    ids=["baseline", "dry friction", "quantization"],
)
def test_cutting_a_command_in_two_changes_nothing(acting):
    volts = np.random.default_rng(2).uniform(0, 40, 400)
    start = Start(0.0, 0.012)
    one, other = player(start=start, acting=acting), player(start=start, acting=acting)
    whole = one.play(volts)
    pieces = np.hstack((other.play(volts[:150]), other.play(volts[150:])))
    np.testing.assert_array_equal(whole, pieces)
    assert one.state == other.state


def test_the_most_effects_and_the_end_bumpers_fit_and_one_more_does_not():
    friction = ActiveEffect(DRY_FRICTION, np.array(DRY_FRICTION.starts[0]))
    assert np.isfinite(player(acting=[friction] * bus.MOST_EFFECTS).play(np.full(20, 20.0))).all()
    with pytest.raises(ValueError, match="at most"):
        player(acting=[friction] * (bus.MOST_EFFECTS + 1))


@pytest.mark.parametrize("time_s", [8e-5, 1e-3 / 12.0, 4e-4])
def test_readings_are_those_of_first_order_filters(time_s):
    """Check against a fine simulation of a filter of the time constant of the coil, of a shorter and a longer one."""
    volts = 10.0 * np.sign(np.sin(np.arange(400) / 7.0))
    start, instrument = Start(0.0, 0.01), InstrumentParameters(inductance_h=1e-3, resistance_ohm=12.0)
    found = simulate(volts, RATE, replace(instrument, filter_time_s=time_s), Tissue(), start, substeps=4).readings
    times = 200
    fine = simulate(np.repeat(volts, times), times * RATE, instrument, Tissue(), start, substeps=1).readings
    kept = np.exp(-1.0 / (times * RATE * time_s))
    for name, first in (("voltage", 0.0), ("current", 0.0), ("position", 0.01)):
        true = getattr(fine, name)
        expected, _ = signal.lfilter([1.0 - kept], [1.0, -kept], true, zi=[kept * first])
        np.testing.assert_allclose(getattr(found, name), expected[times - 1 :: times], atol=5e-3 * np.std(true))


def test_parameters_can_change_during_a_simulation_but_not_the_effects():
    """Check that a changed simulation converges to one that always had the new parameters, at the same surface."""
    friction = ActiveEffect(DRY_FRICTION, np.array(DRY_FRICTION.starts[0]))
    stronger = ActiveEffect(DRY_FRICTION, 2.0 * friction.values)
    one, other = player(acting=[friction]), player(acting=[stronger])
    one.set_parameters(Tissue(surface_m=0.5, stiffness_n_per_m=900.0), [stronger])
    other.set_parameters(Tissue(stiffness_n_per_m=900.0), [stronger])
    volts = np.full(200, 20.0)
    np.testing.assert_array_equal(one.play(volts), other.play(volts))
    with pytest.raises(ValueError, match="which effects"):
        one.set_parameters(Tissue(), [])
