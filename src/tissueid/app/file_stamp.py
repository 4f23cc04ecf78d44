"""Whether a file is still the one that something was computed from."""

from __future__ import annotations

from pathlib import Path

Stamp = tuple[int, int]
"""When a file was last changed, ns, and its size."""


def stamp_of(path: Path) -> Stamp | None:
    """Return the stamp of a file, None where it is not there."""
    try:
        status = path.stat()
    except (OSError, ValueError):
        return None
    return status.st_mtime_ns, status.st_size
