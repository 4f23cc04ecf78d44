"""Atomic writing of files: written under a temporary name in the same folder, then renamed.

The temporary name is random and created exclusively, so that a symbolic link is never followed. The file is locked
while it is written, which distinguishes it from the leftovers of killed programs.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import shutil
import stat
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

_FOLDERS_CANNOT = (errno.EINVAL, errno.ENOTSUP, errno.EBADF, errno.EACCES, errno.EPERM, errno.EISDIR)
"""Errors of systems that cannot sync a folder; other errors come from the disk."""
_NO_LINKS = (errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK, errno.EXDEV)
"""Errors of file systems without hard links."""
_NO_FOLLOW = getattr(os, "O_NOFOLLOW", 0)
_PRIVATE_FILE = 0o600
_PRIVATE_FOLDER = 0o700


@contextmanager
def atomic_file(path: Path, *, synced: bool = False, new: bool = False, shared: bool = False) -> Iterator[Path]:
    """Yield an empty temporary file in the folder of ``path``; it replaces ``path`` when the block ends.

    An exception in the block leaves ``path`` unchanged and no other file.

    Args:
        path: of the file.
        synced: whether file and name are on the disk at the end; without it, a crash directly after may lose them.
        new: whether an existing file, even one that appeared during writing, must not be replaced.
        shared: whether the umask decides who can read the file (no personal data); by default only its owner can.

    Raises:
        FileExistsError: ``new``, and the file exists.
        OSError: the folder is missing, or the disk is full or not writable. If only the sync of the name failed, the
            file is in place, but its source should be kept.
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
            error.filename = str(path)  # the name that the user gave
        raise
    finally:
        # A failed removal must not hide the first error.
        if partial is not None:
            with contextlib.suppress(OSError):
                partial.unlink()


@contextmanager
def atomic_folder(path: Path) -> Iterator[Path]:
    """Yield a temporary folder that replaces ``path`` at the end: private, and only in place of an empty folder.

    Raises:
        OSError: ``path`` is not empty, its folder is missing, or the disk is full or not writable.
    """
    remove_leftovers(path)
    partial = _partial(path)
    held = None
    try:
        partial.mkdir(_PRIVATE_FOLDER)
        partial.chmod(_PRIVATE_FOLDER)
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


def check_creatable(path: Path) -> None:
    """Create and remove the temporary file by which :func:`atomic_file` would write ``path``.

    Raises:
        OSError: that fails: the name is too long with what is added to it, or the folder is not writable.
    """
    with _claimed_file(path, _PRIVATE_FILE) as (partial, _identity):
        partial.unlink()


def private_folder(path: Path) -> Path:
    """Create a folder and its missing parents, readable for the owner only, and return it.

    Existing folders are not changed.

    Raises:
        OSError: the folder cannot be created, or a file has its name.
    """
    for folder in (*reversed(path.parents), path):
        if not folder.is_dir():
            folder.mkdir(_PRIVATE_FOLDER, exist_ok=True)
            folder.chmod(_PRIVATE_FOLDER)  # whatever the umask is
    return path


def create_private(path: Path) -> int:
    """Create a file, readable for its owner only, open it for writing and return the descriptor.

    Raises:
        FileExistsError: there is a file, or a symbolic link, of that name.
        OSError: it cannot be made.
    """
    return _create(path, _PRIVATE_FILE)


def open_regular(path: Path) -> IO[bytes]:
    """Open an ordinary file for reading. A pipe or device, which may never end, is refused without waiting.

    Raises:
        OSError: it is not there, may not be read, or is no ordinary file.
    """
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "it is not an ordinary file", str(path))
    return os.fdopen(descriptor, "rb")


def private_opener(path: str, flags: int) -> int:
    """Opener for ``open``: a new file is readable for its owner only; symbolic links are not followed."""
    if not flags & os.O_CREAT:
        return os.open(path, flags | _NO_FOLLOW)
    try:
        return _private(os.open(path, flags | os.O_EXCL | _NO_FOLLOW, _PRIVATE_FILE))
    except FileExistsError:
        return os.open(path, flags | _NO_FOLLOW, _PRIVATE_FILE)


def write_private(path: Path, text: str) -> None:
    """Write a text atomically to a file that only its owner can read.

    Raises:
        OSError: the folder is missing, or the disk is full or not writable.
    """
    with atomic_file(path) as partial:
        partial.write_text(text, encoding="utf-8")


def unused_path(path: Path, *, separator: str = "-", taken: Callable[[Path], bool] = os.path.lexists) -> Path:
    """Return ``path`` if it is not taken, else the first of ``name-2.ext``, ``name-3.ext``, ... that is not."""
    free, number = path, 2
    while taken(free):
        free, number = path.with_name(f"{path.stem}{separator}{number}{path.suffix}"), number + 1
    return free


def remove_leftovers(path: Path) -> None:
    """Remove temporary files for ``path`` that killed programs left, except those that are being written."""
    if sys.platform == "win32":
        return  # without locks they cannot be identified there
    pattern = re.compile(re.escape(f".{path.name}.") + r"[0-9a-f]{16}\.partial")
    with contextlib.suppress(OSError):
        names = [entry.name for entry in os.scandir(path.parent) if pattern.fullmatch(entry.name)]
        for name in names:
            _remove_unlocked(path.with_name(name))


def _remove_unlocked(partial: Path) -> None:
    """Remove a file or folder of this user that no program has locked."""
    try:
        descriptor = os.open(partial, os.O_RDONLY | _NO_FOLLOW | os.O_NONBLOCK)
    except OSError:
        return
    with contextlib.suppress(OSError):
        info = os.fstat(descriptor)
        owned = info.st_uid == os.geteuid() and os.path.samestat(info, partial.lstat())
        if owned and _lock(descriptor, exclusive=True):
            if stat.S_ISREG(info.st_mode):
                partial.unlink()
            elif stat.S_ISDIR(info.st_mode):
                shutil.rmtree(partial, ignore_errors=True)
    os.close(descriptor)


def _partial(path: Path) -> Path:
    return path.with_name(f".{path.name}.{os.urandom(8).hex()}.partial")


def _create(path: Path, mode: int) -> int:
    flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | _NO_FOLLOW | getattr(os, "O_BINARY", 0)
    descriptor = os.open(str(path), flags, mode)
    return _private(descriptor) if mode == _PRIVATE_FILE else descriptor


def _private(descriptor: int) -> int:
    """Make a new file readable and writable for its owner, whatever the umask is; return its descriptor."""
    if hasattr(os, "fchmod"):
        os.fchmod(descriptor, _PRIVATE_FILE)
    return descriptor


@contextmanager
def _claimed_file(path: Path, mode: int) -> Iterator[tuple[Path, os.stat_result]]:
    """Create and lock an empty temporary file; yield its path and identity."""
    while True:
        partial = _partial(path)
        try:
            descriptor: int | None = _create(partial, mode)
        except OSError as error:
            error.filename = str(path)  # the name that the user gave
            raise
        assert descriptor is not None
        try:
            identity = os.fstat(descriptor)
            if sys.platform == "win32":
                os.close(descriptor)
                descriptor = None
            elif not _lock(descriptor, exclusive=False) or not partial.exists():
                continue  # removed as a leftover between the two calls
            yield partial, identity
            return
        finally:
            if descriptor is not None:
                os.close(descriptor)


@contextmanager
def _opened_again(partial: Path, identity: os.stat_result) -> Iterator[int]:
    """Open the written file again and check that it is the one that was created.

    Raises:
        OSError: another file or a symbolic link has its name.
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
    """Lock an open file without waiting; return False if another program holds it.

    Writers use a shared lock, which does not disturb readers of HDF5. Without locks in the file system no file is
    removed.
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
    """Sync the names in a folder to disk, if the system supports it.

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
    """Write all of the data, in several calls if necessary.

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
