"""Recursive least squares: the least-squares answer itself, forgetting that stays bounded, gaps, and live use."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from coded import coded, codes, refused
from identification import simulated
from scipy import linalg

from tissueid.errors import UnusableInputError
from tissueid.identification import validated
from tissueid.identification.engines.lms import Lms
from tissueid.identification.engines.rls import Rls
from tissueid.messages import code_of
from tissueid.records import Record, joined


@pytest.fixture(scope="module")
def record() -> Record:
    return simulated.linear_record(60)


broadband = partial(simulated.broadband, n=1500, noise=0.0)


def regressors(x: np.ndarray, lags: int, constant: float) -> np.ndarray:
    """Rows of newest to oldest input and a constant, one for each sample, NaN where the memory is not complete."""
    rows = np.full((x.size, lags + 1), np.nan)
    for n in range(lags - 1, x.size):
        rows[n, :lags] = x[n - lags + 1 : n + 1][::-1]
    rows[:, lags] = constant
    return rows


def ridged(rows: np.ndarray, y: np.ndarray, ridge: float) -> np.ndarray:
    """Least squares with a ridge, on the explicit matrix."""
    used = np.isfinite(rows).all(axis=1) & np.isfinite(y)
    tall = np.vstack([rows[used], np.sqrt(ridge) * np.eye(rows.shape[1])])
    return linalg.lstsq(tall, np.concatenate([y[used], np.zeros(rows.shape[1])]))[0]


def test_without_forgetting_it_is_the_ridge_regression(record: Record):
    model = Rls().fit(record)
    x, y = record.input - record.input.mean(), record.output - record.output.mean()
    std = float(np.std(x))
    expected = ridged(regressors(x, 250, std), y, std**2 / 200.0)
    assert np.linalg.norm(model.impulse_response / 2000.0 - expected[:250]) < 1e-8 * np.linalg.norm(expected[:250])
    assert model.output_mean == pytest.approx(record.output.mean() + std * expected[250], rel=1e-9)


def test_every_sample_is_the_plain_recursion():
    """Eqs. 6.2-6.5 as they stand, on a whole matrix."""
    record, lags = broadband(61, n=200, noise=0.1), 30
    live = Rls(memory=0.03, covariance=50.0).start(1000.0, input_std=0.9, input_mean=2.0, output_mean=7.0)
    v, h = 50.0 / 0.81 * np.eye(lags + 1), np.zeros(lags + 1)
    for n, row in enumerate(regressors(record.input - 2.0, lags, 0.9)):
        error = live.update(record.input[n], record.output[n])
        if n < lags - 1:
            assert np.isnan(error)
            continue
        expected = record.output[n] - 7.0 - row @ h
        gain = v @ row / (1.0 + row @ v @ row)
        v = v - np.outer(gain, row @ v)
        h = h + gain * expected
        assert error == pytest.approx(expected, rel=1e-9, abs=1e-12)
        np.testing.assert_allclose(live.impulse_response / 1000.0, h[:lags], atol=1e-11)
    np.testing.assert_allclose(live.covariance, v[:lags, :lags], atol=1e-10 * np.max(v))


def test_with_forgetting_it_is_the_weighted_regression_whose_ridge_stays():
    """The ridge comes back a coefficient at a time, as an observation of zero with a weight of its own."""
    record, lags, forgetting, ridge = broadband(62, n=700, noise=0.1), 30, 0.98, 1.0 / 200.0
    live = Rls(memory=0.03, forgetting=forgetting).start(1000.0, input_mean=2.0, output_mean=7.0)
    live.batch(record.input, record.output)
    rows = regressors(record.input - 2.0, lags, 1.0)[lags - 1 :]
    age = np.arange(len(rows))[::-1]
    returned = np.zeros((len(rows), lags + 1))
    returned[np.arange(len(rows)), np.arange(len(rows)) % (lags + 1)] = 1.0
    weight = np.sqrt(forgetting**age)[:, None]
    tall = np.vstack(
        [
            weight * rows,
            weight * np.sqrt(ridge * (lags + 1) * (1.0 - forgetting)) * returned,
            np.sqrt(ridge * forgetting ** len(rows)) * np.eye(lags + 1),
        ]
    )
    target = np.zeros(len(tall))
    target[: len(rows)] = weight[:, 0] * (record.output[lags - 1 :] - 7.0)
    expected = linalg.lstsq(tall, target)[0]
    np.testing.assert_allclose(live.impulse_response / 1000.0, expected[:lags], atol=1e-9)
    np.testing.assert_allclose(live.covariance, np.linalg.inv(tall.T @ tall)[:lags, :lags], rtol=0.0, atol=1e-10)


def test_it_agrees_with_lms_and_holds_on_new_samples(record: Record):
    ours = validated(Rls().fit(record, slice(0, 6000)), record, slice(6000, None)).report
    theirs = validated(Lms().fit(record, slice(0, 6000)), record, slice(6000, None)).report
    assert ours.vaf_validation_percent == pytest.approx(theirs.vaf_validation_percent, abs=0.05)
    assert ours.vaf_percent == pytest.approx(theirs.vaf_percent, abs=0.05)
    assert ours.details["vaf_tracking_percent"] > 99.0
    assert ours.n_samples == theirs.n_samples
    assert ours.n_parameters == theirs.n_parameters == 251
    for name in ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m"):
        assert ours.parameters[name].value == pytest.approx(theirs.parameters[name].value, rel=1e-9)


def test_a_part_in_the_middle_is_fitted_alone_with_the_memory_before_it(record: Record):
    y = simulated.changed(record.output, (np.s_[:3000], 5.0), (np.s_[5000:], -5.0))
    model = Rls().fit(Record(record.input, y, 2000.0), slice(3000, 5000))
    assert model.report.n_samples == 2000
    assert model.report.vaf_percent > 99.5
    assert model.trajectory_s[0] >= 1.5
    assert model.trajectory_s[-1] < 2.5


def test_records_are_fitted_together_and_nothing_reaches_across():
    parts = [broadband(64, k, n=400, noise=0.1) for k in range(3)]
    together = Rls(memory=0.03).fit(joined(parts))
    u = np.concatenate([p.input for p in parts])
    y = np.concatenate([p.output for p in parts])
    rows = np.vstack([regressors(p.input - u.mean(), 30, 0.0) for p in parts])
    std = float(np.std(u))
    rows[:, 30] = std
    expected = ridged(rows, y - y.mean(), std**2 / 200.0)
    np.testing.assert_allclose(together.impulse_response / 1000.0, expected[:30], atol=1e-6)
    assert together.report.n_samples == 3 * (400 - 29)


def test_forgetting_follows_a_system_that_changes():
    first, second = broadband(65, 0, n=3000, noise=0.05), broadband(65, 1, n=3000, noise=0.05)
    u = np.concatenate([first.input, second.input])
    y = np.concatenate([first.output, 14.0 - second.output])
    following, keeping = Rls(memory=0.03, forgetting=0.99).start(1000.0), Rls(memory=0.03).start(1000.0)
    late = slice(4000, None)
    assert np.nanstd(following.batch(u, y)[late]) < 0.1 * np.nanstd(keeping.batch(u, y)[late])


def test_the_covariance_stays_bounded_where_nothing_is_excited():
    rng = simulated.generator(66)
    t = np.arange(20000) / 1000.0
    u = np.where(t < 10.0, np.sin(60.0 * t), 0.0)  # one frequency, then nothing
    live = Rls(memory=0.03, forgetting=0.99).start(1000.0, input_mean=0.0, output_mean=0.0)
    live.batch(u, 0.5 * u + 0.001 * rng.standard_normal(t.size))
    assert np.all(np.linalg.eigvalsh(live.covariance) > 0.0)
    assert np.max(np.linalg.eigvalsh(live.covariance)) < 2.0 * 200.0
    after = broadband(66, 1, noise=0.01)
    errors = live.batch(after.input - 2.0, after.output - 7.0)
    assert np.std(errors[-200:]) < 0.02
    model = live.model()
    assert not {"rls.unexcited", "rls.bounded"} & set(codes(model.report.findings))
    quiet = Rls(memory=0.03, forgetting=0.99).fit(
        Record(np.sin(60.0 * t[:5000]), np.sin(60.0 * t[:5000] - 0.5), 1000.0)
    )
    assert "rls.bounded" in codes(quiet.report.findings)


def test_a_memory_of_few_samples_warns():
    report = Rls(memory=0.03, forgetting=0.97).fit(broadband(67, noise=0.1)).report
    [warning] = [text for text in report.warnings if code_of(text) == "rls.short_memory"]
    assert round(warning.values["samples"]) == 33
    assert warning.values["lags"] == 30


def test_a_live_run_finds_its_operating_point():
    record = broadband(68, n=3000, noise=0.05)
    live = Rls(memory=0.03).start(1000.0)
    with pytest.raises(UnusableInputError):
        live.model()
    live.batch(record.input, record.output)
    model = live.model()
    np.testing.assert_allclose(model.impulse_response / 1000.0, simulated.KERNEL, atol=0.01)
    assert (live.samples, model.report.n_samples) == (3000, 3000 - 29)
    assert model.report.vaf_percent > 99.0
    assert model.simulate(np.full(60, 2.0))[-1] == pytest.approx(7.0, abs=0.02)


def test_a_long_run_keeps_the_latest_and_a_thinned_course():
    record = broadband(69, n=26000, noise=0.1)
    live = Rls(memory=0.008).start(1000.0)
    live.batch(record.input, record.output)
    np.testing.assert_allclose(live.recent().input, record.input[-10000:])
    np.testing.assert_allclose(live.recent().output, record.output[-10000:])
    responses, times, positions = live.trajectory
    assert responses.shape == (times.size, 8)
    assert 200 <= times.size <= 400
    assert np.ptp(np.diff(times)) < 1e-9
    np.testing.assert_allclose(positions, record.output[np.round(times * 1000.0).astype(int)])
    change = np.linalg.norm(responses - live.impulse_response, axis=1)
    assert change[-20:].mean() < 0.1 * change[:5].mean()


@pytest.mark.parametrize(
    ("forgetting", "pole"),
    [(0.995, 0.7), *(pytest.param(*case, marks=pytest.mark.soak) for case in ((1.0, 0.0), (1.0, 0.9), (0.995, 0.0)))],
)
def test_standard_deviation_of_each_lag_is_the_spread_of_repeats(forgetting: float, pole: float):
    found, reported = [], []
    for run in range(40):
        model = Rls(memory=0.03, forgetting=forgetting).fit(broadband(70, run, noise=0.5, pole=pole))
        found.append(model.impulse_response)
        reported.append(model.impulse_response_std)
    ratio = np.mean(reported, axis=0) / np.std(found, axis=0, ddof=1)
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.12)


@pytest.mark.soak
@pytest.mark.parametrize(("forgetting", "pole"), [(1.0, 0.0), (1.0, 0.9), (0.998, 0.0), (0.998, 0.9)])
def test_intervals_hold_the_kernel(forgetting: float, pole: float):
    held = []
    for run in range(200):
        model = Rls(memory=0.03, forgetting=forgetting).fit(broadband(71, run, n=4000, noise=0.5, pole=pole))
        off = model.impulse_response / 1000.0 - simulated.KERNEL
        held.append(np.abs(off) < 1.96 * model.impulse_response_std / 1000.0)
    print("\n", forgetting, pole, np.mean(held))
    assert 0.92 < np.mean(held) < 0.97


def test_refusals():
    for rate in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(UnusableInputError, check=coded("record.sample_rate")):
            Rls().start(rate)
    live = Rls().start(2000.0)
    refused(lambda: live.batch(np.zeros(3), np.zeros(4)), "online.lengths")
    refused(lambda: Rls.from_options({"forgetting": 1.1}), "option.refused", option="forgetting")
