"""Recording date of an imported file: from its header, else its modification time."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

Origin = Literal["header", "modified"]
_HEAD = 8_192
"""Bytes that contain the date: the first segment of an LVM file, the first 116 bytes of a MAT file."""
_LVM_DATE = re.compile(r"^Date[\t,;](\d{4})[/.-](\d{1,2})[/.-](\d{1,2})", re.MULTILINE)
_LVM_TIME = re.compile(r"^Time[\t,;](\d{1,2}):(\d{2}):(\d{2})", re.MULTILINE)
_MAT = re.compile(r"Created on: \w{3} (\w{3}) +(\d{1,2}) (\d{2}):(\d{2}):(\d{2}) (\d{4})")
_MONTHS = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")


def recording_date(path: Path, file_format: str) -> tuple[str, Origin]:
    """Return the date of a record in UTC, and its origin.

    Headers state the local time of the computer that wrote them; the zone of this computer is assumed.

    Raises:
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        head = file.read(_HEAD).decode("latin-1").replace("\r\n", "\n")
    found = {"lvm": _of_lvm, "mat": _of_mat}.get(file_format, lambda _head: None)(head)
    origin: Origin = "header"
    if found is None:
        found, origin = datetime.fromtimestamp(path.stat().st_mtime), "modified"
    return found.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"), origin


def _of_lvm(head: str) -> datetime | None:
    """Return the last date before the rows: that of the first segment, or of the file if the segment has none."""
    head = re.split(r"^X_Value", head, maxsplit=1, flags=re.MULTILINE)[0]
    days, times = _LVM_DATE.findall(head), _LVM_TIME.findall(head)
    if not days:
        return None
    time = times[-1] if times else ("0", "0", "0")
    return _moment(*map(int, (*days[-1], *time)))


def _of_mat(head: str) -> datetime | None:
    match = _MAT.search(head[:116])
    if match is None or match[1] not in _MONTHS:
        return None
    return _moment(int(match[6]), _MONTHS.index(match[1]) + 1, *map(int, match.group(2, 3, 4, 5)))


def _moment(*parts: int) -> datetime | None:
    """Return a date, or None if it is invalid or from a clock that was never set (1904 or 1970)."""
    try:
        found = datetime(*parts)  # type: ignore[arg-type]
    except ValueError:
        return None
    return found if found.year > 1970 else None


__all__ = ["Origin", "recording_date"]
