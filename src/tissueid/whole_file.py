"""Files that are whole or not there: written beside their place under another name, then renamed into it."""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_FOLDERS_CANNOT = (errno.EINVAL, errno.ENOTSUP, errno.EBADF, errno.EACCES, errno.EPERM, errno.EISDIR)
"""What systems answer that do not let a folder be synced; anything else is the disk."""


@contextmanager
def whole_file(path: Path, *, synced: bool = False) -> Iterator[Path]:
    """A name beside ``path`` to write to; it takes the place of ``path`` when the block ends, and only then.

    An exception in the block leaves ``path`` as it was and nothing beside it. With ``synced`` the file and its new
    name have reached the disk when this ends; without it, a computer that dies just then may lose them.

    Raises:
        OSError: the folder is missing, or the disk is full or not writable. Where only the new name could not be
            synced, the file has it, but whatever it was made from is better kept.
    """
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        yield partial
        if synced:
            with partial.open("rb+") as raw:
                os.fsync(raw.fileno())
        partial.replace(path)
        if synced:
            sync_folder(path.parent)
    except OSError as error:
        if error.filename == str(partial):
            error.filename = str(path)  # the name that people gave
        raise
    finally:
        # What cannot be removed, on a disk that fails, must not hide why.
        with contextlib.suppress(OSError):
            partial.unlink()


def sync_folder(folder: Path) -> None:
    """Make the names in a folder durable, where the system lets a folder be synced.

    Raises:
        OSError: the disk failed.
    """
    if not hasattr(os, "O_DIRECTORY"):
        return
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
    except OSError as error:
        if error.errno not in _FOLDERS_CANNOT:
            raise


def write_all(descriptor: int, data: bytes) -> None:
    """Write all of it, however often the system takes only a part.

    Raises:
        OSError: the disk is full or failed; a part may be written.
    """
    view = memoryview(data)
    while view:
        try:
            written = os.write(descriptor, view)
        except InterruptedError:
            continue
        if written <= 0:
            raise OSError(errno.EIO, "nothing more is taken")
        view = view[written:]
