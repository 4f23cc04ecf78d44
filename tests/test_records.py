"""Records: what every engine eats."""

from __future__ import annotations

import numpy as np
import pytest
from coded import coded

from tissueid.errors import UnusableInputError
from tissueid.records import Record, joined


def test_joined_records_are_separated_by_a_missing_sample():
    first = Record(np.arange(3.0), np.ones(3), 100.0)
    second = Record(np.arange(2.0), np.zeros(2), 100.0)
    both = joined([first, second])
    np.testing.assert_array_equal(both.input, [0.0, 1.0, 2.0, np.nan, 0.0, 1.0])
    np.testing.assert_array_equal(both.valid, [True, True, True, False, True, True])


def test_a_joint_is_distinguished_from_a_lost_sample():
    one = Record(np.arange(3.0), np.ones(3), 100.0)
    both = joined([joined([one, one]), one])
    assert both.joints == (3, 7)
    assert both[2:8].joints == (1, 5)
    assert both[4:7].joints == ()


def test_infinity_is_a_sample_that_was_not_received():
    record = Record(np.array([0.0, np.inf, 1.0]), np.array([0.0, 1.0, -np.inf]), 100.0)
    np.testing.assert_array_equal(record.valid, [True, False, False])


@pytest.mark.parametrize("size", [1e200, 1e-200])
def test_sizes_that_no_instrument_measures_are_refused(size: float):
    with pytest.raises(UnusableInputError, check=coded("record.magnitude", signal="output", largest=2 * size)):
        Record(np.arange(3.0), size * np.arange(3.0), 100.0)


def test_one_record_joined_is_itself():
    only = Record(np.arange(3.0), np.ones(3), 100.0)
    np.testing.assert_array_equal(joined([only]).input, only.input)


@pytest.mark.parametrize(
    ("other", "check"),
    [
        (Record(np.ones(2), np.ones(2), 200.0), coded("record.rates_differ", first=100.0, other=200.0)),
        (Record(np.ones(2), np.ones(2), 100.0, input_unit="V"), coded("record.signals_differ")),
    ],
)
def test_records_that_differ_in_kind_are_not_joined(other: Record, check):
    with pytest.raises(UnusableInputError, check=check):
        joined([Record(np.ones(2), np.ones(2), 100.0), other])


def test_no_records_are_refused():
    with pytest.raises(UnusableInputError, check=coded("record.none")):
        joined([])
