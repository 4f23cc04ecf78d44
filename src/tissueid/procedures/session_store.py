"""Where the sessions of a study are read and the results of each are kept: a folder, or an address by fsspec.

Both are picklable, so that a worker on another machine reads and writes itself. A result has a key, which depends on
name, size and time of its session, and is written atomically.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from tissueid.atomic_write import atomic_file, private_folder
from tissueid.errors import UnusableInputError
from tissueid.messages import Message, Verbatim
from tissueid.procedures.study_plans import RESULTS

LARGEST_RESULT = 20_000_000
"""Number of bytes of the result of one session."""
_LARGEST_SESSION = 4_000_000_000
_ENDING = ".h5"


class SessionStore(Protocol):
    """Interface of a place with sessions and results. ``name`` is the path of a session below it."""

    def sessions(self) -> dict[str, str]:
        """Return the key of each session by its name, in the order of the names.

        Raises:
            UnusableInputError: the place cannot be read.
        """
        ...

    def local_file(self, name: str) -> contextlib.AbstractContextManager[Path]:
        """Return a context with a file of this machine that has the content of a session."""
        ...

    def results(self, analysis: str) -> list[str]:
        """Return the keys of the results of an analysis."""
        ...

    def read_result(self, analysis: str, key: str) -> bytes | None:
        """Return a result, or None if there is none or it is too large."""
        ...

    def write_result(self, analysis: str, key: str, content: bytes) -> None:
        """Write a result atomically.

        Raises:
            OSError: it cannot be written.
        """
        ...

    def remove_result(self, analysis: str, key: str) -> None:
        """Remove a result, if it is there."""
        ...


@dataclass(frozen=True)
class FolderStore:
    """A folder of this machine, or one that all workers see."""

    folder: Path

    def sessions(self) -> dict[str, str]:
        """Return the key of each session by its name."""
        if not self.folder.is_dir():
            raise UnusableInputError(Message("study.no_folder", "{folder} is not a folder", folder=str(self.folder)))
        results = self.folder / RESULTS
        files = sorted(path for path in self.folder.rglob(f"*{_ENDING}") if results not in path.parents)
        return {str(path.relative_to(self.folder)): self._key(path) for path in files}

    @contextlib.contextmanager
    def local_file(self, name: str) -> Iterator[Path]:
        """Yield the file itself."""
        yield self.folder / name

    def results(self, analysis: str) -> list[str]:
        """Return the keys of the results of an analysis."""
        return [path.stem for path in (self.folder / RESULTS / analysis).glob("*.json")]

    def read_result(self, analysis: str, key: str) -> bytes | None:
        """Return a result, or None."""
        path = self._result(analysis, key)
        try:
            return None if path.stat().st_size > LARGEST_RESULT else path.read_bytes()
        except OSError:
            return None

    def write_result(self, analysis: str, key: str, content: bytes) -> None:
        """Write a result atomically."""
        private_folder(self.folder / RESULTS / analysis)
        with atomic_file(self._result(analysis, key)) as partial:
            partial.write_bytes(content)

    def remove_result(self, analysis: str, key: str) -> None:
        """Remove a result, if it is there."""
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

    Every file system raises errors of its own, not only OSError.
    """

    url: str

    def sessions(self) -> dict[str, str]:
        """Return the key of each session by its name."""
        files, root = self._open()
        try:
            found = files.find(root, detail=True) if files.exists(root) else None
        except Exception as error:
            raise self._unreadable(error) from error
        if found is None:
            raise self._unreadable(FileNotFoundError("there is nothing"))
        names = {self._name(root, path): about for path, about in found.items() if path.endswith(_ENDING)}
        return {
            name: _digest(name, about.get("size"), _version(about))
            for name, about in sorted(names.items())
            if not name.startswith(f"{RESULTS}/")
        }

    @contextlib.contextmanager
    def local_file(self, name: str) -> Iterator[Path]:
        """Yield a temporary copy: the reader of sessions needs a file."""
        files, root = self._open()
        with tempfile.TemporaryDirectory(prefix="tissueid-") as folder:
            path = Path(folder) / f"session{_ENDING}"
            try:
                size = files.size(f"{root}/{name}") or 0
                if size <= _LARGEST_SESSION:
                    files.get_file(f"{root}/{name}", str(path))
            except Exception as error:
                raise self._unreadable(error) from error
            if size > _LARGEST_SESSION:
                raise UnusableInputError(
                    Message("study.session_size", "{name} is too large ({size} bytes)", name=name, size=size)
                )
            yield path

    def results(self, analysis: str) -> list[str]:
        """Return the keys of the results of an analysis."""
        files, root = self._open()
        folder = f"{root}/{RESULTS}/{analysis}"
        found = files.ls(folder, detail=False) if files.exists(folder) else []
        return [Path(path).stem for path in found if str(path).endswith(".json")]

    def read_result(self, analysis: str, key: str) -> bytes | None:
        """Return a result, or None."""
        files, root = self._open()
        path = f"{root}/{RESULTS}/{analysis}/{key}.json"
        try:
            return None if (files.size(path) or 0) > LARGEST_RESULT else bytes(files.cat_file(path))
        except OSError:
            return None

    def write_result(self, analysis: str, key: str, content: bytes) -> None:
        """Write a result under another name and rename it; where a name is written at once, the rename is a copy."""
        files, root = self._open()
        folder = f"{root}/{RESULTS}/{analysis}"
        files.makedirs(folder, exist_ok=True)
        files.pipe_file(f"{folder}/{key}.partial", content)
        files.mv(f"{folder}/{key}.partial", f"{folder}/{key}.json")

    def remove_result(self, analysis: str, key: str) -> None:
        """Remove a result, if it is there."""
        files, root = self._open()
        with contextlib.suppress(OSError):
            files.rm_file(f"{root}/{RESULTS}/{analysis}/{key}.json")

    def _open(self) -> tuple[Any, str]:
        import fsspec

        try:
            files, root = fsspec.core.url_to_fs(self.url)
        except (ImportError, ValueError, OSError) as error:
            raise self._unreadable(error) from error
        return files, str(root).rstrip("/")

    def _name(self, root: str, path: str) -> str:
        return str(path)[len(root) :].lstrip("/")

    def _unreadable(self, error: Exception) -> UnusableInputError:
        why = Verbatim((str(error).splitlines() or [type(error).__name__])[0])
        return UnusableInputError(
            Message("study.no_address", "{url} cannot be read: {reason}", url=Verbatim(self.url), reason=why)
        )


def _version(about: dict[str, Any]) -> str:
    return next(
        (str(about[name]) for name in ("ETag", "etag", "mtime", "LastModified", "created") if name in about), ""
    )


def _digest(*parts: object) -> str:
    return hashlib.sha256(json.dumps(parts, default=str).encode()).hexdigest()[:40]
