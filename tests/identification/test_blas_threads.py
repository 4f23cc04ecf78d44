"""Fits run with one thread of linear algebra, whatever the environment says, and give it back."""

from __future__ import annotations

import numpy as np
import pytest

from tissueid.errors import UnusableInputError
from tissueid.identification import blas_threads
from tissueid.identification.engines.lms import Lms
from tissueid.records import Record


@pytest.fixture
def counts(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Numbers of threads that were set in a library; the last one is in force."""
    set_threads = [4]
    monkeypatch.setattr(blas_threads, "_libraries", lambda: ((lambda: set_threads[-1], set_threads.append),))
    return set_threads


def test_the_limit_ends_with_the_last_of_several_uses(counts: list[int]):
    with blas_threads.one_blas_thread():
        assert blas_threads.blas_threads() == (1,)
        with blas_threads.one_blas_thread():
            pass
        assert counts == [4, 1]
    assert counts == [4, 1, 4]


def test_a_fit_is_limited_and_a_refused_one_gives_the_threads_back(counts: list[int]):
    with pytest.raises(UnusableInputError):
        Lms().fit(Record(np.ones(100), np.ones(100), 1000.0))
    assert counts == [4, 1, 4]


def test_openblas_of_numpy_and_scipy_is_found():
    assert all(number >= 1 for number in blas_threads.blas_threads())
