"""The newest head of a log in a small file next to it, which shows that the log was emptied, cut off or removed."""

from __future__ import annotations

import contextlib
import os
import re
import stat
from pathlib import Path

from tissueid.atomic_write import open_regular, private_opener, write_all

_HEAD = re.compile(rb"(\d{1,12}):([0-9a-f]{64})")
_LONGEST = 100


def newest_path(log: Path) -> Path:
    """Return the path of the newest head of a log."""
    return log.with_name(log.name + ".head")


def read_newest(log: Path) -> tuple[int, str] | None:
    """Return number and hash of the newest line ever written to a log; None if unknown."""
    try:
        with open_regular(newest_path(log)) as file:
            match = _HEAD.fullmatch(file.read(_LONGEST).partition(b"\n")[0])
    except OSError:
        return None
    return None if match is None else (int(match[1]), match[2].decode())


def write_newest(log: Path, head: str, like: os.stat_result) -> None:
    """Store the head of the newest line, with the group and mode of the log in ``like``.

    The file is not synced, so that it is never newer than the log. If it cannot be written, the older head stays,
    which the log still contains.
    """
    with contextlib.suppress(OSError):
        path = newest_path(log)
        made = not path.exists()
        descriptor = private_opener(str(path), os.O_WRONLY | os.O_CREAT | getattr(os, "O_NONBLOCK", 0))
        try:
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                return
            data = f"{head}\n".encode()
            write_all(descriptor, data)
            os.ftruncate(descriptor, len(data))
            if made and hasattr(os, "fchown"):
                os.fchown(descriptor, -1, like.st_gid)
                os.fchmod(descriptor, stat.S_IMODE(like.st_mode) & 0o666)
        finally:
            os.close(descriptor)
