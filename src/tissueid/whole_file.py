"""Files that are whole or not there: written in the same folder under another name, then given their own.

The other name cannot be guessed, and is created exclusively: a symbolic link that waits under it is never followed. It
is locked while it is written, so that what a killed program left is known from what another one is writing.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import secrets
import shutil
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

_FOLDERS_CANNOT = (errno.EINVAL, errno.ENOTSUP, errno.EBADF, errno.EACCES, errno.EPERM, errno.EISDIR)
"""What systems answer that do not let a folder be synced; anything else is the disk."""
_NO_LINKS = (errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK, errno.EXDEV)
"""What file systems answer that have no hard links."""
_NO_FOLLOW = getattr(os, "O_NOFOLLOW", 0)
_PRIVATE_FILE = 0o600
_PRIVATE_FOLDER = 0o700


@contextmanager
def whole_file(path: Path, *, synced: bool = False, new: bool = False, shared: bool = False) -> Iterator[Path]:
    """Give an empty file in the folder of ``path`` to write to; it takes the place of ``path`` when the block ends.

    An exception in the block leaves ``path`` as it was and no other file. The file is readable for its owner alone,
    whatever the umask; with ``shared``, for holders of no personal data, the umask decides. With ``synced`` the
    file and its new name have reached the disk when this ends; without it, a computer that dies just then may lose
    them. With ``new`` a file that is already at ``path`` is never replaced, even one that appeared meanwhile.

    Raises:
        FileExistsError: ``new``, and there is a file.
        OSError: the folder is missing, or the disk is full or not writable. Where only the new name could not be
            synced, the file has it, but whatever it was made from is better kept.
    """
    remove_leftovers(path)
    partial: Path | None = None
    try:
        with _claimed_file(path, 0o666 if shared else _PRIVATE_FILE) as (partial, identity):
            yield partial
            with _opened_again(partial, identity) as descriptor:
                if synced:
                    os.fsync(descriptor)
            if sys.platform != "win32":
                _publish(partial, path, new=new)
        if sys.platform == "win32":  # where a file that is open cannot be renamed
            _publish(partial, path, new=new)
        if synced:
            sync_folder(path.parent)
    except OSError as error:
        if partial is not None and str(error.filename) == str(partial):
            error.filename = str(path)  # the name that people gave
        raise
    finally:
        # What cannot be removed, on a disk that fails, must not hide why.
        if partial is not None:
            with contextlib.suppress(OSError):
                partial.unlink()


@contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """As ``whole_file``, for a folder of files: private, and never in the place of a folder that holds anything.

    Raises:
        OSError: ``path`` holds something, its folder is missing, or the disk is full or not writable.
    """
    remove_leftovers(path)
    partial = _partial(path)
    held = None
    try:
        partial.mkdir(_PRIVATE_FOLDER)
        if sys.platform != "win32":
            held = os.open(partial, os.O_RDONLY | _NO_FOLLOW)
            _lock(held, exclusive=False)
        yield partial
        for name in partial.rglob("*"):
            name.chmod(_PRIVATE_FOLDER if name.is_dir() else _PRIVATE_FILE)
        if path.exists():
            path.rmdir()
        partial.rename(path)
    except OSError as error:
        if str(error.filename) == str(partial):
            error.filename = str(path)
        raise
    finally:
        if held is not None:
            os.close(held)
        shutil.rmtree(partial, ignore_errors=True)


def private_folder(path: Path) -> Path:
    """Make a folder and those above it that are missing, for their owner alone, and return it.

    Folders that are there already are left as they are.

    Raises:
        OSError: it cannot be made, or a file has its name.
    """
    for folder in (*reversed(path.parents), path):
        if not folder.is_dir():
            folder.mkdir(_PRIVATE_FOLDER, exist_ok=True)
    return path


def create_private(path: Path) -> int:
    """Create a file for its owner alone and open it for writing; returns the descriptor.

    Raises:
        FileExistsError: there is a file, or a symbolic link, of that name.
        OSError: it cannot be made.
    """
    return _create(path, _PRIVATE_FILE)


def open_regular(path: Path) -> IO[bytes]:
    """Open an ordinary file for reading; a pipe or a device, which may never end, is refused without waiting.

    Raises:
        OSError: it is not there, may not be read, or is no ordinary file.
    """
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "it is not an ordinary file", str(path))
    return os.fdopen(descriptor, "rb")


def private_opener(path: str, flags: int) -> int:
    """Open a file for ``open``: for its owner alone where it is made, and never through a symbolic link."""
    return os.open(path, flags | _NO_FOLLOW, _PRIVATE_FILE)


def write_private(path: Path, text: str) -> None:
    """Write a text, whole or not at all, for the owner of the file alone.

    Raises:
        OSError: the folder is missing, or the disk is full or not writable.
    """
    with whole_file(path) as partial:
        partial.write_text(text, encoding="utf-8")


def remove_leftovers(path: Path) -> None:
    """Remove what killed programs left of writing ``path``. What is being written by another one is left alone."""
    if sys.platform == "win32":
        return  # there is nothing that tells them from others' there
    pattern = re.compile(re.escape(f".{path.name}.") + r"[0-9a-f]{16}\.partial")
    with contextlib.suppress(OSError):
        names = [entry.name for entry in os.scandir(path.parent) if pattern.fullmatch(entry.name)]
        for name in names:
            _remove_unlocked(path.with_name(name))


def _remove_unlocked(partial: Path) -> None:
    """Remove a file or folder of this account that no program holds."""
    try:
        descriptor = os.open(partial, os.O_RDONLY | _NO_FOLLOW | os.O_NONBLOCK)
    except OSError:
        return
    with contextlib.suppress(OSError):
        found = os.fstat(descriptor)
        owned = found.st_uid == os.geteuid() and os.path.samestat(found, partial.lstat())
        if owned and _lock(descriptor, exclusive=True):
            if stat.S_ISREG(found.st_mode):
                partial.unlink()
            elif stat.S_ISDIR(found.st_mode):
                shutil.rmtree(partial, ignore_errors=True)
    os.close(descriptor)


def _partial(path: Path) -> Path:
    return path.with_name(f".{path.name}.{secrets.token_hex(8)}.partial")


def _create(path: Path, mode: int) -> int:
    flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | _NO_FOLLOW | getattr(os, "O_BINARY", 0)
    return os.open(str(path), flags, mode)


@contextmanager
def _claimed_file(path: Path, mode: int) -> Iterator[tuple[Path, os.stat_result]]:
    """An empty file under a name of its own, and what it is known again by; held until the block ends."""
    while True:
        partial = _partial(path)
        try:
            descriptor: int | None = _create(partial, mode)
        except OSError as error:
            error.filename = str(path)  # the name that people gave
            raise
        assert descriptor is not None
        try:
            identity = os.fstat(descriptor)
            if sys.platform == "win32":
                os.close(descriptor)
                descriptor = None
            elif not _lock(descriptor, exclusive=False) or not partial.exists():
                continue  # taken for a leftover between the two calls
            yield partial, identity
            return
        finally:
            if descriptor is not None:
                os.close(descriptor)


@contextmanager
def _opened_again(partial: Path, identity: os.stat_result) -> Iterator[int]:
    """The file that was written, if it is still the one that was created.

    Raises:
        OSError: another one, or a symbolic link, has its name.
    """
    descriptor = os.open(str(partial), os.O_RDWR | _NO_FOLLOW | getattr(os, "O_BINARY", 0))
    try:
        if not os.path.samestat(os.fstat(descriptor), identity):
            raise OSError(errno.EPERM, "another program exchanged the file while it was written", str(partial))
        yield descriptor
    finally:
        os.close(descriptor)


def _publish(partial: Path, path: Path, *, new: bool) -> None:
    """Give the finished file its name.

    Raises:
        FileExistsError: ``new``, and there is a file of that name.
    """
    if not new:
        partial.replace(path)
        return
    try:
        if sys.platform == "win32":
            partial.rename(path)  # refuses there what exists
        else:
            os.link(partial, path)
    except FileExistsError as error:
        raise FileExistsError(error.errno, error.strerror, str(path)) from error
    except OSError as error:
        if error.errno not in _NO_LINKS:
            raise
        if os.path.lexists(path):
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path)) from error
        partial.replace(path)


def _lock(descriptor: int, *, exclusive: bool) -> bool:
    """Lock an open file without waiting; False where another program holds it.

    The lock of a writer is a shared one, which readers of HDF5 do not stumble over. On a file system without locks
    nothing is held, and nothing removed.
    """
    if sys.platform == "win32":
        return True
    import fcntl

    try:
        fcntl.flock(descriptor, (fcntl.LOCK_EX if exclusive else fcntl.LOCK_SH) | fcntl.LOCK_NB)
    except OSError as error:
        return not exclusive and error.errno not in (errno.EWOULDBLOCK, errno.EAGAIN, errno.EACCES)
    return True


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
