"""Bounds of the cross-compiled firmware: cycles of the sample interrupt, stack, memory; and how they are computed."""

import pytest
from reference.lines import EmulatedLine, run_on

from firmware_sim.reference.bounds import TIMINGS, BoundError, Program, bounds_of
from firmware_sim.reference.build import QEMU, STM32, build
from firmware_sim.reference.tools import MissingToolError

SAMPLE_S = 500e-6


@pytest.mark.parametrize(("target", "memory_bytes"), [(QEMU, 4 << 20), (STM32, 512 << 10)], ids=["qemu", "stm32h743"])
def test_the_interrupt_the_stack_and_the_memory_are_bounded(target, memory_bytes):
    try:
        bounds = bounds_of(build(target), TIMINGS[target.name])
    except MissingToolError as error:
        pytest.skip(str(error))
    assert bounds.instructions < bounds.cycles
    assert bounds.seconds < 0.7 * SAMPLE_S
    assert bounds.stack < 2048
    assert bounds.variable_bytes < memory_bytes
    assert bounds.code_bytes < 32 << 10


def test_the_emulator_counts_no_more_instructions_than_the_bound(emulated):
    line = EmulatedLine(emulated)
    run_on(line, ("5.2b", "5.4e"))
    assert 300 < line.device.counted_instructions < bounds_of(emulated, TIMINGS["qemu"]).instructions


BRANCH = """
00000100 <root>:
 100:\tcmp\tr0, #0
 102:\tbeq.n\t10a <root+0xa>
 104:\tvdiv.f64\td0, d1, d2
 108:\tb.n\t10c <root+0xc>
 10a:\tadds\tr0, #1
 10c:\tbx\tlr
"""
LOOP = """
00000200 <memset>:
 200:\tpush\t{r4, r5, lr}
 202:\tadds\tr0, #1
 204:\tcmp\tr0, r1
 206:\tbne.n\t202 <memset+0x2>
 208:\tpop\t{r4, r5, pc}

00000210 <root>:
 210:\tsub\tsp, #24
 212:\tbl\t200 <memset>
 216:\tbl\t200 <memset>
 21a:\tbx\tlr
"""


def test_the_most_expensive_branch_counts():
    assert Program(BRANCH).cost("root") == (1 + 9 + 32 + 9 + 9, 5)


def test_a_loop_counts_as_often_as_it_runs_at_most():
    loop = 4 * (1 + 1 + 9)
    memset = (1 + 3) + loop + (1 + 3)
    assert Program(LOOP).cost("root") == (1 + 2 * (9 + memset) + 9, 4 + 2 * (2 + 12))
    assert Program(LOOP).cost("root", free=("memset",)) == (28, 4)


def test_the_deepest_path_of_calls_is_the_stack():
    assert Program(LOOP).stack("root") == 24 + 12


@pytest.mark.parametrize(
    ("listing", "words"),
    [
        (LOOP.replace("memset", "unknown"), "loop without a known bound in unknown"),
        (LOOP.replace("bne.n\t202 <memset+0x2>", "bl\t210 <root>"), "recursion"),
        (LOOP.replace("bl\t200 <memset>", "blx\tr3"), "call by pointer in root"),
        (LOOP.replace("sub\tsp, #24", "sub.w\tsp, sp, r3"), "frame of variable size in root"),
        (LOOP.replace("<memset>:", "<other>:"), "no function memset"),
    ],
)
def test_what_has_no_bound_is_an_error(listing, words):
    program = Program(listing)
    with pytest.raises(BoundError, match=words):
        program.cost("root"), program.stack("root")
