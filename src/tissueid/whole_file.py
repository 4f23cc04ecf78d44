"""Files that are whole or not there: written beside their place under another name, then renamed into it."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def whole_file(path: Path, *, synced: bool = False) -> Iterator[Path]:
    """A name beside ``path`` to write to; it takes the place of ``path`` when the block ends, and only then.

    An exception in the block leaves ``path`` as it was and nothing beside it. With ``synced`` the file and its new
    name have reached the disk when this ends; without it, a computer that dies just then may lose them.

    Raises:
        OSError: the folder is missing, or the disk is full or not writable.
    """
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        yield partial
        if synced:
            with partial.open("rb+") as raw:
                os.fsync(raw.fileno())
        partial.replace(path)
        if synced:
            _sync_folder(path.parent)
    except OSError as error:
        if error.filename == str(partial):
            error.filename = str(path)  # the name that people gave
        raise
    finally:
        partial.unlink(missing_ok=True)


def _sync_folder(folder: Path) -> None:
    """Make the rename itself durable, where the system lets a folder be synced."""
    with contextlib.suppress(OSError, AttributeError):
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
