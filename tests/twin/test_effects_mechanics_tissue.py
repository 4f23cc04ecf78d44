"""Effects of the stages mechanics and tissue: neutral values, signatures, energy, step size, independent solutions."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from played_effects import RATE, SURFACE, change, moved, noise, play
from scipy.integrate import solve_ivp

from tissueid.twin import bus
from tissueid.twin.catalogue import all_effects, effect
from tissueid.twin.chain_parameters import InstrumentParameters, Tissue, spring
from tissueid.twin.simulation import ActiveEffect, Start, simulate

MOST_PARAMETERS = 7
"""Most parameters that a fit of one effect to one test can determine."""
NAMES = [name for name, one in all_effects().items() if one.stage in ("mechanics", "tissue")]


def typical(name):
    return np.array(effect(name).starts[0])


def shown_by(name):
    """Return a command that shows the effect: the probe lifts off under small loads only."""
    return noise(mean=2.0) if effect(name).models_lift_off else noise()


@pytest.mark.parametrize("name", NAMES)
def test_it_vanishes_at_its_neutral_values(name):
    declared = effect(name)
    names = [item.name for item in declared.parameters]
    without = play().readings
    for neutral in declared.neutral:
        values = typical(name)
        for parameter, value in neutral.items():
            values[names.index(parameter)] = value
        with_it = play(name, values).readings
        for signal_name in ("voltage", "current", "position"):
            np.testing.assert_allclose(getattr(with_it, signal_name), getattr(without, signal_name), rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_it_vanishes_continuously(name):
    declared = effect(name)
    names = [item.name for item in declared.parameters]
    for neutral in declared.neutral:
        sizes = []
        for share in (1.0, 1e-2, 1e-4):
            values = typical(name)
            for parameter, value in neutral.items():
                k = names.index(parameter)
                values[k] = values[k] / share if math.isinf(value) else value + (values[k] - value) * share
            sizes.append(change(name, values, command=shown_by(name)))
        assert sizes[0] > 1e-4
        assert sizes[1] < 0.2 * sizes[0]
        assert sizes[2] <= 0.1 * sizes[1]


@pytest.mark.parametrize("name", NAMES)
def test_starts_lie_inside_the_bounds_and_differ(name):
    declared = effect(name)
    assert 1 <= len(declared.starts) <= 4
    assert len(set(declared.starts)) == len(declared.starts)
    assert 1 <= len(declared.parameters) <= MOST_PARAMETERS
    for start in declared.starts:
        for value, parameter in zip(start, declared.parameters, strict=True):
            inside = parameter.low < value < parameter.high
            assert inside or (parameter.fixed and value in (parameter.low, parameter.high)), (parameter.name, value)


@pytest.mark.parametrize("name", NAMES)
def test_four_steps_a_sample_are_sufficient(name):
    for start in effect(name).starts:
        command = shown_by(name)
        coarse, fine = (play(name, start, command, steps).readings.position for steps in (4, 40))
        plain = play(None, None, command, 40).readings.position
        error, own = (np.sqrt(np.mean(x**2)) for x in (coarse - fine, fine - plain))
        assert error < max(0.002 * own, 0.0005 * np.std(fine)), start


@pytest.mark.parametrize("name", NAMES)
def test_every_corner_of_the_bounds_stays_finite(name):
    declared = effect(name)
    for k in range(2 ** len(declared.parameters)):
        values = [item.high if k >> i & 1 else item.low for i, item in enumerate(declared.parameters)]
        readings = play(name, values, noise(0.2), substeps=4).readings
        assert np.isfinite(readings.position).all(), values
        assert np.isfinite(readings.current).all(), values


@pytest.mark.parametrize("name", NAMES)
def test_small_steps_of_a_parameter_change_little(name):
    declared = effect(name)
    start = np.array(declared.starts[0])
    command = shown_by(name)
    before = play(name, start, command).readings.position
    own = change(name, start, command=command) * np.std(before)
    for k, parameter in enumerate(declared.parameters):
        one, two = start.copy(), start.copy()
        size = 1e-3 * (start[k] if parameter.logarithmic else (parameter.high - parameter.low) / 4)
        one[k] += size
        two[k] += 2 * size
        first, second = (play(name, x, command).readings.position - before for x in (one, two))
        # Twice the step is twice the change, as derivatives by differences need.
        off = np.sqrt(np.mean((second - 2 * first) ** 2))
        assert off < 0.2 * np.sqrt(np.mean(second**2)) + 1e-4 * own, parameter.name


@pytest.mark.parametrize("name", NAMES)
def test_voltage_is_left_alone_and_current_changes_by_back_emf_only(name):
    values = typical(name)
    command = shown_by(name)
    assert change(name, values, "voltage", command=command) == 0.0
    position = change(name, values, "position", command=command)
    assert position > 1e-3
    assert change(name, values, "current", command=command) < 0.1 * position


@pytest.mark.parametrize("name", NAMES)
def test_the_spring_test_shows_mechanics_but_not_tissue(name):
    how = {"command": noise(mean=0.0), "tissue": spring(0.012, 1000.0, 0.005, 0.5), "on_tissue": False}
    assert (change(name, typical(name), **how) > 1e-3) == (effect(name).stage == "mechanics")


@pytest.mark.parametrize("name", ["dry_friction", "directional_friction", "tissue_hysteresis"])
def test_closed_loops_of_friction_take_energy_whatever_the_speed(name):
    def pressed(numbers):
        numbers[bus.TISSUE_FORCE] = 3.0

    values, lost = typical(name), []
    if name == "directional_friction":
        values[3] = 0.0  # without its Stribeck part, which does depend on speed
    for hertz in (0.5, 5.0):
        time = np.arange(0.0, 2.0 / hertz, 1.0 / (hertz * 1000.0))
        position = 0.003 + 5e-4 * np.sin(2 * np.pi * hertz * time)
        velocity = 2 * np.pi * hertz * 5e-4 * np.cos(2 * np.pi * hertz * time)
        result = moved(name, values, position, time[1], velocity, pressed)
        force = result[:, bus.TISSUE_FORCE] - 3.0 - result[:, bus.FORCE]
        half = time.size // 2
        lost.append(float(np.sum((force * velocity)[half:]) * time[1]))
    assert lost[0] > 0.0
    if name == "dry_friction":  # without its Stribeck part, which does depend on speed
        values[2] = 0.0
        time = np.arange(0.0, 2.0, 5e-4)
        result = moved(name, values, 0.01 * np.sin(2 * np.pi * time), 5e-4, 0.02 * np.pi * np.cos(2 * np.pi * time))
        assert np.sum(-result[:, bus.FORCE] * 0.02 * np.pi * np.cos(2 * np.pi * time)) * 5e-4 / 2 == pytest.approx(
            4 * 0.01 * values[0], rel=0.02
        )
    else:
        assert lost[1] == pytest.approx(lost[0], rel=0.01)


def test_friction_holds_as_much_as_it_slides_with_and_differs_by_direction():
    there = np.concatenate([np.linspace(0.0, 2e-3, 2000), np.linspace(2e-3, 0.0, 2000)])
    for name, values, pair in (
        ("dry_friction", (0.3, 2e-5, 0.0, 0.5, 1.0), (-0.3, 0.3)),
        ("directional_friction", (0.3, 0.5, 2e-5, 0.0, 0.5, 1.0), (-0.45, 0.15)),
    ):
        force = moved(name, values, there, 1e-3)[:, bus.FORCE]
        assert force[1990] == pytest.approx(pair[0], rel=1e-3)
        assert force[-10] == pytest.approx(pair[1], rel=1e-3)


def test_drag_is_a_power_of_speed():
    for speed in (0.005, 0.05, 0.2):
        result = moved("quadratic_drag", (0.4, 2.0), np.zeros(1), 1e-4, np.array([speed]))
        assert result[0, bus.DAMPING] * speed == pytest.approx(0.4 * (speed / 0.05) ** 2, rel=1e-3)
    # It falls with the square of amplitude while linear errors keep their share.
    shares = []
    for amplitude in (26.0, 6.5):
        command = noise(amplitude=amplitude)
        plain = play(None, None, command).readings.position[400:]
        off = play("quadratic_drag", (0.3, 2.0), command).readings.position[400:] - plain
        shares.append(np.std(off) / np.std(plain))
    assert shares[1] < 0.5 * shares[0]


def test_the_end_stop_pushes_and_never_pulls():
    volts = np.full(3000, 20.0)
    rest = play("end_stop", (0.011, 10.0, 1.0, 5.0, 1.0), volts).readings.position[-1]
    pressed = 3.0 * 20.0 / 12.0 + 0.2 - 400.0 * math.exp(250.0 * (rest - SURFACE)) * (rest - SURFACE)
    assert rest - 0.011 == pytest.approx(pressed / 1e5, abs=1e-8)
    wave = -1e-4 * np.cos(2 * np.pi * 20 * np.arange(0.0, 0.1, 1e-4))
    velocity = np.gradient(wave, 1e-4)
    for side in (1.0, -1.0):
        result = moved("end_stop", (0.011, 10.0, 1.5, 100.0, side), 0.011 + side * wave, 1e-4, side * velocity)
        assert (side * result[:, bus.FORCE]).max() < 1e-3
        assert (side * result[:, bus.FORCE]).min() < -5.0
        assert np.sum(result[:, bus.FORCE] * side * velocity) < 0.0
    # Out of reach it has no effect.
    assert change("end_stop", (0.020, 10.0, 1.0, 5.0, 1.0)) == 0.0


def test_starts_for_the_stop_are_read_from_the_record():
    position = np.append(np.linspace(0.009, 0.0141, 200), np.nan)
    starts = effect("end_stop").starts_from([{"position": position}, {"position": np.full(5, np.nan)}], RATE)
    assert starts[0][0] == pytest.approx(0.01405)
    assert 0.0137 < starts[1][0] < 0.0141
    assert effect("end_stop").starts_from([{"position": np.full(5, np.nan)}, {}], RATE) == ()


@pytest.mark.parametrize(
    ("second", "share", "together", "direction"),
    [(2.5, 0.0, 0.0, 0.0), (1.8, 0.4, 0.0, 0.0), (2.5, 0.0, 1.0, 0.0), (1.8, 0.4, 1.0, 0.0), (1.8, 0.4, 0.0, 0.8)],
)
def test_masses_on_springs_move_as_an_independent_solution_has_them(second, share, together, direction):
    hertz, ratio, frame, lossy = 25.0, 0.04, 0.8, 0.5 if direction == 0.0 else 6.0
    device, rest = InstrumentParameters(weight_n=0.0), spring(0.012, 1000.0, 0.004, lossy)
    volts = noise(0.1, 0.0, 20.0)
    values = (hertz, ratio, frame, second, share, together)
    acting = [ActiveEffect(effect("mount_resonance"), np.array(values))]
    acting += [ActiveEffect(effect("directional_damping"), np.array((direction, 0.02)))] if direction else []
    start = Start(volts[0] / device.resistance_ohm, 0.012)
    mine = simulate(volts, RATE, device, rest, start, acting, on_tissue=bool(direction), substeps=20).readings
    modes = [(2 * math.pi * hertz, 1.0), (2 * math.pi * hertz * second, share)]

    def slope(t, y):
        current, x, v, *states = y  # x against the frame, its modes against the ground
        volt = volts[min(int(t * RATE + 1e-9), volts.size - 1)]
        coil, base, base_v = 3.0 * current, states[0] + states[2], states[1] + states[3]
        seen, seen_v = (x, v) if together else (x + base, v + base_v)
        contact = 1000.0 * (seen - 0.012) + lossy * (1.0 + direction * math.tanh(seen_v / 0.02)) * seen_v
        reaction = -coil + 3.5 * v + (contact if together else 0.0)
        own = [-2 * ratio * w * states[2 * k + 1] - w * w * states[2 * k] for k, (w, _) in enumerate(modes)]
        bases = [found + part * reaction / frame for found, (_, part) in zip(own, modes, strict=True)]
        rail = (coil - 3.5 * v - contact) / 0.064 - sum(bases)
        return [(volt - 12.0 * current - 3.0 * v) / 1e-3, v, rail, states[1], bases[0], states[3], bases[1]]

    solved = [volts[0] / 12.0, 0.012, 0.0, 0.0, 0.0, 0.0, 0.0]
    position = []
    for n in range(volts.size):
        span = ((n + 1e-6) / RATE, (n + 1 - 1e-6) / RATE)
        solved = solve_ivp(slope, span, solved, rtol=1e-6, atol=1e-10).y[:, -1]
        position.append(solved[1])
    assert np.sqrt(np.mean((mine.position - position) ** 2)) < 0.001 * np.std(position)
    assert change("mount_resonance", values, tissue=rest, on_tissue=False, command=volts) > 0.03


@pytest.mark.parametrize("values", [{"second": 2.0}, {"tissue_on_frame": 1.0}])
def test_another_minimum_is_a_value_of_fitted_parameters(values):
    with pytest.raises(ValueError, match="mount_resonance"):
        replace(effect("mount_resonance"), other_minima=(values,))


@pytest.mark.parametrize(("mean", "lifts"), [(10.0, False), (0.0, True)])
def test_a_frame_that_moves_lifts_the_probe_only_where_the_contact_force_ends(mean, lifts):
    time = np.arange(3000) / RATE
    volts = mean + 16.0 * np.sin(2 * np.pi * 64.0 * time) * np.minimum(2.0 * time, 1.0)
    soft = Tissue(SURFACE, 0.03, 4.0, 300.0, 300.0, 400.0)
    frame = ActiveEffect(effect("mount_resonance"), np.array((64.0, 0.024, 0.35, 2.5, 0.0, 0.0)))
    loose, stuck = (
        simulate(
            volts, RATE, InstrumentParameters(), soft, Start(mean / 12.0, SURFACE), [frame, held]
        ).readings.position
        for held in (ActiveEffect(effect("contact_loss"), np.array((0.1, adhesion_n))) for adhesion_n in (1e-3, 20.0))
    )
    assert bool(np.abs(loose - stuck).max() > 1e-5) is lifts


def test_cogging_shifts_equilibria_by_its_force():
    rest = spring(0.012, 1000.0)
    volts = np.full(2000, 6.0)
    shape = (0.3, -0.2, 3e-3, 0.2, 0.1, -0.1, 0.05)
    x = play("cogging", shape, volts, tissue=rest, on_tissue=False).readings.position[-1]
    angle = 2 * math.pi * (x - 0.0135) / 3e-3
    wave = 0.3 * math.sin(angle) - 0.2 * math.cos(angle)
    second = 0.2 * math.sin(2 * angle) + 0.1 * math.cos(2 * angle)
    third = -0.1 * math.sin(3 * angle) + 0.05 * math.cos(3 * angle)
    wave += math.hypot(0.3, -0.2) * (second + third)
    assert 1000.0 * (x - 0.012) == pytest.approx(3.0 * 0.5 + 0.2 + wave, abs=1e-6)
    result = moved("cogging", shape, 0.0135 + np.linspace(0.0, 3e-3, 3001), 1e-3)[:, bus.FORCE]
    assert np.trapezoid(result, dx=1e-6) == pytest.approx(0.0, abs=1e-9)  # no work round a period


def test_a_layer_engages_at_its_depth_and_a_cube_is_a_cube():
    depth = np.array([0.001, 0.0018, 0.004, -0.004])
    force = moved("tissue_stiffening", (0.5, 0.002, 1.0, 1e-4), depth, 1e-3)[:, bus.TISSUE_FORCE]
    np.testing.assert_allclose(force, [0.0, 0.0, 1.0, -1.0], atol=0.01)
    force = moved("tissue_stiffening", (0.5, 0.0, 3.0, 1e-4), depth, 1e-3)[:, bus.TISSUE_FORCE]
    np.testing.assert_allclose(force, 0.5 * (depth / 1e-3) ** 3, rtol=1e-6)
    position = 0.009 + np.append(0.0, np.linspace(0.002, 0.004, 2001))
    starts = effect("tissue_stiffening").starts_from([{"position": position, "command": position}, {}], RATE)
    assert [start[1] for start in starts] == pytest.approx([0.0026, 0.003, 0.0034, 0.0037, 0.0039], abs=2e-6)
    assert effect("tissue_stiffening").starts_from([{"position": np.full(9, np.nan)}], RATE) == ()


def test_relaxation_follows_its_branches_and_takes_energy():
    def elastic(numbers):
        numbers[bus.TISSUE_FORCE] = 1000.0 * numbers[bus.DEPTH]
        numbers[bus.STIFFNESS] = 1000.0

    # Relaxed at the start of a test, before the step.
    step = np.r_[0.0, np.full(4000, 0.002)]
    time = (np.arange(4000) + 0.5) * 1e-4
    taus = 0.1 * 10.0 ** np.linspace(-1.0, 1.0, 7)
    for tilt in (0.0, 0.3):
        values = (0.6, 0.1, 2.0, 1.0, tilt)
        result = moved("viscoelasticity", values, step, 1e-4, np.zeros(4001), elastic)[1:, bus.TISSUE_FORCE]
        left = np.average(np.exp(-time[:, None] / taus), axis=1, weights=taus**-tilt)
        np.testing.assert_allclose(result, 2.0 * (1.0 + 0.6 * left), rtol=3e-4)
    time = np.arange(0.0, 0.5, 1e-4)
    loop = moved(
        "viscoelasticity", (0.6, 0.05, 1.0, 1.0, 0.1), 1e-3 * np.sin(2 * np.pi * 4 * time), 1e-4, None, elastic
    )
    assert np.sum(loop[:, bus.TISSUE_FORCE] * np.gradient(1e-3 * np.sin(2 * np.pi * 4 * time))) > 0.0


def test_the_tissues_loops_yield_at_lengths_that_their_logarithms_spread():
    def pressed(numbers):
        numbers[bus.TISSUE_FORCE] = 3.0

    speed = np.full(4000, 1e-3)
    result = moved("tissue_hysteresis", (0.2, 1e-4, 0.0, 0.0, 1.0), np.zeros(4000), 1e-3, speed, pressed)
    gone = (np.arange(4000) + 0.5) * 1e-6
    yields = 1e-4 * np.exp(np.linspace(-1.0, 1.0, 8))
    expected = 0.2 * np.minimum(gone[:, None] / yields, 1.0).mean(axis=1)
    np.testing.assert_allclose(result[:, bus.TISSUE_FORCE] - 3.0, expected, atol=0.2 * 1e-2)


def test_stiffness_drifts_from_every_start_with_time_and_with_work():
    def working(numbers):
        numbers[bus.TISSUE_FORCE] = 4.0

    still = np.zeros(5000)
    result = moved("preconditioning", (-0.4, 0.5, 0.0), still, 1e-3, still, working)[:, bus.TISSUE_FORCE]
    np.testing.assert_allclose(result, 4.0 * (1 - 0.4 * (1 - np.exp(-(np.arange(5000) + 1) * 1e-3 / 0.5))), rtol=1e-9)
    assert moved("preconditioning", (-0.4, 0.5, 1.0), still, 1e-3, still, working)[-1, bus.TISSUE_FORCE] == 4.0
    fast = moved("preconditioning", (-0.4, 0.5, 1.0), still, 1e-3, still + 0.05, working)[:, bus.TISSUE_FORCE]
    np.testing.assert_allclose(fast[-1], 4.0 * 0.6, rtol=1e-3)
    early, late = (
        np.mean(
            np.abs(
                play("preconditioning", (-0.3, 1.0, 0.0), noise(2.0)).readings.position[part]
                - play(None, None, noise(2.0)).readings.position[part]
            )
        )
        for part in (slice(0, 300), slice(3000, 4000))
    )
    assert late > 2 * early


def test_mass_grows_with_depth_and_keeps_energy():
    def bare(numbers):
        numbers[bus.TISSUE_FORCE] = 0.0

    depth = np.array([0.0003, 0.003, 0.012, -0.001])
    result = moved("added_mass", (0.03, 0.003, 2.0, 0.5), depth, 1e-3, np.full(4, 0.1), bare)
    np.testing.assert_allclose(
        result[:, bus.TISSUE_MASS], [0.03 * 0.00995, 0.03 * (1 - np.exp(-1)), 0.03, 0.0], rtol=1e-3
    )
    # With only that mass, kinetic energy is constant.
    x, v, dt, energy = 0.001, 0.05, 1e-5, []
    for _ in range(4000):
        now = moved("added_mass", (0.1, 3e-3, 2.0, 0.5), np.array([x]), dt, np.array([v]), bare)[0]
        mass = 0.06 + now[bus.TISSUE_MASS]
        energy.append(0.5 * mass * v * v)
        v -= dt * now[bus.TISSUE_FORCE] / mass
        x += dt * v
    assert x > 0.0025
    assert energy[-1] == pytest.approx(energy[0], rel=5e-3)


def test_damping_differs_by_direction_and_never_drives():
    def damped(numbers):
        numbers[bus.TISSUE_DAMPING] = 6.0

    result = moved("directional_damping", (0.4, 1e-3), np.zeros(3), 1e-4, np.array([0.1, 0.0, -0.1]), damped)
    np.testing.assert_allclose(result[:, bus.TISSUE_DAMPING], [8.4, 6.0, 3.6], rtol=1e-9)
    # Rectified speed shifts the mean, which no symmetric law does.
    out = np.mean(play("directional_damping", (0.5, 0.005)).readings.position[300:])
    deeper = np.mean(play("directional_damping", (-0.5, 0.005)).readings.position[300:])
    assert out < np.mean(play().readings.position[300:]) < deeper


def test_a_reflex_answers_a_push_one_delay_later_and_no_pull():
    time = np.arange(0.0, 0.4, 1.25e-4)
    bump = np.exp(-0.5 * ((time - 0.1) / 0.004) ** 2) * 0.09
    for delay in (0.02, 0.0731, 0.15):
        values = (0.2, delay, 0.5, 1.0, 0.01, 50.0, 5e-4)
        answer = moved("reflex", values, np.zeros(time.size), 1.25e-4, bump)[:, bus.TISSUE_FORCE]
        pulled = moved("reflex", values, np.zeros(time.size), 1.25e-4, -bump)[:, bus.TISSUE_FORCE]
        # The rest is the smoothed corner.
        assert np.abs(pulled).max() < 1e-3 * 0.2
        answer -= pulled
        centre = np.sum(time * answer) / np.sum(answer)
        assert centre == pytest.approx(0.1 + delay + 5e-4 + 2 * 0.01, abs=2e-4)
    held = moved(
        "reflex", (0.2, 0.05, 1.0, 0.0, 0.01, 50.0, 5e-4), np.full(time.size, 4e-3), 1.25e-4, np.zeros(time.size)
    )
    assert held[380, bus.TISSUE_FORCE] == 0.0
    assert held[-1, bus.TISSUE_FORCE] == pytest.approx(0.2, rel=0.02)
    tired = moved(
        "reflex", (2.0, 0.05, 1.0, 0.0, 0.01, 0.5, 5e-4), np.full(time.size, 4e-3), 1.25e-4, np.zeros(time.size)
    )
    assert tired[-1, bus.TISSUE_FORCE] == pytest.approx(2.0 / (1.0 + 2.0 / 0.5), rel=0.02)
    starts = effect("reflex").starts_from([{"position": np.append(0.009, np.full(99, 0.0135))}], RATE)
    assert [start[2] for start in starts] == pytest.approx([1.5] * 4)
    assert effect("reflex").starts_from([{}], RATE) == ()
