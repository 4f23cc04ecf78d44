"""Detection limits: an effect above its limit is named, one well below is not."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from gap_records import observed

from tissueid.gap import diagnose
from tissueid.gap.answer import as_answer
from tissueid.gap.diagnosis import DetectionLimits
from tissueid.gap.fitting import predict
from tissueid.gap.parameters import parametrise
from tissueid.gap.search import Search
from tissueid.gap.workers import SerialExecutor
from tissueid.twin.catalogue import all_effects, effect

CANDIDATES = ("dry_friction", "latency", "viscoelasticity", "coil_heating", "sensor_lag")
FEW = ("dry_friction", "latency", "sensor_lag")
SAMPLES = 4000


@functools.cache
def baseline():
    return Search(observed(samples=SAMPLES), SerialExecutor()).baseline()


@functools.cache
def limits():
    return DetectionLimits(baseline(), ())


def with_effect(name, times):
    """The session as the twin simulates it with an effect of some times its limit, and noise."""
    fit, chosen, limit = baseline().fit, effect(name), limits().of(effect(name))
    values = {item.name: start for item, start in zip(chosen.parameters, chosen.starts[0], strict=True)}
    values[limit.parameter] = limit.value / times if limit.below else limit.value * times
    parameters = parametrise(fit.parameters.dataset, [chosen], [tuple(values.values())], fit.predictions)
    theta = parameters.array("start")
    for k, item in enumerate(fit.parameters.coordinates):
        theta[parameters.index[item.name]] = fit.theta[k]
    random = np.random.default_rng(4)
    dataset = fit.parameters.dataset
    tests = []
    for test, predicted in zip(dataset.tests, predict(parameters, theta), strict=True):
        noisy = {
            channel: values + dataset.noise[channel] * random.standard_normal(values.size)
            for channel, values in predicted.items()
        }
        tests.append(replace(test, signals=test.signals | noisy))
    return replace(dataset, tests=tuple(tests))


@pytest.mark.parametrize(
    "name", [CANDIDATES[0], *(pytest.param(name, marks=pytest.mark.soak) for name in CANDIDATES[1:])]
)
def test_an_effect_above_its_limit_is_named_and_one_well_below_is_not(name):
    assert limits().of(effect(name)) is not None
    tried = (name, *FEW)
    above = diagnose(with_effect(name, 1.5), SerialExecutor(), candidates=tried)
    assert (above.verdict, above.combination) == ("effect", (name,))
    below = diagnose(with_effect(name, 0.4), SerialExecutor(), candidates=tried)
    assert below.verdict == "no_gap"


def test_every_effect_that_is_not_named_has_a_limit_or_none():
    result = diagnose(observed("dry_friction", samples=SAMPLES), SerialExecutor(), candidates=FEW)
    assert result.combination == ("dry_friction",)
    assert list(result.detection_limits) == [name for name in all_effects() if name in FEW[1:]]
    lag = result.detection_limits["sensor_lag"]
    assert lag.parameter == "delay_s"
    assert 0.0 < lag.value < 1e-3


def test_an_effect_that_the_test_does_not_excite_has_no_limit():
    # The probe stays on the skin.
    assert limits().of(effect("contact_loss")) is None
    assert limits().of(effect("mains_hum")) is None


def test_the_answer_holds_the_limits():
    result = diagnose(
        observed(samples=SAMPLES), SerialExecutor(), candidates=("dry_friction", "coil_heating", "mains_hum")
    )
    limits_in_answer = as_answer(result)["detection_limits"]
    assert limits_in_answer["mains_hum"] is None
    assert set(limits_in_answer["dry_friction"]) == {"parameter", "value", "unit", "below"}
    assert (limits_in_answer["dry_friction"]["below"], limits_in_answer["coil_heating"]["below"]) == (False, True)
