"""Localisation of a gap on recordings of the simulated laboratory, which shares nothing with the twin."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from gap_records import RATE_HZ, observed

from tissueid.gap.decision import score_candidate
from tissueid.gap.error_regions import ErrorProfile
from tissueid.gap.fitting import fit
from tissueid.gap.localisation import Localisation, localise
from tissueid.gap.noise import lost_samples, mains_lines, quiet_motion
from tissueid.gap.stage_substitution import DRIVE, MOVING, TISSUE, motion, propagated_noise, simulate_stage
from tissueid.twin.catalogue import effect
from tissueid.twin.effect import STAGES

SAMPLES = 4000


@cache
def found(name: str, seed: int = 3) -> Localisation:
    tests = observed(name, seed)
    return localise(tests, score_candidate(fit(tests)))


@pytest.mark.parametrize(
    ("effect", "stage"),
    [
        ("amplifier_deadband", "drive"),
        ("eddy_currents", "coil"),
        ("quadratic_drag", "mechanics"),
        ("sensor_lag", "sensing"),
    ],
)
def test_the_stage_of_the_effect_is_found(effect, stage):
    result = found(effect)
    assert result.stage == stage
    assert result.shares[stage] > 0.5
    assert sum(result.shares.values()) == pytest.approx(1.0)
    assert result.findings[0].stage == stage
    assert result.findings[0].error > result.findings[0].floor


def test_no_stage_is_at_fault_without_an_effect():
    result = found("")
    assert not result.above_floor
    assert result.findings == ()
    assert set(result.shares) == set(STAGES)
    assert result.regions.above["bands_hz"] == ()
    assert result.regions.above["time_s"] == ()


def test_the_answer_has_the_contracts_keys_and_plain_values():
    answer = found("quadratic_drag").as_answer()
    assert {"stage", "stages", "bands_hz", "depth_m", "direction", "time_s"} <= set(answer)
    assert list(answer["stages"]) == list(STAGES)
    assert answer["direction"] in ("both", "into", "out")
    assert answer["bands_hz"]
    assert all(0.0 <= low < high <= RATE_HZ / 2.0 for low, high in answer["bands_hz"])


def test_errors_within_the_calibration_are_not_a_fault():
    tests = observed("", 3)
    baseline = fit(tests)
    answer = simulate_stage(baseline, tests.tests, (), "voltage", DRIVE, tests.noise["voltage"])
    assert np.std(answer.residual(tests.tests[0])) < 1.1 * tests.noise["voltage"]


def test_motion_is_smoothed_and_differentiated_without_delay():
    test = observed("", 3).tests[0]
    time = np.arange(SAMPLES) / RATE_HZ
    position, velocity = motion(test, 1e-3 * np.sin(2.0 * np.pi * 40.0 * time))
    middle = slice(100, -100)
    assert np.allclose(position[middle], 1e-3 * np.sin(2.0 * np.pi * 40.0 * time)[middle], atol=5e-6)
    expected = 1e-3 * 2.0 * np.pi * 40.0 * np.cos(2.0 * np.pi * 40.0 * time)
    assert np.allclose(velocity[middle], expected[middle], atol=2e-3)


def test_lines_of_the_mains_are_found_and_noise_has_none():
    random = np.random.default_rng(1)
    time = np.arange(SAMPLES) / RATE_HZ
    noise = random.normal(size=SAMPLES)
    hum = np.sin(2.0 * np.pi * 50.1 * time) + 0.4 * np.sin(2.0 * np.pi * 150.3 * time)
    result = mains_lines(noise + hum, RATE_HZ)
    assert result.mains_hz == 50.0
    assert result.deviation == pytest.approx(np.std(hum), rel=0.1)
    assert sum(mains_lines(random.normal(size=SAMPLES), RATE_HZ).mains_hz > 0.0 for _ in range(100)) == 0


def test_coloured_noise_has_no_lines():
    random = np.random.default_rng(2)
    kernel = np.exp(-np.arange(200) / 40.0)
    coloured = [np.convolve(random.normal(size=SAMPLES), kernel)[:SAMPLES] for _ in range(50)]
    assert sum(mains_lines(item, RATE_HZ).mains_hz > 0.0 for item in coloured) == 0


def test_lost_samples_are_detected_and_delays_are_not():
    random = np.random.default_rng(3)
    command = np.convolve(random.normal(size=SAMPLES + 40), np.ones(8) / 8, "same")
    kept = np.delete(command, np.arange(500, 4000, 500))[:SAMPLES]
    assert lost_samples(command[:SAMPLES], kept, RATE_HZ) == pytest.approx(-7, abs=1)
    assert lost_samples(command[:SAMPLES], np.roll(command, 3)[:SAMPLES], RATE_HZ) == 0
    assert lost_samples(command[:SAMPLES], command[:SAMPLES] * np.abs(command[:SAMPLES]), RATE_HZ) == 0


def test_settling_is_not_quiet_motion():
    time = np.arange(3000) / RATE_HZ
    noise = 1e-6 * np.random.default_rng(4).normal(size=3000)
    assert quiet_motion(1e-3 * np.exp(-time / 0.08) + noise, RATE_HZ) < 1.2e-6
    assert quiet_motion(2e-5 * np.sin(2.0 * np.pi * 3.0 * time) + noise, RATE_HZ) > 8e-6


def test_connected_bins_are_one_interval():
    profile = ErrorProfile(np.arange(6.0), np.ones(5), np.array([True, True, False, False, True]))
    assert profile.intervals() == ((0.0, 2.0), (4.0, 5.0))


def test_noise_of_the_measured_current_counts_as_noise_of_a_motion_with_friction():
    tests = observed("dry_friction", 3)
    friction = effect("dry_friction")
    creeping = replace(friction, starts=tuple((*start[:3], 0.6, start[4]) for start in friction.starts))
    baseline = score_candidate(fit(tests, [creeping], most_steps=20))
    assert baseline.score < 0.12
    carried = propagated_noise(baseline.fit, tests.tests, "current", tests.noise["current"])
    assert carried > tests.noise["position"], "it makes the twin stick and slip elsewhere"
    result = localise(tests, baseline)
    floor = float(np.hypot(tests.noise["position"], carried))
    answer = simulate_stage(baseline.fit, tests.tests, ("current",), "position", (*MOVING, *TISSUE), floor)
    alone = answer.residual(tests.tests[0])[40:].std() / tests.noise["position"]
    assert alone > 1.3 * result.errors["tissue"]
    without = fit(observed("", 3))
    assert propagated_noise(without, tests.tests, "current", tests.noise["current"]) < 0.3 * tests.noise["position"]


def test_a_neutral_localisation_has_no_stage_and_no_region():
    result = found("quadratic_drag").neutral()
    assert (result.above_floor, result.findings) == (False, ())
    assert result.regions.above["bands_hz"] == result.regions.above["depth_m"] == result.regions.above["time_s"] == ()
    assert not any(profile.above.any() for profile in result.regions.profiles.values())
    assert set(result.regions.profiles) == set(found("quadratic_drag").regions.profiles)
