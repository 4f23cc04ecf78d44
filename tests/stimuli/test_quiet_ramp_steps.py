"""Nothing, a slow ramp, and steps that are held: shapes, ends, preloads, and what is refused."""

import json

import numpy as np
import pytest
from coded import coded
from hypothesis import given, settings
from hypothesis import strategies as st

from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.stimuli import get_stimulus, rebuild, with_preload
from tissueid.stimuli.kinds.quasi_static import Quiet, SlowRamp, StepHold
from tissueid.stimuli.stimulus_check import assess_stimulus

KINDS = (Quiet, SlowRamp, StepHold)


def test_quiet_asks_for_nothing_not_even_a_preload():
    played = with_preload(Quiet(seconds=1.5).build())
    assert len(played) == 4000
    assert not played.values.any()
    assert np.isnan(played.crest_factor)


@settings(max_examples=25)
@given(low=st.floats(-5.0, 5.0), span=st.floats(0.1, 10.0), seconds=st.floats(0.1, 6.0))
def test_a_ramp_goes_straight_up_and_down_again(low: float, span: float, seconds: float):
    played = SlowRamp.from_options({"force_min_n": low, "force_max_n": low + span, "seconds": seconds}).build()
    values = played.values
    assert values.size == round(seconds * 2000.0)
    assert values[0] == pytest.approx(low) == values[-1]
    assert values.max() == pytest.approx(low + span)
    np.testing.assert_allclose(values, values[::-1], atol=1e-9)
    up = np.diff(values[: (values.size + 1) // 2])
    np.testing.assert_allclose(up, up[0], atol=1e-9)


def test_steps_are_held_and_their_edges_are_no_jumps():
    played = StepHold(force_min_n=1.0, force_max_n=5.0, seconds=4.0).build()
    holds = played.values.reshape(4, 2000)
    np.testing.assert_allclose(holds[:, 20:], np.array([1.0, 5.0, 3.0, 1.0])[:, None] * np.ones((1, 1980)), atol=1e-12)
    # A raised cosine of 10 ms: its steepest is pi / 2 of a straight one.
    assert np.abs(np.diff(played.values)).max() * 2000.0 == pytest.approx(0.5 * np.pi * 4.0 / 0.01, rel=0.01)
    assert (
        assess_stimulus(
            played, DeviceDescription(), max_force_n=12.0, max_seconds=30.0, max_temperature_c=80.0
        ).concerns
        == ()
    )


@pytest.mark.parametrize("kind", [SlowRamp, StepHold])
def test_the_preload_leads_into_it_without_a_step(kind: type):
    played = with_preload(kind(force_min_n=0.5, force_max_n=6.0).build(), preload_s=0.5)
    assert played.values[999] == pytest.approx(0.5)
    assert abs(played.values[1000] - 0.5) < 0.01
    assert np.abs(np.diff(played.values[:1000])).max() < 0.02


@pytest.mark.parametrize("kind", [SlowRamp, StepHold])
def test_volts_are_designed_as_volts(kind: type):
    played = kind(voltage_min_v=0.0, voltage_max_v=20.0).build()
    assert (played.unit, played.values.max()) == ("V", 20.0)


@pytest.mark.parametrize("kind", KINDS)
def test_they_are_built_again_sample_for_sample(kind: type):
    played = with_preload(kind(seconds=2.0).build(), 0.5)
    again = rebuild(json.loads(json.dumps(played.description)))
    np.testing.assert_array_equal(again.values, played.values)
    assert get_stimulus(kind.name) is kind
    assert kind.test_kind == kind.name
    assert kind(seconds=2.0).planned_samples() == kind(seconds=2.0).build().values.size
    assert get_stimulus("noise").test_kind == "stochastic"


@pytest.mark.parametrize(
    ("kind", "options", "refusal"),
    [
        ("quiet", {"seconds": 0.0}, coded("option.refused", option="seconds", reason="option.greater")),
        ("quiet", {"force_max_n": 3.0}, coded("option.unknown", option="force_max_n")),
        (
            "slow_ramp",
            {"force_min_n": 4.0, "force_max_n": 4.0},
            coded("stimulus.range", what="force", least=4.0, greatest=4.0, unit="N"),
        ),
        ("slow_ramp", {"seconds": 0.001}, coded("slow_ramp.short", least=4)),
        ("step_hold", {"seconds": 0.02}, coded("step_hold.rise", rise_s=0.01, hold_s=0.005)),
        ("step_hold", {"rise_s": 0.0}, coded("option.refused", option="rise_s", reason="option.least")),
        ("step_hold", {"seconds": 4.0, "sample_rate": 0.5}, coded("step_hold.short")),
    ],
)
def test_what_does_not_hold_together_is_refused_in_one_line(kind: str, options: dict[str, float], refusal):
    with pytest.raises(UnusableInputError, check=refusal) as caught:
        get_stimulus(kind).from_options(options)
    assert "\n" not in str(caught.value)


def test_they_say_when_they_are_too_long():
    for kind in KINDS:
        with pytest.raises(UnusableInputError, check=coded("stimulus.samples", limit=5_000_000)):
            rebuild({"type": kind.name, "seconds": 600.0, "sample_rate": 1e6})
