"""Residual tests: their size for right models, their power against known faults, gaps, and refusals."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from coded import codes, refused
from identification import simulated
from identification import simulated_validation as systems
from scipy import signal

from tissueid.identification.engines.lms import Lms
from tissueid.identification.engines.wiener import Wiener
from tissueid.identification.validation.residual_tests import MEANINGS, ResidualTests, residual_tests
from tissueid.records import Record, joined

FITTED, HELD_OUT = slice(0, 4500), slice(4500, None)
COLOUR_BLIND = tuple(name for name in MEANINGS if name != "autocorrelation")


def examined(record: Record) -> ResidualTests:
    return residual_tests(systems.PlainFir().fit(record, FITTED), record, HELD_OUT)


def failed(tests: ResidualTests) -> set[str]:
    return {test.name for test in tests.tests if test.adjusted_p_value is not None and test.adjusted_p_value < 0.01}


def rejections(runs: int, fitted: int, held_out: int, low_pass: bool, pole: float) -> dict[str, list[bool]]:
    found: dict[str, list[bool]] = {name: [] for name in MEANINGS}
    for run in range(runs):
        seed = (60, run, held_out, int(low_pass), round(10 * pole))
        record = systems.record(*seed, n=fitted + held_out, low_pass=low_pass, pole=pole)
        model = systems.PlainFir().fit(record, slice(0, fitted))
        for test in residual_tests(model, record, slice(fitted, None)).tests:
            found[test.name].append(not test.passed)
    return found


@pytest.mark.parametrize(
    ("low_pass", "pole"),
    [
        (False, 0.0),
        (True, 0.9),
        pytest.param(False, 0.9, marks=pytest.mark.soak),
        pytest.param(True, 0.0, marks=pytest.mark.soak),
    ],
)
def test_right_models_pass_nineteen_times_in_twenty(low_pass: bool, pole: float):
    found = rejections(16, 3000, 1500, low_pass, pole)
    assert np.mean([found[name] for name in COLOUR_BLIND]) == pytest.approx(0.05, abs=0.045)
    assert np.mean(found["autocorrelation"]) == (1.0 if pole else pytest.approx(0.05, abs=0.15))


@pytest.mark.soak
@pytest.mark.timeout(3000)
def test_the_size_of_every_test_is_five_percent():
    sizes: dict[str, list[bool]] = {name: [] for name in MEANINGS}
    for held_out, low_pass, pole in product((1500, 6000), (False, True), (0.0, 0.9)):
        for name, found in rejections(250, 4500, held_out, low_pass, pole).items():
            if pole == 0.0 or name != "autocorrelation":
                sizes[name] += found
    percent = {name: 100.0 * float(np.mean(found)) for name, found in sizes.items()}
    print(percent)
    for name, size in percent.items():
        assert 3.5 <= size <= 6.5, (name, size)


def test_a_single_lag_leaves_its_band_one_time_in_twenty():
    outside = []
    for run in range(12):
        tests = examined(systems.record(61, run, low_pass=True, pole=0.9))
        outside += [np.mean(np.abs(tests[name].correlation) > tests[name].band) for name in COLOUR_BLIND]
    assert np.mean(outside) == pytest.approx(0.05, abs=0.02)


def test_the_plain_band_would_be_wrong_for_coloured_signals():
    """What 1.96 / sqrt(n) makes of a right model: the reason for all the rest."""
    wrong = 0
    for run in range(20):
        record = systems.record(62, run, low_pass=True, pole=0.9)
        e = systems.PlainFir().fit(record, FITTED).residuals(record)[HELD_OUT]
        u = record.input[HELD_OUT] - record.input[HELD_OUT].mean()
        coefficient = np.array([np.mean(e[k:] * u[: e.size - k]) for k in range(20)]) / np.std(e) / np.std(u)
        wrong += int(np.any(np.abs(coefficient) > 3.0 / np.sqrt(e.size)))  # 5 % for 20 lags, were both white
    assert wrong > 5


@pytest.mark.parametrize(
    ("fault", "name"),
    [
        ({"even": 0.1}, "squared_output"),
        ({"odd": 0.1}, "cubed_output"),
        ({"hammerstein": 0.05}, "squared_input"),
        ({"speed": 0.5}, "squared_speed"),
    ],
)
def test_each_nonlinearity_fails_its_test(fault: dict[str, float], name: str):
    tests = examined(systems.record(63, low_pass=True, **fault))
    assert name in failed(tests)
    assert any(MEANINGS[name] == finding for finding in tests.findings)  # type: ignore[index]
    even = {"squared_input", "squared_output", "squared_speed"}
    assert failed(tests).isdisjoint({"cubed_output"} if name in even else even)


def test_a_right_model_passes():
    tests = examined(systems.record(64))
    assert failed(tests) == set()
    assert "residuals.unrelated" in codes(tests.findings)


def test_a_memory_too_short_fails_the_test_against_the_input():
    record = systems.record(65)
    model = systems.PlainFir(lags=20).fit(record, FITTED)
    assert "input" in failed(residual_tests(model, record, HELD_OUT))


def test_a_wiener_system_fitted_by_lms_fails_and_by_wiener_passes():
    record = simulated.wiener_record(66)
    fitted, held_out = slice(0, 6000), slice(6000, None)
    straight = residual_tests(Lms().fit(record, fitted), record, held_out)
    assert "squared_output" in failed(straight)
    assert "input" not in failed(straight)
    curved = residual_tests(Wiener().fit(record, fitted), record, held_out)
    assert failed(curved) <= {"autocorrelation"}


def test_noise_that_grows_with_the_load_fails_the_tests_of_size():
    record = systems.record(67, noise=0.0)
    e = simulated.generator(67, 1).standard_normal(len(record))
    slanted = replace(record, output=record.output + 0.2 * e * np.exp(0.3 * (record.input - 2.0)))
    assert "residual_size_input" in failed(examined(slanted))
    both_ways = replace(record, output=record.output + 0.2 * e * np.abs(record.input - 2.0))
    assert "residual_size_squared_input" in failed(examined(both_ways))


def test_noise_whose_memory_follows_the_load_fails_the_product():
    record = systems.record(68, noise=0.0)
    rng = simulated.generator(68, 1)
    e = np.zeros(len(record))
    for n in range(1, e.size):
        e[n] = 0.4 * np.tanh(record.input[n - 1] - 2.0) * e[n - 1] + 0.2 * rng.standard_normal()
    assert "residual_input_product" in failed(examined(replace(record, output=record.output + e)))


def test_an_input_that_answers_the_output_is_found():
    rng = simulated.generator(69)
    n = 6000
    drive, e = rng.standard_normal(n), 0.5 * systems.coloured(rng, n, 0.6)
    u, y = np.zeros(n), np.zeros(n)
    for i in range(systems.LAGS, n):
        u[i] = drive[i] - 0.4 * e[i - 3]
        y[i] = systems.KERNEL @ u[i - systems.LAGS + 1 : i + 1][::-1] + e[i]
    record = Record(u, y, systems.RATE)
    model = systems.fir(systems.KERNEL, 0.0, 0.0, 10**9)
    assert "feedback" in failed(residual_tests(model, record, slice(100, None)))


def test_the_bands_do_not_care_for_units():
    record = systems.record(70, low_pass=True, pole=0.9)
    small = replace(record, output=1e-6 * record.output, input=1e3 * record.input)
    for ours, theirs in zip(examined(record).tests, examined(small).tests, strict=True):
        np.testing.assert_allclose(ours.correlation, theirs.correlation, rtol=1e-4, atol=1e-6)
        np.testing.assert_allclose(ours.band, theirs.band, rtol=1e-4)


def test_fitted_samples_say_nothing_against_the_input():
    record = systems.record(71)
    tests = residual_tests(systems.PlainFir().fit(record, FITTED), record, FITTED, in_sample=True)
    assert tests["input"].p_value is None
    assert tests["input"].passed is None
    assert tests["input"].correlation.size == 0
    assert tests["squared_output"].p_value is not None


def test_gaps_are_left_out_and_nothing_reaches_across():
    record = systems.record(72)
    u, y = record.input.copy(), record.output.copy()
    u[5000:5010], y[5000:5010], y[5400] = np.nan, np.nan, np.nan
    model = systems.PlainFir().fit(record, FITTED)
    tests = residual_tests(model, Record(u, y, systems.RATE), HELD_OUT)
    assert tests.n_samples == 1500 - 10 - (systems.LAGS - 1) - 1
    y[5010 : 5010 + systems.LAGS - 1] = 1e3  # depends on inputs that were not recorded
    again = residual_tests(model, Record(u, y, systems.RATE), HELD_OUT)
    for ours, theirs in zip(tests.tests, again.tests, strict=True):
        np.testing.assert_array_equal(ours.correlation, theirs.correlation)


def test_joined_records_are_tested_together():
    record = systems.record(73, n=10500)
    model = systems.PlainFir().fit(record, FITTED)
    tests = residual_tests(model, joined([record[4500:7500], record[7500:]]))
    assert tests.n_samples == 2 * (3000 - systems.LAGS + 1)
    assert failed(tests) == set()


def test_a_few_parameters_are_not_taken_for_a_free_kernel():
    record = systems.record(74, low_pass=True)
    exact = signal.lfilter(systems.KERNEL, [1.0], np.eye(1, 40)[0])
    scale = np.linalg.lstsq(
        np.convolve(record.input - 2.0, exact)[40:6000, None], record.output[40:] - 7.0, rcond=None
    )[0][0]
    few = systems.fir(scale * exact, 2.0, 7.0, 4500, n_parameters=2)
    free = systems.fir(scale * exact, 2.0, 7.0, 4500)
    narrow, wide = (residual_tests(m, record, HELD_OUT)["input"].band for m in (few, free))
    assert np.all(narrow < wide)
    assert failed(residual_tests(few, record, HELD_OUT)) == set()


def test_results_are_the_same_every_time():
    record = systems.record(75)
    assert [t.p_value for t in examined(record).tests] == [t.p_value for t in examined(record).tests]


def test_refusals_are_one_line():
    record = systems.record(76)
    model = systems.PlainFir().fit(record, FITTED)
    refused(lambda: residual_tests(model, record, slice(5900, None)), "residuals.too_few", samples=40)
    refused(lambda: residual_tests(model, record, HELD_OUT, scheduled=True), "residuals.no_schedule")
    refused(lambda: residual_tests(model, replace(record, sample_rate_hz=500.0), HELD_OUT), "engine.other_sample_rate")
    refused(
        lambda: residual_tests(model, replace(record, output=model.simulate(record.input)), HELD_OUT),
        "noise_model.constant",
    )
