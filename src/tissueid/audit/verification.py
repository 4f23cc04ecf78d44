"""Verification of the audit log: whether every line is present and unchanged, and if not, what was done."""

from __future__ import annotations

import hashlib
import os
import re
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from tissueid.atomic_write import open_regular
from tissueid.audit.line import (
    CANCEL,
    CLOSED_OFF,
    LINES_MISSING,
    MAX_LINE,
    NOTHING_BEFORE,
    STARTED,
    LogLine,
    is_torn,
    read_line,
)
from tissueid.audit.log import newest_path, read_newest
from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.messages import Action, Message

_CANCEL_LINES = 1000
"""Lines between two checks for cancellation."""
MAX_BYTES = 1_000_000_000
"""Largest log that is read, bytes: two million lines, decades of daily use."""
_MOST_TORN = 4 * MAX_LINE
"""Most bytes of unfinished lines, which a crash can leave; the next writer closes them off."""
_HEAD = re.compile(r"(?:(\d{1,12}):)?([0-9a-f]{64})")


class LogDamage(Enum):
    """Kind of damage of a log."""

    CHANGED = marked("changed")
    REMOVED = marked("removed")
    INSERTED = marked("inserted")
    REORDERED = marked("reordered")
    CUT = marked("cut off")
    FOREIGN = marked("foreign")


@dataclass(frozen=True)
class Broken:
    """The first damage of a log: ``line`` is counted from 1 in the file, and ``message`` describes it."""

    line: int
    damage: LogDamage
    message: str


@dataclass(frozen=True)
class Verification:
    """Result of a verification: whole if ``broken`` is None. ``remarks`` report what is unusual but not damage."""

    lines: int
    """Lines before the first damage."""
    head: str
    """Number and hash of the newest of these lines; empty without lines."""
    broken: Broken | None = None
    remarks: tuple[str, ...] = ()

    @property
    def whole(self) -> bool:
        """Whether the log has no damage."""
        return self.broken is None


def check_head(text: str) -> tuple[int | None, str]:
    """Return number (None without one) and hash of a head as stored in files.

    Raises:
        UnusableInputError: the text is not a head.
    """
    match = _HEAD.fullmatch(text.strip())
    if match is None:
        raise UnusableInputError(
            "audit.head",
            "a head of the audit log is NUMBER:HASH with 64 hexadecimal digits, not {text}",
            text=repr(text[:80]),
        )
    return None if match[1] is None else int(match[1]), match[2]


def read_lines(path: Path) -> Iterator[LogLine]:
    """Yield the lines of a log whose hash is correct, in the order of the file. Other lines are skipped.

    Raises:
        OSError: the log cannot be read.
    """
    for raw in _raw_lines(path):
        if (line := read_line(raw.removesuffix(b"\n"))) is not None:
            yield line


def verify(
    path: Path,
    heads: dict[str, str] | None = None,
    *,
    after: Sequence[Path] = (),
    cancelled: Callable[[], object] = lambda: None,
) -> Verification:
    """Verify a log from its first line.

    A log that was cut off at its end is consistent in itself. Only a head from another file shows the loss, such as
    the newest head stored next to the log.

    Args:
        path: of the log.
        heads: heads that the log must contain, each with the name of its source.
        after: earlier logs with the lines that this log reports as missing.
        cancelled: called regularly; may raise to cancel.

    Raises:
        OSError: a log cannot be read.
        UnusableInputError: a head is invalid, a log is too large, or an earlier log is damaged.
    """
    wanted = [(*check_head(head), where) for head, where in (heads or {}).items()]
    if (newest := read_newest(path)) is not None:
        note = Message("audit.newest_note", "the note of the newest line, {path},", path=str(newest_path(path)))
        wanted.insert(0, (*newest, note))
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


def _hashes_of(logs: Sequence[Path], cancelled: Callable[[], object]) -> set[str]:
    """Return the hashes of all lines of some logs.

    Raises:
        UnusableInputError: a log is damaged.
    """
    hashes: set[str] = set()
    for path in logs:
        walk = _Walk(path, cancelled)
        if (broken := walk.broken()) is not None:
            raise UnusableInputError("audit.earlier_damaged", "{path}: {why}", path=str(path), why=broken.message)
        hashes |= walk.hashes
    return hashes


def _not_in(walk: _Walk, earlier_hashes: set[str]) -> Broken | None:
    """Return the first line that reports missing lines which no earlier log contains."""
    for position, number, own in walk.missing:
        if own not in earlier_hashes:
            name_file = Action(
                "audit.after", "tissueid audit verify --after FILE", marked("verify in the shell with --after FILE")
            )
            if number is None:
                message = Message(
                    "audit.lines_missing",
                    "line {place} reports that earlier lines of the log are missing: the log was emptied, cut off or "
                    "removed. If it was moved, name the file: {action}",
                    place=position,
                    action=name_file,
                )
            else:
                message = Message(
                    "audit.lines_missing",
                    "line {place} reports that lines up to {number} of the log are missing: the log was emptied, cut "
                    "off or removed. If it was moved, name the file: {action}",
                    place=position,
                    number=number,
                    action=name_file,
                )
            return Broken(position, LogDamage.CUT, message)
    return None


def _missing(number: int | None, walk: _Walk, where: str) -> Broken:
    """Return the damage of a log that does not contain the head from ``where``."""
    lines = 0 if walk.last is None else walk.last.number
    if number is None:
        message = Message(
            "audit.cut_off",
            "{where} was written with a later line, and the log ends with line {lines}: its end was cut off",
            where=where,
            lines=lines,
        )
        return Broken(lines + 1, LogDamage.CUT, message)
    if number <= lines:
        message = Message(
            "audit.other_log",
            "{where} was written when line {number} had another hash: this is another log, or a new one",
            where=where,
            number=number,
        )
        return Broken(number, LogDamage.FOREIGN, message)
    message = Message(
        "audit.cut_off",
        "{where} was written when the log had line {number}, and it ends with line {lines}: its end was cut off",
        where=where,
        number=number,
        lines=lines,
    )
    return Broken(lines + 1, LogDamage.CUT, message)


class _Walk:
    """One pass through a log, up to the first damage."""

    def __init__(self, path: Path, cancelled: Callable[[], object]) -> None:
        self._cancelled = cancelled
        self.last: LogLine | None = None
        self.hashes: set[str] = set()
        self.remarks: list[str] = []
        self.missing: list[tuple[int, int | None, str]] = []
        """Place of each line that reports missing lines, with number and hash of the newest missing line."""
        self._path = path
        self._position = 0
        self._torn = b""
        """Unfinished pieces that a later line must account for."""

    def broken(self) -> Broken | None:
        """Return the first damage; None without any."""
        for raw in _raw_lines(self._path):
            if self._position % _CANCEL_LINES == 0:
                self._cancelled()
            self._position += 1
            if (problem := self._check_line(raw)) is not None:
                return problem
        if self._torn:
            self.remarks.append(
                Message(
                    "audit.last_unfinished",
                    "line {line}, the last, was not finished when the computer or the program stopped; the next line "
                    "will record it",
                    line=self._position,
                )
            )
        return None

    def _check_line(self, raw: bytes) -> Broken | None:
        number = 1 if self.last is None else self.last.number + 1
        line = read_line(raw.removesuffix(b"\n"))
        if line is None:
            finished = raw.endswith(b"\n")
            piece = raw.removesuffix(b"\n").removesuffix(CANCEL)
            if is_torn(piece, number) and (not finished or raw.endswith(CANCEL + b"\n")):
                self._torn += raw
                if len(self._torn) > _MOST_TORN:
                    return self._damage(raw, number, None)
                return None
            return self._damage(raw, number, None)
        before = NOTHING_BEFORE if self.last is None else self.last.hash
        if line.number != number or line.previous != before:
            return self._damage(raw, number, line)
        if self._torn:
            expected = {"bytes": len(self._torn), "sha256": hashlib.sha256(self._torn).hexdigest()}
            if line.what != CLOSED_OFF or line.new != expected:
                message = Message(
                    "audit.foreign_bytes",
                    "{count} bytes before line {line} are not a line, and that line does not account for them",
                    count=len(self._torn),
                    line=number,
                )
                return Broken(self._position - 1, LogDamage.INSERTED, message)
            self.remarks.append(
                Message(
                    "audit.closed_off", "before line {line} a line was left unfinished, and closed off", line=number
                )
            )
            self._torn = b""
        if number == 1 and line.what not in (STARTED, CLOSED_OFF):
            return Broken(1, LogDamage.FOREIGN, Message("audit.no_start", "its first line does not begin an audit log"))
        if self.last is not None and line.time < self.last.time:
            self.remarks.append(
                Message(
                    "audit.clock",
                    "the clock goes back at line {line}, from {old} to {new}",
                    line=number,
                    old=self.last.time,
                    new=line.time,
                )
            )
        if not raw.endswith(b"\n"):
            self.remarks.append(
                Message(
                    "audit.no_newline",
                    "line {line} has no end of line: the computer stopped while it was written",
                    line=number,
                )
            )
        if line.what == LINES_MISSING and isinstance(line.old, str) and (head := _HEAD.fullmatch(line.old)):
            self.missing.append((self._position, int(head[1]) if head[1] else None, head[2]))
        self.last = line
        self.hashes.add(line.hash)
        return None

    def _damage(self, raw: bytes, number: int, line: LogLine | None) -> Broken:
        """Return the damage where ``raw`` stands in place of line ``number``; ``line`` is None if its hash is wrong."""
        position = self._position
        later = {item.number: item for item in self._after(position)}
        if line is None:
            return self._without_hash(raw, number, later)
        if line.hash in self.hashes:
            message = Message(
                "audit.copy",
                "a copy of line {copied} is in the place of line {line}",
                copied=line.number,
                line=number,
            )
            return Broken(position, LogDamage.INSERTED, message)
        if line.number > number:
            if number in later:
                message = Message(
                    "audit.reordered",
                    "line {found} is in the place of line {line}, which comes later",
                    found=line.number,
                    line=number,
                )
                return Broken(position, LogDamage.REORDERED, message)
            if line.number == number + 1:
                message = Message("audit.removed", "line {line} is missing", line=number)
            else:
                message = Message(
                    "audit.removed", "lines {line} to {last} are missing", line=number, last=line.number - 1
                )
            return Broken(position, LogDamage.REMOVED, message)
        if line.number < number:
            message = Message(
                "audit.twice", "two lines have number {line}: one of them is not part of the log", line=line.number
            )
            return Broken(position - 1, LogDamage.INSERTED, message)
        message = Message(
            "audit.exchanged",
            "line {line} does not continue the line before it: one of the two was replaced",
            line=number,
        )
        return Broken(max(1, position - 1), LogDamage.CHANGED, message)

    def _without_hash(self, raw: bytes, number: int, later: dict[int, LogLine]) -> Broken:
        """Return the damage where the bytes in place of line ``number`` do not have a correct hash."""
        position = self._position
        following = later.get(number)
        before = NOTHING_BEFORE if self.last is None else self.last.hash
        if following is not None and following.previous == before:
            message = Message("audit.inserted", "the text before line {line} is not part of the log", line=number)
            return Broken(position, LogDamage.INSERTED, message)
        if number == 1 and not later:
            return Broken(
                1, LogDamage.FOREIGN, Message("audit.foreign", "it does not begin with a line of an audit log")
            )
        if not raw.endswith(b"\n") and b'"hash"' not in raw:
            message = Message("audit.cut_short", "line {line} was cut short: its hash is missing", line=number)
        else:
            message = Message("audit.changed", "line {line} was changed: its hash is wrong", line=number)
        return Broken(position, LogDamage.CHANGED, message)

    def _after(self, position: int) -> Iterator[LogLine]:
        """Yield the lines with a correct hash after a place."""
        for count, raw in enumerate(_raw_lines(self._path), start=1):
            if count > position and (line := read_line(raw.removesuffix(b"\n"))) is not None:
                yield line


def _raw_lines(path: Path) -> Iterator[bytes]:
    """Yield the lines of the file with their newlines; a line longer than ``MAX_LINE`` comes in pieces.

    Lines that are added during reading are not included.

    Raises:
        OSError: the file cannot be read, or is not an ordinary file.
        UnusableInputError: the file is too large.
    """
    with open_regular(path) as file:
        remaining = os.fstat(file.fileno()).st_size
        if remaining > MAX_BYTES:
            raise UnusableInputError(
                "audit.too_large",
                "{path} has {size:.0f} MB; at most {most:.0f} MB are read",
                path=str(path),
                size=remaining / 1e6,
                most=MAX_BYTES / 1e6,
            )
        while raw := file.readline(min(MAX_LINE, remaining)):
            remaining -= len(raw)
            yield raw


def last_lines(path: Path, count: int) -> list[LogLine]:
    """Return the newest lines of a log, oldest first.

    Raises:
        OSError: the log cannot be read.
    """
    return list(deque(read_lines(path), maxlen=count))
