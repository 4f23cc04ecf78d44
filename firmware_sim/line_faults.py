"""A line that damages, loses, repeats and reorders what it carries, the same way every time for the same seed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from tissueid import wire

Way = Literal["to_host", "to_device"]
Direction = Literal["both", "to_host", "to_device"]
Pieces = Literal["frames", "bursts"]
"""What a line takes hold of: whole frames, or runs of bytes that begin and end anywhere."""

LONGEST_BURST = 64
FURTHEST = 3
"""How many pieces, at most, overtake one that is held back."""

OTHER_VERSION = 2


class _Trouble:
    """One thing that is wrong with one way of the line. ``share`` of the pieces are touched."""

    def __init__(self, kind: str, share: float, pieces: Pieces, random: np.random.Generator) -> None:
        self._touch = _TOUCH[kind]
        self._share = share
        self._pieces = pieces
        self._random = random
        self.touched = 0
        self._tail = b""
        self._held: list[tuple[int, bytes]] = []

    def carry(self, data: bytes) -> bytes:
        """What comes out when ``data`` goes in; the beginning of a frame waits for its end."""
        out = bytearray()
        for piece in self._cut(data):
            touched = self._random.random() < self._share
            self.touched += touched
            out += self._touch(self, piece) if touched else piece
            if not (touched and self._touch is _Trouble.hold):
                out += self._overtaken()
        return bytes(out)

    def rest(self) -> bytes:
        """What is still on the way."""
        held = b"".join(piece for _, piece in self._held)
        rest, self._held, self._tail = held + self._tail, [], b""
        return rest

    def flip(self, piece: bytes) -> bytes:
        """One bit of it is turned over."""
        damaged = bytearray(piece)
        damaged[self._random.integers(len(piece))] ^= 1 << int(self._random.integers(8))
        return bytes(damaged)

    def drop(self, _: bytes) -> bytes:
        """It never arrives."""
        return b""

    def repeat(self, piece: bytes) -> bytes:
        """It arrives twice."""
        return piece + piece

    def hold(self, piece: bytes) -> bytes:
        """It is overtaken by some of those that follow."""
        self._held.append((int(self._random.integers(1, FURTHEST + 1)), piece))
        return b""

    def relabel(self, piece: bytes) -> bytes:
        """A whole frame of another version of the protocol comes in its place."""
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


_TOUCH: dict[str, Callable[[_Trouble, bytes], bytes]] = {
    "bit_flips": _Trouble.flip,
    "drops": _Trouble.drop,
    "duplicates": _Trouble.repeat,
    "reordering": _Trouble.hold,
    "wrong_version_frames": _Trouble.relabel,
}

LINE_KINDS = frozenset(_TOUCH)
"""What can be wrong with a line."""


class LineFaults:
    """Both ways of a line: bytes go through ``to_host`` or ``to_device``, and without trouble come out as they are."""

    def __init__(self, seed: int = 0) -> None:
        self._random = np.random.default_rng([seed, 0x11E5])
        self._troubles: dict[Way, list[_Trouble]] = {way: [] for way in get_args(Way)}
        self._left: dict[Way, bytes] = dict.fromkeys(get_args(Way), b"")
        self._touched_before = 0

    @property
    def touched(self) -> int:
        """How many pieces were touched so far."""
        return self._touched_before + sum(item.touched for items in self._troubles.values() for item in items)

    def begin(
        self, kind: str, share: float, pieces: Pieces = "frames", direction: Direction = "both"
    ) -> Callable[[], None]:
        """From now on ``share`` of the pieces are touched; returns what ends it.

        Raises:
            KeyError: no such kind.
        """
        ways: tuple[Way, ...] = get_args(Way) if direction == "both" else (direction,)
        begun = [(way, _Trouble(kind, share, pieces, self._random.spawn(1)[0])) for way in ways]
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
        """The cable is pulled: what was on its way is gone."""
        for way, troubles in self._troubles.items():
            self._left[way] = b""
            for trouble in troubles:
                trouble.rest()

    def to_host(self, data: bytes) -> bytes:
        """What the host hears of what the device sent."""
        return self._carry("to_host", data)

    def to_device(self, data: bytes) -> bytes:
        """What the device hears of what the host sent."""
        return self._carry("to_device", data)

    def _carry(self, way: Way, data: bytes) -> bytes:
        data, self._left[way] = self._left[way] + data, b""
        for trouble in self._troubles[way]:
            data = trouble.carry(data)
        return data
