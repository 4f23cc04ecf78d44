"""The newest head of a log, in a small file next to it: what tells that the log was emptied, cut off or removed."""

from __future__ import annotations

import contextlib
import os
import re
import stat
from pathlib import Path

from tissueid.whole_file import open_regular, private_opener, write_all

_HEAD = re.compile(rb"(\d{1,12}):([0-9a-f]{64})")
_LONGEST = 100


def newest_path(log: Path) -> Path:
    """Where the newest head of a log is kept."""
    return log.with_name(log.name + ".head")


def read_newest(log: Path) -> tuple[int, str] | None:
    """Number and hash of the newest line that was ever written to a log; None where that is not known."""
    try:
        with open_regular(newest_path(log)) as file:
            match = _HEAD.fullmatch(file.read(_LONGEST).partition(b"\n")[0])
    except OSError:
        return None
    return None if match is None else (int(match[1]), match[2].decode())


def write_newest(log: Path, head: str, like: os.stat_result) -> None:
    """Keep the head of the line that was just written, for the accounts that may write the log, whose mode is ``like``.

    It is not synced, so that it is never ahead of the log. Where it cannot be written the older one stays, which the
    log still holds.
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
