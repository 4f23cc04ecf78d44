"""Effects act in the order of what they act on, whatever the order in which they are given."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from played_effects import DEVICE, RATE, TISSUE, noise

from tissueid.instrument.tissues import TISSUES
from tissueid.twin.catalogue import all_effects, effect
from tissueid.twin.effect import ActsOn
from tissueid.twin.player import Player
from tissueid.twin.simulation import ActiveEffect, Start, simulate, values_by_name

NAMES = tuple(all_effects())
COMMAND = noise(0.03, mean=8.0)
START = Start(float(COMMAND[0]) / DEVICE.resistance_ohm, TISSUE.surface_m)


def typical(name, strength=1.0):
    """Return an effect with some amplitude: of breathing, hum and lost samples, whose starts are neutral, as well."""
    values = np.array(effect(name).starts[0])
    for k, parameter in enumerate(effect(name).parameters):
        if parameter.per_test and parameter.neutral == 0.0:
            values[k] = 1e-5 * (k + 1)
    if name == "dropped_samples":
        values[1:3] = 20.0, 1.0
    values[0] *= strength
    return ActiveEffect(effect(name), values)


def signals(acting):
    found = simulate(COMMAND, RATE, DEVICE, TISSUE, START, acting).readings
    return np.stack([found.voltage, found.current, found.position])


def player(acting):
    return Player(DEVICE, TISSUE, START, acting, sample_rate_hz=RATE, substeps=5)


@pytest.mark.parametrize("name", NAMES)
def test_the_order_in_which_a_pair_is_given_changes_nothing(name):
    """Check every pair in the simulation of a fit, in a simulated instrument, and after a change of parameters."""
    for other in NAMES[NAMES.index(name) + 1 :]:
        pair = [typical(name), typical(other)]
        np.testing.assert_array_equal(signals(pair), signals(pair[::-1]), err_msg=other)
        expected = player(pair).play(COMMAND)
        np.testing.assert_array_equal(player(pair[::-1]).play(COMMAND), expected, err_msg=other)
        for given in (pair, pair[::-1]):
            changed = player([typical(item.effect.name, 0.5) for item in given])
            changed.set_parameters(TISSUE, given)
            np.testing.assert_array_equal(changed.play(COMMAND), expected, err_msg=other)


def test_the_effects_of_skin_can_be_given_in_any_order():
    """Check that no order gives the parameters of one effect to another when they change from test to test."""
    simulated = TISSUES["forearm"].varied(1.0)
    drawn, further = (simulated.drawn(np.random.default_rng(seed))[1] for seed in (1, 2))
    found = []
    for names in itertools.permutations(drawn):
        first, then = (
            [ActiveEffect(effect(name), values_by_name(effect(name), values[name])) for name in names]
            for values in (drawn, further)
        )
        under_way = player(first)
        under_way.set_parameters(TISSUE, then)
        found.append(under_way.play(COMMAND))
    assert len(found) == 120
    assert all(np.array_equal(one, found[0]) for one in found)


def test_each_effect_is_evaluated_after_those_whose_result_it_reads():
    order = sorted(NAMES, key=lambda name: effect(name).evaluation)
    for earlier, later in (
        ("latency", "amplifier_lag"),
        ("amplifier_lag", "amplifier_deadband"),
        ("amplifier_deadband", "amplifier_clipping"),
        ("inductance_position", "eddy_currents"),
        ("coil_heating", "eddy_currents"),
        ("physiological_motion", "viscoelasticity"),
        ("preconditioning", "tissue_hysteresis"),
        ("dry_friction", "mount_resonance"),
        ("viscoelasticity", "mount_resonance"),
        ("mount_resonance", "contact_loss"),
        ("sensor_nonlinearity", "sensor_backlash"),
        ("sensor_lag", "clock_skew"),
        ("mains_hum", "quantization"),
        ("quantization", "dropped_samples"),
    ):
        assert order.index(earlier) < order.index(later), (earlier, later)
    assert [name for name in NAMES if effect(name).models_lift_off] == ["contact_loss"]
    assert effect("contact_loss").acts_on is ActsOn.LIFT_OFF
