"""Noise that comes in impulses: seen, left out of the floor, and called a matter of sensing."""

import numpy as np
import pytest
from gap_records import changed, recorded

from tissueid.gap.diagnosis import diagnose
from tissueid.gap.fitting import fit
from tissueid.gap.impulses import cleaned, ordinary_noise, without_impulses_in_the_floor
from tissueid.gap.observing import observe
from tissueid.gap.workers import Alone

SAMPLES = 3000


@pytest.fixture(scope="module")
def spoilt():
    random = np.random.default_rng(4)
    hit = random.random(SAMPLES) < 0.03
    kicks = np.where(hit, 6e-5 * random.standard_normal(SAMPLES), 0.0)
    session = recorded(samples=SAMPLES)
    position = session.tests[0].signals["position"]
    return observe(changed(session, position=position + kicks)), hit & (np.abs(kicks) > 4e-5)


def test_most_readings_say_what_the_noise_is(spoilt):
    observed, _ = spoilt
    clean = observe(changed(recorded(samples=SAMPLES)))
    found, expected = ordinary_noise(fit(observed)), ordinary_noise(fit(clean))
    assert observed.noise["position"] > 2.0 * clean.noise["position"]
    for name, level in expected.items():
        assert found[name] == pytest.approx(level, rel=0.25)
        assert level == pytest.approx(clean.noise[name], rel=0.15)


def test_an_ordinary_record_is_left_alone():
    fitted = fit(observe(changed(recorded(samples=SAMPLES))))
    observed = fitted.parameters.observed
    assert without_impulses_in_the_floor(fitted) is observed
    assert cleaned(observed, fitted) is observed


def test_impulses_are_taken_out_of_the_floor_and_then_out_of_the_record(spoilt):
    observed, large = spoilt
    fitted = fit(observed)
    told = without_impulses_in_the_floor(fitted)
    assert set(told.impulsive) == {"position"}
    assert told.impulsive["position"] == observed.noise["position"]
    assert "impulses" in told.remarks[-1]
    position = cleaned(told, fitted).tests[0].signals["position"]
    # Two next to each other can hide one another.
    assert np.isnan(position[large]).mean() > 0.95
    assert np.isnan(position).mean() < 0.2


def test_coarse_steps_are_no_impulses():
    session = recorded(samples=SAMPLES)
    stepped = 2e-5 * np.round(session.tests[0].signals["position"] / 2e-5)
    fitted = fit(observe(changed(session, position=stepped)))
    assert without_impulses_in_the_floor(fitted) is fitted.parameters.observed


def test_the_diagnosis_names_the_stage_and_no_cause(spoilt):
    observed, _ = spoilt
    told = diagnose(observed, Alone(), candidates=("dry_friction", "sensor_lag"))
    assert told.verdict == "unexplained"
    assert told.where.stage == "sensing"
    assert any("impulses" in remark for remark in told.remarks)
