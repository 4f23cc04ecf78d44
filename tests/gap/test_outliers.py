"""Outliers: detected, removed from the noise floor, and attributed to the sensors."""

import numpy as np
import pytest
from coded import says
from gap_records import changed, recorded

from tissueid.gap.diagnosis import diagnose
from tissueid.gap.fitting import fit
from tissueid.gap.noise import robust_noise, with_robust_noise, without_outliers
from tissueid.gap.preparation import prepare
from tissueid.gap.workers import SerialExecutor
from tissueid.messages import code_of

SAMPLES = 3000


@pytest.fixture(scope="module")
def spoilt():
    random = np.random.default_rng(4)
    hit = random.random(SAMPLES) < 0.03
    kicks = np.where(hit, 6e-5 * random.standard_normal(SAMPLES), 0.0)
    session = recorded(samples=SAMPLES)
    position = session.tests[0].signals["position"]
    return prepare(changed(session, position=position + kicks)), hit & (np.abs(kicks) > 4e-5)


def test_the_noise_is_that_of_most_readings(spoilt):
    observed, _ = spoilt
    clean = prepare(changed(recorded(samples=SAMPLES)))
    found, expected = robust_noise(fit(observed)), robust_noise(fit(clean))
    assert observed.noise["position"] > 2.0 * clean.noise["position"]
    for name, level in expected.items():
        assert found[name] == pytest.approx(level, rel=0.25)
        assert level == pytest.approx(clean.noise[name], rel=0.15)


def test_a_record_without_outliers_is_unchanged():
    fitted = fit(prepare(changed(recorded(samples=SAMPLES))))
    observed = fitted.parameters.dataset
    assert with_robust_noise(fitted) is observed
    assert without_outliers(observed, fitted) is observed


def test_outliers_are_removed_from_noise_floor_and_record(spoilt):
    observed, large = spoilt
    fitted = fit(observed)
    result = with_robust_noise(fitted)
    assert set(result.impulsive) == {"position"}
    assert result.impulsive["position"] == observed.noise["position"]
    assert says(result.remarks[-1], "gap.impulsive_noise", channel="position")
    position = without_outliers(result, fitted).tests[0].signals["position"]
    # Two adjacent outliers can hide each other.
    assert np.isnan(position[large]).mean() > 0.95
    assert np.isnan(position).mean() < 0.2


def test_coarse_steps_are_not_outliers():
    session = recorded(samples=SAMPLES)
    stepped = 2e-5 * np.round(session.tests[0].signals["position"] / 2e-5)
    fitted = fit(prepare(changed(session, position=stepped)))
    assert with_robust_noise(fitted) is fitted.parameters.dataset


def test_the_diagnosis_names_the_stage_and_no_cause(spoilt):
    observed, _ = spoilt
    result = diagnose(observed, SerialExecutor(), candidates=("dry_friction", "sensor_lag"))
    assert result.verdict == "unexplained"
    assert result.where.stage == "sensing"
    assert any(code_of(remark) == "gap.impulsive_noise" for remark in result.remarks)
