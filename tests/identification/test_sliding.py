"""Sliding least mean squares: the answer of the engine over the same window, samples in and out, gaps, and refusals."""

from __future__ import annotations

import numpy as np
import pytest
from coded import refused
from identification import simulated
from scipy import linalg

from tissueid.identification.engines.lms import Lms
from tissueid.identification.live.sliding import SlidingLms
from tissueid.records import Record

RATE = simulated.RATE


@pytest.fixture(scope="module")
def record() -> Record:
    return simulated.linear_record(170)


def with_gaps(record: Record) -> tuple[np.ndarray, np.ndarray]:
    u, y = record.input.copy(), record.output.copy()
    u[5200], y[6400:6403] = np.nan, np.nan
    return u, y


def apart(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.linalg.norm(found - expected) / np.linalg.norm(expected))


OPTIONS = [Lms(), Lms(taper=0.0), Lms(taper=1.0, memory=0.05), Lms(method="svd", tolerance=1e-9)]


@pytest.mark.parametrize("options", OPTIONS, ids=["default", "no taper", "all taper", "svd"])
@pytest.mark.parametrize("gaps", [False, True], ids=["whole", "gaps"])
def test_it_is_lms_over_the_same_window(record: Record, options: Lms, gaps: bool):
    u, y = with_gaps(record) if gaps else (record.input, record.output)
    sliding = SlidingLms(options, RATE, 2.0)
    for first in range(0, 7000, 333):
        sliding.batch(u[first : min(first + 333, 7000)], y[first : min(first + 333, 7000)])
    expected = options.fit(Record(u[3000:7000], y[3000:7000], RATE))
    # Levinson's recursion itself leaves a few parts in a billion at this condition number.
    assert apart(sliding.impulse_response, expected.impulse_response) < 2e-8
    np.testing.assert_array_equal(sliding.model().impulse_response, expected.impulse_response)
    assert sliding.samples == 7000


def test_all_so_far_grows_past_its_first_room(record: Record):
    u, y = np.tile(record.input, 3), np.tile(record.output, 3)
    sliding = SlidingLms(Lms(memory=0.04), RATE)
    sliding.batch(u[:100], y[:100])
    sliding.batch(u[100:], y[100:])
    assert len(sliding.recent()) == 24_000
    assert apart(sliding.impulse_response, Lms(memory=0.04).fit(Record(u, y, RATE)).impulse_response) < 2e-8


def test_the_plain_solution_is_that_of_the_normal_equations():
    """White input: the sums over the window, on explicit shifted copies."""
    rng = simulated.generator(171)
    u = rng.standard_normal(3000)
    y = np.convolve(u, [0.0, 0.5, -0.2])[:3000] + 0.1 * rng.standard_normal(3000)
    sliding = SlidingLms(Lms(memory=0.01, taper=0.0), 1000.0, 1.5)
    sliding.batch(u, y)
    x, z = u[-1500:] - u[-1500:].mean(), y[-1500:] - y[-1500:].mean()
    shifted = np.stack([np.concatenate([np.zeros(k), x[: x.size - k]]) for k in range(10)])
    r = np.array([x[k:] @ x[: x.size - k] for k in range(10)])
    expected = linalg.solve(linalg.toeplitz(r), shifted @ z)
    np.testing.assert_allclose(sliding.impulse_response / 1000.0, expected, atol=1e-12)


def test_one_by_one_is_many_at_once_to_the_last_bit(record: Record):
    u, y = with_gaps(record)
    u, y = u[4800:6000], y[4800:6000]
    one, many = (SlidingLms(Lms(memory=0.02), RATE, 0.25) for _ in range(2))
    for a, b in zip(u.tolist(), y.tolist(), strict=True):
        one.update(a, b)
    for part in (slice(0, 7), slice(7, 900), slice(900, None)):
        many.batch(u[part], y[part])
    np.testing.assert_array_equal(one.impulse_response, many.impulse_response)


def test_a_wild_sample_leaves_no_trace_once_it_has_left(record: Record):
    y = simulated.changed(record.output, (1000, 1e9))
    sliding = SlidingLms(Lms(), RATE, 1.0)
    sliding.batch(record.input[:6000], y[:6000])
    expected = Lms().fit(Record(record.input[4000:6000], y[4000:6000], RATE))
    assert apart(sliding.impulse_response, expected.impulse_response) < 2e-8


def test_a_gap_counts_until_it_has_left(record: Record):
    u, y = with_gaps(record)
    sliding = SlidingLms(Lms(), RATE, 0.5)
    sliding.batch(u[:7900], y[:7900])
    expected = Lms().fit(record[6900:7900])
    assert apart(sliding.impulse_response, expected.impulse_response) < 2e-8


def test_looking_changes_nothing(record: Record):
    looked, left = (SlidingLms(Lms(), RATE, 1.0) for _ in range(2))
    for first in range(0, 4000, 500):
        some = slice(first, first + 500)
        looked.batch(record.input[some], record.output[some])
        left.batch(record.input[some], record.output[some])
        if first:
            looked.impulse_response  # noqa: B018
            looked.model()
    np.testing.assert_array_equal(looked.impulse_response, left.impulse_response)


def test_refusals(record: Record):
    refused(lambda: SlidingLms(Lms(), 0.0), "record.sample_rate", rate=0.0)
    refused(lambda: SlidingLms(Lms(), RATE, 0.2), "online.short_window", window=0.2, memory=0.125)
    sliding = SlidingLms(Lms(), RATE, 1.0)
    refused(sliding.solve, "record.empty")
    refused(lambda: sliding.batch(np.zeros(3), np.zeros(4)), "online.lengths")
    sliding.batch(np.zeros(600), np.zeros(600))
    refused(sliding.solve, "record.constant")
    fresh = SlidingLms(Lms(), RATE, 1.0)
    fresh.batch(record.input[:100], record.output[:100])
    refused(fresh.solve, "record.shorter_than_memory")
