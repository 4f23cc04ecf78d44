"""Finding kinds of stimulus, preloads, rebuilding, and volts for newtons."""

from __future__ import annotations

import json
import math
from typing import Any, ClassVar

import numpy as np
import pytest
from coded import coded
from plugged import Plugin, plugged_in

from tissueid.device import DeviceDescription
from tissueid.errors import LimitError, UnusableInputError
from tissueid.stimuli import (
    OpenLoopKind,
    Stimulus,
    base,
    get_stimulus,
    rebuild,
    stimulus_names,
    to_voltage,
    with_preload,
)
from tissueid.stimuli.kinds.multisine import multisine_from_description
from tissueid.stimuli.kinds.noise import Noise

NESTED: dict[str, Any] = {"type": "noise"}
for _ in range(5000):
    NESTED = {"type": "guided", "preload_s": 0.5, "stimulus": NESTED}


class Silence(OpenLoopKind):
    """A stimulus of somebody else's package."""

    name: ClassVar[str] = "silence"

    def build(self) -> Stimulus:
        return Stimulus(np.zeros(10), 100.0, self.describe(), seed=0, crest_factor=1.0)


def test_kinds_are_found_and_an_unknown_one_lists_them():
    assert "noise" in stimulus_names()
    assert get_stimulus("noise") is Noise
    with pytest.raises(UnusableInputError, check=coded("registry.unknown_name", what="stimulus", name="nois")):
        get_stimulus("nois")


def test_third_parties_add_kinds_and_a_broken_one_costs_nobody():
    installed = [Plugin("broken", ImportError("gone"), "broken:Kind"), Plugin("silence", Silence)]
    with (
        plugged_in("tissueid.stimuli", installed, base.kinds),
        pytest.warns(UserWarning, match=r"'broken' \(broken:Kind\) was left out: gone"),
    ):
        assert {"noise", "silence"} <= set(stimulus_names())


def test_an_option_that_a_kind_does_not_have_lists_those_that_it_has():
    with pytest.raises(UnusableInputError, check=coded("option.unknown", option="cutof_hz")):
        Noise.from_options({"cutof_hz": 100.0})


def test_a_list_that_is_none_is_told_what_one_looks_like():
    with pytest.raises(UnusableInputError, check=coded("option.list", option="quantiles")):
        Noise.from_options({"quantiles": "low"})


def test_guided_rises_without_a_step_and_holds_the_mean_load():
    played = Noise(seed=1).build()
    whole = with_preload(played, preload_s=0.5)
    mean = played.values.mean()
    assert len(whole) == 1000 + 8000
    assert whole.preload_s == 0.5
    assert whole.seconds == pytest.approx(4.5)
    assert whole.values[0] == 0.0
    np.testing.assert_allclose(whole.values[100:1000], mean)
    np.testing.assert_array_equal(whole.values[1000:], played.values)
    rise = np.diff(whole.values[:1000])
    assert np.all(rise >= 0.0)
    assert rise.max() < 0.05 * mean
    assert np.max(np.abs(np.diff(whole.values))) <= np.max(np.abs(np.diff(played.values))) + 1e-9
    assert whole.crest_factor == played.crest_factor


def test_a_preload_shorter_than_its_rise_is_refused():
    with pytest.raises(UnusableInputError, check=coded("stimulus.preload_short", rise=0.05, seconds=0.01)):
        with_preload(Noise().build(), preload_s=0.01)


def test_a_description_survives_json_and_builds_the_same_again():
    whole = with_preload(Noise(seed=9, distribution="uniform").build(), preload_s=0.3)
    again = rebuild(json.loads(json.dumps(whole.description)))
    np.testing.assert_array_equal(again.values, whole.values)
    assert again.preload_s == whole.preload_s
    assert again.seed == 9


@pytest.mark.parametrize(
    ("description", "refusal"),
    [
        ({}, coded("stimulus.no_type")),
        ({"type": "nothing"}, coded("registry.unknown_name", what="stimulus", name="nothing")),
        ({"type": "noise", "cutoff_hz": "high"}, coded("option.refused", option="cutoff_hz", reason="option.number")),
        ({"type": "noise", "seconds": 10**400}, coded("option.refused", option="seconds", reason="option.number")),
        ({"type": "rtig"}, coded("stimulus.feedback", name="rtig")),
        ({"type": ["noise"]}, coded("stimulus.no_type")),
        ({"type": "guided"}, coded("stimulus.preload_description")),
        ({"type": "guided", "preload_s": "x", "stimulus": {"type": "noise"}}, coded("stimulus.preload_description")),
        ({"type": "guided", "preload_s": 0.5, "stimulus": "noise"}, coded("stimulus.preload_description")),
        ({"type": "guided", "preload_s": 0.5, "stimulus": NESTED}, coded("stimulus.preload_description")),
        (
            {"type": "guided", "preload_s": 0.01, "stimulus": {"type": "noise"}},
            coded("stimulus.preload_length", rise=0.05, limit=60.0),
        ),
        (
            {"type": "guided", "preload_s": math.nan, "stimulus": {"type": "noise"}},
            coded("stimulus.preload_length", rise=0.05, limit=60.0),
        ),
        (
            {"type": "guided", "preload_s": 60.0, "stimulus": {"type": "noise", "sample_rate": 1e6, "seconds": 0.01}},
            coded("stimulus.preload_samples", limit=5000000),
        ),
        ({1: 2}, coded("stimulus.description")),
        ([("type", "noise")], coded("stimulus.description")),
        (None, coded("stimulus.description")),
    ],
)
def test_descriptions_that_do_not_hold_are_refused(description: object, refusal):
    with pytest.raises(UnusableInputError, check=refusal) as refused:
        rebuild(description)
    assert "\n" not in str(refused.value)


def test_a_description_nested_beyond_reason_is_no_multisine():
    assert multisine_from_description(NESTED) is None


def test_volts_for_newtons_and_the_limit_of_the_amplifier():
    device = DeviceDescription()
    force = np.array([0.0, 3.0, -6.0])
    np.testing.assert_allclose(to_voltage(force, device), [device.voltage_for_force(f) for f in force])
    with pytest.raises(
        LimitError,
        check=coded("stimulus.amplifier", peak=60.0, limit=48.0, advice="stimulus.lower_force"),
    ):
        to_voltage(np.array([15.0]), device)
    assert to_voltage(np.array([]), device).size == 0
