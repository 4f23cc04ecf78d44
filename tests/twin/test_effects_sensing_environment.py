"""Effects of sensors and surroundings, compared with independent computations."""

import math
import tracemalloc

import numpy as np
import pytest
from scipy import integrate, signal
from scipy.interpolate import CubicHermiteSpline

from tissueid.twin import bus, chain_parameters, simulation
from tissueid.twin.catalogue import effect
from tissueid.twin.effect import Effect, Parameter, Readings

RATE = 2000.0
SURFACE = 0.0095
TISSUE = chain_parameters.Tissue(SURFACE, 0.02, 5.0, 150.0, 450.0, 200.0)
SENSING = ("sensor_nonlinearity", "sensor_lag", "sensor_backlash", "clock_skew", "quantization")
NOISE = {"voltage": 2e-3, "current": 0.95e-3, "position": 1.9e-6}


def readings(position, rate=RATE):
    position = np.asarray(position, np.float64)
    time = np.arange(1, position.size + 1) / rate
    return Readings(time, np.zeros(position.size), np.zeros(position.size), position, rate)


def recorded(name, position, *values):
    one = effect(name)
    return one.recording(readings(position), np.array(values, np.float64)).position


def stochastic(seed=0, size=9000):
    rng = np.random.default_rng(seed)
    noise = np.convolve(rng.uniform(-1.0, 1.0, size + 8), np.ones(8) / 8.0, "valid")[:size]
    return np.where(np.arange(size) < 500, 15.0, 15.0 + 20.0 * noise)


def triangle(size=9000):
    return 15.0 + 9.0 * 2.0 / math.pi * np.arcsin(np.sin(2.0 * np.pi * np.arange(size) / 8000.0))


def played(command, seed=1, acting=(), **given):
    """Return a test with noise, and the clean simulation of the baseline."""
    start = simulation.Start(command[0] / 12.0, SURFACE)
    instrument = chain_parameters.InstrumentParameters(weight_n=0.1)
    clean = simulation.simulate(command, RATE, instrument, TISSUE, start, acting, **given).readings
    rng = np.random.default_rng(seed)
    signals = {name: getattr(clean, name) + std * rng.normal(size=command.size) for name, std in NOISE.items()}
    return {"command": command, **signals}, clean


def with_prediction(signals, clean):
    return signals | {f"predicted_{name}": getattr(clean, name) for name in NOISE}


def slipped(values, slips):
    """Remove ``lost`` samples before sample ``at`` of the record; the end is missing."""
    left = list(values)
    for at, lost in slips:
        del left[at : at + lost]
    return np.array(left + [np.nan] * (len(values) - len(left)))


def slips_in(found):
    pairs = [(found[f"slip_{k}_sample"], found[f"slip_{k}_lost"]) for k in range(1, 25)]
    return [(int(at), int(lost)) for at, lost in pairs if lost]


@pytest.mark.parametrize("name", SENSING)
def test_sensing_leaves_voltage_and_current_as_they_were(name):
    one = effect(name)
    _, plain = played(stochastic(size=1500))
    for start in one.starts:
        _, there = played(stochastic(size=1500), acting=[simulation.ActiveEffect(one, np.array(start))])
        np.testing.assert_array_equal(there.voltage, plain.voltage)
        np.testing.assert_array_equal(there.current, plain.current)


@pytest.mark.parametrize(("delay", "second"), [(2e-4, 0.05), (1e-3, 0.25), (4e-3, 0.5), (2e-2, 1.2)])
def test_sensor_lag_is_the_filter_of_its_equation(delay, second):
    def position(t):
        return 1e-3 * (np.sin(2 * np.pi * 11.0 * t) + 0.4 * np.sin(2 * np.pi * 37.0 * t)) * (1.0 - np.exp(-t / 0.01))

    time = np.arange(1, 201) / RATE
    exact = integrate.solve_ivp(
        lambda t, y: (y[1], (position(t) - y[0] - delay * y[1]) / (second * delay * delay)),
        (0.0, time[-1]),
        (0.0, 0.0),
        method="Radau",
        t_eval=time,
        rtol=1e-6,
        atol=1e-11,
    ).y[0]
    ours = recorded("sensor_lag", position(time), delay, second, 0.0)
    assert np.abs(ours - exact).max() < 0.006 * np.abs(position(time)).max()


def test_sensor_lag_of_dead_time_alone_only_shifts():
    time = np.arange(1, 1201) / RATE
    ours = recorded("sensor_lag", np.sin(2 * np.pi * 10.0 * time), 4e-3, 0.3, 0.8)
    whole = recorded("sensor_lag", np.sin(2 * np.pi * 10.0 * (time - 3.2e-3)), 8e-4, 0.3, 0.0)
    assert np.abs(ours - whole)[100:].max() < 1e-4


def test_sensor_lag_keeps_what_stands_still():
    np.testing.assert_allclose(recorded("sensor_lag", np.full(300, 0.0123), 5e-3, 0.5, 0.2), 0.0123, rtol=1e-12)


def test_clock_skew_reads_the_position_of_another_time():
    time = np.arange(1, 9001) / RATE

    def position(t):
        return 1e-3 * np.sin(2 * np.pi * 23.0 * t) + 3e-4 * np.cos(2 * np.pi * 71.0 * t)

    other = time + 3.3e-4 + 2e-3 * time - 1e-4 * time**2
    ours = recorded("clock_skew", position(time), 3.3e-4, 2e-3, -2e-4)
    inside = other < time[-1]
    assert np.abs(ours - position(other))[inside].max() < 2e-6
    np.testing.assert_allclose(ours[~inside], position(time[-1]), rtol=1e-9)


def test_backlash_stands_still_until_the_play_is_taken_up():
    play = 4e-5
    down_and_up = np.concatenate((np.linspace(0, 5e-4, 300), np.linspace(5e-4, 0, 300), np.linspace(0, 5e-4, 300)))
    ours = recorded("sensor_backlash", down_and_up, play, 0.0, 0.0)
    np.testing.assert_allclose(ours[100:300], down_and_up[100:300] - play, atol=1e-12)
    np.testing.assert_allclose(ours[400:600], down_and_up[400:600] + play, atol=1e-12)
    still = (down_and_up[300:360] > 5e-4 - 2 * play).sum()
    assert still > 10
    assert np.ptp(ours[300 : 300 + still]) == 0.0


def test_backlash_is_the_same_however_fast_and_rounded_without_leaving_the_play():
    path = 1e-4 * np.cumsum(np.random.default_rng(3).normal(size=400))
    slow = np.interp(np.arange(0, 399, 0.1), np.arange(400), path)
    for rounding in (0.0, 0.5, 1.2):
        ours = recorded("sensor_backlash", path, 1e-4, rounding, 0.3)
        again = recorded("sensor_backlash", slow, 1e-4, rounding, 0.3)
        np.testing.assert_allclose(again[::10], ours[:-1], atol=1e-12)
        assert np.abs(ours - path).max() <= 1e-4 * (1 + 1e-9)


@pytest.mark.parametrize("blur", [0.02, 0.15, 0.4, 0.9])
@pytest.mark.parametrize("threshold", [0.0, -0.5])
def test_quantization_is_the_mean_of_rounded_readings_and_knows_their_spread(blur, threshold):
    step, origin = 5e-5, 1.3e-5
    exact = 0.01 + np.linspace(0.0, 4.0 * step, 160, endpoint=False)
    noise = np.random.default_rng(4).normal(size=(20000, 1)) * blur * step
    turn = np.floor if threshold else np.round
    drawn = origin + step * turn((exact + noise - origin) / step)
    ours = recorded("quantization", exact, step, origin, threshold, blur)
    assert np.abs(ours - drawn.mean(axis=0)).max() < 5.0 * step * max(blur, 0.5) / np.sqrt(20000)
    # Variance of the residual in addition to the noise; rounding can also remove noise.
    left = effect("quantization").irreducible(np.array([step, origin, threshold, blur]))
    assert left["position"] <= step / np.sqrt(12.0)
    spread = np.mean(drawn.var(axis=0)) - (blur * step) ** 2
    assert left["position"] ** 2 == pytest.approx(max(spread, 0.0), abs=0.01 * step**2)


@pytest.mark.parametrize("step", [6.2499e-5, 1e-5, 3e-6])
def test_quantization_reads_its_grid_off_the_record(step):
    signals, _ = played(stochastic())
    coarse = np.round((signals["position"] - 2e-6) / step) * step + 2e-6
    coarse[2000:2010] = np.nan
    found = effect("quantization").estimate_from_record({"position": coarse.astype(np.float32).astype(float)}, RATE)
    assert found["step_m"] == pytest.approx(step, rel=2e-4)
    off = (found["origin_m"] - 2e-6) / step
    assert abs(off - round(off)) < 0.1
    rough = recorded("quantization", signals["position"], found["step_m"], found["origin_m"], 0.0, 0.01)
    assert np.nanstd(rough - coarse) < 0.12 * step


def test_no_grid_is_found_where_there_is_none():
    signals, _ = played(stochastic())
    for fine in (signals["position"], np.round(signals["position"] / 4.88e-7) * 4.88e-7, np.full(500, np.nan)):
        assert effect("quantization").estimate_from_record({"position": fine}, RATE)["step_m"] == 5e-7


@pytest.mark.parametrize("command", [stochastic(), triangle()], ids=["stochastic", "ramp"])
def test_losses_of_the_record_are_exact(command):
    true = [(1207, 1), (2600, 7), (5000, 2), (8100, 5)] if np.ptp(np.diff(command)) > 1.0 else [(2300, 7), (6900, 4)]
    signals, _ = played(0.99 * command)
    signals = {name: slipped(values, true) for name, values in signals.items()} | {"command": command}
    found = effect("dropped_samples").estimate_from_record(signals, RATE)
    assert found["position_alone"] == 0.0
    assert [lost for _, lost in slips_in(found)] == [lost for _, lost in true]
    near = 1 if np.ptp(np.diff(command)) > 1.0 else 6
    assert all(abs(ours - at) < near for (ours, _), (at, _) in zip(slips_in(found), true, strict=True))


def test_a_rise_at_the_start_with_another_gain_is_no_loss():
    command = stochastic()
    command[:50] = command[500] * np.sin(np.linspace(0.0, 0.5 * np.pi, 50)) ** 2
    signals, _ = played(command - 0.004 * command**2)
    true = [(2300, 1), (5000, 3), (8100, 5)]
    signals = {name: slipped(values, true) for name, values in signals.items()} | {"command": command}
    found = slips_in(effect("dropped_samples").estimate_from_record(signals, RATE))
    assert [lost for _, lost in found] == [1, 3, 5]
    assert all(abs(ours - at) < 3 for (ours, _), (at, _) in zip(found, true, strict=True))


def test_losses_during_a_constant_command_are_placed_in_its_middle():
    command = np.r_[np.full(1000, 14.0), stochastic()[1000:]]
    signals, _ = played(command)
    signals = {name: slipped(values, [(400, 2), (5000, 1)]) for name, values in signals.items()} | {"command": command}
    (still, lost), later = slips_in(effect("dropped_samples").estimate_from_record(signals, RATE))
    assert 300 < still < 700
    assert lost == 2
    assert later == (5000, 1)


@pytest.mark.parametrize("slips", [[(7500, 1)], [(9000, 0)], [(8998, 2)]], ids=["lost", "complete", "ends early"])
def test_a_late_loss_behind_a_slow_amplifier_shows_by_what_is_missing_at_the_end(slips):
    command = stochastic()
    late = signal.lfilter([0.55], [1.0, -0.45], command, zi=[0.45 * command[0]])[0]
    signals, _ = played(late)
    signals = {name: slipped(values, slips) for name, values in signals.items()} | {"command": command}
    found = slips_in(effect("dropped_samples").estimate_from_record(signals, RATE))
    assert found == (slips if slips[0][0] < 8000 else [])


def test_losses_of_the_position_are_found_by_the_back_emf():
    signals, _ = played(stochastic())
    true = [(1500, 3), (4000, 1), (6768, 8)]
    signals["position"] = slipped(signals["position"], true)
    found = effect("dropped_samples").estimate_from_record(signals, RATE)
    assert found["position_alone"] == 1.0
    assert [lost for _, lost in slips_in(found)] == [3, 1, 8]
    assert all(abs(ours - at) < 25 for (ours, _), (at, _) in zip(slips_in(found), true, strict=True))


@pytest.mark.parametrize("command", [stochastic(), triangle()], ids=["stochastic", "ramp"])
def test_losses_of_the_position_are_exact_with_a_prediction(command):
    signals, clean = played(command)
    moving = command.size == 9000 and np.ptp(np.diff(command)) > 1.0
    true = [(1500, 3), (4000, 1), (6768, 8)] if moving else [(2500, 9), (6800, 6)]
    signals["position"] = slipped(signals["position"], true)
    found = slips_in(effect("dropped_samples").estimate_from_record(with_prediction(signals, clean), RATE))
    assert [lost for _, lost in found] == [lost for _, lost in true]
    assert all(abs(ours - at) < (3 if moving else 120) for (ours, _), (at, _) in zip(found, true, strict=True))


def test_losses_are_limited_to_the_searched_range():
    signals, _ = played(stochastic())
    signals["position"][4000:] = np.nan
    tracemalloc.start()
    try:
        assert slips_in(effect("dropped_samples").estimate_from_record(signals, RATE)) == []
        assert (
            tracemalloc.get_traced_memory()[1] < 150e6
        )  # a table of lags as wide as what is missing is ten times that
    finally:
        tracemalloc.stop()


def test_filters_and_delays_are_not_losses():
    signals, clean = played(stochastic())
    lagging = effect("sensor_lag").recording(clean, np.array([3e-3, 0.4, 0.0])).position
    late = np.r_[np.full(3, signals["voltage"][0]), signals["voltage"][:-3]]
    for changed in ({}, {"position": lagging + 1.9e-6 * np.random.default_rng(7).normal(size=9000)}, {"voltage": late}):
        changed = signals | changed
        if "voltage" in changed and changed["voltage"] is late:
            changed["current"] = np.r_[np.full(3, signals["current"][0]), signals["current"][:-3]]
            changed["position"] = np.r_[np.full(3, signals["position"][0]), signals["position"][:-3]]
        assert slips_in(effect("dropped_samples").estimate_from_record(changed, RATE)) == []


def test_lost_samples_bring_what_comes_after_forward():
    one = effect("dropped_samples")
    _, clean = played(stochastic(size=1000))
    values = np.zeros(len(one.parameters))
    values[1:5] = 400, 3, 700, 5
    for alone in (0.0, 1.0):
        values[0] = alone
        there = one.recording(clean, values)
        for name in NOISE:
            expected = slipped(getattr(clean, name), [(400, 3), (700, 5)])
            expected = getattr(clean, name) if alone and name != "position" else expected
            known = np.isfinite(expected)
            np.testing.assert_array_equal(getattr(there, name)[known], expected[known])


def test_sensor_nonlinearity_finds_a_wave_along_the_stroke():
    signals, clean = played(stochastic())
    signals["position"] = signals["position"] + 1.5e-5 * np.sin(2 * np.pi * clean.position / 7.3e-4 + 1.0)
    one = effect("sensor_nonlinearity")
    bowed, start = one.starts_from([with_prediction(signals, clean)], RATE)
    assert bowed[:2] == start[:2] == pytest.approx(np.quantile(signals["position"], [0.002, 0.998]), rel=1e-6)
    assert start[-1] == pytest.approx(7.3e-4, rel=0.02)
    after = one.recording(clean, np.array(start)).position - signals["position"]
    assert np.std(after[600:]) < 0.3 * 1.5e-5 / np.sqrt(2)
    assert one.starts_from([{"position": np.full(50, np.nan), "voltage": np.zeros(50)}], RATE) == ()


def test_sensor_nonlinearity_is_a_function_of_position_alone():
    errors = 1e-5 * np.array([0.0, 1.0, 3.0, 2.0, 0.0, -1.0, -2.0, -2.0, 0.0, 1.0, 1.0, 3.0, 4.0])
    places = np.linspace(0.006, 0.018, 13)
    at = np.array([0.012, 0.0165, 0.007, 0.003, 0.025])
    wave = 2 * np.pi * (at - 0.012) / 5e-3
    expected = CubicHermiteSpline(places, errors, np.gradient(errors, places))(np.clip(at, 0.006, 0.018))
    expected += 4e-6 * np.cos(wave) - 1e-6 * np.cos(2 * wave)
    ours = recorded("sensor_nonlinearity", at, 0.006, 0.018, *errors, 4e-6, 0.0, -1e-6, 0.0, 5e-3)
    np.testing.assert_allclose(ours - at, expected, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("hertz", [49.96, 60.05])
@pytest.mark.parametrize("predicted", [True, False])
def test_hum_is_found_in_each_test_and_its_quadratures_are_the_same_in_all(hertz, predicted):
    one = effect("mains_hum")
    names = [parameter.name for parameter in one.parameters]
    # The two tests differ only by the phases of the mains, which estimate_from_record has to find.
    turned = []
    for seed, at in ((1, 0.7), (2, 2.9)):
        signals, clean = played(stochastic(seed), seed)
        wave = 2 * np.pi * hertz * clean.time + at
        signals["voltage"] = signals["voltage"] + 0.05 * np.cos(wave) + 0.02 * np.sin(3 * wave)
        signals["position"] = signals["position"] + 2e-5 * np.sin(wave)
        found = one.estimate_from_record(with_prediction(signals, clean) if predicted else signals, RATE)
        assert found["frequency_hz"] == pytest.approx(hertz, abs=0.004 if predicted else 0.02)
        turned.append((found["phase_1_rad"] - at, found["phase_3_rad"] - 3 * at))
    apart = np.angle(np.exp(1j * (np.array(turned[0]) - np.array(turned[1]))))
    assert np.abs(apart).max() < (0.05 if predicted else 0.5)
    values = dict.fromkeys(names, 0.0) | found | {"voltage_cosine_1": 0.03, "position_sine_2": 1e-5}
    there = one.recording(clean, np.array([values[name] for name in names]))
    angle = 2 * np.pi * found["frequency_hz"] * clean.time
    np.testing.assert_allclose(there.voltage - clean.voltage, 0.03 * np.cos(angle + found["phase_1_rad"]), atol=1e-12)
    sine = 1e-5 * np.sin(2 * angle + found["phase_2_rad"])
    np.testing.assert_allclose(there.position - clean.position, sine, atol=1e-12)
    np.testing.assert_array_equal(there.current, clean.current)


def test_the_probe_follows_a_surface_that_moves_slowly_and_not_on_the_spring():
    one = effect("physiological_motion")
    names = [parameter.name for parameter in one.parameters]
    values = dict(zip(names, one.starts[0], strict=True)) | {"breathing_sine_1_m": 5e-4, "pulse_cosine_3_m": 2e-5}
    acting = [simulation.ActiveEffect(one, np.array([values[name] for name in names]))]
    command = np.full(6000, 15.0)
    _, plain = played(command)
    _, there = played(command, acting=acting)
    surface = 5e-4 * np.sin(2 * np.pi * 0.25 * plain.time) + 2e-5 * np.cos(2 * np.pi * 3.6 * plain.time)
    assert np.std((there.position - plain.position - surface)[1000:]) < 0.05 * np.std(surface)
    assert np.abs(there.current - plain.current).max() < 2e-3
    np.testing.assert_array_equal(there.voltage, plain.voltage)
    _, spring = played(command, on_tissue=False)
    _, spring_too = played(command, acting=acting, on_tissue=False)
    np.testing.assert_array_equal(spring_too.position, spring.position)


def test_moving_surface_is_that_of_its_equation():
    one = effect("physiological_motion")
    names = [parameter.name for parameter in one.parameters]
    random = np.random.default_rng(5)
    values = {name: 1e-4 * random.normal() for name in names} | dict(zip(names, one.starts[0][:6], strict=False))
    values |= {"pulse_sway_cosine_rad": 0.3, "pulse_sway_sine_rad": -0.4}
    parameters = np.array([values[name] for name in names])
    numbers, state, step = np.zeros(bus.MOST_STATES), np.zeros(bus.MOST_STATES), 1e-4
    for k in range(41001):
        numbers[bus.TIME], numbers[bus.SURFACE_POSITION], numbers[bus.SURFACE_VELOCITY] = k * step, SURFACE, 0.0
        one.hook(bus.SURFACE, numbers, parameters, state, step)
        if k in (0, 3700, 41000):
            expected = SURFACE + moved_surface(values, (k + 0.5) * step)
            assert numbers[bus.SURFACE_POSITION] == pytest.approx(expected, rel=1e-10)
            near = [moved_surface(values, (k + share) * step) for share in (0.49, 0.51)]
            assert numbers[bus.SURFACE_VELOCITY] == pytest.approx((near[1] - near[0]) / (0.02 * step), rel=1e-6)


def moved_surface(values, time):
    """Return the motion of the surface by the equation of ``physiological_motion``, m."""
    breath = 2 * np.pi * values["breathing_hz"] * time
    beat = 2 * np.pi * values["pulse_hz"] * time
    beat += values["pulse_sway_cosine_rad"] * np.cos(breath) + values["pulse_sway_sine_rad"] * np.sin(breath)
    angles = {f"breathing_{{}}_{h}_m": h * breath for h in (1, 2, 3)}
    angles |= {f"pulse_{{}}_{h}_m": h * beat for h in (1, 2, 3, 4, 5)}
    for line in (1, 2, 3, 4, 5):
        hertz = values["tremor_hz"] + (line - 3) * values["tremor_spacing_hz"]
        angles[f"tremor_{{}}_{line}_m"] = 2 * np.pi * hertz * time
    waves = (
        values[name.format("cosine")] * np.cos(angle) + values[name.format("sine")] * np.sin(angle)
        for name, angle in angles.items()
    )
    return values["mean_m"] + sum(waves)


def test_breathing_pulse_and_tremor_are_read_off_the_record():
    signals, clean = played(stochastic())
    time = clean.time
    pulse = 6e-5 * np.exp(-((((1.15 * time + 0.2) % 1.0 - 0.3) / 0.12) ** 2))
    moved = 3e-4 * np.sin(2 * np.pi * 0.31 * time + 1.0) + pulse + 2e-5 * np.sin(2 * np.pi * 9.6 * time)
    signals["position"] = signals["position"] + moved
    (found,) = effect("physiological_motion").estimate_from_records([with_prediction(signals, clean)], RATE)
    assert found["breathing_hz"] == pytest.approx(0.31, abs=0.05)
    assert found["pulse_hz"] == pytest.approx(1.15, abs=0.05)
    assert found["tremor_hz"] == pytest.approx(9.6, abs=0.05)
    left = moved - moved.mean() - [moved_surface(found, at) - found["mean_m"] for at in time]
    assert np.std(left[600:]) < 0.1 * np.std(moved)
    assert set(found) == {parameter.name for parameter in effect("physiological_motion").parameters}


def test_breathing_hurries_and_slows_the_pulse():
    signals, clean = played(stochastic())
    values = dict.fromkeys((parameter.name for parameter in effect("physiological_motion").parameters), 0.0)
    values |= {"breathing_hz": 0.29, "pulse_hz": 1.25, "breathing_cosine_1_m": 1e-4, "pulse_sway_sine_rad": 0.6}
    values |= {"pulse_cosine_1_m": 2e-5, "pulse_cosine_2_m": 1.5e-5, "pulse_sine_3_m": 1e-5, "pulse_cosine_4_m": 5e-6}
    moved = np.array([moved_surface(values, at) for at in clean.time])
    signals["position"] = signals["position"] + moved
    (found,) = effect("physiological_motion").estimate_from_records([with_prediction(signals, clean)], RATE)
    assert found["pulse_hz"] == pytest.approx(1.25, abs=0.05)
    assert found["pulse_sway_sine_rad"] == pytest.approx(0.6, abs=0.25)
    left = moved - moved.mean() - [moved_surface(found, at) - found["mean_m"] for at in clean.time]
    assert np.std(left[600:]) < 3e-6


def test_rates_are_those_of_all_tests_and_heights_those_of_each():
    quiet, still = played(np.full(9000, 14.0))
    signals, clean = played(stochastic())
    tests = []
    for (recorded_, met), phase, mean in (((quiet, still), 0.3, 0.0), ((signals, clean), 2.1, 2e-4)):
        sways = 1e-4 * np.sin(2 * np.pi * 0.27 * met.time + phase) + 1e-5 * np.cos(2 * np.pi * 1.31 * met.time + phase)
        tests.append(with_prediction(recorded_ | {"position": recorded_["position"] + sways + mean}, met))
    both = effect("physiological_motion").estimate_from_records(tests, RATE)
    for found, mean in zip(both, (0.0, 2e-4), strict=True):
        assert found["breathing_hz"] == pytest.approx(0.27, abs=0.02)
        assert found["pulse_hz"] == pytest.approx(1.31, abs=0.05)
        assert found["mean_m"] == pytest.approx(mean, abs=3e-5)
        assert math.hypot(found["breathing_cosine_1_m"], found["breathing_sine_1_m"]) == pytest.approx(1e-4, rel=0.15)


@pytest.mark.parametrize("name", ["dropped_samples", "quantization", "mains_hum", "physiological_motion"])
@pytest.mark.parametrize("size", [3, 60, 1500])
def test_records_without_anything_in_them_give_values_within_bounds(name, size):
    one = effect(name)
    bounds = {parameter.name: parameter for parameter in one.parameters if parameter.per_test}
    empty, still = np.full(size, np.nan), np.full(size, 0.0121)
    for values in (empty, still):
        signals = {"command": still, "voltage": values, "current": values, "position": values}
        found = (
            one.estimate_from_record(signals, RATE)
            if one.estimate_from_record
            else one.estimate_from_records([signals], RATE)[0]
        )
        assert set(found) == set(bounds)
        assert all(bounds[key].low <= value <= bounds[key].high for key, value in found.items())


def test_only_what_hooks_into_the_chain_is_held_to_its_number_of_parameters():
    many = tuple(Parameter(f"p{k}", "1", 0.0, 0.0, 1.0) for k in range(bus.MOST_PARAMETERS + 1))
    about = ("many", "sensing", "", "", "", "", many, ((0.0,) * len(many),))
    assert Effect(*about, recording=lambda given, values: given).order == len(many)
    with pytest.raises(ValueError, match=f"a hook takes at most {bus.MOST_PARAMETERS} parameters"):
        Effect(*about, places=(bus.SURFACE,), hook=effect("physiological_motion").hook)


def test_fixed_parameters_do_not_count_and_per_test_parameters_count_once():
    assert effect("dropped_samples").order == 0
    assert effect("quantization").order == 2
    assert effect("mains_hum").order == 24
    assert effect("physiological_motion").order == 27
