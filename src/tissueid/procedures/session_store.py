"""Where the sessions of a study are read and the results of each are kept: a folder, or an address by fsspec.

Both are picklable, so that a worker on another machine reads and writes itself. A result has a key, which depends on
name, size and time of its session, and is written atomically.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tissueid.atomic_write import atomic_file, private_folder
from tissueid.errors import SessionFormatError, UnusableInputError
from tissueid.messages import Verbatim
from tissueid.procedures.study_plans import RESULTS
from tissueid.sessions.file_policy import check_session_file, session_files
from tissueid.untrusted_input import MAX_FILE_BYTES, allowed_unpacked_bytes

LARGEST_RESULT = 20_000_000
"""Number of bytes of the result of one session."""
_ENDING = ".h5"
_BLOCK_BYTES = 2 << 20
"""Bytes that are copied at once: the first block has the signature of a session."""
_REFUSED = {"reference", "dask", "async_wrapper", "asyncwrapper", "generic"}
"""Kinds of addresses whose files name other places, code or pickles."""


@dataclass(frozen=True)
class FolderStore:
    """A folder of this machine, or one that all workers see."""

    folder: Path

    def sessions(self) -> dict[str, str]:
        """Return the key of each session by its name."""
        results = self.folder / RESULTS
        files = session_files(self.folder, recursive=True)
        return {_name(path.relative_to(self.folder)): self._key(path) for path in files if results not in path.parents}

    @contextlib.contextmanager
    def local_file(self, name: str) -> Iterator[Path]:
        """Yield the file itself."""
        path = self.folder / name
        yield path if path.exists() else self.folder / _stored_name(name)

    def results(self, analysis: str) -> list[str]:
        """Return the keys of the results of an analysis."""
        return [path.stem for path in (self.folder / RESULTS / analysis).glob("*.json")]

    def read_result(self, analysis: str, key: str) -> bytes | None:
        """Return a result, or None."""
        path = self._result(analysis, key)
        try:
            usable = path.is_file() and path.stat().st_size <= LARGEST_RESULT
            return path.read_bytes() if usable else None
        except OSError:
            return None

    def write_result(self, analysis: str, key: str, content: bytes) -> None:
        """Write a result atomically."""
        private_folder(self.folder / RESULTS / analysis)
        with atomic_file(self._result(analysis, key)) as partial:
            partial.write_bytes(content)

    def remove_result(self, analysis: str, key: str) -> None:
        """Remove a result, if it is there."""
        with contextlib.suppress(OSError):
            self._result(analysis, key).unlink(missing_ok=True)

    def _result(self, analysis: str, key: str) -> Path:
        return self.folder / RESULTS / analysis / f"{key}.json"

    def _key(self, path: Path) -> str:
        try:
            status = path.stat()
        except OSError:
            stamp = (-1, -1)
        else:
            stamp = (status.st_size, status.st_mtime_ns)
        return _digest(str(path.relative_to(self.folder)), *stamp)


@dataclass(frozen=True)
class RemoteStore:
    """An address of fsspec, such as ``s3://bucket/study``; each worker opens it by itself.

    A place that cannot be written, such as an archive, keeps no results.
    """

    url: str

    def sessions(self) -> dict[str, str]:
        """Return the key of each session by its name."""
        with self._opened() as (files, root):
            if not files.exists(root):
                raise FileNotFoundError("there is nothing")
            listing = files.find(root, detail=True)
            names = {_name(path[len(root) :].lstrip("/")): about for path, about in listing.items()}
            return {
                name: _digest(name, about.get("size"), _version(about))
                for name, about in sorted(names.items())
                if name.lower().endswith(_ENDING) and not name.startswith(f"{RESULTS}/")
            }

    @contextlib.contextmanager
    def local_file(self, name: str) -> Iterator[Path]:
        """Yield a temporary copy: the reader of sessions needs a file. Sizes and signature are checked before."""
        with tempfile.TemporaryDirectory(prefix="tissueid-") as folder:
            path = Path(folder) / f"session{_ENDING}"
            with self._opened() as (files, root):
                stored_path = f"{root}/{name}"
                _copy(files, stored_path if files.exists(stored_path) else f"{root}/{_stored_name(name)}", path)
            yield path

    def results(self, analysis: str) -> list[str]:
        """Return the keys of the results of an analysis."""
        with contextlib.suppress(UnusableInputError), self._opened() as (files, root):
            folder = f"{root}/{RESULTS}/{analysis}"
            paths = files.ls(folder, detail=False) if files.exists(folder) else []
            return [Path(path).stem for path in paths if str(path).endswith(".json")]
        return []

    def read_result(self, analysis: str, key: str) -> bytes | None:
        """Return a result, or None."""
        with contextlib.suppress(UnusableInputError), self._opened() as (files, root):
            path = f"{root}/{RESULTS}/{analysis}/{key}.json"
            return None if (files.size(path) or 0) > LARGEST_RESULT else bytes(files.cat_file(path))
        return None

    def write_result(self, analysis: str, key: str, content: bytes) -> None:
        """Write a result under another name and rename it; where a name is written at once, the rename is a copy."""
        with self._opened() as (files, root):
            folder = f"{root}/{RESULTS}/{analysis}"
            files.makedirs(folder, exist_ok=True)
            files.pipe_file(f"{folder}/{key}.partial", content)
            files.mv(f"{folder}/{key}.partial", f"{folder}/{key}.json")

    def remove_result(self, analysis: str, key: str) -> None:
        """Remove a result, if it is there."""
        with contextlib.suppress(UnusableInputError), self._opened() as (files, root):
            files.rm_file(f"{root}/{RESULTS}/{analysis}/{key}.json")

    @contextlib.contextmanager
    def _opened(self) -> Iterator[tuple[Any, str]]:
        """Yield the file system and the path in it; its errors, which may be of any kind, become one line.

        Raises:
            UnusableInputError: the block failed.
        """
        import fsspec

        kinds = {part.partition("://")[0] for part in self.url.lower().split("::")}
        if refused := sorted(kinds & _REFUSED):
            raise UnusableInputError(
                "study.refused_address",
                "{url} is not read: files at an address of the kind {kind} name other places or code",
                url=Verbatim(self.url),
                kind=Verbatim(refused[0]),
            )
        try:
            files, root = fsspec.core.url_to_fs(self.url)
            yield files, str(root).rstrip("/")
        except UnusableInputError:
            raise
        except Exception as error:
            why = Verbatim((str(error).splitlines() or [type(error).__name__])[0])
            raise UnusableInputError(
                "study.no_address", "{url} cannot be read: {reason}", url=Verbatim(self.url), reason=why
            ) from error


SessionStore = FolderStore | RemoteStore
"""A place with sessions and results. ``name`` is the path of a session below it."""


def _copy(files: Any, source_path: str, target: Path) -> None:
    """Copy a file of fsspec after checking its size, as stated and as packed, the room on this disk and its signature.

    Raises:
        UnusableInputError: it is too large, or is no session.
        Exception: of any kind, from the file system.
    """
    about = files.info(source_path)
    size, packed = about.get("size"), about.get("compress_size")
    most = MAX_FILE_BYTES if packed is None else min(MAX_FILE_BYTES, allowed_unpacked_bytes(packed))
    most = min(most, shutil.disk_usage(target.parent).free)
    copied = 0
    with files.open(source_path, "rb") as source, target.open("wb") as file:
        while (size or 0) <= most and copied <= most and (block := source.read(_BLOCK_BYTES)):
            file.write(block)
            if not copied:
                file.flush()
                try:
                    check_session_file(target)
                except SessionFormatError as error:
                    raise UnusableInputError("study.no_session", "is not an HDF5 session") from error
            copied += len(block)
    if (size := max(size or 0, copied)) > most:
        raise UnusableInputError(
            "study.session_size", "has {size} bytes; at most {most} are read", size=size, most=most
        )


def _version(about: dict[str, Any]) -> str:
    return next(
        (str(about[name]) for name in ("ETag", "etag", "mtime", "LastModified", "created") if name in about), ""
    )


def _name(path: object) -> str:
    """Return a path as text of a table; bytes that are not UTF-8 as ``\\xE9``."""
    return os.fsencode(str(path)).decode("utf-8", "backslashreplace")


def _stored_name(name: str) -> str:
    """Return the path of a ``_name`` with bytes that are not UTF-8."""
    return os.fsdecode(re.sub(rb"\\x([0-9a-f]{2})", lambda match: bytes.fromhex(match[1].decode()), name.encode()))


def _digest(*parts: object) -> str:
    return hashlib.sha256(json.dumps(parts, default=str).encode()).hexdigest()[:40]
