"""Reading the audit log with suspicion: whether every line is there as it was written, and if not, what was done."""

from __future__ import annotations

import hashlib
import os
import re
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from tissueid.audit.line import (
    CANCEL,
    CLOSED_OFF,
    LINES_MISSING,
    MAX_LINE,
    NOTHING_BEFORE,
    STARTED,
    Line,
    is_torn,
    read_line,
)
from tissueid.audit.newest import newest_path, read_newest
from tissueid.errors import UnusableInputError
from tissueid.whole_file import open_regular

_LOOK = 1000
"""Lines between two looks whether it is cancelled."""
MAX_BYTES = 1_000_000_000
"""Bytes of a log: two million lines, some decades of a busy instrument."""
_MOST_TORN = 4 * MAX_LINE
"""Bytes of lines that a dying computer left unfinished; a program that writes closes them off."""
_HEAD = re.compile(r"(?:(\d{1,12}):)?([0-9a-f]{64})")


class Damage(Enum):
    """What was done to a log."""

    CHANGED = "changed"
    REMOVED = "removed"
    INSERTED = "inserted"
    REORDERED = "reordered"
    CUT = "cut off"
    FOREIGN = "foreign"


@dataclass(frozen=True)
class Broken:
    """The first place, a line of the file counted from 1, where a log is not as it was written, and why."""

    place: int
    damage: Damage
    words: str


@dataclass(frozen=True)
class Verification:
    """What a log is: whole where ``broken`` is None. ``remarks`` are no damage, but worth a look."""

    lines: int
    """Whole lines before the first broken one."""
    head: str
    """Number and hash of the newest of them; empty where there is none."""
    broken: Broken | None = None
    remarks: tuple[str, ...] = ()

    @property
    def whole(self) -> bool:
        """Whether nothing was changed, removed, inserted, reordered or cut off."""
        return self.broken is None


def check_head(text: str) -> tuple[int | None, str]:
    """Number, where it is said, and hash of a head as files carry it.

    Raises:
        UnusableInputError: it is none.
    """
    match = _HEAD.fullmatch(text.strip())
    if match is None:
        raise UnusableInputError(
            f"a head of the audit log is NUMBER:HASH with 64 hexadecimal digits, not {text[:80]!r}"
        )
    return None if match[1] is None else int(match[1]), match[2]


def read_lines(path: Path) -> Iterator[Line]:
    """The lines of a log that have the hash that they say, in the order of the file; others are passed over.

    Raises:
        OSError: it cannot be read.
    """
    for raw in _raw_lines(path):
        if (line := read_line(raw.removesuffix(b"\n"))) is not None:
            yield line


def verify(
    path: Path,
    heads: dict[str, str] | None = None,
    *,
    after: Sequence[Path] = (),
    cancelled: Callable[[], None] = lambda: None,
) -> Verification:
    """Go through a log from its first line. ``heads`` are heads that it must hold, and the name of where each stands.

    A log that was cut off at its end is whole in itself: only a head from elsewhere tells, such as the newest one that
    is kept next to the log. ``after`` are earlier logs that hold what this one says is missing. ``cancelled`` is
    called from time to time, and may raise to end it.

    Raises:
        OSError: a log cannot be read.
        UnusableInputError: a head that is none, a log that is too large, or an earlier one that is not whole.
    """
    wanted = [(*check_head(head), where) for head, where in (heads or {}).items()]
    if (newest := read_newest(path)) is not None:
        wanted.insert(0, (*newest, f"the note of the newest line, {newest_path(path)},"))
    walk = _Walk(path, cancelled)
    broken = walk.broken()
    if broken is None:
        for number, own, where in wanted:
            if own not in walk.hashes:
                broken = _missing(number, walk, where)
                break
    if broken is None and walk.missing:
        broken = _not_in(walk, _hashes_of(after, cancelled))
    last = walk.last
    return Verification(
        0 if last is None else last.number, "" if last is None else last.head, broken, tuple(walk.remarks)
    )


def _hashes_of(logs: Sequence[Path], cancelled: Callable[[], None]) -> set[str]:
    """The hashes of all lines of logs.

    Raises:
        UnusableInputError: one is not whole.
    """
    hashes: set[str] = set()
    for path in logs:
        walk = _Walk(path, cancelled)
        if (broken := walk.broken()) is not None:
            raise UnusableInputError(f"{path}: {broken.words}")
        hashes |= walk.hashes
    return hashes


def _not_in(walk: _Walk, known: set[str]) -> Broken | None:
    """The first line that says that others are missing which no earlier log holds either."""
    for place, number, own in walk.missing:
        if own not in known:
            words = (
                f"line {place} says that lines up to {number} were in the log before and are not there: it was "
                "emptied, cut off or removed. Where it was moved away, name the file that it is now with --after"
            )
            return Broken(place, Damage.CUT, words)
    return None


def _missing(number: int | None, walk: _Walk, where: str) -> Broken:
    """A head that the log should hold is not in it."""
    lines = 0 if walk.last is None else walk.last.number
    if number is not None and number <= lines:
        words = f"{where} was written when line {number} had another hash: this is another log, or one made anew"
        return Broken(number, Damage.FOREIGN, words)
    line = "another line" if number is None else f"line {number}"
    words = f"{where} was written when the log had {line}, and it ends with line {lines}: its end was cut off"
    return Broken(lines + 1, Damage.CUT, words)


class _Walk:
    """One way through a log, up to the first place where it is broken."""

    def __init__(self, path: Path, cancelled: Callable[[], None]) -> None:
        self._cancelled = cancelled
        self.last: Line | None = None
        self.hashes: set[str] = set()
        self.remarks: list[str] = []
        self.missing: list[tuple[int, int | None, str]] = []
        """Of each line that says that others are missing: its place, and number and hash of the newest of those."""
        self._path = path
        self._place = 0
        self._torn = b""
        """Torn pieces that a line to come must account for."""

    def broken(self) -> Broken | None:
        """The first broken place, or None when there is none."""
        for raw in _raw_lines(self._path):
            if self._place % _LOOK == 0:
                self._cancelled()
            self._place += 1
            if (problem := self._take(raw)) is not None:
                return problem
        if self._torn:
            self.remarks.append(
                f"line {self._place}, the last, was not finished when the computer or the program died; the next one "
                "that is added will say so"
            )
        return None

    def _take(self, raw: bytes) -> Broken | None:
        number = 1 if self.last is None else self.last.number + 1
        line = read_line(raw.removesuffix(b"\n"))
        if line is None:
            finished = raw.endswith(b"\n")
            piece = raw.removesuffix(b"\n").removesuffix(CANCEL)
            if is_torn(piece, number) and (not finished or raw.endswith(CANCEL + b"\n")):
                self._torn += raw
                if len(self._torn) > _MOST_TORN:
                    return self._tell(raw, number, None)
                return None
            return self._tell(raw, number, None)
        before = NOTHING_BEFORE if self.last is None else self.last.hash
        if line.number != number or line.previous != before:
            return self._tell(raw, number, line)
        if self._torn:
            left = {"bytes": len(self._torn), "sha256": hashlib.sha256(self._torn).hexdigest()}
            if line.what != CLOSED_OFF or line.new != left:
                words = f"{len(self._torn)} bytes before line {number} are no line, and it does not account for them"
                return Broken(self._place - 1, Damage.INSERTED, words)
            self.remarks.append(f"before line {number} a line was left unfinished, and closed off")
            self._torn = b""
        if number == 1 and line.what not in (STARTED, CLOSED_OFF):
            return Broken(1, Damage.FOREIGN, "its first line does not begin an audit log")
        if self.last is not None and line.time < self.last.time:
            self.remarks.append(f"the clock goes back at line {number}, from {self.last.time} to {line.time}")
        if not raw.endswith(b"\n"):
            self.remarks.append(f"line {number} lacks its end: the computer died while it was written")
        if line.what == LINES_MISSING and isinstance(line.old, str) and (head := _HEAD.fullmatch(line.old)):
            self.missing.append((self._place, int(head[1]) if head[1] else None, head[2]))
        self.last = line
        self.hashes.add(line.hash)
        return None

    def _tell(self, raw: bytes, number: int, line: Line | None) -> Broken:
        """What was done where line ``number`` should stand and ``raw``, with or without a hash that is right, does."""
        place = self._place
        later = {item.number: item for item in self._after(place)}
        if line is None:
            following = later.get(number)
            if following is not None and self._continues(following):
                return Broken(place, Damage.INSERTED, f"what stands before line {number} is not part of the log")
            if number == 1 and not later:
                return Broken(1, Damage.FOREIGN, "it does not begin with a line of an audit log")
            what = "was cut short" if not raw.endswith(b"\n") and b'"hash"' not in raw else "was changed"
            return Broken(place, Damage.CHANGED, f"line {number} {what}: it does not have the hash that it says")
        if line.hash in self.hashes:
            return Broken(place, Damage.INSERTED, f"a copy of line {line.number} stands where line {number} should")
        if line.number > number:
            if number in later:
                words = f"line {line.number} stands where line {number} should, which comes later"
                return Broken(place, Damage.REORDERED, words)
            gone = f"line {number} is" if line.number == number + 1 else f"lines {number} to {line.number - 1} are"
            return Broken(place, Damage.REMOVED, f"{gone} not there")
        if line.number < number:
            words = f"two lines have number {line.number}: one of them is not part of the log"
            return Broken(place - 1, Damage.INSERTED, words)
        words = f"line {number} continues another line than the one before it: one of the two was exchanged"
        return Broken(max(1, place - 1), Damage.CHANGED, words)

    def _continues(self, line: Line) -> bool:
        return line.previous == (NOTHING_BEFORE if self.last is None else self.last.hash)

    def _after(self, place: int) -> Iterator[Line]:
        """The whole lines after a place."""
        for count, raw in enumerate(_raw_lines(self._path), start=1):
            if count > place and (line := read_line(raw.removesuffix(b"\n"))) is not None:
                yield line


def _raw_lines(path: Path) -> Iterator[bytes]:
    """Lines with their newlines; what is longer than a line can be comes in pieces.

    What is added while they are read is left for the next time.

    Raises:
        OSError: it cannot be read, or is no ordinary file.
        UnusableInputError: it is too large.
    """
    with open_regular(path) as file:
        left = os.fstat(file.fileno()).st_size
        if left > MAX_BYTES:
            raise UnusableInputError(f"{path} has {left / 1e6:.0f} MB; at most {MAX_BYTES / 1e6:.0f} MB are read")
        while raw := file.readline(min(MAX_LINE, left)):
            left -= len(raw)
            yield raw


def last_lines(path: Path, count: int) -> list[Line]:
    """The newest lines of a log, oldest first.

    Raises:
        OSError: it cannot be read.
    """
    return list(deque(read_lines(path), maxlen=count))
