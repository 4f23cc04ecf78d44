"""The C and the Python firmware answer the same traffic with the same bytes.

A million frames are compared by ``python -m firmware_sim.reference.differential``.
"""

import pytest

from firmware_sim.reference.differential import compare, compare_boards


@pytest.mark.parametrize("seed", [1, 2])
def test_random_and_damaged_frames_are_answered_alike(program, seed):
    sent, received = compare(program, frames=2000, seed=seed)
    assert sent >= 2000
    assert received > 100_000


def test_whole_runs_are_answered_alike(program):
    sent, received = compare(program, frames=300, seed=3, quick=False)
    assert sent >= 300
    assert received > 100_000


@pytest.mark.parametrize("frames", [200, pytest.param(20_000, marks=pytest.mark.soak)])
def test_the_cross_compiled_firmware_answers_with_the_same_bytes(program, emulated, frames):
    sent, received = compare_boards(program, emulated, frames=frames, seed=4)
    assert sent >= frames
    assert received > 50 * frames
