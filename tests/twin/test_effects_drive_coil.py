"""Effects of drive and coil, compared with independent solutions of their equations."""

import math

import numpy as np
import pytest
from scipy import signal
from scipy.interpolate import CubicHermiteSpline

from tissueid.twin import chain_parameters, simulation
from tissueid.twin.catalogue import all_effects

RATE = 2000.0
NOISE = {"voltage": 2e-3, "current": 0.95e-3, "position": 1.9e-6}
PLAIN = chain_parameters.InstrumentParameters(weight_n=0.0)
BLOCKED = chain_parameters.InstrumentParameters(weight_n=0.0, force_constant_n_per_a=1e-12)
"""Without force constant there is no back-EMF."""
TISSUE = chain_parameters.Tissue(0.009, 0.015, 5.0, 150.0, 350.0, 250.0)
DRIVE = ("latency", "amplifier_lag", "amplifier_clipping", "amplifier_deadband", "amplifier_drift")


def commands(size=1200, mean=14.0, seed=3):
    noise = np.random.default_rng(seed).uniform(-1.0, 1.0, size)
    return np.r_[np.full(50, mean), mean + 12.0 * np.convolve(noise, np.ones(4) / 2.0, "same")[50:]]


def play(name=None, values=(), command=None, instrument=PLAIN, met=TISSUE, rate=RATE, **more):
    command = commands() if command is None else command
    acting = [] if name is None else [simulation.ActiveEffect(all_effects()[name], np.array(values, float))]
    start = simulation.Start(command[0] / instrument.resistance_ohm, met.surface_m)
    return simulation.simulate(command, rate, instrument, met, start, acting, **more).readings


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def settled(name, values, volts, stiffness=1000.0):
    """Return the position from the rest of the spring, and the current, at equilibrium."""
    readings = play(name, values, np.full(3000, float(volts)), met=chain_parameters.spring(0.012, stiffness, 0.0, 20.0))
    return readings.position[-1] - 0.012, readings.current[-1]


# Signals in which they show.


@pytest.mark.parametrize("name", DRIVE)
def test_faults_of_the_drive_are_gone_once_the_measured_voltage_is_given(name):
    start = all_effects()[name].starts[-1]
    faulty, plain = play(name, start), play()
    assert rms(faulty.voltage - plain.voltage) > 5 * NOISE["voltage"]
    given = simulation.MeasuredSignals(voltage=faulty.voltage)
    np.testing.assert_array_equal(play(name, start, given=given).current, play(given=given).current)


@pytest.mark.parametrize(
    ("name", "values", "channel"),
    [
        ("eddy_currents", (5e-4, 4.0, 0.3, 0.1), "current"),
        ("coil_heating", (5.0, 0.7), "current"),
        ("inductance_position", (0.008, 0.013, 0.0, 0.2, 0.4, 1.0, 3.0, 6.0), "current"),
        ("force_constant_position", (0.008, 0.020, 1.0, 0.98, 0.95, 0.9, 0.8, 0.7, 0.6), "position"),
        ("flux_saturation", (0.04, 2.0, 1.0, 0.0), "position"),
        ("reluctance_force", (0.05, 0.0), "position"),
    ],
)
def test_faults_of_the_coil_leave_the_voltage_alone(name, values, channel):
    faulty, plain = play(name, values), play()
    np.testing.assert_array_equal(faulty.voltage, plain.voltage)
    changes = {of: rms(getattr(faulty, of) - getattr(plain, of)) / np.std(getattr(plain, of)) for of in NOISE}
    assert changes[channel] * np.std(getattr(plain, channel)) > 3 * NOISE[channel]
    if channel == "position":
        assert changes["position"] > 3.0 * changes["current"]


def test_a_force_alone_leaves_the_current_of_a_given_motion_alone():
    position = 0.011 + 5e-4 * np.sin(2 * np.pi * 20.0 * np.arange(1200) / RATE)
    given = simulation.MeasuredSignals(position=position, velocity=np.gradient(position) * RATE)
    plain = play(given=given)
    np.testing.assert_array_equal(play("reluctance_force", (0.1, 0.0), given=given).current, plain.current)
    changed = play("flux_saturation", (0.1, 2.0, 1.0, 0.0), given=given).current
    assert rms(changed - plain.current) > NOISE["current"]


# Drive.


def test_a_delay_of_whole_samples_shifts_everything():
    # On the spring without a mean nothing moves before the first command.
    met, command = chain_parameters.spring(0.012, 1000.0), commands(mean=0.0)
    late, plain = play("latency", (3.0 / RATE, 1.0), command, met=met), play(command=command, met=met)
    for name in NOISE:
        np.testing.assert_allclose(getattr(late, name)[3:], getattr(plain, name)[:-3], rtol=1e-7, atol=1e-9)


def test_a_delay_between_samples_is_that_of_a_command_at_a_higher_rate():
    command = commands()
    # An edge takes a tenth of a sample, which delays its mean by half of that.
    late = play("latency", (1.45 / RATE, 0.0), substeps=40)
    fine = np.r_[np.full(12, command[0]), np.repeat(command, 8)][: 8 * command.size]
    expected = play(command=fine, rate=8 * RATE, substeps=5)
    np.testing.assert_allclose(late.voltage[2:], command[1:-1], rtol=1e-12)
    for name in ("current", "position"):
        there = getattr(expected, name)[7::8]
        assert rms(getattr(late, name) - there) < 1e-3 * np.std(there)


def test_a_delay_held_again_weights_two_commands():
    command = commands()
    late = play("latency", (2.25 / RATE, 1.0))
    np.testing.assert_allclose(late.voltage[4:], 0.75 * command[2:-2] + 0.25 * command[1:-3], rtol=1e-9)


def test_a_delay_is_found_in_the_record_and_none_where_there_is_none():
    found = all_effects()["latency"].starts_from
    command = commands(4000)
    noise = np.random.default_rng(1).normal(0.0, 2e-3, command.size)
    for samples in (0.0, 0.6, 7.0, 23.3):
        voltage = play("latency", (max(samples, 1e-3) / RATE, 1.0), command).voltage + noise
        voltage[100:120] = np.nan
        starts = found([{"command": command, "voltage": voltage}], RATE)
        if samples == 0.0:
            assert starts == ()
        else:
            assert starts[0][0] * RATE == pytest.approx(samples, abs=0.01)
    assert found([{"command": np.zeros(4000), "voltage": noise}], RATE) == ()
    assert found([{"command": command}], RATE) == ()


@pytest.mark.parametrize(("lag", "shape"), [(4e-4, 0.05), (3e-4, 0.25), (6e-4, 0.5), (2e-5, 0.9)])
def test_a_slow_amplifier_is_its_transfer_function(lag, shape):
    command = commands(600)
    slow = play("amplifier_lag", (lag, shape, 0.0), command, BLOCKED)
    filtered = ([1.0], [shape * lag**2, lag, 1.0])
    coil = ([1.0], np.polymul(filtered[1], [BLOCKED.inductance_h, BLOCKED.resistance_ohm]))
    for system, found, scale, off in ((filtered, slow.voltage, 1.0, 1e-7), (coil, slow.current, 12.0, 3e-3)):
        numerator, denominator, _ = signal.cont2discrete(system, 1.0 / RATE, "zoh")
        deviations = signal.lfilter(numerator.ravel(), denominator, np.append(command - command[0], 0.0))[1:]
        expected = command[0] / scale + deviations
        assert rms(found - expected) < off * np.std(expected)
    before_the_hold = play("amplifier_lag", (lag, shape, 1.0), command, BLOCKED)
    np.testing.assert_allclose(before_the_hold.voltage, slow.voltage, rtol=1e-9)


def test_clipping_spans_hard_and_soft_limits():
    command = np.linspace(-40.0, 46.0, 500)
    hard = play("amplifier_clipping", (20.0, 80.0, 0.0, 0.75, 0.0), command).voltage
    np.testing.assert_allclose(hard, np.clip(command, -15.0, 20.0), atol=0.07)
    soft = play("amplifier_clipping", (20.0, 1.0, 0.0, 1.0, 0.0), command).voltage
    np.testing.assert_allclose(soft, 20.0 * np.tanh(command / 20.0), rtol=1e-6)
    beyond = play("amplifier_clipping", (20.0, 80.0, 0.3, 1.0, 0.0), command).voltage
    assert beyond[-1] == pytest.approx(0.3 * 46.0 + 0.7 * 20.0, rel=1e-6)
    assert (np.diff(beyond) > 0.0).all()
    between = play("amplifier_clipping", (4.0, 80.0, 0.0, 0.5, 8.0), command).voltage
    np.testing.assert_allclose(between, np.clip(command, 6.0, 12.0), atol=0.07)
    at_rest = play("amplifier_clipping", (4.0, 80.0, 0.0, 0.5, 8.0), np.zeros(50)).voltage
    np.testing.assert_allclose(at_rest, 6.0, atol=0.07)


def test_clipping_starts_at_the_ends_of_the_recorded_voltage():
    voltage = 8.0 + 3.0 * np.sin(np.linspace(0.0, 40.0 * np.pi, 3000))
    around_zero, around_mean = all_effects()["amplifier_clipping"].starts_from([{"voltage": voltage}, {}], RATE)
    assert (around_zero[0], around_zero[4]) == (pytest.approx(1.05 * 11.0, rel=1e-2), 0.0)
    assert (around_mean[0], around_mean[3], around_mean[4]) == (
        pytest.approx(1.05 * 3.0, rel=0.05),
        pytest.approx(1.0, rel=0.05),
        pytest.approx(8.0, rel=0.01),
    )
    starts = all_effects()["amplifier_clipping"].starts_from
    assert starts([{"voltage": np.zeros(9)}], RATE) == ()
    assert len(starts([{"voltage": np.append(np.zeros(5000), 3.0)}], RATE)) == 1  # no swing on both sides of the mean


def test_a_dead_zone_removes_small_commands():
    command = np.linspace(-10.0, 10.0, 501)
    wide = play("amplifier_deadband", (2.0, 1.0, 100.0, 0.0), command).voltage
    np.testing.assert_allclose(wide, np.sign(command) * np.maximum(np.abs(command) - 2.0, 0.0), atol=0.02)
    gate = play("amplifier_deadband", (2.0, 0.0, 100.0, 0.0), command).voltage
    away = np.abs(np.abs(command) - 2.0) > 0.3
    np.testing.assert_allclose(gate[away], np.where(np.abs(command) > 2.0, command, 0.0)[away], atol=1e-5)
    assert gate[250] == 0.0


def test_within_a_dead_zone_a_share_of_the_gain_may_be_left():
    command = np.linspace(-10.0, 10.0, 501)
    found = play("amplifier_deadband", (4.0, 1.0, 100.0, 0.25), command).voltage
    size = np.abs(command)
    np.testing.assert_allclose(found, np.sign(command) * np.where(size > 4.0, size - 3.0, 0.25 * size), atol=0.03)


def test_gain_and_offset_drift():
    command = commands()
    time = np.arange(1, command.size + 1) / RATE
    gone = 1.0 - np.exp(-time / 0.3)
    drifted = play("amplifier_drift", (0.3, 0.05, -0.02, 0.4), command).voltage
    np.testing.assert_allclose(drifted, command * (1.0 + 0.05 * gone - 0.02 * time) + 0.4 * gone, atol=5e-3)


# Coil.


@pytest.mark.parametrize(("branch", "loss", "taken"), [(5e-4, 4.0, 0.0), (2e-3, 2.0, 0.8), (2e-4, 60.0, 1.0)])
def test_eddy_currents_are_a_branch_in_series(branch, loss, taken):
    command = commands(600)
    own = 1e-3 / (1.0 + taken * branch / 1e-3)
    matrix = np.array([[-(12.0 + loss) / own, loss / own], [loss / branch, -loss / branch]])
    system = (matrix, np.array([[1.0 / own], [0.0]]), np.eye(2), np.zeros((2, 1)))
    a, b, _, _, _ = signal.cont2discrete(system, 1.0 / RATE, "zoh")
    state, expected = np.full(2, command[0] / 12.0), []
    for volts in command:
        state = a @ state + b[:, 0] * volts
        expected.append(state[0])
    for substeps in (1, 4, 40):
        lossy = play("eddy_currents", (branch, loss, taken, 0.0), command, BLOCKED, substeps=substeps).current
        np.testing.assert_allclose(lossy, expected, atol=1e-9)


def test_a_slower_branch_of_eddy_currents_is_another_in_series():
    command, (branch, loss) = commands(600), (6e-4, 5.0)
    slow_branch, slow_loss = 8.0 * 0.3 * branch, 0.3 * loss
    matrix = np.array(
        [
            [-(12.0 + loss + slow_loss) / 1e-3, loss / 1e-3, slow_loss / 1e-3],
            [loss / branch, -loss / branch, 0.0],
            [slow_loss / slow_branch, 0.0, -slow_loss / slow_branch],
        ]
    )
    system = (matrix, np.array([[1e3], [0.0], [0.0]]), np.eye(3), np.zeros((3, 1)))
    a, b, _, _, _ = signal.cont2discrete(system, 1.0 / RATE, "zoh")
    state, expected = np.full(3, command[0] / 12.0), []
    for volts in command:
        state = a @ state + b[:, 0] * volts
        expected.append(state[0])
    for substeps in (1, 4):
        both = play("eddy_currents", (branch, loss, 0.0, 0.3), command, BLOCKED, substeps=substeps).current
        np.testing.assert_allclose(both, expected, atol=1e-8)


def test_eddy_currents_take_energy_and_give_none():
    command = commands(600, mean=0.0)
    fine = np.repeat(command, 20)
    lossy = play("eddy_currents", (1e-3, 3.0, 0.5, 0.5), fine, BLOCKED, rate=20 * RATE, substeps=20).current
    beyond_copper = np.cumsum((fine - 12.0 * lossy) * lossy)
    assert beyond_copper.min() > -1e-3 * beyond_copper.max()
    assert beyond_copper[-1] > 0.0


def test_the_winding_stores_heat():
    volts = 18.0
    current = play("coil_heating", (20.0, 500.0), np.full(9000, volts), BLOCKED).current
    time = np.arange(1, 9001) / RATE
    # Without cooling: C theta' = V^2 / (R0 (1 + a theta)), so theta + a theta^2 / 2 = V^2 t / (R0 C).
    rise = (np.sqrt(1.0 + 2.0 * 0.0039 * volts**2 * time / (12.0 * 20.0)) - 1.0) / 0.0039
    np.testing.assert_allclose(volts / current / 12.0 - 1.0, 0.0039 * rise, rtol=6e-3, atol=2e-6)
    cooled = play("coil_heating", (20.0, 0.2), np.full(9000, volts), BLOCKED).current[-1]
    power = volts * cooled
    assert volts / cooled / 12.0 - 1.0 == pytest.approx(0.0039 * power * 0.2 / 20.0, rel=1e-3)


def through(low, high, values):
    """Return a curve through values at equal distances with mean slopes."""
    places = np.linspace(low, high, len(values))
    slopes = np.gradient(values, places)
    return CubicHermiteSpline(places, values, slopes)


SHARES = (0.7, 0.8, 1.0, 1.3, 1.5)


def test_inductance_by_place_sets_how_fast_current_settles():
    along = through(0.006, 0.022, SHARES)
    for position, share in ((0.007, along(0.007)), (0.0163, along(0.0163)), (0.021, along(0.021)), (0.030, 1.5)):
        still = simulation.MeasuredSignals(position=np.full(40, position), velocity=np.zeros(40))
        step = np.r_[np.zeros(4), np.full(36, 12.0)]
        current = play("inductance_position", (0.006, 0.022, 1.0, *SHARES), step, given=still).current
        expected = 1.0 - np.exp(-12.0 / (1e-3 * share) * np.arange(1, 37) / RATE)
        np.testing.assert_allclose(current[4:], expected, rtol=1e-9)


def test_inductance_that_grows_pulls_as_energy_demands():
    values = (0.006, 0.022, 1.0, *SHARES)
    away, current = settled("inductance_position", values, 12.0)
    extra = 0.5 * 1e-3 * through(0.006, 0.022, SHARES).derivative()(0.012 + away) * current**2
    assert 1000.0 * away == pytest.approx(3.0 * current + extra, rel=1e-5)
    without, _ = settled("inductance_position", (0.006, 0.022, 0.0, *SHARES), 12.0)
    assert 1000.0 * without == pytest.approx(3.0 * current, rel=1e-5)


def test_the_force_constant_along_the_stroke_shows_in_force_and_back_emf():
    shares = (0.7, 0.85, 0.97, 1.0, 0.98, 0.9, 0.75)
    values = (0.006, 0.024, *shares)

    def constant(position):
        return 3.0 * through(0.006, 0.024, shares)(np.clip(position, 0.006, 0.024))

    for volts in (4.0, 12.0, 30.0):
        away, current = settled("force_constant_position", values, volts)
        assert 1000.0 * away == pytest.approx(constant(0.012 + away) * current, rel=1e-5)
    velocity = np.full(600, 0.06)
    moving = simulation.MeasuredSignals(position=0.008 + 0.06 * np.arange(600) / RATE, velocity=velocity)
    current = play("force_constant_position", values, np.zeros(600), given=moving).current
    np.testing.assert_allclose(current[10:], -constant(moving.position[10:]) * 0.06 / 12.0, rtol=2e-3)


def test_curves_along_the_stroke_begin_where_the_probe_went():
    position = np.linspace(0.009, 0.015, 2001)
    tests = [{"position": np.append(position, np.nan), "command": np.arange(2002.0)}, {"position": position + 1.0}]
    for name in ("force_constant_position", "inductance_position", "sensor_nonlinearity"):
        start = all_effects()[name].starts_from(tests, RATE)[0] if name != "sensor_nonlinearity" else None
        if start is not None:
            assert start[:2] == pytest.approx((0.009, 0.015), abs=2e-5)
        assert all_effects()[name].starts_from([{"position": np.full(9, np.nan), "command": np.zeros(9)}], RATE) == ()


@pytest.mark.parametrize("bias", [0.0, 0.9, -0.6])
def test_flux_saturates_by_current_and_by_its_sign(bias):
    def left(current):
        # The two branches are joined over 0.05 A.
        flux = current + bias
        sign = flux / math.hypot(flux, 0.05)
        return 1.0 / (1.0 + 0.05 * (flux**2 + 0.05**2) * (0.7 + 0.3 * sign))

    none = left(0.0)
    for volts in (-18.0, -6.0, 6.0, 18.0):
        away, current = settled("flux_saturation", (0.05, 2.0, 0.4, bias), volts)
        assert 1000.0 * away == pytest.approx(3.0 * current * left(current) / none, rel=1e-4)
    moving = simulation.MeasuredSignals(position=np.full(400, 0.012), velocity=np.full(400, 0.05))
    current = play("flux_saturation", (0.05, 2.0, 0.4, bias), np.full(400, 12.0), given=moving).current[-1]
    assert 12.0 - 12.0 * current == pytest.approx(3.0 * left(current) / none * 0.05, rel=1e-4)


def test_a_reluctance_force_acts_one_way_for_either_current():
    up, current = settled("reluctance_force", (0.2, 60.0), 9.0)
    down, _ = settled("reluctance_force", (0.2, 60.0), -9.0)
    for away, sign in ((up, 1.0), (down, -1.0)):
        extra = 0.2 * math.exp(60.0 * (0.012 + away - 0.016)) * current**2
        assert 1000.0 * away == pytest.approx(sign * 3.0 * current + extra, rel=1e-5)
