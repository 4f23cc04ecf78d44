"""Which samples serve which purpose, what cannot be used, and how noisy each channel is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap_records import DEVICE, RATE_HZ, changed, observed, recorded

from tissueid.errors import UnusableInputError
from tissueid.gap.observed import Purpose
from tissueid.gap.observing import BLOCK_S, SETTLING_S, observe
from tissueid.sessions import Session

TRUE_NOISE = {
    "voltage": np.hypot(2.0e-3, 50.0 / 32768 / np.sqrt(12.0)),
    "current": np.hypot(0.95e-3, 5.0 / 32768 / np.sqrt(12.0)),
    "position": np.hypot(1.9e-6, 0.032 / 65536 / np.sqrt(12.0)),
}
"""White noise with the converter's steps, by channel (SI): what the laboratory adds."""
BLOCK = round(BLOCK_S * RATE_HZ)
SETTLING = round(SETTLING_S * RATE_HZ)


def test_stretches_take_turns():
    purpose = observed().tests[0].purpose
    turns = [Purpose.FIT, Purpose.CHOICE, Purpose.FIT, Purpose.CHECK] * 2
    assert np.all(purpose[:SETTLING] == Purpose.NOTHING)
    for number, turn in enumerate(turns):
        assert np.all(purpose[max(number * BLOCK, SETTLING) : (number + 1) * BLOCK] == turn)


def test_a_stochastic_test_of_another_amplitude_is_held_out_whole():
    held_out, *others = sorted(observed(full=True).tests, key=lambda test: bool(test.serving(Purpose.FIT).any()))
    assert (held_out.number, held_out.kind) == (4, "stochastic")
    assert held_out.serving(Purpose.CHOICE).any()
    assert held_out.serving(Purpose.CHECK).any()
    assert all(test.serving(Purpose.FIT).any() for test in others)


def test_named_tests_are_fitted_and_held_out_whole():
    seen = observe(recorded(full=True), fit=(2, 3), check=(4,))
    assert [test.number for test in seen.tests] == [2, 3, 4]
    for test in seen.tests[:2]:
        assert np.all(test.purpose[SETTLING:] == Purpose.FIT)
    assert not seen.tests[2].serving(Purpose.FIT).any()


def test_what_is_only_held_out_leaves_the_others_to_be_fitted():
    seen = observe(recorded(full=True), check=(4,))
    fitted = [test.number for test in seen.tests if test.serving(Purpose.FIT).any()]
    assert fitted == [1, 2, 3, 5, 6]


def test_a_test_that_is_fitted_and_held_out_takes_turns():
    seen = observe(recorded(), fit=(1,), check=(1,))
    assert np.array_equal(seen.tests[0].purpose, observed().tests[0].purpose)


def test_fixtures_and_surface():
    seen = observed(full=True)
    assert [test.fixture for test in seen.tests] == ["tissue"] * 5 + ["spring"]
    assert seen.full
    assert not observed().full
    assert seen.tests[0].quiet
    lost = replace(recorded().tests[0], surface_position_m=float("nan"))
    told = observe(Session(DEVICE, tests=(lost,))).tests[0].surface_m
    assert told == pytest.approx(recorded().tests[0].surface_position_m, abs=1e-4)


def without_anything() -> Session:
    return Session(DEVICE)


def cut(samples: int) -> Session:
    first = recorded().tests[0]
    return changed(recorded(), **{name: values[:samples] for name, values in first.signals.items()})


def mostly_missing() -> Session:
    position = recorded().tests[0].signals["position"].copy()
    position[:3000] = np.nan
    return changed(recorded(), position=position)


def stretched(**factors: float) -> Session:
    first = recorded().tests[0]
    return changed(recorded(), **{name: factor * first.signals[name] for name, factor in factors.items()})


def in_millinewtons() -> Session:
    force = 1e3 * 3.0 * recorded().tests[0].signals["current"]
    return changed(recorded(), command=None, voltage=None, current=None, force=force)


@pytest.mark.parametrize(
    ("session", "says"),
    [
        (without_anything, "it holds no tests"),
        (lambda: cut(300), "too short"),
        (lambda: cut(2900), "too short"),
        (lambda: changed(recorded(), position=None), "no position"),
        (mostly_missing, "75% of its position is missing"),
        (lambda: stretched(position=0.0), "never changes"),
        (lambda: stretched(position=1e3), "is it in metres"),
        (in_millinewtons, "is it in N"),
        (lambda: changed(recorded(), command=None, voltage=None, current=None), "drives it"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(session, says):
    with pytest.raises(UnusableInputError, match=says) as refusal:
        observe(session())
    assert "\n" not in str(refusal.value)


def test_tests_that_do_not_exist_and_nothing_to_fit_are_refused():
    with pytest.raises(UnusableInputError, match="no test 7; it has 1"):
        observe(recorded(), fit=(7,))
    with pytest.raises(UnusableInputError, match="none is left to be fitted"):
        observe(recorded(), check=(1,))


def test_what_cannot_be_used_beside_others_is_remarked_upon():
    good = recorded().tests[0]
    bad = replace(good, number=2, signals={name: values[:300] for name, values in good.signals.items()})
    seen = observe(Session(DEVICE, tests=(good, bad)))
    assert [test.number for test in seen.tests] == [1]
    assert any("test 2 is left out" in remark for remark in seen.remarks)


def test_infinite_readings_count_as_not_received():
    position = recorded().tests[0].signals["position"].copy()
    position[700] = np.inf
    assert np.isnan(observe(changed(recorded(), position=position)).tests[0].signals["position"][700])


@pytest.mark.parametrize(
    ("effect", "seed"),
    [("", 3), ("", 6), ("amplifier_clipping", 4), ("amplifier_deadband", 3), ("sensor_lag", 6), ("end_stop", 6)],
)
def test_noise_is_right_within_a_tenth(effect, seed):
    noise = observed(effect, seed, 9000).noise
    assert set(noise) == set(TRUE_NOISE)
    for channel, truth in TRUE_NOISE.items():
        assert noise[channel] == pytest.approx(truth, rel=0.1)


def test_noise_is_right_in_a_full_session():
    for channel, level in observed(full=True).noise.items():
        assert level == pytest.approx(TRUE_NOISE[channel], rel=0.1)


def test_a_repeat_was_played_alike():
    seen = observed(full=True).tests
    repeats = [test.played for test in seen if test.kind == "stochastic"]
    assert repeats[0] == repeats[1] != repeats[2]


def test_noise_is_right_where_samples_slip():
    # Every slip spoils the relation to the command: the voltage, which has little noise, is the hardest.
    noise = observed("dropped_samples", 4, 9000).noise
    assert noise["voltage"] == pytest.approx(TRUE_NOISE["voltage"], rel=0.25)
    assert noise["current"] == pytest.approx(TRUE_NOISE["current"], rel=0.1)
    assert noise["position"] == pytest.approx(TRUE_NOISE["position"], rel=0.1)


def test_coarse_steps_are_no_noise_of_the_sensor_nor_of_the_current():
    record = recorded("quantization", 6, 9000).tests[0].signals["position"]
    step = np.min(np.diff(np.unique(record)))
    assert step > 1e-4
    noise = observed("quantization", 6, 9000).noise
    assert noise["position"] <= 0.051 * step
    assert noise["current"] == pytest.approx(TRUE_NOISE["current"], rel=0.1)


def test_noise_is_right_where_readings_are_missing():
    random = np.random.default_rng(1)
    position = recorded(samples=9000).tests[0].signals["position"].copy()
    position[random.random(position.size) < 0.05] = np.nan
    position[4000:4300] = np.nan
    noise = observe(changed(recorded(samples=9000), position=position)).noise
    assert noise["position"] == pytest.approx(TRUE_NOISE["position"], rel=0.1)
