"""Lines of the audit log as bytes: JSON that ends with the SHA-256 of all bytes before it.

These bytes contain the hash of the line before, so that no line can be changed, removed, inserted or moved without
breaking every later line. The bytes themselves are hashed, not their meaning.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from dataclasses import dataclass
from typing import Any

NOTHING_BEFORE = "0" * 64
"""The previous hash of the first line."""
MAX_LINE = 65_536
"""Most bytes of a line, with its newline."""
HEAD_ATTRIBUTE = "audit_head"
"""Attribute of files with the head of the log at the time of writing."""
STARTED = "audit.started"
CLOSED_OFF = "audit.closed_off"
LINES_MISSING = "audit.lines_missing"
"""Lines of the log are missing: ``old`` is the head of the newest of them."""
CANCEL = b"\x18"
"""Byte that closes off an unfinished line after a crash; complete lines never contain it."""
_HASH = re.compile(rb',"hash":"([0-9a-f]{64})"}')
"""End of every line. No text within a line can match, because its quotes are escaped."""
_HASH_LENGTH = 75
_MAX_TEXT = 2_000


@dataclass(frozen=True)
class LogLine:
    """One line: action ``what``, such as ``test.begun``, on ``subject``, with the value before and after it."""

    number: int
    time: str
    """ISO 8601, UTC, by the computer's clock."""
    role: str
    who: str
    """User account of the operating system."""
    what: str
    subject: str
    old: Any
    new: Any
    software: str
    previous: str
    hash: str

    @property
    def head(self) -> str:
        """Number and hash, as stored in files."""
        return f"{self.number}:{self.hash}"


def make_line(**fields: Any) -> tuple[LogLine, bytes]:
    """Return a line and its bytes, with newline, from all other fields. The hash of a long value replaces it."""
    fields = {name: plain(value) for name, value in fields.items()}
    body = _body(fields)
    if len(body) + 80 > MAX_LINE:
        for name in ("old", "new"):
            text = json.dumps(fields[name]).encode()
            fields[name] = f"{len(text)} bytes that are not kept here, SHA-256 {hashlib.sha256(text).hexdigest()}"
        body = _body(fields)
    own = hashlib.sha256(body).hexdigest()
    return LogLine(**fields, hash=own), body + f',"hash":"{own}"}}\n'.encode()


def _body(fields: dict[str, Any]) -> bytes:
    return json.dumps(fields, separators=(",", ":"), allow_nan=False).encode()[:-1]


def read_line(raw: bytes) -> LogLine | None:
    """Return the line of these bytes, without newline; None if its hash is wrong."""
    tail = _HASH.fullmatch(raw, max(0, len(raw) - _HASH_LENGTH))
    if tail is None or hashlib.sha256(raw[: tail.start()]).hexdigest().encode() != tail[1]:
        return None
    try:
        line = LogLine(**json.loads(raw))
    except (ValueError, TypeError, RecursionError):
        return None
    return line if isinstance(line.number, int) and isinstance(line.previous, str) else None


def is_torn(raw: bytes, number: int) -> bool:
    """Return whether these bytes can be an unfinished line ``number`` after a crash."""
    if not raw.strip(b"\0"):
        return True  # some file systems allocate the space first and fill it later
    start = f'{{"number":{number},"time":"'.encode()
    return raw[: len(start)] == start[: len(raw)] and _HASH.search(raw) is None


def plain(value: Any) -> Any:
    """Return a value for JSON: NaN and infinity become null, other types their text; long texts are cut."""
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
