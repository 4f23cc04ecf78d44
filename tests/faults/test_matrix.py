"""Every fault in every state: the coil is free in time, what was recorded is kept, the message helps, it goes on."""

import pytest
from faults.cells import ORDEALS, STATES, run_cell

from firmware_sim.faults import FAULT_KINDS

REPRESENTATIVE = {
    ("single bit flips, 5 % of frames", "loading"),
    ("lost bursts of bytes", "feedback"),
    ("frames twice, 10 %", "armed"),
    ("frames out of order, 5 %", "stimulus"),
    ("clock drifting, 1 % a second", "feedback"),
    ("firmware hangs 2 s", "calibrating"),
    ("reset", "loading"),
    ("brown-out", "preload"),
    ("position stuck", "stimulus"),
    ("current stuck", "idle"),
    ("temperature stuck", "between"),
    ("open coil", "armed"),
    ("another version after a reset", "loaded"),
    ("frames of another version, 10 %", "preload"),
    ("the device hears nothing", "loaded"),
    ("unplugged", "feedback"),
    ("button", "release"),
    ("lost frames, 5 %", "checking"),
}
"""Every kind and every state once or twice."""

CELLS = [
    pytest.param(name, state, marks=[] if (name, state) in REPRESENTATIVE else pytest.mark.soak, id=f"{name}-{state}")
    for name in ORDEALS
    for state in STATES
]


@pytest.mark.parametrize(("name", "state"), CELLS)
def test_a_fault_in_a_state(name, state, tmp_path):
    assert run_cell(name, state, tmp_path).problems == []


def test_the_representative_part_has_every_kind_of_fault_and_every_state():
    assert {ORDEALS[name].fault.kind for name, _ in REPRESENTATIVE} == {item.fault.kind for item in ORDEALS.values()}
    assert {state for _, state in REPRESENTATIVE} == set(STATES)


def test_the_matrix_has_every_kind_of_fault():
    # A cable is put back at the end of every cell that pulled it.
    assert {item.fault.kind for item in ORDEALS.values()} == set(FAULT_KINDS) - {"replug"}
