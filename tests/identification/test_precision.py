"""How well the parameters are known so far, and when that ends a test."""

from __future__ import annotations

import math

import numpy as np
import pytest
from coded import Refusal, refused
from identification import simulated
from pydantic import ValidationError

from tissueid.errors import UnusableInputError
from tissueid.identification.engines.lms import Lms
from tissueid.identification.live.stopping import PARAMETERS, WIDENING, Precision, StopRule, precision
from tissueid.records import Record

TRUTH = (simulated.MASS, simulated.DAMPING, simulated.STIFFNESS)


def test_it_is_what_lms_reports_a_little_widened():
    record = simulated.linear_record(180, snr_db=20.0, colour=0.9)
    found, reported = precision(record), Lms().fit(record).report.parameters
    for name, quantity in zip(PARAMETERS, ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m"), strict=True):
        assert found.estimates[name].value == reported[quantity].value
        assert found.estimates[name].std == pytest.approx(WIDENING * reported[quantity].std, rel=1e-12)
        assert found.relative_std[name] == pytest.approx(found.estimates[name].std / found.estimates[name].value)
    assert found.seconds == 4.0


def test_it_grows_with_the_record_and_holds():
    """Root of the time, and the truth within three standard deviations, with coloured noise and a gap."""
    rng = simulated.generator(182)
    force, position = simulated.second_order(rng)
    y = position + simulated.noise(rng, position, 15.0, colour=0.95)
    force[3000], y[5000:5100] = np.nan, np.nan
    record = Record(force, y, simulated.RATE)
    early, late = precision(record[:2000]), precision(record)
    for name, true in zip(PARAMETERS, TRUTH, strict=True):
        assert 1.3 < early.relative_std[name] / late.relative_std[name] < 3.2
        assert abs(late.estimates[name].value - true) < 3.0 * late.estimates[name].std


def test_too_little_is_refused():
    record = simulated.linear_record(183)
    refused(lambda: precision(record[:200]), "record.shorter_than_memory")
    refused(lambda: precision(Record(np.full(2000, 3.0), np.zeros(2000), 2000.0)), "record.constant")


def look(seconds: float, **relative_std: float) -> Precision:
    fitted = precision(simulated.linear_record(184)[:1500]).second_order
    return Precision(seconds, fitted, dict.fromkeys(PARAMETERS, math.inf) | relative_std)


def test_a_rule_wants_its_targets_several_times_in_a_row_and_some_time():
    rule = StopRule(targets={"stiffness": 0.02, "mass": 0.05}, min_seconds=1.0, looks=2)
    good, bad = {"stiffness": 0.019, "mass": 0.05}, {"stiffness": 0.021, "mass": 0.01}
    assert not rule.enough([])
    assert not rule.enough([look(2.0, **good)])
    assert rule.enough([look(2.0, **good), look(2.25, **good)])
    assert not rule.enough([look(2.0, **good), look(2.25, **bad)])
    assert not rule.enough([look(2.0, **good), look(2.25, **bad), look(2.5, **good)])
    assert not rule.enough([look(0.5, **good), look(0.75, **good)])
    assert not rule.enough([look(2.0, stiffness=0.01), look(2.25, stiffness=0.01)])  # the mass is not known


@pytest.mark.soak
def test_intervals_hold_at_the_look_that_ends_a_test():
    """Coloured noise, a look every quarter of a second, tests that end at targets met after 1 to 4 s."""
    held, ended = [], []
    for run in range(150):
        record = simulated.linear_record(185, run, snr_db=15.0, colour=0.9)
        looks = [precision(record[:end]) for end in range(1000, 8001, 500)]
        for share in (0.01, 0.014):
            rule = StopRule(targets={"damping": share})
            last = next((k for k in range(1, len(looks)) if rule.enough(looks[:k])), len(looks)) - 1
            found = looks[last].estimates
            ended.append(looks[last].seconds)
            held.append(
                [
                    abs(found[name].value - true) < 1.96 * found[name].std
                    for name, true in zip(PARAMETERS, TRUTH, strict=True)
                ]
            )
    assert 1.0 < np.median(ended) < 4.0
    assert np.min(np.mean(held, axis=0)) > 0.93 - 2.0 * math.sqrt(0.95 * 0.05 / 150)


def test_a_rule_from_words():
    rule = StopRule.from_words(["stiffness=0.02", "mass=0.1"])
    assert rule.targets == {"stiffness": 0.02, "mass": 0.1}
    assert str(rule) == "stiffness to 2 % and mass to 10 %"


@pytest.mark.parametrize(
    ("words", "refusal"),
    [
        (["stiffness"], Refusal("stop_rule.target", text="stiffness")),
        (["colour=0.1"], Refusal("stop_rule.target", text="colour=0.1")),
        (["mass=much"], Refusal("stop_rule.share", name="mass", text="much")),
        (["mass=2"], Refusal("stop_rule.share", name="mass", text="2")),
        (["mass=nan"], Refusal("stop_rule.share", text="nan")),
        (["mass=0.1", "mass=0.2"], Refusal("stop_rule.repeated", name="mass")),
        ([], Refusal("option.refused", option="targets")),
    ],
)
def test_words_that_are_no_rule(words: list[str], refusal: Refusal):
    with pytest.raises(UnusableInputError, check=refusal.check):
        StopRule.from_words(words)


def test_bounds_of_a_rule():
    for changes in ({"min_seconds": 0.1}, {"looks": 0}, {"targets": {"mass": 0.9}}, {"targets": {}}):
        with pytest.raises(ValidationError):
            StopRule(**({"targets": {"mass": 0.1}} | changes))
