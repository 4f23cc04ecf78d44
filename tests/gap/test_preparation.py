"""Preparation of sessions: purposes of samples, unusable tests, and noise of each channel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from coded import coded, says
from gap_records import DEVICE, RATE_HZ, changed, not_usable, observed, recorded

from tissueid.device import GRAVITY_M_S2
from tissueid.errors import UnusableInputError
from tissueid.gap.dataset import Purpose
from tissueid.gap.preparation import BLOCK_S, GRAVITY_STD_M_S2, SETTLING_S, prepare
from tissueid.sessions import Session

TRUE_NOISE = {
    "voltage": np.hypot(2.0e-3, 50.0 / 32768 / np.sqrt(12.0)),
    "current": np.hypot(0.95e-3, 5.0 / 32768 / np.sqrt(12.0)),
    "position": np.hypot(1.9e-6, 0.032 / 65536 / np.sqrt(12.0)),
}
"""White noise and quantization of the laboratory, by channel (SI)."""
BLOCK = round(BLOCK_S * RATE_HZ)
SETTLING = round(SETTLING_S * RATE_HZ)


def test_blocks_alternate_between_purposes():
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
    seen = prepare(recorded(full=True), fit=(2, 3), check=(4,))
    assert [test.number for test in seen.tests] == [2, 3, 4]
    for test in seen.tests[:2]:
        assert np.all(test.purpose[SETTLING:] == Purpose.FIT)
    assert not seen.tests[2].serving(Purpose.FIT).any()


def test_held_out_tests_leave_the_others_to_fit():
    seen = prepare(recorded(full=True), check=(4,))
    fitted = [test.number for test in seen.tests if test.serving(Purpose.FIT).any()]
    assert fitted == [1, 2, 3, 5, 6]


def test_a_test_to_fit_and_check_alternates():
    seen = prepare(recorded(), fit=(1,), check=(1,))
    assert np.array_equal(seen.tests[0].purpose, observed().tests[0].purpose)


def test_fixtures_and_surface():
    seen = observed(full=True)
    assert [test.fixture for test in seen.tests] == ["tissue"] * 5 + ["spring"]
    assert seen.full
    assert not observed().full
    assert seen.tests[0].quiet
    lost = replace(recorded().tests[0], surface_position_m=float("nan"))
    result = prepare(Session(DEVICE, tests=(lost,))).tests[0].surface_m
    assert result == pytest.approx(recorded().tests[0].surface_position_m, abs=1e-4)


def found_again(surface_errors_m: tuple[float, ...], moved_m: tuple[float, ...] = (0.0,) * 6) -> Session:
    # A full session whose tests find the surface a millimetre above the probe at rest, each with an error.
    tests = [
        replace(
            test,
            signals=test.signals | {"position": test.signals["position"] + moved},
            surface_position_m=test.surface_position_m - 1e-3 + error,
        )
        for test, error, moved in zip(recorded(full=True).tests, surface_errors_m, moved_m, strict=True)
    ]
    return Session(DEVICE, tests=tuple(tests))


ERRORS_M = (1e-4, -2e-4, 0.0, 2e-4, -1e-4, 3e-4)


def test_tests_that_rest_at_one_position_have_one_surface():
    recorded_at = recorded(full=True).tests[0].surface_position_m
    *on_tissue, on_spring = prepare(found_again(ERRORS_M)).tests
    assert len({test.surface_m for test in on_tissue}) == 1
    assert on_tissue[0].surface_m == pytest.approx(recorded_at - 1e-3, abs=2e-5)
    assert on_spring.surface_m == recorded(full=True).tests[-1].surface_position_m - 1e-3 + 3e-4


def test_surfaces_move_as_the_positions_at_rest_do():
    recorded_at = recorded(full=True).tests[0].surface_position_m
    moved = (0.0, 3e-4, -2e-4, 0.0, 1e-4, 0.0)
    *on_tissue, _ = prepare(found_again(tuple(np.add(ERRORS_M, 2.0 * np.array(moved))), moved)).tests
    depth = on_tissue[0].starting_position_m - on_tissue[0].surface_m
    assert depth == pytest.approx(1e-3, abs=2.5e-4)
    for test, by in zip(on_tissue, moved, strict=False):
        assert test.starting_position_m - test.surface_m == pytest.approx(depth, abs=1e-6)
        assert test.starting_position_m == pytest.approx(recorded_at + by, abs=2e-5)


def test_surfaces_that_agree_better_than_the_positions_at_rest_are_kept():
    session = found_again((0.0,) * 6, (0.0, 3e-4, -2e-4, 0.0, 1e-4, 0.0))
    assert [test.surface_m for test in prepare(session).tests] == [test.surface_position_m for test in session.tests]


def off_the_skin(*flights_s: tuple[float, float]) -> Session:
    # The session with the probe 3 mm off the skin in these times.
    signals = recorded().tests[0].signals
    position, times = signals["position"].copy(), np.arange(signals["position"].size) / RATE_HZ
    surface = recorded().tests[0].surface_position_m
    for left, back in flights_s:
        position[(times >= left) & (times < back)] = surface - 3e-3
        position[times >= back] = np.maximum(position[times >= back], surface)
    return changed(recorded(), position=position)


def unused(session: Session) -> np.ndarray:
    return np.flatnonzero(prepare(session).tests[0].purpose == Purpose.NOTHING)[SETTLING:] / RATE_HZ


def test_flights_and_the_time_after_them_are_not_used():
    seen = prepare(off_the_skin((0.5, 0.55), (1.0, 1.02)))
    result = unused(off_the_skin((0.5, 0.55), (1.0, 1.02)))
    expected = np.r_[np.arange(1000, 1100 + 200), np.arange(2000, 2040 + 200)] / RATE_HZ
    assert result == pytest.approx(expected)
    assert says(seen.remarks[0], "gap.off_skin", number=1, seconds=pytest.approx(expected.size / RATE_HZ))
    for purpose in (Purpose.FIT, Purpose.CHOICE, Purpose.CHECK):
        assert seen.tests[0].serving(purpose).any()


def test_a_probe_that_does_not_return_ends_the_part_that_is_used():
    result = unused(off_the_skin((0.5, 0.55), (1.0, 3.0)))
    assert result[-1] == (recorded().tests[0].samples - 1) / RATE_HZ
    assert result.size == 300 + recorded().tests[0].samples - 2000


def test_a_probe_off_the_skin_from_the_beginning_is_used():
    assert not unused(off_the_skin((0.0, 0.4))).size


def test_lost_readings_are_no_flight():
    position = recorded().tests[0].signals["position"].copy()
    position[1000:1050] = np.nan
    assert not unused(changed(recorded(), position=position)).size


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
    ("session", "code", "values"),
    [
        (lambda: cut(300), "too_short", {"seconds": 0.15}),
        (lambda: cut(2900), "too_short", {"seconds": 1.45}),
        (lambda: changed(recorded(), position=None), "no_position", {}),
        (mostly_missing, "missing_samples", {"percent": 75.0, "channel": "position"}),
        (lambda: stretched(position=0.0), "constant_position", {}),
        (lambda: stretched(position=1e3), "travel", {"stroke_m": DEVICE.stroke_m}),
        (in_millinewtons, "force_unit", {}),
        (lambda: changed(recorded(), command=None, voltage=None, current=None), "no_excitation", {}),
    ],
)
def test_an_unusable_test_is_refused_with_its_reason(session, code, values):
    with pytest.raises(UnusableInputError, check=not_usable(f"gap.{code}", **values)):
        prepare(session())


@pytest.mark.parametrize("name", ["voltage", "current"])
def test_a_signal_without_any_sample_counts_as_not_recorded(name: str):
    missing = np.full(recorded().tests[0].samples, np.nan)
    (test,) = prepare(changed(recorded(), **{name: missing})).tests
    assert name not in test.signals


def test_missing_tests_are_refused():
    with pytest.raises(UnusableInputError, check=coded("gap.not_usable")) as refused:
        prepare(without_anything())
    assert says(refused.value.message.values["reason"], "gap.no_tests")
    with pytest.raises(UnusableInputError, check=coded("gap.no_such_test", number=7, others="1")):
        prepare(recorded(), fit=(7,))
    with pytest.raises(UnusableInputError, check=coded("gap.nothing_to_fit")):
        prepare(recorded(), check=(1,))


def test_an_unusable_test_among_others_gets_a_remark():
    good = recorded().tests[0]
    bad = replace(good, number=2, signals={name: values[:300] for name, values in good.signals.items()})
    seen = prepare(Session(DEVICE, tests=(good, bad)))
    assert [test.number for test in seen.tests] == [1]
    assert says(seen.remarks[0], "gap.test_left_out", number=2)
    assert says(seen.remarks[0].values["reason"], "gap.too_short", seconds=0.15)


def test_infinite_readings_count_as_not_received():
    position = recorded().tests[0].signals["position"].copy()
    position[700] = np.inf
    assert np.isnan(prepare(changed(recorded(), position=position)).tests[0].signals["position"][700])


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


def test_a_repeat_has_the_same_command():
    seen = observed(full=True).tests
    repeats = [test.played for test in seen if test.kind == "stochastic"]
    assert repeats[0] == repeats[1] != repeats[2]


def test_noise_is_right_with_lost_samples():
    # Every loss distorts the relation to the command, most of all for the voltage with its low noise.
    noise = observed("dropped_samples", 4, 9000).noise
    assert noise["voltage"] == pytest.approx(TRUE_NOISE["voltage"], rel=0.25)
    assert noise["current"] == pytest.approx(TRUE_NOISE["current"], rel=0.1)
    assert noise["position"] == pytest.approx(TRUE_NOISE["position"], rel=0.1)


def test_coarse_steps_are_not_sensor_noise():
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
    noise = prepare(changed(recorded(samples=9000), position=position)).noise
    assert noise["position"] == pytest.approx(TRUE_NOISE["position"], rel=0.1)


def test_measured_gravity_bounds_the_weight():
    session = recorded("dry_friction")
    known = {"gravity_along_stroke_m_s2": 4.9, "gravity_across_stroke_m_s2": 8.5}
    upright = replace(session, tests=tuple(replace(test, notes=known) for test in session.tests))
    assert prepare(session).gravity_m_s2 == (0.0, GRAVITY_M_S2)
    assert prepare(upright).gravity_m_s2 == (4.9, GRAVITY_STD_M_S2)
    assumed = {"gravity_along_stroke_m_s2": 9.8}
    unmeasured = replace(session, tests=tuple(replace(test, notes=assumed) for test in session.tests))
    assert prepare(unmeasured).gravity_m_s2 == (0.0, GRAVITY_M_S2)
