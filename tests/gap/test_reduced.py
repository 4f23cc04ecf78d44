"""Records of a part of the chain: excitation, prediction, and input-output records."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from coded import says
from gap_records import not_usable
from scipy import integrate, signal

from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.gap.decision import gap, score_candidate
from tissueid.gap.diagnosis import diagnose
from tissueid.gap.fit_tasks import effects_of
from tissueid.gap.fitting import fit
from tissueid.gap.next_experiment import candidate_tests
from tissueid.gap.preparation import prepare
from tissueid.gap.search import applicable
from tissueid.gap.workers import SerialExecutor
from tissueid.sessions import Session, Test
from tissueid.sessions.imports.export_attributes import unknown_device
from tissueid.twin.catalogue import all_effects, effect

RATE = 2000.0
DEVICE = DeviceDescription()
NAN = float("nan")
UNKNOWN = unknown_device()


def linear_test(seconds=3.0, seed=1):
    """Return voltage, current and position of a coil that moves a mass on a spring, by the matrix exponential."""
    r, inductance, kf, mass, damping, stiffness, surface = 12.0, 1e-3, 3.0, 0.075, 9.0, 500.0, 0.010
    a = np.array([[-r / inductance, 0, -kf / inductance], [0, 0, 1], [kf / mass, -stiffness / mass, -damping / mass]])
    b = np.array([[1 / inductance], [0], [0]])
    random = np.random.default_rng(seed)
    volts = 4.0 + 6.0 * signal.sosfilt(
        signal.butter(4, 150, fs=RATE, output="sos"), random.uniform(-1, 1, round(seconds * RATE))
    )
    ad, bd, *_ = signal.cont2discrete((a, b, np.eye(3), np.zeros((3, 1))), 1 / RATE)
    state, rows = np.array([volts[0] / r, 0.0, 0.0]), []
    for v in volts:
        state = ad @ state + bd[:, 0] * v
        rows.append(state)
    current, depth, _ = np.array(rows).T
    noise = random.standard_normal((3, volts.size))
    return {
        "voltage": volts + 2e-3 * noise[0],
        "current": current + 5e-4 * noise[1],
        "position": surface + depth + 1e-6 * noise[2],
        "command": volts,
    }


def session(signals, device=DEVICE, rate=RATE, **about):
    return Session(device, tests=(Test(1, "stochastic", signals, rate, **about),))


@pytest.mark.parametrize(
    ("kept", "driven_by", "channels"),
    [
        (("command", "voltage", "current", "position"), "command", ("voltage", "current", "position")),
        (("voltage", "current", "position"), "voltage", ("current", "position")),
        (("current", "position"), "current", ("position",)),
        (("force", "position"), "current", ("position",)),
    ],
)
def test_the_chain_begins_with_what_was_recorded_and_fits_to_the_noise(kept, driven_by, channels):
    signals = linear_test()
    signals["force"] = DEVICE.force_constant_n_per_a * signals["current"]
    observed = prepare(session({name: signals[name] for name in kept}, surface_position_m=0.010))
    assert observed.tests[0].driven_by == driven_by
    assert observed.channels == channels
    found = score_candidate(fit(observed))
    # The noise of measured upstream signals cannot be predicted.
    assert gap(found.checked_by) < 0.006
    assert np.log(found.checked_by[-1].ratio) < 1.0
    stages = {effect(name).stage for name, item in all_effects().items() if applicable(observed, item)}
    assert ("drive" in stages) == (driven_by == "command")
    assert ("coil" in stages) == (driven_by != "current")


@cache
def duffing(cubic, seconds=12.0, rate=600.0, seed=3, amplitude=0.03):
    """Return input and output (V) of a 40 Hz resonance on a hardening spring, by adaptive Runge-Kutta."""
    random = np.random.default_rng(seed)
    times = np.arange(round(seconds * rate)) / rate
    hz = np.arange(1.0, 120.0, 0.37)
    phases = random.uniform(0, 2 * np.pi, hz.size)
    size = amplitude * math.sqrt(2.0 / hz.size)
    omega = 2 * np.pi * 40.0

    def force(t):
        return size * np.cos(2 * np.pi * hz * t + phases).sum()

    def slope(t, y):
        return [y[1], omega**2 * (force(t) - y[0] * (1.0 + cubic * y[0] ** 2)) - 0.12 * omega * y[1]]

    solved = integrate.solve_ivp(slope, (0, times[-1]), [0.0, 0.0], t_eval=times, rtol=1e-6, atol=1e-8, max_step=2e-3)
    volts = size * np.cos(2 * np.pi * np.outer(times, hz) + phases).sum(axis=1)
    return {"input": volts, "output": solved.y[0] + 2e-4 * random.standard_normal(times.size)}


def bare(signals, rate=600.0):
    return session(signals, UNKNOWN, rate, units={"input": "V", "output": "V"})


def test_a_linear_input_output_record_has_no_gap():
    observed = prepare(bare(duffing(0.0)))
    about = observed.equivalent
    assert about.natural_hz == pytest.approx(40.0, rel=0.01)
    assert about.damping_n_s_per_m / about.mass_kg == pytest.approx(0.12 * 2 * np.pi * 40.0, rel=0.06)
    assert gap(score_candidate(fit(observed)).checked_by) < 0.01


@pytest.mark.soak
def test_a_hardening_spring_is_separated_from_drag():
    observed = prepare(bare(duffing(6.0, seconds=8.0)))
    names = ["tissue_stiffening", "quadratic_drag"]
    found = diagnose(observed, SerialExecutor(), candidates=names)
    assert found.verdict == "effect"
    assert found.ranking[0].effect == "tissue_stiffening"
    assert found.gap.closed > 0.9
    assert found.where.stage == "tissue"
    assert found.next_experiment is None
    assert says(found.remarks[0], "gap.equivalent_oscillator", input="input (V)", output="output (V)")


def test_the_scale_of_a_bare_record_does_not_matter():
    signals = duffing(6.0, seconds=3.0)
    other = {"input": 1e3 * signals["input"], "output": 1e-6 * signals["output"] + 5.0}
    one, two = prepare(bare(signals)), prepare(bare(other))
    np.testing.assert_allclose(one.tests[0].signals["position"], two.tests[0].signals["position"], atol=1e-9)
    np.testing.assert_allclose(one.tests[0].command, two.tests[0].command, rtol=1e-9, atol=1e-12)


def test_effects_that_a_record_cannot_show_are_left_out():
    observed = prepare(bare(duffing(0.0)))
    known = {name: item.stage for name, item in effects_of(observed).items() if applicable(observed, item)}
    assert set(known.values()) == {"drive", "mechanics", "tissue", "sensing"}
    # Of the drive only a nonlinear law: a linear one is part of the oscillator.
    assert {name for name, stage in known.items() if stage == "drive"} == {"amplifier_clipping", "amplifier_deadband"}
    assert "sensor_backlash" in known


@pytest.mark.parametrize(
    ("signals", "device", "code"),
    [
        ({"output": np.arange(1000.0)}, UNKNOWN, "no_input"),
        ({"input": np.arange(1000.0)}, UNKNOWN, "no_output"),
        ({"input": np.ones(1000), "output": np.arange(1000.0)}, UNKNOWN, "constant_signal"),
        ({"input": np.arange(1000.0), "output": np.full(1000, NAN)}, UNKNOWN, "missing_samples"),
        ({"position": 1e-3 * np.sin(np.arange(2000.0))}, DEVICE, "no_excitation"),
        ({"input": np.arange(50.0), "output": np.arange(50.0)}, UNKNOWN, "too_short"),
        (
            {"command": np.arange(2000.0), "position": 1e-3 * np.sin(np.arange(2000.0))},
            replace(DEVICE, amplifier_gain=NAN),
            "unknown_amplifier",
        ),
    ],
)
def test_an_unusable_record_is_refused_with_its_reason(signals, device, code):
    with pytest.raises(UnusableInputError, check=not_usable(f"gap.{code}")):
        prepare(session(signals, device))


def test_an_unknown_spring_is_refused():
    device = replace(DEVICE, calibration_spring_n_per_m=NAN)
    with pytest.raises(UnusableInputError, check=not_usable("gap.unknown_spring")):
        prepare(Session(device, tests=(Test(1, "spring", linear_test(), RATE),)))


def test_without_its_gain_a_session_is_driven_by_its_voltage():
    observed = prepare(session(linear_test(), replace(DEVICE, amplifier_gain=NAN)))
    assert observed.tests[0].driven_by == "voltage"
    assert candidate_tests(observed) == ()


def test_candidate_tests_are_commands_where_voltages_were_recorded():
    signals = {name: values for name, values in linear_test().items() if name != "command"}
    plain, doubled = (prepare(session(signals, replace(DEVICE, amplifier_gain=gain))) for gain in (1.0, 2.0))
    for one, other in zip(candidate_tests(plain), candidate_tests(doubled), strict=True):
        np.testing.assert_allclose(other.test.command, 0.5 * one.test.command)
