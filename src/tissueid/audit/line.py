"""One line of the audit log as bytes: JSON that ends with the SHA-256 of all that stands before it.

What stands before it holds the hash of the line before, so that no line can be changed, taken out, put in or moved
without every later one telling. The bytes themselves are hashed: there is no second way to write a line.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from dataclasses import asdict, dataclass
from typing import Any

NOTHING_BEFORE = "0" * 64
"""The hash that the first line continues."""
MAX_LINE = 65_536
"""Bytes of a line, its end included."""
HEAD_ATTRIBUTE = "audit_head"
"""Under this name files carry the head that the log had when they were written."""
STARTED = "audit.started"
CLOSED_OFF = "audit.closed_off"
LINES_MISSING = "audit.lines_missing"
"""Lines that were in the log are not there: ``old`` is the head of the newest of them."""
CANCEL = b"\x18"
"""Ends what a dying computer left of a line, once somebody has seen it; no whole line holds this byte."""
_HASH = re.compile(rb',"hash":"([0-9a-f]{64})"}')
"""How every line ends; no text within one can hold it, for its quotes are escaped."""
_HASH_LENGTH = 75
_MAX_TEXT = 2_000


@dataclass(frozen=True)
class Line:
    """One line: ``what`` was done (``test.begun``, ...) to which ``subject``, from which ``old`` to which ``new``."""

    number: int
    time: str
    """ISO 8601, UTC, by the computer's clock."""
    role: str
    who: str
    """The account on the operating system."""
    what: str
    subject: str
    old: Any
    new: Any
    software: str
    previous: str
    hash: str

    @property
    def head(self) -> str:
        """Number and hash: what a file written now remembers of the log."""
        return f"{self.number}:{self.hash}"


def make_line(**fields: Any) -> tuple[Line, bytes]:
    """A line and its bytes, the newline included, from all fields but ``hash``. Values that are too long are told."""
    fields = {name: plain(value) for name, value in fields.items()}
    body = _body(fields)
    if len(body) + 80 > MAX_LINE:
        for name in ("old", "new"):
            text = json.dumps(fields[name]).encode()
            fields[name] = f"{len(text)} bytes that are not kept here, SHA-256 {hashlib.sha256(text).hexdigest()}"
        body = _body(fields)
    own = hashlib.sha256(body).hexdigest()
    return Line(**fields, hash=own), body + f',"hash":"{own}"}}\n'.encode()


def _body(fields: dict[str, Any]) -> bytes:
    return json.dumps(fields, separators=(",", ":"), allow_nan=False).encode()[:-1]


def read_line(raw: bytes) -> Line | None:
    """The line of these bytes, without a newline; None where they do not have the hash that they say."""
    tail = _HASH.fullmatch(raw, max(0, len(raw) - _HASH_LENGTH))
    if tail is None or hashlib.sha256(raw[: tail.start()]).hexdigest().encode() != tail[1]:
        return None
    try:
        line = Line(**json.loads(raw))
    except (ValueError, TypeError, RecursionError):
        return None
    return line if isinstance(line.number, int) and isinstance(line.previous, str) else None


def is_torn(raw: bytes, number: int) -> bool:
    """Whether these bytes can be what is left of line ``number`` when the computer died while it was written."""
    if not raw.strip(b"\0"):
        return True  # some file systems make room first and fill it later
    start = f'{{"number":{number},"time":"'.encode()
    return raw[: len(start)] == start[: len(raw)] and _HASH.search(raw) is None


def fields_of(line: Line) -> dict[str, Any]:
    """The line as JSON has it."""
    return asdict(line)


def plain(value: Any) -> Any:
    """A value as JSON can hold it: numbers that are none become null, what is unknown its text; long texts are cut."""
    if isinstance(value, bool | int) or value is None:
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, str):
        return value if len(value) <= _MAX_TEXT else value[:_MAX_TEXT] + "..."
    if isinstance(value, dict):
        return {str(key)[:_MAX_TEXT]: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return plain(value.item()) if hasattr(value, "item") else plain(str(value))
