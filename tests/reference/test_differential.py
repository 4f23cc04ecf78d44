"""The C and the Python firmware answer the same traffic with the same bytes.

A million frames are compared by ``python -m firmware_sim.reference.differential``.
"""

import pytest

from firmware_sim.reference.differential import compare


@pytest.mark.parametrize("seed", [1, 2])
def test_random_and_damaged_frames_are_answered_alike(program, seed):
    sent, received = compare(program, frames=2000, seed=seed)
    assert sent >= 2000
    assert received > 100_000


def test_whole_runs_are_answered_alike(program):
    sent, received = compare(program, frames=300, seed=3, quick=False)
    assert sent >= 300
    assert received > 100_000
