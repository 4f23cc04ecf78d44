"""Records with only a part of the chain: what drives them, what is predicted, and what a bare input and output tell."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate, signal

from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.gap.diagnosis import diagnose
from tissueid.gap.fitting import fit
from tissueid.gap.menu import menu
from tissueid.gap.observing import observe
from tissueid.gap.scoring import gap, judged
from tissueid.gap.search import applicable
from tissueid.gap.workers import Alone
from tissueid.sessions import Session, Test
from tissueid.twin.catalogue import all_effects, effect

RATE = 2000.0
DEVICE = DeviceDescription()
NAN = float("nan")
UNKNOWN = replace(
    DEVICE,
    coil_resistance_ohm=NAN,
    coil_inductance_h=NAN,
    force_constant_n_per_a=NAN,
    moving_mass_kg=NAN,
    bearing_damping_n_s_per_m=NAN,
    amplifier_gain=NAN,
    amplifier_limit_v=NAN,
    stroke_m=NAN,
    calibration_relative_uncertainty=NAN,
)


def linear_test(seconds=3.0, seed=1):
    """Voltage, current and position of a coil that shakes a mass on a linear spring, by the matrix exponential."""
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
    observed = observe(session({name: signals[name] for name in kept}, surface_position_m=0.010))
    assert observed.tests[0].driven_by == driven_by
    assert observed.channels == channels
    found = judged(fit(observed))
    # Measured upstream signals carry noise of their own, which no model can take away.
    assert gap(found.checked_by) < 0.006
    assert np.log(found.checked_by[-1].ratio) < 1.0
    stages = {effect(name).stage for name, item in all_effects().items() if applicable(observed, item)}
    assert ("drive" in stages) == (driven_by == "command")
    assert ("coil" in stages) == (driven_by != "current")


def duffing(cubic, seconds=12.0, rate=600.0, seed=3, amplitude=0.03):
    """Volts in, volts out: a resonance at 40 Hz on a hardening spring, band-limited input, by adaptive Runge-Kutta."""
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


def test_a_bare_linear_record_leaves_nothing_to_explain():
    observed = observe(bare(duffing(0.0)))
    about = observed.equivalent
    assert about.natural_hz == pytest.approx(40.0, rel=0.01)
    assert about.damping_n_s_per_m / about.mass_kg == pytest.approx(0.12 * 2 * np.pi * 40.0, rel=0.06)
    assert gap(judged(fit(observed)).checked_by) < 0.01


def test_a_bare_hardening_spring_is_told_from_drag():
    observed = observe(bare(duffing(6.0, seconds=8.0)))
    names = ["tissue_stiffening", "quadratic_drag"]
    found = diagnose(observed, Alone(), candidates=names)
    assert found.verdict == "effect"
    assert found.ranking[0].effect == "tissue_stiffening"
    assert found.gap.closed > 0.9
    assert found.where.stage == "tissue"
    assert found.next_experiment is None
    assert any("seen as a force" in line for line in found.remarks)


def test_the_scale_of_a_bare_record_does_not_matter():
    signals = duffing(6.0, seconds=4.0)
    other = {"input": 1e3 * signals["input"], "output": 1e-6 * signals["output"] + 5.0}
    one, two = observe(bare(signals)), observe(bare(other))
    np.testing.assert_allclose(one.tests[0].signals["position"], two.tests[0].signals["position"], atol=1e-9)
    np.testing.assert_allclose(one.tests[0].command, two.tests[0].command, rtol=1e-9, atol=1e-12)


def test_a_bare_record_leaves_out_what_it_cannot_show():
    observed = observe(bare(duffing(0.0, seconds=4.0)))
    stages = {item.stage for item in all_effects().values() if applicable(observed, item)}
    assert stages == {"mechanics", "tissue", "sensing"}


@pytest.mark.parametrize(
    ("signals", "device", "reason"),
    [
        ({"output": np.arange(1000.0)}, UNKNOWN, "nothing that drives it"),
        ({"input": np.arange(1000.0)}, UNKNOWN, "no position or output"),
        ({"input": np.ones(1000), "output": np.arange(1000.0)}, UNKNOWN, "never changes"),
        ({"input": np.arange(1000.0), "output": np.full(1000, NAN)}, UNKNOWN, "is missing"),
        ({"position": 1e-3 * np.sin(np.arange(2000.0))}, DEVICE, "no command, voltage, current or force"),
        ({"input": np.arange(50.0), "output": np.arange(50.0)}, UNKNOWN, "too short"),
        (
            {"command": np.arange(2000.0), "position": 1e-3 * np.sin(np.arange(2000.0))},
            replace(DEVICE, amplifier_gain=NAN),
            "neither gain nor limit",
        ),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(signals, device, reason):
    with pytest.raises(UnusableInputError, match=reason):
        observe(session(signals, device))


def test_a_spring_of_which_nothing_is_known_is_refused():
    device = replace(DEVICE, calibration_spring_n_per_m=NAN)
    with pytest.raises(UnusableInputError, match="how stiff its calibration spring is"):
        observe(Session(device, tests=(Test(1, "spring", linear_test(), RATE),)))


def test_without_its_gain_a_session_is_driven_by_its_voltage():
    observed = observe(session(linear_test(), replace(DEVICE, amplifier_gain=NAN)))
    assert observed.tests[0].driven_by == "voltage"
    assert menu(observed) == ()


def test_the_menu_asks_for_commands_where_voltages_were_recorded():
    signals = {name: values for name, values in linear_test().items() if name != "command"}
    plain, doubled = (observe(session(signals, replace(DEVICE, amplifier_gain=gain))) for gain in (1.0, 2.0))
    for one, other in zip(menu(plain), menu(doubled), strict=True):
        np.testing.assert_allclose(other.test.command, 0.5 * one.test.command)
