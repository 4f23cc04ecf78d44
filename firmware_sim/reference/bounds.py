"""Upper bounds of a built microcontroller target, from its disassembly: cycles of the sample interrupt, stack, memory.

Cycles: the most expensive path through the instructions of the interrupt and of all functions that it calls, whether an
input can take it or not; a loop counts as often as it runs at most. So no input takes longer, as long as the assumed
cycles of an instruction hold: code and variables in memory without wait states, no two instructions at once.
Stack: the sum of the frames along the deepest path of calls. Recursion, calls by pointer, frames of variable size and
loops without a known bound are errors.
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from firmware_sim.reference.tools import tool

LOOPS: Mapping[str, int] = {
    "plausibility_check": 9,
    "firmware_take": 7,
    "memset": 4,
    "board_read": 7,
    "board_clock_us": 3,
}
"""Largest number of passes of any loop of a function that the interrupt calls: older summaries of 10 ms; channels;
bytes before and after the words, and 16 bytes at once of the 56 of a summary; channels; readings of a slow counter."""

ENTRY_CYCLES = 60
"""Entry into an interrupt and return: 26 words of registers each way, and vectors."""
EXCEPTION_BYTES = 108
"""Registers that an interrupt saves, with those of the floating-point unit and the alignment."""

_CYCLES: tuple[tuple[str, int], ...] = (
    (r"vdiv\.f64|vsqrt\.f64", 32),
    (r"vdiv\.f32|vsqrt\.f32", 18),
    (r"vf?n?m[ul][las]\w*\.f64", 10),
    (r"v\w+\.f64(\.\w+)?", 5),
    (r"v(ldr|str)", 3),
    (r"v\w+(\.\w+)*", 3),
    (r"[us]div", 12),
    (r"[us]m[ul][la]l?", 2),
    (r"b|b[a-z]{2}|bl|bx|blx|cbn?z|tb[bh]", 9),
    (r"ldr\w*|str\w*", 3),
    (r".*", 1),
)
"""Cycles that are assumed for an instruction of a Cortex-M7, the first pattern that fits. ARM publishes none; these are
on the slow side. A list of registers adds one cycle each."""


@dataclass
class _Function:
    """A function: address, mnemonic and operands of each instruction."""

    name: str
    code: list[tuple[int, str, str]] = field(default_factory=list)


class BoundError(RuntimeError):
    """There is no bound; the message says why."""


@dataclass(frozen=True)
class Bounds:
    """Bounds of a program: cycles, instructions and duration of its sample interrupt, memory in bytes.

    ``seconds`` includes the transfers to the converters and the interrupts of higher priority. ``stack`` is that of the
    main loop and of all interrupts on top of it.
    """

    cycles: int
    instructions: int
    seconds: float
    stack: int
    code_bytes: int
    variable_bytes: int


class Program:
    """A linked program.

    Args:
        listing: output of ``objdump -d --no-show-raw-insn``.
    """

    def __init__(self, listing: str) -> None:
        self.functions = dict(_functions(listing))

    def cost(self, root: str, free: Iterable[str] = ()) -> tuple[int, int]:
        """Return the largest numbers of cycles and of instructions of a call of ``root``, without those of ``free``.

        Raises:
            BoundError: there is no bound.
        """
        known: dict[str, tuple[int, int]] = dict.fromkeys(free, (0, 0))
        return self._cost(root, known, ())

    def _cost(self, name: str, known: dict[str, tuple[int, int]], path: tuple[str, ...]) -> tuple[int, int]:
        if name not in known:
            function = self._function(name, path)
            places = {address: k for k, (address, _, _) in enumerate(function.code)}
            after = [_successors(function, k, places) for k in range(len(function.code))]
            own = [(_cycles(mnemonic, operands), 1) for _, mnemonic, operands in function.code]
            for k, (_, mnemonic, operands) in enumerate(function.code):
                if called := self._called(function, mnemonic, operands):
                    below = self._cost(called, known, (*path, name))
                    own[k] = own[k][0] + below[0], own[k][1] + below[1]
            cycles, count = (_longest(name, [item[part] for item in own], after) for part in (0, 1))
            known[name] = cycles, count
        return known[name]

    def stack(self, root: str, free: Iterable[str] = ()) -> int:
        """Return the largest stack of a call of ``root`` in bytes, without that of ``free``.

        Raises:
            BoundError: there is no bound.
        """
        return self._stack(root, dict.fromkeys(free, 0), ())

    def _stack(self, name: str, known: dict[str, int], path: tuple[str, ...]) -> int:
        if name not in known:
            function = self._function(name, path)
            frame = sum(_pushed(name, mnemonic, operands) for _, mnemonic, operands in function.code)
            calls = {self._called(function, mnemonic, operands) for _, mnemonic, operands in function.code}
            below = [self._stack(item, known, (*path, name)) for item in calls if item]
            known[name] = frame + max(below, default=0)
        return known[name]

    def _function(self, name: str, path: tuple[str, ...]) -> _Function:
        if name in path:
            raise BoundError(f"recursion: {' -> '.join((*path, name))}")
        if name not in self.functions:
            raise BoundError(f"no function {name}")
        return self.functions[name]

    def _called(self, function: _Function, mnemonic: str, operands: str) -> str | None:
        """Return the function that an instruction calls or continues in."""
        if mnemonic == "blx" or (mnemonic == "bx" and operands.strip() != "lr"):
            raise BoundError(f"call by pointer in {function.name}")
        if not mnemonic.startswith(("b", "cb")) or mnemonic.startswith(("bic", "bfi", "bfc", "bkpt")):
            return None
        target = re.search(r"<([^+>]+)(?:\+0x[0-9a-f]+)?>", operands)
        if target is None or (target[1] == function.name and mnemonic != "bl"):
            return None
        return target[1]


def _functions(listing: str) -> Iterable[tuple[str, _Function]]:
    function = _Function("")
    for line in listing.splitlines():
        if head := re.match(r"[0-9a-f]+ <(.+)>:$", line):
            function = _Function(head[1])
            yield head[1], function
        elif (row := re.match(r"\s*([0-9a-f]+):\t(\S+)\s*(.*)", line)) and not row[2].startswith("."):
            function.code.append((int(row[1], 16), re.sub(r"\.[nw]$", "", row[2]), row[3]))


def _longest(name: str, costs: list[int], after: list[list[int]]) -> int:
    """Return the cost of the most expensive path through a function from its first instruction on.

    Args:
        name: of the function, for the bound of its loops.
        costs: of each instruction.
        after: instructions that may follow each.
    """

    def walk(nodes: set[int], first: int, after: Mapping[int, list[int]]) -> int:
        loops = _loops(nodes, after)
        if loops and name not in LOOPS:
            raise BoundError(f"loop without a known bound in {name}")
        place = {node: k for k, loop in enumerate(loops) for node in loop}
        total: dict[int, int] = {}
        for node in _backwards(first, nodes, after):
            if node in total:
                continue
            members = loops[place[node]] if node in place else {node}
            if node in place:
                entered = {n for k in nodes - members for n in after[k] if n in members} | ({first} & members)
                # Loops within this one: without the ways back to where it is entered.
                inner = {k: [n for n in after[k] if n in members and n not in entered] for k in members}
                own = LOOPS[name] * max(walk(members, entry, inner) for entry in entered)
            else:
                own = costs[node]
            left = (total[n] for k in members for n in after[k] if n in nodes and n not in members)
            total |= dict.fromkeys(members, own + max(left, default=0))
        return total[first]

    return walk(set(range(len(costs))), 0, dict(enumerate(after)))


def _backwards(first: int, nodes: set[int], after: Mapping[int, list[int]]) -> list[int]:
    """Return the nodes that can be reached, each after all that follow it on a path without loops."""
    order: list[int] = []
    seen = {first}
    waiting = [(first, iter(after[first]))]
    while waiting:
        node, following = waiting[-1]
        for n in following:
            if n in nodes and n not in seen:
                seen.add(n)
                waiting.append((n, iter(after[n])))
                break
        else:
            order.append(node)
            waiting.pop()
    return order


def _successors(function: _Function, k: int, places: Mapping[int, int]) -> list[int]:
    """Return the instructions that may follow instruction ``k`` in its function."""
    _, mnemonic, operands = function.code[k]
    if mnemonic.startswith("tb"):
        raise BoundError(f"table of branches in {function.name}")
    following = [k + 1] if k + 1 < len(function.code) else []
    leaves = mnemonic == "bx" or ("pc" in operands and mnemonic in ("pop", "ldmia", "ldr") and "[pc" not in operands)
    if leaves or not mnemonic.startswith(("b", "cb")) or mnemonic in ("bl", "bic", "bics", "bfi", "bfc"):
        return [] if leaves else following
    target = re.search(r"([0-9a-f]+) <([^+>]+)", operands)
    taken = [places[int(target[1], 16)]] if target and target[2] == function.name else []
    return taken if mnemonic == "b" else [*taken, *following]


def _loops(nodes: set[int], after: Mapping[int, list[int]]) -> list[set[int]]:
    """Return the sets of nodes that can reach each other and themselves."""
    reached = {}
    for start in nodes:
        seen: set[int] = set()
        waiting = list(after[start])
        while waiting:
            node = waiting.pop()
            if node in nodes and node not in seen:
                seen.add(node)
                waiting += after[node]
        reached[start] = seen
    found: list[set[int]] = []
    for start in sorted(nodes):
        if start in reached[start] and not any(start in loop for loop in found):
            found.append({node for node in reached[start] if start in reached[node]})
    return found


def _registers(operands: str) -> int:
    """Return the number of registers of a list in braces."""
    count = 0
    inside = re.search(r"\{(.*?)\}", operands)
    for part in inside[1].split(",") if inside else ():
        first, _, last = part.strip().partition("-")
        count += int(last[1:]) - int(first[1:]) + 1 if last else 1
    return count


def _cycles(mnemonic: str, operands: str) -> int:
    return next(cost for pattern, cost in _CYCLES if re.fullmatch(pattern, mnemonic)) + _registers(operands)


def _pushed(name: str, mnemonic: str, operands: str) -> int:
    """Return by how many bytes an instruction lowers the stack pointer."""
    if mnemonic in ("push", "vpush") or (mnemonic in ("stmdb", "vstmdb") and operands.startswith("sp!")):
        return _registers(operands) * (8 if "{d" in operands else 4)
    if moved := re.search(r"\[sp, #-(\d+)\]!", operands):
        return int(moved[1])
    if mnemonic.startswith("sub") and operands.startswith("sp,"):
        amount = re.search(r"#(\d+)", operands)
        if amount is None:
            raise BoundError(f"frame of variable size in {name}")
        return int(amount[1])
    return 0


@dataclass(frozen=True)
class Timing:
    """Interrupts of a target and its clock."""

    clock_hz: float
    interrupt: str = "sample_interrupt"
    others: tuple[str, ...] = ()
    """Other interrupts: one that the sample interrupt interrupts, or that interrupts it, for each level of priority."""
    root: str = "reset"
    free: tuple[str, ...] = ()
    """Functions that do not count: the simulated plant, or what waits for a converter."""
    transfer_s: float = 0.0
    """Time of the transfers to the converters."""
    preempting: str | None = None
    """Interrupt that interrupts the one of the samples."""
    preemptions: int = 0
    """How often it does so in one sample at most."""


TIMINGS: Mapping[str, Timing] = {
    "qemu": Timing(25e6, others=("line_interrupt",), free=("plant_step", "plant_init")),
    # At 16 MHz, 8 words of 16 bits of a conversion and 24 bits of a command; half as much again for pauses.
    # In 500 us the line brings 47 bytes.
    "stm32h743": Timing(
        64e6,
        others=("line_interrupt",),
        free=("spi_exchange",),
        transfer_s=1.5 * (128 + 24) / 16e6,
        preempting="line_interrupt",
        preemptions=47,
    ),
}
"""By the name of the target."""


def _output(name: str, *arguments: str) -> str:
    program = tool("bounds: not computed", f"arm-none-eabi-{name}")
    return subprocess.run([program, *arguments], capture_output=True, text=True, check=True).stdout


def bounds_of(path: Path, timing: Timing) -> Bounds:
    """Return the bounds of a program.

    Args:
        path: ELF file.
        timing: of its board.

    Raises:
        MissingToolError: there is no disassembler.
        BoundError: there is no bound.
    """
    program = Program(_output("objdump", "-d", "--no-show-raw-insn", str(path)))
    cycles, instructions = program.cost(timing.interrupt, timing.free)
    meanwhile = 0
    if timing.preempting is not None:
        meanwhile = timing.preemptions * (program.cost(timing.preempting)[0] + ENTRY_CYCLES)
    interrupts = (timing.interrupt, *timing.others)
    rows = (line.split() for line in _output("size", "-A", str(path)).splitlines())
    memory = {row[0]: int(row[1]) for row in rows if len(row) == 3 and row[0].startswith(".")}
    return Bounds(
        cycles + ENTRY_CYCLES,
        instructions,
        (cycles + ENTRY_CYCLES + meanwhile) / timing.clock_hz + timing.transfer_s,
        program.stack(timing.root, timing.free)
        + sum(program.stack(name, timing.free) + EXCEPTION_BYTES for name in interrupts),
        sum(memory.get(name, 0) for name in (".text", ".ARM.exidx", ".data")),
        sum(memory.get(name, 0) for name in (".data", ".bss")),
    )


def words(bounds: Bounds) -> str:
    """Return the bounds in one line."""
    return (
        f"sample interrupt at most {bounds.cycles} cycles, {bounds.seconds * 1e6:.0f} us of 500 us; stack at most "
        f"{bounds.stack} bytes; code {bounds.code_bytes} bytes, variables {bounds.variable_bytes} bytes"
    )
