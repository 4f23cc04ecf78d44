"""Scores of the gap, on errors made by hand."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from tissueid.gap.closed_share import closed_in_draws, draws_of, widened
from tissueid.gap.decision import (
    Candidate,
    ChannelError,
    closed,
    floor,
    gap,
    gap_left,
    quiet_tests,
    score,
    tried,
    without_rare_events,
)


def error(test: int = 1, channel: str = "position", square: float = 4.0, **others: float) -> ChannelError:
    figures = {"noise": 1.0, "spread": 10.0, "samples": 100} | others
    return ChannelError(test, channel, square, figures["noise"], figures["spread"], int(figures["samples"]))


@pytest.mark.parametrize(
    ("before", "after", "least", "share"),
    [
        (0.5, 0.3, 0.3, 1.0),
        (0.5, 0.5, 0.3, 0.0),
        (0.5, np.sqrt(0.09 + 0.04), 0.3, 0.5),
        (0.5, 0.2, 0.3, 1.0),
        (0.5, np.sqrt(0.09 + 0.64), 0.3, -1.0),
        (1.0, 0.1, 0.0, 0.9),
    ],
)
def test_the_closed_share(before, after, least, share):
    assert closed(before, after, least) == pytest.approx(share)


@pytest.mark.parametrize("before", [0.3, 0.2, np.nan])
def test_nothing_is_closed_where_there_was_no_gap(before):
    assert np.isnan(closed(before, 0.1, 0.3))


def test_the_score_is_half_the_logarithm_over_the_noise():
    assert score([error(square=1.0)]) == 0.0
    assert score([error(square=np.e**2)]) == pytest.approx(1.0)
    assert score([]) == 0.0


def test_errors_below_the_noise_are_the_noise():
    assert error(square=0.5).ratio == 1.0
    assert score([error(square=0.5), error(channel="current", square=np.e**2)]) == pytest.approx(1.0)


def test_channels_add_up_and_tests_are_averaged():
    found = [error(1, "position", np.e**2), error(1, "current", np.e**4), error(2, "position", np.e**2)]
    assert score(found) == pytest.approx((1.0 + 2.0 + 1.0) / 2)


def test_irreducible_errors_count_as_noise():
    rounded = ChannelError(1, "position", 4.0, 1.0, 10.0, 100, irreducible=np.sqrt(3.0))
    assert rounded.ratio == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("blocks", "rare", "left"), [(10, 2, 1.0), (10, 3, 1.0 + 99.0 / 8), (2, 1, 1.0), (1, 1, 100.0)]
)
def test_a_fifth_of_the_blocks_are_rare_events(blocks, rare, left):
    errors = np.ones((blocks, 50))
    errors[:rare] = 10.0
    samples = (np.arange(blocks)[:, None] * 200 + np.arange(50)).ravel()
    assert without_rare_events(errors.ravel(), samples) == pytest.approx(left)


def test_rare_events_do_not_count_in_the_score_but_in_the_gap():
    once = ChannelError(1, "position", 100.0, 1.0, 100.0, 100, frequent=np.e**2)
    assert score([once]) == pytest.approx(1.0)
    assert gap([once]) == pytest.approx(0.1)


def test_the_gap_is_relative_to_the_recorded_deviation():
    assert gap([error(square=4.0, spread=10.0)]) == pytest.approx(0.2)
    assert floor([error(noise=1.0, spread=10.0)]) == pytest.approx(0.1)


def test_what_is_left_below_the_floor_is_the_floor():
    before = [error(square=9.0, noise=2.0, spread=10.0)]
    assert gap_left(before, [error(square=5.0, noise=2.0, spread=10.0)]) == pytest.approx(np.sqrt(5.0) / 10.0)
    assert gap_left(before, [error(square=3.9, noise=2.0, spread=10.0)]) == pytest.approx(0.2)
    # Without a gap above the floor it is no more than before.
    low = [error(square=3.0, noise=2.0, spread=10.0)]
    assert gap_left(low, low) == pytest.approx(np.sqrt(3.0) / 10.0)


def test_channels_count_alike_and_samples_by_their_number():
    found = [error(channel="position", square=4.0), error(channel="current", square=1e-2, spread=1.0, noise=1e-3)]
    assert gap(found) == pytest.approx(np.sqrt((0.04 + 0.01) / 2))
    pooled = [error(1, square=4.0, samples=300), error(2, square=8.0, samples=100)]
    assert gap(pooled) == pytest.approx(np.sqrt((300 * 4.0 + 100 * 8.0) / (400 * 100.0)))


def test_what_an_effect_leaves_however_well_it_is_known_counts_as_closed():
    parameters = SimpleNamespace(dataset=SimpleNamespace(tests=()), effects=())

    def candidate(names: tuple[str, ...], square: float, irreducible: float = 0.0) -> Candidate:
        found = ChannelError(1, "position", square, 1.0, 10.0, 100, irreducible)
        return Candidate(names, SimpleNamespace(parameters=parameters), (found,), ())  # type: ignore[arg-type]

    baseline = candidate((), 101.0)
    assert tried(baseline, candidate(("quantization",), 85.0, 8.0)).closed == pytest.approx(1.0 - np.sqrt(20.0 / 100.0))
    assert tried(baseline, candidate(("quantization",), 64.0, 8.0)).closed == pytest.approx(1.0)
    assert tried(baseline, candidate(("latency",), 85.0)).closed == pytest.approx(1.0 - np.sqrt(84.0 / 100.0))


def test_quiet_tests_are_left_out_of_the_gap():
    found = [error(1, square=4.0), error(2, square=1e4)]
    assert gap(found, quiet=(2,)) == pytest.approx(0.2)
    tests = [SimpleNamespace(number=1, quiet=False), SimpleNamespace(number=2, quiet=True)]
    assert quiet_tests(tests) == (2,)  # type: ignore[arg-type]


def test_without_anything_to_compare_there_is_no_figure():
    assert np.isnan(gap([]))
    assert np.isnan(gap([error(spread=0.0)]))


def test_a_candidate_is_chosen_by_one_part_and_checked_on_the_other():
    effects = [SimpleNamespace(name="a", order=2), SimpleNamespace(name="b", order=1)]
    fitted = SimpleNamespace(parameters=SimpleNamespace(effects=effects))
    candidate = Candidate(("a", "b"), fitted, (error(square=np.e**2),), (error(square=1e6),))  # type: ignore[arg-type]
    assert candidate.score == pytest.approx(1.0)
    assert candidate.orders == (2, 1)


def test_intervals_from_four_blocks_cover_the_truth():
    random = np.random.default_rng(1)
    before, left, trials, draws, count = 100.0, 4.0, 600, 200, 4
    common, own = random.normal(size=(2, trials, count))
    errors = before * np.exp(0.3 * common), left * np.exp(0.3 * (0.5 * common + np.sqrt(0.75) * own))
    truth = closed(*(np.sqrt(size * np.exp(0.5 * 0.3**2)) for size in (before, left)), 1.0)
    held = plain = 0
    for one, other in zip(*errors, strict=True):
        again = random.integers(count, size=(draws, count))
        drawn = np.array([closed(np.sqrt(one[k].mean()), np.sqrt(other[k].mean()), 1.0) for k in again])
        low, high = widened(closed(np.sqrt(one.mean()), np.sqrt(other.mean()), 1.0), drawn, count)
        held += low <= truth <= high
        plain += np.quantile(drawn, 0.025) <= truth <= np.quantile(drawn, 0.975)
    assert plain < 0.82 * trials
    assert held > 0.92 * trials


def test_the_closed_share_of_draws_is_that_of_the_drawn_stretches():
    random = np.random.default_rng(2)

    def stretches(size: float) -> list[list[ChannelError]]:
        return [
            [error(test, name, size * random.uniform(0.5, 2.0)) for test in (1, 2, 3) for name in channels]
            for channels in [("current", "position", "velocity")] * 3 + [("position",)]
        ]

    before, after = stretches(60.0), stretches(7.0)
    draws = draws_of(len(before))
    found = closed_in_draws(before, after, draws, quiet=(3,))
    for chosen, share in zip(draws[:40], found, strict=False):
        one, other = ([item for k in chosen for item in of[k]] for of in (before, after))
        assert share == pytest.approx(closed(gap(one, (3,)), gap(other, (3,)), floor(one, (3,))))
    assert found.shape == (400,)
    assert np.isnan(closed_in_draws(after, after, draws, quiet=(1, 2, 3))).all()
    assert draws_of(1).shape == (0, 1)
    assert np.isnan(widened(0.5, closed_in_draws(before[:1], after[:1], draws_of(1), ()), 1)).all()
