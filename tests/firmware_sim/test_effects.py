"""Effects of the simulated plant: absent at zero, each in its own signals, and never a source of energy."""

import time

import numpy as np
import pytest

from firmware_sim import kernel
from firmware_sim.bench import Bench
from firmware_sim.effects import EFFECTS, LISTED, UNLISTED, in_order, mechanics, read_effects, tissue
from firmware_sim.effects.active_effects import ActiveEffects
from firmware_sim.effects.base import MEMORY, RING_LENGTH, RINGS, ROWS, WIDTH, DrawConditions
from firmware_sim.laboratory import BaselineParameters, Laboratory
from firmware_sim.plant import Plant, PlantParameters
from firmware_sim.presets import load_preset
from firmware_sim.scenario import load_scenario
from tissueid.twin.catalogue import all_effects

pytestmark = pytest.mark.timeout(600)  # the first test compiles the loop, on a busy machine for minutes

FIGURES = BaselineParameters()
SHALLOW = BaselineParameters(mean_v=4.0, surface_m=0.010)
WHERE = {
    "end_stop": {"at_m": 0.0135},
    "magnetic_spring": {"middle_m": 0.0130},
}
"""Figures that say where in this tissue an effect is met."""


def played(mean, seconds=0.6, spread=10.0, seed=0):
    count = round(2000 * seconds)
    slow = np.convolve(np.random.default_rng(seed).normal(size=count + 8), np.ones(8) / 8**0.5, mode="valid")[:count]
    return mean + spread * np.clip(slow, -2.2, 2.2)


def typical(name, **more):
    return EFFECTS[name](level=EFFECTS[name].typical, **WHERE.get(name, {}) | more)


def recorded(effects=(), kind="stochastic", figures=FIGURES, **more):
    command = {"quiet": np.zeros(1200), "spring": played(0.0), "stochastic": played(figures.mean_v)}[kind]
    return Laboratory(effects, 3, figures=figures, clean=True, **more).record(kind, command)


@pytest.fixture(scope="module")
def baseline():
    return {
        (kind, figures.mean_v): recorded((), kind, figures)
        for kind in ("quiet", "stochastic", "spring")
        for figures in (FIGURES, SHALLOW)
    }


def change(one, other, name):
    return np.nanstd(getattr(one, name) - getattr(other, name)) / max(np.std(getattr(other, name)), 1e-9)


def test_the_listed_effects_are_those_that_the_twin_declares_for_the_laboratory():
    declared = {name: one.stage for name, one in all_effects().items() if one.in_laboratory}
    assert {name: EFFECTS[name].stage for name in LISTED} == declared
    assert set(UNLISTED).isdisjoint(all_effects())
    assert len(UNLISTED) >= 3
    assert all(kind.__doc__ and kind.unit for kind in EFFECTS.values())


@pytest.mark.parametrize("name", ROWS)
def test_nothing_acts_at_zero(name):
    absent = EFFECTS[name](level=0.0)
    assert not absent.acts
    assert not ActiveEffects([absent])
    assert Laboratory([absent]).effects == ()


def test_the_loop_without_an_effect_is_the_plants_own():
    plant = Plant(PlantParameters(), load_preset("left-posterior-forearm"))
    state = plant.state.copy()
    commands = played(4.0, 0.1)
    trace = plant.advance(commands)
    again = Plant(PlantParameters(), load_preset("left-posterior-forearm"))
    out, _ = ActiveEffects([]).advance(commands, state, again.plant_row, again.tissue_row, 1 / 2000, again.substeps)
    for k, column in enumerate(trace.dtype.names):
        np.testing.assert_array_equal(out[:, k], trace[column])


@pytest.mark.parametrize("name", sorted(set(ROWS) - {"contact_loss", "dropped_samples"}))
def test_an_effect_vanishes_with_its_level(name, baseline):
    barely = typical(name).model_copy(update={"level": 1e-6 * EFFECTS[name].typical})
    faint = recorded([barely])
    for signal in ("voltage", "current", "position"):
        assert change(faint, baseline["stochastic", FIGURES.mean_v], signal) < 5e-4, signal


@pytest.mark.parametrize("name", ROWS)
def test_a_typical_effect_shows_in_its_signals(name, baseline):
    effect = EFFECTS[name]
    figures = SHALLOW if name == "contact_loss" else FIGURES
    whole, none = recorded([typical(name)], figures=figures), baseline["stochastic", figures.mean_v]
    voltage, current, position = (change(whole, none, signal) for signal in ("voltage", "current", "position"))
    if effect.stage == "drive":
        assert min(voltage, current) > 3e-3
    elif effect.stage == "coil":
        assert voltage == 0.0
        assert max(current, position) > 3e-3
    elif effect.stage in ("mechanics", "tissue"):
        assert voltage == 0.0
        assert position > 5e-3
        assert current < 0.2 * position
    elif name == "dropped_samples":
        assert min(voltage, current, position) > 0.05
    elif effect.stage == "sensing":
        assert voltage == current == 0.0
        assert position > 5e-3


@pytest.mark.parametrize("name", [name for name in ROWS if EFFECTS[name].stage == "tissue"])
def test_tissue_is_not_on_the_spring(name, baseline):
    sprung = recorded([typical(name)], "spring")
    np.testing.assert_array_equal(sprung.position, baseline["spring", FIGURES.mean_v].position)


@pytest.mark.parametrize("name", ["mains_hum", "physiological_motion"])
def test_the_environment_is_there_when_nothing_is_played(name, baseline):
    quiet = recorded([typical(name)], "quiet")
    assert np.std(quiet.position - baseline["quiet", FIGURES.mean_v].position) > 4e-6


# -- laws ---------------------------------------------------------------------------------------------------------


def test_latency_delays_the_voltage():
    late = recorded([EFFECTS["latency"](level=1e-3)])
    np.testing.assert_allclose(late.voltage[2:], late.command[:-2], atol=1e-9)


def test_clipping_holds_its_limits():
    low, high = 0.5 * 20.0, 20.0
    hard = recorded([EFFECTS["amplifier_clipping"](level=1 / high, share_below=0.5)], "spring")
    assert np.abs(hard.command).max() > high
    np.testing.assert_allclose(hard.voltage, np.clip(hard.command, -low, high))
    soft = recorded([EFFECTS["amplifier_clipping"](level=1 / high, kind="soft")], "spring")
    assert np.abs(soft.voltage).max() < high
    gentle = np.abs(soft.command) < 8.0
    np.testing.assert_allclose(soft.voltage[gentle], soft.command[gentle], rtol=1e-3)


def test_a_dead_band_keeps_the_slope_outside():
    dead = recorded([EFFECTS["amplifier_deadband"](level=2.0)], "spring")
    expected = np.sign(dead.command) * np.maximum(np.abs(dead.command) - 2.0, 0.0)
    np.testing.assert_allclose(dead.voltage, expected, atol=1e-12)


def test_a_heated_coil_draws_less():
    warm, cold = recorded([EFFECTS["coil_heating"](level=8.0, time_s=0.3)]), recorded()
    assert np.mean(warm.current[-200:]) < 0.85 * np.mean(cold.current[-200:])


def test_the_field_brakes_as_it_pushes():
    # With a third of the force constant gone everywhere, so is that share of the back-EMF: as a weaker coil has it.
    weak = EFFECTS["force_constant_position"](level=0.6, course="slope", middle_m=0.045, width_m=0.01)
    assert weak.row()[1:] == pytest.approx(1.6)  # ten millimetres and more before the middle of the slope
    strong = recorded([weak])
    like = recorded((), figures=BaselineParameters(force_constant_n_per_a=1.6 * 3.0))
    np.testing.assert_allclose(strong.position, like.position, atol=1e-9)
    np.testing.assert_allclose(strong.current, like.current, atol=1e-6)


def test_inductance_and_ladder_leave_steady_current_alone():
    steady = np.full(1200, 12.0)
    for name in ("eddy_currents", "inductance_position"):
        last = Laboratory([typical(name)], clean=True).record("stochastic", steady).current[-1]
        assert last == pytest.approx(12.0 / 12.0, rel=1e-3)


def swung(amplitude, frequency, count=4000, cycles=2):
    t = np.arange(count * cycles) / count / frequency
    omega = 2 * np.pi * frequency
    return t[1], amplitude * np.sin(omega * t), amplitude * omega * np.cos(omega * t)


def test_bristles_slide_with_their_level_and_take_energy():
    row = EFFECTS["dry_friction"](level=0.4, breakaway_share=0.5).row()
    kept = np.zeros(4)
    for _ in range(2000):
        force = mechanics.bristles.py_func(0.1, 2.5e-5, row, kept)
    assert force == pytest.approx(0.4, rel=1e-6)
    for amplitude in (1e-6, 1e-5, 1e-3):
        kept = np.zeros(4)
        step, _, speed = swung(amplitude, 5.0)
        work = sum(mechanics.bristles.py_func(v, step, row, kept) * v * step for v in speed)
        assert work >= -1e-12
        assert np.abs(kept).max() < 1e-3


def test_slipping_blocks_hold_more_one_way():
    row = EFFECTS["directional_friction"](level=0.2, outward_share=3.0).row()
    kept = np.zeros(MEMORY)
    inwards = [mechanics.slips.py_func(1e-6, row, kept) for _ in range(400)][-1]
    outwards = [mechanics.slips.py_func(-1e-6, row, kept) for _ in range(400)][-1]
    assert inwards == pytest.approx(0.2)
    assert outwards == pytest.approx(-0.6)


def lone(name, **figures):
    rows = np.zeros((len(ROWS), WIDTH))
    row = EFFECTS[name](**figures).row()
    rows[ROWS.index(name), : row.size] = row
    return rows, np.zeros((len(ROWS) + 1, MEMORY))


def loop_area(name, frequency, **figures):
    rows, memory = lone(name, **figures)
    rings = np.zeros((RINGS, 4))
    step, depth, speed = swung(5e-4, frequency, 1000)
    work = [
        -v * step * tissue.tissue.py_func(d, v, 500.0 * d, 5.0, step, False, rows, memory, rings)
        for d, v in zip(depth, speed, strict=True)
    ]
    return sum(work[1000:])


def test_loops_of_tissue_follow_no_speed_and_relaxation_does():
    slow, fast = (loop_area("tissue_hysteresis", f, level=500.0) for f in (0.5, 20.0))
    assert slow > 0
    assert fast == pytest.approx(slow, rel=1e-6)
    slow, fast = (loop_area("viscoelasticity", f, level=0.5) for f in (2.0, 200.0))
    assert slow > 0
    assert fast > 0
    assert fast != pytest.approx(slow, rel=0.05)


def test_relaxation_is_a_power_law():
    # A step in depth: what all branches add falls by the same factor from decade to decade.
    rows, memory = lone("viscoelasticity", level=1.0, exponent=0.3)
    rings = np.zeros((RINGS, 4))
    times = np.array([0.005, 0.05, 0.5])
    force, t, step = [], 0.0, 5e-4
    while t < times[-1] + step:
        force.append(-tissue.tissue.py_func(1e-3, 0.0, 1.0, 5.0, step, False, rows, memory, rings))
        t += step
    at = np.interp(times, step * np.arange(1, len(force) + 1), force)
    first, second = at[1] / at[0], at[2] / at[1]
    assert 0.3 < second < first < 0.75


def test_a_reflex_comes_late(baseline):
    reflex = recorded([EFFECTS["reflex"](level=1.0, delay_s=0.1, threshold_m_per_s=0.0)])
    plain = baseline["stochastic", FIGURES.mean_v]
    np.testing.assert_array_equal(reflex.position[:199], plain.position[:199])
    late = (reflex.position - plain.position)[300:]
    assert late.mean() < -2e-5  # pushed out


def test_tissue_softens_as_it_is_worked(baseline):
    worked = recorded([EFFECTS["preconditioning"](level=0.3, work_j=0.3)])
    deeper = worked.position - baseline["stochastic", FIGURES.mean_v].position
    assert abs(deeper[:20]).max() < 0.1 * deeper[-200:].mean()


@pytest.mark.parametrize("level", [0.5, 4.0])
@pytest.mark.parametrize("adhesion_n", [0.0, 0.02, 0.3])
def test_lifting_off_and_landing_is_found_in_time(level, adhesion_n):
    # It was two to six hundredths where each of the loop's steps was another collision.
    lost = EFFECTS["contact_loss"](level=level, adhesion_n=adhesion_n)
    one, fine = (recorded([lost], figures=SHALLOW, substeps=n) for n in (20, 80))
    assert change(one, fine, "position") < 3e-3
    assert change(one, recorded(figures=SHALLOW), "position") > 0.01


def test_the_probe_leaves_tissue_that_only_pushes():
    pulled = np.full(600, -6.0)
    off = Laboratory([EFFECTS["contact_loss"](level=1.0)], clean=True).record("stochastic", pulled)
    held = Laboratory((), clean=True).record("stochastic", pulled)
    stuck = Laboratory([EFFECTS["contact_loss"](level=1.0, adhesion_n=5.0)], clean=True).record("stochastic", pulled)
    assert off.position[-1] < held.position[-1] - 0.01
    np.testing.assert_allclose(stuck.position, held.position, atol=1e-9)


def test_an_end_stop_turns_the_probe_back():
    stopped = recorded([EFFECTS["end_stop"](level=10.0, at_m=0.0130)])
    assert recorded().position.max() > 0.0136
    assert stopped.position.max() < 0.0133


def test_a_swinging_frame_rings_at_its_own_frequency():
    kick = np.full(1200, 16.0)
    swinging = Laboratory(
        [EFFECTS["mount_resonance"](level=0.05, frequency_hz=40.0, second_share=0.0)], clean=True
    ).record("stochastic", kick)
    still = Laboratory((), clean=True).record("stochastic", kick)
    ringing = np.abs(np.fft.rfft((swinging.position - still.position)[200:] * np.hanning(1000), 8000))
    assert np.fft.rfftfreq(8000, 5e-4)[50:][ringing[50:].argmax()] == pytest.approx(40.0, rel=0.1)


@pytest.mark.parametrize("extra", ["directional_damping", "recruited_mass"])
def test_the_tissue_resists_motion_relative_to_its_own(extra):
    law = load_preset("left-anterior-forearm").with_extras([extra]).to_array()
    state = np.zeros(kernel.STATE_SIZE)

    def resistance(speed):
        return kernel.tissue_resistance(state, law, 0.003, speed)[0]

    law[kernel.REST_VELOCITY] = 0.03
    carried = [resistance(speed) for speed in (0.03, 0.05, 0.01)]
    law[kernel.REST_VELOCITY] = 0.0
    assert carried == pytest.approx([resistance(speed) for speed in (0.0, 0.02, -0.02)])
    assert carried[1] != carried[0]


def test_readings_of_position():
    true = recorded()
    play = recorded([EFFECTS["sensor_backlash"](level=6e-5)])
    assert np.abs(play.position - true.position).max() == pytest.approx(3e-5, rel=1e-6)
    coarse = recorded([EFFECTS["quantization"](level=4e-5)]).position / 4e-5
    np.testing.assert_allclose(coarse, np.rint(coarse), atol=1e-6)
    late = recorded([EFFECTS["clock_skew"](level=1e-9, offset_s=5e-4)])
    np.testing.assert_allclose(late.position[1:], true.position[:-1], atol=1e-9)


@pytest.mark.parametrize("channels", ["all", "position"])
def test_a_record_moves_up_where_samples_are_lost(channels):
    lossy = EFFECTS["dropped_samples"](level=10.0, channels=channels)
    short, true = recorded([lossy]), recorded()
    lost = int(np.isnan(short.position).sum())
    assert lost > 0
    assert np.all(np.isnan(short.position[-lost:]))
    assert set(short.position[:-lost]) <= set(true.position)
    assert np.array_equal(short.current, true.current) is (channels == "position")
    np.testing.assert_array_equal(short.command, true.command)


def test_hum_has_the_mains_frequencies_only():
    quiet = Laboratory([EFFECTS["mains_hum"](level=0.1, sixty=True)], clean=True).record("quiet", np.zeros(2000))
    power = np.abs(np.fft.rfft(quiet.voltage)) ** 2
    assert power[[60, 180, 300]].sum() == pytest.approx(power.sum(), rel=1e-6)
    assert 1e-6 < np.std(quiet.position) < np.std(quiet.current) < np.std(quiet.voltage)


STEEP = ["dry_friction", "directional_friction", "end_stop", "eddy_currents", "inductance_position", "mount_resonance"]


@pytest.mark.parametrize("name", [*STEEP, "viscoelasticity", "added_mass", "flux_saturation", "amplifier_lag"])
def test_finer_steps_change_nothing_that_is_seen(name):
    rough, fine = recorded([typical(name)]), recorded([typical(name)], substeps=80)
    assert change(rough, fine, "position") < 4e-3
    assert change(rough, fine, "current") < 1e-2


@pytest.mark.parametrize("name", ROWS)
def test_whatever_is_drawn_can_be_played(name):
    around = DrawConditions(FIGURES.surface_m, FIGURES.depth_m, 5e-4, FIGURES.mean_v, FIGURES.spread_v)
    for seed in range(40):
        drawn = EFFECTS[name].draw(np.random.default_rng(seed), around)
        assert drawn.acts
        assert drawn.row().size <= WIDTH
        assert EFFECTS[name].draw(np.random.default_rng(seed), around) == drawn
        if seed < 3:
            whole = Laboratory([drawn], clean=True).record("stochastic", played(FIGURES.mean_v, 0.25))
            assert np.nanmax(np.abs(whole.position)) < 0.1


# -- bench and scenario -------------------------------------------------------------------------------------------


def test_a_scenario_file_names_effects(tmp_path):
    path = tmp_path / "scenario.toml"
    text = "[effects.dry_friction]\nlevel = 0.3\n[effects.mains_hum]\nlevel = 0.1\nsixty = true\n"
    path.write_text('preset = "calibration-spring"\n' + text)
    scenario = load_scenario(path)
    assert scenario.acting == (EFFECTS["dry_friction"](level=0.3), EFFECTS["mains_hum"](level=0.1, sixty=True))
    commands = played(0.0, 0.2)
    with_them, without = scenario.bench(), Bench("calibration-spring")
    one, other = (bench.block(commands, energised=True).codes for bench in (with_them, without))
    assert np.std(one[:, 3] - other[:, 3]) > 10  # half micrometres of position
    assert np.std(one[:, 1] - other[:, 1]) > 20  # volts: the hum


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[effects.magic]\nlevel = 1.0\n", "no 'magic'"),
        ("[effects.dry_friction]\nlevel = -1.0\n", "dry_friction.level"),
        ("[effects.dry_friction]\nlevel = nan\n", "dry_friction.level"),
        ("[effects.dry_friction]\n", "dry_friction.level"),
        ("[effects.dry_friction]\nlevel = 0.1\nloudness = 3\n", "loudness"),
        ('[effects.end_stop]\nlevel = 1.0\nside = "up"\n', "end_stop.side"),
        ("[effects]\ndry_friction = 1\n", "effects"),
    ],
)
def test_a_scenario_file_with_nonsense_is_refused_in_one_line(tmp_path, text, words):
    path = tmp_path / "scenario.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=words) as caught:
        load_scenario(path)
    assert "\n" not in str(caught.value)


def test_effects_that_an_instrument_cannot_have_are_refused():
    with pytest.raises(ValueError, match="for the laboratory"):
        Bench("linear-demo", effects=[typical("dropped_samples")])
    with pytest.raises(ValueError, match="linear or dpn, not wiener"):
        Bench("wiener-demo", effects=[typical("reflex")])
    with pytest.raises(ValueError, match="given twice"):
        in_order([typical("cogging"), typical("cogging")])
    with pytest.raises(ValueError, match="no 'magic'"):
        read_effects({"magic": {"level": 1.0}})


@pytest.mark.parametrize("names", [("dry_friction", "viscoelasticity", "latency"), ("quantization", "clock_skew")])
def test_a_bench_with_effects_plays_the_same_however_it_is_cut(names):
    effects = [typical(name) for name in names]
    commands = played(6.0, 0.2)
    whole = Bench("left-posterior-forearm", 5, effects=effects).block(commands, energised=True)
    bench = Bench("left-posterior-forearm", 5, effects=effects)
    first = bench.block(commands[:123], energised=True)
    kept = bench.snapshot()
    second = bench.block(commands[123:], energised=True)
    np.testing.assert_array_equal(whole.codes, np.concatenate([first.codes, second.codes]))
    bench.restore(kept)
    np.testing.assert_array_equal(bench.block(commands[123:], energised=True).codes, second.codes)
    bench.reset()
    np.testing.assert_array_equal(bench.block(commands, energised=True).codes, whole.codes)


def test_effects_cost_little_and_nothing_where_there_are_none(monkeypatch):
    def taken(bench):
        bench.block(np.zeros(20), energised=True)
        start = time.process_time()
        bench.block(played(6.0, 1.0), energised=True)
        return time.process_time() - start

    assert taken(Bench("left-posterior-forearm", effects=[typical(n) for n in ("dry_friction", "latency")])) < 1.0
    monkeypatch.setattr(ActiveEffects, "advance", lambda *_: pytest.fail("the loop with effects was played"))
    assert taken(Bench("left-posterior-forearm", effects=[EFFECTS["cogging"](level=0.0)])) < 1.0


def test_the_arrays_are_large_enough():
    assert kernel.PROFILE == 20
    assert RING_LENGTH > 0.2 / (1 / 2000 / 20)
    assert max(kind(level=kind.typical).row().size for kind in EFFECTS.values()) <= WIDTH
