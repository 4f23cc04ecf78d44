"""Loss of contact: a free surface, the law of two bodies, contact within a step."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from played_effects import RATE, SURFACE, TISSUE, change, moved, noise, play
from scipy.integrate import solve_ivp

from tissueid.twin import bus
from tissueid.twin.catalogue import effect
from tissueid.twin.chain_parameters import InstrumentParameters
from tissueid.twin.simulation import ActiveEffect, Start, simulate


def test_a_probe_that_lifts_off_flies_and_comes_down_on_a_surface_that_returns():
    volts = np.zeros(3000)
    hanging = InstrumentParameters(weight_n=-0.3)
    attached = play(None, None, volts, device=hanging).readings.position
    free = play("contact_loss", (0.1, 1e-3), volts, device=hanging).readings.position
    assert attached[-1] > SURFACE - 0.002
    # 0.3 N against the bearing and the coil, whose shorted back-EMF brakes by kf^2 / R.
    assert (free[-2000] - free[-1]) / 1.0 == pytest.approx(0.3 / (3.5 + 9.0 / 12.0), rel=0.01)


def lifted(then, velocity, taken, slowing_s=10.0):
    """Return forces along a motion that leaves the tissue at 2 mm in the eleventh step of 0.1 ms."""
    depth = np.concatenate([np.full(11, 0.002), then])
    speed = np.concatenate([np.zeros(10), [-0.5], velocity])

    def pressing(numbers):
        numbers[bus.MASS], numbers[bus.TISSUE_MASS] = 0.06, taken
        numbers[bus.TISSUE_FORCE], numbers[bus.TISSUE_DAMPING] = 400.0 * numbers[bus.DEPTH], 4.0

    return moved("contact_loss", (slowing_s, 1e-3), depth, 1e-4, speed, pressing)


@pytest.mark.parametrize(
    ("slowing_s", "at_m"), [(10.0, 2e-3 * math.exp(-1.0)), (0.01, 2e-3 * math.exp(-math.log(2.0)))]
)
def test_a_free_surface_returns_by_its_own_stiffness_and_damping(slowing_s, at_m):
    # Without mass the decay is exp(-k / b t), 10 ms, or (1 + t / T)^(-k T / b) where the return slows.
    then = np.concatenate([np.zeros(100), [at_m - 4e-5, at_m + 4e-5]])
    result = lifted(then, np.zeros(102), 0.0, slowing_s)[:, bus.TISSUE_FORCE]
    assert result[5] == pytest.approx(0.8)
    assert np.abs(result[11:-1]).max() < 1e-3
    assert result[-1] > 0.1


def thrown(seconds, slowing_s, adhesion_n):
    """Return the depth of a heavy probe that tissue throws out from 5 mm, by events, and the number of lift-offs."""
    mass, drag, weight, taken = 0.3, 0.5, 1.0, TISSUE.mass_kg

    def stiffness(y):
        return TISSUE.stiffness_n_per_m * math.exp(TISSUE.stiffness_growth_per_m * y)

    def damping(y):
        return TISSUE.damping_n_s_per_m * math.exp(TISSUE.damping_growth_per_m * y)

    def pull(gap):
        return adhesion_n / (1.0 + (max(gap, 0.0) / 3e-5) ** 2)

    def together(t, x):
        force = weight - drag * x[1] - stiffness(x[0]) * x[0] - damping(x[0]) * x[1]
        return [x[1], force / (mass + taken)]

    def lets_go(t, x):
        return stiffness(x[0]) * x[0] + damping(x[0]) * x[1] + taken * together(t, x)[1] + adhesion_n

    def apart(t, x):
        back = stiffness(x[2]) * x[2] + damping(x[2]) * (1.0 + (t - off) / slowing_s) * x[3] + pull(x[2] - x[0])
        return [x[1], (weight - drag * x[1] + pull(x[2] - x[0])) / mass, x[3], -back / taken]

    def lands(t, x):
        return x[2] - x[0] if t > off + 1e-4 else 1.0

    lets_go.terminal = lands.terminal = True
    lets_go.direction = lands.direction = -1.0
    times, depth = np.arange(1, round(seconds * RATE) + 1) / RATE, []
    at, off, state, lifts, is_off = 0.0, 0.0, [0.005, -0.2], 0, False
    while at < times[-1]:
        law, event = (apart, lands) if is_off else (together, lets_go)
        later = times[(times > at) & (times <= times[-1])]
        found = solve_ivp(law, (at, times[-1]), state, events=event, t_eval=later, rtol=1e-9, atol=1e-12, max_step=1e-3)
        depth.extend(found.y[0])
        if found.status != 1:
            break
        at, state = float(found.t_events[0][0]), list(found.y_events[0][0])
        if is_off:
            common = (mass * state[1] + taken * state[3]) / (mass + taken)
            state = [state[0], common]
        else:
            off, lifts, state = at, lifts + 1, [state[0], state[1], state[0], state[1]]
        is_off = not is_off
    return np.array(depth), lifts


@pytest.mark.parametrize(("slowing_s", "adhesion_n"), [(10.0, 1e-3), (0.02, 0.05)])
def test_lifting_off_and_landing_follow_the_law_of_two_bodies(slowing_s, adhesion_n):
    expected, lifts = thrown(0.15, slowing_s, adhesion_n)
    device = InstrumentParameters(
        weight_n=1.0, force_constant_n_per_a=1e-9, moving_mass_kg=0.3, bearing_damping_n_s_per_m=0.5
    )
    acting = [ActiveEffect(effect("contact_loss"), np.array([slowing_s, adhesion_n]))]
    start = Start(0.0, SURFACE + 0.005, -0.2)
    found = simulate(np.zeros(expected.size), RATE, device, TISSUE, start, acting).readings.position - SURFACE
    assert lifts >= 1
    assert np.ptp(expected) > 2e-3
    np.testing.assert_allclose(found, expected, atol=2e-3 * np.ptp(expected))


def test_the_instant_of_contact_in_a_step_does_not_matter():
    # The cost of a fit is smooth: the motion changes in proportion to the parameters.
    command = noise(mean=2.0)
    ends = [play("contact_loss", (slowing, 0.05), command).readings.position for slowing in np.linspace(0.1, 0.101, 9)]
    steps = [np.abs(two - one).max() for one, two in itertools.pairwise(ends)]
    assert max(steps) < 3.0 * np.median(steps) + 1e-6


def test_contact_is_kept_at_depth():
    assert change("contact_loss", (0.1, 0.01)) < 1e-3
    assert change("contact_loss", (0.1, 0.01), command=noise(mean=2.0)) > 0.01
