"""Requirements of every effect of the library."""

import ctypes
import functools
from dataclasses import replace

import numpy as np
import pytest
from coded import coded
from plugged import Plugin, plugged_in

from tissueid.errors import UnusableInputError
from tissueid.twin import bus, chain_parameters, simulation
from tissueid.twin.catalogue import all_effects, effect
from tissueid.twin.effect import STAGES, Effect, Readings, nested

RATE = 2000.0
SURFACE = 0.009
INSTRUMENT = chain_parameters.InstrumentParameters(weight_n=0.2)
TISSUE = chain_parameters.Tissue(SURFACE, 0.015, 5.0, 150.0, 350.0, 250.0)
NOISE = {"voltage": 2e-3, "current": 0.95e-3, "position": 1.9e-6}
EVERY = pytest.mark.parametrize("one", all_effects().values(), ids=lambda one: one.name)


def commands(size=800):
    """Return a command with a mean and smooth noise that also crosses zero."""
    rng = np.random.default_rng(8)
    noise = np.convolve(rng.normal(size=size + 40), np.hanning(9) / 3.0, "same")[40:]
    return np.r_[np.full(60, 14.0), 14.0 + 9.0 * noise[60:]]


def play(acting=(), kind="stochastic", substeps=4):
    """Simulate one of the tests of a session, from rest on the surface."""
    noise = commands() - 14.0
    command = {"stochastic": 14.0 + noise, "shallow": 5.0 + noise, "spring": 0.8 * noise, "quiet": np.zeros(400)}[kind]
    met = chain_parameters.spring(0.012, 1000.0, 0.005, 0.4) if kind == "spring" else TISSUE
    start = simulation.Start(command[0] / INSTRUMENT.resistance_ohm, met.surface_m)
    readings = simulation.simulate(
        command, RATE, INSTRUMENT, met, start, acting, on_tissue=kind != "spring", substeps=substeps
    ).readings
    return {name: getattr(readings, name) for name in NOISE}


@functools.cache
def plain(kind="stochastic", substeps=4):
    return play((), kind, substeps)


def at(one: Effect, values):
    return [simulation.ActiveEffect(one, np.array(values, np.float64))]


def in_noises(one, other):
    """Return the largest root-mean-square difference of any channel, in deviations of its noise."""
    return max(np.sqrt(np.mean((one[name] - other[name]) ** 2)) / NOISE[name] for name in NOISE)


def test_the_library_is_ordered_along_the_chain():
    stages = [STAGES.index(one.stage) for one in all_effects().values()]
    assert stages == sorted(stages)
    assert set(stages) == set(range(len(STAGES)))
    assert all(one.name == name for name, one in all_effects().items())


def test_an_unknown_name_is_refused():
    with pytest.raises(UnusableInputError, check=coded("effect.unknown", name="rust", known=", ".join(all_effects()))):
        effect("rust")


@EVERY
def test_its_declaration_is_complete(one):
    known = set(all_effects())
    for text in (one.title, one.equation, one.signature, one.source, one.remedy):
        assert len(text) > 5
    assert one.mistaken_for
    assert set(one.mistaken_for) <= known - {one.name}
    assert one.needs <= {"command", "voltage", "current", "position"}
    assert len({parameter.name for parameter in one.parameters}) == len(one.parameters)
    assert all(parameter.unit and parameter.meaning for parameter in one.parameters)
    assert any(parameter.neutral is not None for parameter in one.parameters)


@EVERY
def test_its_starts_and_priors_lie_within_its_bounds(one):
    for start in one.starts:
        for parameter, value in zip(one.parameters, start, strict=True):
            assert parameter.low <= value <= parameter.high, parameter.name
    for parameter in one.parameters:
        assert parameter.prior is None or parameter.low <= parameter.prior <= parameter.high, parameter.name
        assert (parameter.prior_std is None) or parameter.prior_std > 0.0


@EVERY
def test_it_leaves_something_in_the_records_at_its_starts(one):
    if one.estimate_from_record or one.estimate_from_records or one.starts_from is not None:
        pytest.skip("where it starts is read from the record")
    kinds = ("stochastic", "shallow", "spring")
    change = max(in_noises(play(at(one, start), kind), plain(kind)) for start in one.starts for kind in kinds)
    quiet = max(in_noises(play(at(one, start), "quiet"), plain("quiet")) for start in one.starts)
    assert max(change, quiet) > 1.0


@EVERY
def test_it_stays_finite_to_the_ends_of_its_ranges(one):
    for k, parameter in enumerate(one.parameters):
        for end in (parameter.low, parameter.high):
            for start in one.starts[:2]:
                values = list(start)
                values[k] = end
                for kind in ("stochastic", "spring"):
                    readings = play(at(one, values), kind)
                    for name, signal in readings.items():
                        assert np.isfinite(signal).all(), (name, parameter.name, end)
                        assert np.abs(signal).max() < 1e4, (name, parameter.name, end)


@EVERY
def test_a_motion_that_diverges_ends_without_a_message(one, capfd):
    command = np.ones(50)
    for values in one.starts[:2]:
        for position, velocity in ((np.nan, 0.0), (np.inf, 0.0), (SURFACE, np.nan), (-1e300, 1e300)):
            start = simulation.Start(0.0, position, velocity)
            found = simulation.simulate(command, RATE, INSTRUMENT, TISSUE, start, at(one, values))
            assert found.readings.position.shape == command.shape
    assert capfd.readouterr() == ("", "")


@EVERY
def test_it_vanishes_at_its_neutral_value(one):
    # A logarithmic parameter is tested at the end of its range, where the effect is negligible.
    ends = {}
    for k, parameter in enumerate(one.parameters):
        if parameter.neutral is not None:
            towards = parameter.high if parameter.neutral > parameter.high else parameter.low
            within = parameter.low <= parameter.neutral <= parameter.high and not parameter.logarithmic
            ends[k] = parameter.neutral if within else towards
    sets = [ends] if one.jointly else [{k: end} for k, end in ends.items()]
    for start in one.starts:
        for chosen in sets:
            values = [chosen.get(k, value) for k, value in enumerate(start)]
            assert in_noises(play(at(one, values)), plain()) < 0.7, (values, start)


@EVERY
def test_ten_times_as_many_steps_change_little(one):
    for start in one.starts:
        for kind in ("stochastic", "spring"):
            coarse, fine = play(at(one, start), kind), play(at(one, start), kind, 40)
            without, without_fine = plain(kind), plain(kind, 40)
            for name in NOISE:
                change, better = coarse[name] - without[name], fine[name] - without_fine[name]
                own, signal = np.sqrt(np.mean(better**2)), np.std(without[name])
                off = np.sqrt(np.mean((change - better) ** 2))
                assert off <= max(2e-3 * own, 5e-4 * signal), (name, kind, start, off / own, off / signal)


def _pointer(values):
    return values.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


@EVERY
def test_the_compiled_hook_is_the_one_that_is_written(one):
    if one.hook is None:
        pytest.skip("it acts on what was recorded alone")
    rng = np.random.default_rng(2)
    steps, step = 400, 1e-3
    time = np.arange(steps) * step
    given = np.zeros((steps, bus.MOST_STATES))
    wave = np.sin(2 * np.pi * 15.0 * time) + 0.3 * np.sin(2 * np.pi * 43.0 * time + 1.0)
    given[:, bus.TIME] = time
    given[:, bus.SAMPLE] = np.arange(steps) // 4
    given[:, bus.VOLTAGE] = 8.0 * np.repeat(wave[::4], 4) + 3.0
    given[:, bus.CURRENT] = 0.7 * wave + 0.2
    given[:, bus.POSITION] = SURFACE + 0.002 + 3e-3 * wave
    given[:, bus.VELOCITY] = np.gradient(given[:, bus.POSITION], step)
    given[:, bus.ACCELERATION] = np.gradient(given[:, bus.VELOCITY], step)
    given[:, bus.SURFACE_POSITION] = SURFACE
    given[:, bus.DEPTH] = given[:, bus.POSITION] - SURFACE
    given[:, bus.STROKE] = 0.032
    for at_, value in (
        (bus.RESISTANCE, 12.0),
        (bus.INDUCTANCE, 1e-3),
        (bus.FORCE_CONSTANT, 3.0),
        (bus.FORCE, 1.0),
        (bus.DAMPING, 3.5),
        (bus.MASS, 0.06),
        (bus.TISSUE_FORCE, 0.8),
        (bus.TISSUE_DAMPING, 5.0),
        (bus.TISSUE_MASS, 0.015),
        (bus.STIFFNESS, 400.0),
        (bus.STIFFNESS_GROWTH, 250.0),
    ):
        given[:, at_] = value * (1.0 + 0.05 * rng.random(steps))
    # A hook with several places is called in their order, step by step.
    places = sorted(one.places)
    where = np.tile(places, steps)
    given = np.repeat(given, len(places), axis=0)
    acts = False
    for start in one.starts:
        parameters = np.zeros(bus.MOST_PARAMETERS)
        parameters[: len(start)] = start
        written, state = given.copy(), np.zeros(bus.MOST_STATES)
        for k in range(where.size):
            one.hook(int(where[k]), written[k], parameters, state, step)
        built, other = given.copy(), np.zeros(bus.MOST_STATES)
        call = simulation.compiled(one.hook).ctypes
        for k in range(where.size):
            call(int(where[k]), _pointer(built[k]), _pointer(parameters), _pointer(other), step)
        np.testing.assert_allclose(built, written, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(other, state, rtol=1e-9, atol=1e-12)
        acts = acts or (written[:, : bus.SIZE] != given[:, : bus.SIZE]).any()
    assert acts or one.estimate_from_record or one.estimate_from_records or one.recording is not None


@EVERY
def test_simulations_are_repeatable(one):
    first, second = play(at(one, one.starts[0])), play(at(one, one.starts[0]))
    for name in NOISE:
        np.testing.assert_array_equal(first[name], second[name])


def test_a_special_case_and_its_general_form_are_nested():
    dry, directional, drag = map(effect, ("dry_friction", "directional_friction", "quadratic_drag"))
    assert nested(dry, directional)
    assert nested(directional, dry)
    assert not nested(dry, drag)
    assert not nested(drag, drag)


def test_bounds_priors_and_starts_scale_with_the_instrument():
    for one in all_effects().values():
        assert one.scaled({"force_constant_n_per_a": 1.0, "stroke_m": 1.0}) == one
    other = {"force_constant_n_per_a": 4.0, "stroke_m": 1.5}
    plain_one, scaled = effect("reluctance_force"), effect("reluctance_force").scaled(other)
    strength, growth = scaled.parameters
    assert (strength.low, strength.high) == (16.0 * plain_one.parameters[0].low, 16.0 * plain_one.parameters[0].high)
    assert growth == plain_one.parameters[1]
    assert scaled.starts == tuple((16.0 * force, growth) for force, growth in plain_one.starts)
    bias = effect("flux_saturation").scaled(other).parameters[-1]
    assert (bias.high, bias.prior, bias.prior_std) == (0.75, 0.0, 0.175)
    assert effect("end_stop").scaled(other).parameters[0].high == pytest.approx(0.051)
    assert effect("latency").scaled(other) is effect("latency")
    with pytest.raises(ValueError, match="scales with one of"):
        replace(plain_one.parameters[0], scales_with=("stroke", 1))


@EVERY
def test_records_of_a_motion_that_diverges_give_no_warning(one):
    time = np.arange(1, 801) / RATE
    for end in (np.inf, -np.inf, np.nan, 1e300):
        signal = np.where(time < 0.2, 0.01, end)
        for start in one.starts[:2]:
            found = simulation.recorded(Readings(time, signal, signal, signal, RATE), at(one, start))
            assert found.position.shape == time.shape


@pytest.mark.parametrize("values", [{"name": 5}, {"name": "\x1b[31m"}, {"title": None}, {"parameters": ("x",)}])
def test_a_declaration_of_other_content_is_refused(values):
    with pytest.raises(ValueError, match="effect "):
        replace(effect("dry_friction"), **values)


def test_effects_of_plugins_that_cannot_be_used_are_left_out():
    new = replace(effect("dry_friction"), name="new_friction")
    contents = {"good": new, "twice": new, "number": 5, "ours": effect("sensor_lag"), "exits": SystemExit(3)}
    installed = [Plugin(name, loaded) for name, loaded in contents.items()]
    with plugged_in("tissueid.effects", installed), pytest.warns(UserWarning, match="was left out") as seen:
        found = all_effects.__wrapped__()
    assert set(found) - set(all_effects()) == {"new_friction"}
    assert len(seen) == len(contents) - 1
