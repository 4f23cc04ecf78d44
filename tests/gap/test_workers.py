"""Work in this process and in others: order, progress, cancelling and failures."""

from __future__ import annotations

import math
import operator

import pytest

from tissueid.gap.fitting import Cancelled
from tissueid.gap.workers import Alone, Pool, crew


def never() -> bool:
    return False


def test_one_worker_works_in_this_process():
    with crew(1) as people:
        assert isinstance(people, Alone)
        done: list[int] = []
        assert people.do(operator.neg, [3, 1, 2], never, done.append) == [-3, -1, -2]
        assert done == [3, 1, 2]
        assert people.do(operator.neg, [], never, done.append) == []


def test_alone_stops_before_the_next_piece():
    done: list[int] = []
    with pytest.raises(Cancelled):
        Alone().do(operator.neg, [1, 2, 3], lambda: len(done) == 2, done.append)
    assert done == [1, 2]


def test_several_workers_answer_in_order_tell_failures_and_can_be_cancelled():
    with crew(2) as people:
        assert isinstance(people, Pool)
        done: list[int] = []
        assert people.do(math.factorial, [5, 1, 4, 3], never, done.append) == [120, 1, 24, 6]
        assert sorted(done) == [1, 3, 4, 5]
        assert people.do(math.factorial, [], never, done.append) == []
        with pytest.raises(ValueError, match="negative"):
            people.do(math.factorial, [2, -1], never, done.append)
        with pytest.raises(Cancelled):
            people.do(math.factorial, list(range(100)), lambda: True, done.append)
        assert people.do(math.factorial, [3], never, done.append) == [6]
