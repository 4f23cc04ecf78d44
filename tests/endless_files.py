"""Files with names of sessions that must be refused before they are read: most of them never end."""

from __future__ import annotations

import os
from pathlib import Path

SPARSE_BYTES = 3_000_000_000


def files_that_never_end(folder: Path, suffix: str = ".h5") -> set[str]:
    """Write a pipe, a link to an endless device, a huge file that is a hole and a folder; return the names of files."""
    names = set()
    with (folder / f"hole{suffix}").open("wb") as file:
        file.truncate(SPARSE_BYTES)
        names.add(f"hole{suffix}")
    if hasattr(os, "mkfifo"):
        os.mkfifo(folder / f"pipe{suffix}")
        (folder / f"zeros{suffix}").symlink_to("/dev/zero")
        names |= {f"pipe{suffix}", f"zeros{suffix}"}
    (folder / f"folder{suffix}").mkdir()
    return names
