"""Input-output records of other machines: choice of the baseline, and causes in its coordinates."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy import signal

from firmware_sim.other_machines import (
    BoucWen,
    Duffing,
    MachineRecord,
    ServoAxis,
    TwoMassDrive,
    bouc_wen,
    duffing,
    main,
    multisine,
    servo_axis,
    two_mass_drive,
)
from tissueid.gap.dataset import Purpose
from tissueid.gap.decision import gap, score_candidate
from tissueid.gap.diagnosis import diagnose
from tissueid.gap.fit_tasks import acts_on_machine, effects_of
from tissueid.gap.fitting import fit
from tissueid.gap.forward_model import recorded_state, restarts
from tissueid.gap.machine_family import with_best_family
from tissueid.gap.preparation import prepare
from tissueid.gap.search import Search
from tissueid.gap.workers import SerialExecutor
from tissueid.sessions import Session, Test
from tissueid.sessions.imports.export_attributes import unknown_device
from tissueid.twin.machine_effects import BOUC_WEN, machine_effects

NAN = float("nan")
UNKNOWN = unknown_device()


def session(*records):
    tests = []
    for number, record in enumerate(records, start=1):
        signals = dict(zip(record.names, (record.input, record.output), strict=True))
        units = dict(zip(record.names, record.units, strict=True))
        tests.append(Test(number, "stochastic", signals, record.sample_rate_hz, units=units))
    return Session(UNKNOWN, tests=tuple(tests))


def dataset(record):
    return prepare(session(record))


def diagnosed(record, *names):
    return diagnose(dataset(record), SerialExecutor(), candidates=names)


@pytest.mark.soak
def test_friction_of_a_servo_axis_in_closed_loop_is_named():
    found = diagnosed(servo_axis(2, 10.0, ServoAxis(sample_rate_hz=500.0)), "dry_friction", "quadratic_drag")
    about = found.dataset.equivalent
    assert about.family == "free_mass"
    assert about.restart_s is not None
    assert found.combination == ("dry_friction",)
    assert found.gap.closed > 0.9
    # The machine's own friction, 20.4 N, in its own unit.
    assert found.ranking[0].parameters["coulomb_n"] / about.input_n == pytest.approx(20.4, rel=0.05)
    assert {"gap.restarted", "gap.machine_family"} <= {item.code for item in found.remarks}


def test_loops_that_harden_are_named_with_their_parameters():
    found = diagnosed(bouc_wen(2, 3.5, BoucWen(noise_m=2e-6)), "tissue_hysteresis", "dry_friction")
    about = found.dataset.equivalent
    assert (about.family, about.restart_s) == ("oscillator", None)
    assert found.combination == ("tissue_hysteresis",)
    assert found.gap.closed > 0.95
    fitted = found.ranking[0].parameters
    assert fitted["form"] == BOUC_WEN
    assert fitted["angle"] == pytest.approx(np.arctan2(-1.1, 0.8), abs=0.05)
    assert fitted["yield_m"] / about.output_m == pytest.approx(1e-3 / np.hypot(0.8, 1.1), rel=0.15)


@pytest.mark.soak
def test_a_circuit_with_square_and_cubic_stiffness_is_named():
    found = diagnosed(duffing(2, 6.0, Duffing(square_1_v=0.4)), "tissue_stiffening", "dry_friction")
    assert found.combination == ("tissue_stiffening",)
    assert found.gap.closed > 0.95


@pytest.mark.parametrize("of_load", [False, pytest.param(True, marks=pytest.mark.soak)])
def test_two_masses_are_a_baseline(of_load):
    record = two_mass_drive(1, 4.0, TwoMassDrive(coulomb_n=0.0), of_load=of_load)
    chosen = with_best_family(dataset(record))
    about = chosen.equivalent
    assert about.family == ("far_mass" if of_load else "driven_mass")
    found = fit(chosen)
    left = score_candidate(found)
    assert gap(left.checked_by) < 0.02
    if not of_load:
        assert np.exp(found.value("coupling_mass_ratio")) == pytest.approx(1.2 / 0.8, rel=0.1)
        assert np.exp(found.value("coupling_hz")) == pytest.approx(np.sqrt(3e4 / 0.8) / (2 * np.pi), rel=0.05)


def first_order(seconds=6.0, rate=400.0, friction=0.0, seed=4):
    """Return the speed of a drive with dry friction in fine steps: m v' = u - b v - c sgn v."""
    random = np.random.default_rng(seed)
    size = round(seconds * rate)
    given = signal.sosfilt(signal.butter(2, 20.0, fs=rate, output="sos"), random.standard_normal(size))
    given /= given.std()
    speed, v, step = np.empty(size), 0.0, 1.0 / (20 * rate)
    for n in range(size):
        speed[n] = v
        for _ in range(20):
            free = (v + step * given[n] / 0.05) / (1.0 + step * 0.6 / 0.05)
            v = np.sign(free) * max(abs(free) - step * friction / 0.05, 0.0)
    return MachineRecord(given, speed + 1e-4 * random.standard_normal(size), rate, ("input", "output"), ("V", "V"))


def test_a_linear_drive_of_first_order_has_no_gap():
    chosen = with_best_family(dataset(first_order()))
    assert chosen.equivalent.family == "velocity"
    assert gap(score_candidate(fit(chosen)).checked_by) < 0.01


@pytest.mark.parametrize("late", [0, 37])
def test_a_dead_time_is_part_of_the_baseline(late):
    record = duffing(3, 5.0, Duffing(square_1_v=0.0, cubic_1_v2=0.0))
    moved = replace(record, output=np.roll(record.output, late))
    observed = dataset(moved)
    assert observed.equivalent.delay_s * record.sample_rate_hz == pytest.approx(late, abs=1.5)
    assert gap(score_candidate(fit(observed)).checked_by) < 0.01


def test_a_saturating_input_is_named():
    size, rate = 3000, 600.0
    given, fine = multisine(size, rate, (1.0, 60.0), 5)
    # The answer of a linear machine to the limited input, in periodic steady state.
    s = 2j * np.pi * np.fft.rfftfreq(fine.size, 1.0 / (rate * fine.size / size))
    natural = 2 * np.pi * 40.0
    response = natural**2 / (s**2 + 0.2 * natural * s + natural**2)
    answer = np.fft.irfft(np.fft.rfft(np.clip(fine, -1.2, 1.2)) * response, fine.size)[:: fine.size // size]
    record = MachineRecord(given, answer, rate, ("input", "output"), ("V", "V"))
    found = diagnosed(record, "amplifier_clipping", "tissue_stiffening")
    about = found.dataset.equivalent
    assert found.combination == ("amplifier_clipping",)
    assert found.where.stage == "drive"
    limit = found.ranking[0].parameters["limit_v"] / (about.volts_per_newton * about.input_n)
    assert limit == pytest.approx(1.2, rel=0.1)


def test_windows_start_from_the_recorded_motion():
    chosen = with_best_family(dataset(servo_axis(1, 8.0, ServoAxis(sample_rate_hz=250.0))))
    (test,) = chosen.tests
    starts = restarts(test, chosen.equivalent)
    assert len(starts) >= 16
    found = fit(chosen, most_steps=2)
    position, velocity = recorded_state(test)
    at = found.predictions[0]["position"]
    for first in starts[1:]:
        assert at[first] == pytest.approx(position[first - 1] + velocity[first - 1] / 250.0, abs=2e-4)
    # Whole windows serve one purpose, and the first one, whose hidden states are unknown, none.
    assert not test.purpose[: starts[1]].any()
    assert all(np.ptp(test.purpose[a:b]) == 0 for a, b in pairwise(starts))
    assert {Purpose.FIT, Purpose.CHOICE, Purpose.CHECK} <= set(test.purpose.tolist())


def test_the_start_of_a_whole_test_is_no_evidence():
    axis = ServoAxis(sample_rate_hz=250.0)
    chosen = with_best_family(prepare(session(*(servo_axis(seed, 8.0, axis) for seed in (1, 2))), (1,), (2,)))
    for test, purposes in zip(chosen.tests, ({Purpose.FIT}, {Purpose.CHOICE, Purpose.CHECK}), strict=True):
        begin = restarts(test, chosen.equivalent)[1]
        assert begin > 10
        assert not test.purpose[:begin].any()
        assert set(test.purpose[begin:].tolist()) == purposes


@pytest.mark.parametrize("one", machine_effects().values(), ids=machine_effects())
def test_effects_of_a_machine_start_within_their_bounds(one):
    position = 1e-3 * np.random.default_rng(0).standard_normal(500)
    found = one.starts_from([{"position": position, "command": position}], 500.0) if one.starts_from else ()
    for start in (*one.starts, *found):
        for parameter, value in zip(one.parameters, start, strict=True):
            assert parameter.low <= value <= parameter.high, parameter.name


def test_a_search_tries_the_effects_of_the_machine():
    observed = dataset(duffing(1, 3.0))
    assert effects_of(observed)["tissue_stiffening"] is machine_effects()["tissue_stiffening"]
    assert not acts_on_machine(observed, effects_of(observed)["mains_hum"])
    assert "latency" not in Search(observed, SerialExecutor()).names


def test_a_record_is_written_with_names_and_units(tmp_path):
    main(["servo_axis", "--out", str(tmp_path / "axis.csv"), "--seconds", "2", "--seed", "3"])
    lines = (tmp_path / "axis.csv").read_text().splitlines()
    assert lines[0] == "time (s),force (N),position (m)"
    assert len(lines) == 2001
    expected = servo_axis(3, 2.0)
    np.testing.assert_allclose(np.loadtxt(lines[1:], delimiter=",")[:, 1], expected.input, rtol=1e-8, atol=1e-8)
