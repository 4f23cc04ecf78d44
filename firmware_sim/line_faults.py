"""A line that damages, loses, repeats and reorders data, reproducibly for the same seed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from tissueid import wire

Way = Literal["to_host", "to_device"]
Direction = Literal["both", "to_host", "to_device"]
Pieces = Literal["frames", "bursts"]
"""Unit affected by a fault: whole frames, or bursts of bytes with arbitrary boundaries."""

LONGEST_BURST = 64
FURTHEST = 3
"""Largest number of pieces that overtake a delayed one."""

OTHER_VERSION = 2


class _LineFault:
    """One fault of one direction of the line, which affects the share ``share`` of the pieces."""

    def __init__(self, kind: str, share: float, pieces: Pieces, random: np.random.Generator) -> None:
        self._touch = _TOUCH[kind]
        self._share = share
        self._pieces = pieces
        self._random = random
        self.touched = 0
        self._tail = b""
        self._held: list[tuple[int, bytes]] = []

    def carry(self, data: bytes) -> bytes:
        """Return the output for an input; an incomplete frame waits for its end."""
        out = bytearray()
        for piece in self._cut(data):
            touched = self._random.random() < self._share
            self.touched += touched
            out += self._touch(self, piece) if touched else piece
            if not (touched and self._touch is _LineFault.hold):
                out += self._overtaken()
        return bytes(out)

    def rest(self) -> bytes:
        """Return the data that is still in transit."""
        held = b"".join(piece for _, piece in self._held)
        rest, self._held, self._tail = held + self._tail, [], b""
        return rest

    def flip(self, piece: bytes) -> bytes:
        """Invert one bit."""
        damaged = bytearray(piece)
        damaged[self._random.integers(len(piece))] ^= 1 << int(self._random.integers(8))
        return bytes(damaged)

    def drop(self, _: bytes) -> bytes:
        """Lose the piece."""
        return b""

    def repeat(self, piece: bytes) -> bytes:
        """Send the piece twice."""
        return piece + piece

    def hold(self, piece: bytes) -> bytes:
        """Delay the piece behind some of the following ones."""
        self._held.append((int(self._random.integers(1, FURTHEST + 1)), piece))
        return b""

    def relabel(self, piece: bytes) -> bytes:
        """Replace the piece by a valid frame of another protocol version."""
        return b"".join(
            wire.encode_frame(replace(frame, version=OTHER_VERSION)) for frame in wire.FrameDecoder().feed(piece)
        )

    def _overtaken(self) -> bytes:
        self._held = [(left - 1, piece) for left, piece in self._held]
        free = b"".join(piece for left, piece in self._held if left <= 0)
        self._held = [item for item in self._held if item[0] > 0]
        return free

    def _cut(self, data: bytes) -> Iterator[bytes]:
        if self._pieces == "frames":
            *whole, self._tail = (self._tail + data).split(b"\0")
            yield from (piece + b"\0" for piece in whole)
            return
        while data:
            size = int(self._random.integers(1, LONGEST_BURST + 1))
            yield data[:size]
            data = data[size:]


_TOUCH: dict[str, Callable[[_LineFault, bytes], bytes]] = {
    "bit_flips": _LineFault.flip,
    "drops": _LineFault.drop,
    "duplicates": _LineFault.repeat,
    "reordering": _LineFault.hold,
    "wrong_version_frames": _LineFault.relabel,
}

LINE_KINDS = frozenset(_TOUCH)
"""Names of the line faults."""


class LineFaults:
    """Both directions of a line: bytes pass through ``to_host`` or ``to_device``, unchanged without faults."""

    def __init__(self, seed: int = 0) -> None:
        self._random = np.random.default_rng([seed, 0x11E5])
        self._troubles: dict[Way, list[_LineFault]] = {way: [] for way in get_args(Way)}
        self._left: dict[Way, bytes] = dict.fromkeys(get_args(Way), b"")
        self._touched_before = 0

    @property
    def touched(self) -> int:
        """Number of affected pieces so far."""
        return self._touched_before + sum(item.touched for items in self._troubles.values() for item in items)

    def begin(
        self, kind: str, share: float, pieces: Pieces = "frames", direction: Direction = "both"
    ) -> Callable[[], None]:
        """Start a fault that affects the share ``share`` of the pieces; return a function that ends it.

        Raises:
            KeyError: there is no such kind.
        """
        ways: tuple[Way, ...] = get_args(Way) if direction == "both" else (direction,)
        begun = [(way, _LineFault(kind, share, pieces, self._random.spawn(1)[0])) for way in ways]
        for way, trouble in begun:
            self._troubles[way].append(trouble)

        def end() -> None:
            for way, trouble in begun:
                if trouble in self._troubles[way]:
                    self._troubles[way].remove(trouble)
                    self._left[way] += trouble.rest()
                    self._touched_before += trouble.touched

        return end

    def cut(self) -> None:
        """Drop all data in transit when the cable is unplugged."""
        for way, troubles in self._troubles.items():
            self._left[way] = b""
            for trouble in troubles:
                trouble.rest()

    def to_host(self, data: bytes) -> bytes:
        """Return what the host receives of the device's bytes."""
        return self._carry("to_host", data)

    def to_device(self, data: bytes) -> bytes:
        """Return what the device receives of the host's bytes."""
        return self._carry("to_device", data)

    def _carry(self, way: Way, data: bytes) -> bytes:
        data, self._left[way] = self._left[way] + data, b""
        for trouble in self._troubles[way]:
            data = trouble.carry(data)
        return data
