"""One step of the device clock: play commands, sample the sensors and check the limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from firmware_sim.bench import Bench, Block, Snapshot
from firmware_sim.guard import Guard
from firmware_sim.limits import ArmedLimits
from tissueid import wire
from tissueid.wire import Fault, Flag

# Plain numbers: numpy converts a member of an enumeration element by element.
_ENERGISED, _BUTTON, _SATURATED = int(Flag.ENERGISED), int(Flag.BUTTON), int(Flag.SATURATED)

SIGNALS = tuple(name for name in wire.SAMPLE.names or () if name != "flags")


@dataclass(frozen=True)
class Sampled:
    """Played commands and samples: ``command_v`` and ``flags`` (n,), ``samples`` (n,) of wire.SAMPLE.

    ``fault`` is the limit that the last sample violated; ``button`` is the state of the button.
    """

    command_v: NDArray[np.float64]
    flags: NDArray[np.uint16]
    samples: NDArray[np.void]
    fault: Fault
    button: bool


def _with_reduced_command(
    bench: Bench,
    guard: Guard,
    before: Snapshot,
    command_v: NDArray[np.float64],
    flags: NDArray[np.uint16],
    block: Block,
    limits: ArmedLimits,
) -> tuple[NDArray[np.float64], NDArray[np.uint16], Block]:
    """Reduce the commands of a block sample by sample, based on earlier measurements only, and play the block again.

    A real device does this before it plays each sample; here the block is repeated from ``before`` for each change.
    """
    done = 0
    while True:
        reduced = guard.with_reduced_force(command_v, block, limits)
        changed = np.flatnonzero(reduced[done:] != command_v[done:])
        if not changed.size:
            return command_v, flags, block
        k = done + int(changed[0])
        command_v, flags, done = command_v.copy(), flags.copy(), k + 1
        command_v[k] = reduced[k]
        flags[k] |= Flag.LIMITED
        bench.restore(before)
        block = bench.block(command_v, energised=True)


def sampled(
    bench: Bench,
    guard: Guard,
    command_v: NDArray[np.float64],
    flags: NDArray[np.uint16],
    *,
    energised: bool,
    limits: ArmedLimits | None,
    cursor: int,
) -> Sampled:
    """Play commands, shape (n,), V, from ``cursor`` of their run on; fewer if a limit is violated.

    A command whose force would exceed its limit is reduced. Nothing is checked while the coil is off, or without
    limits.
    """
    before = bench.snapshot()
    block = bench.block(command_v, energised)
    first, fault = 0, Fault.NONE
    if limits is not None and energised:
        command_v, flags, block = _with_reduced_command(bench, guard, before, command_v, flags, block, limits)
        first, fault = guard.judge(block, limits, cursor)
    if fault and first + 1 < command_v.size:
        # The trip acts on the next sample, so later samples of the block are discarded.
        bench.restore(before)
        command_v, flags = command_v[: first + 1], flags[: first + 1]
        block = bench.block(command_v, energised)
    guard.update(block)
    samples = np.zeros(command_v.size, wire.SAMPLE)
    for name, codes in zip(SIGNALS, block.codes.T, strict=True):
        samples[name] = codes
    everywhere = (_ENERGISED if energised else 0) | (_BUTTON if block.button else 0)
    samples["flags"] = flags | everywhere
    samples["flags"][block.flags != 0] |= _SATURATED
    return Sampled(command_v, flags, samples, fault, block.button)
