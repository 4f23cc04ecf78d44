"""What an HDF5 file from anywhere holds, taken with suspicion: groups, data and attributes of this very file."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tissueid.errors import SessionFormatError

MAX_TEXT = 1_000_000


@contextmanager
def opened(path: Path) -> Iterator[h5py.File]:
    """The file, open to be read; whatever is wrong with it is said as what it is.

    Raises:
        SessionFormatError: says what.
    """
    try:
        with h5py.File(path, "r") as file:
            yield file
    except SessionFormatError as error:
        raise SessionFormatError(f"{path}: {error}") from error
    except FileNotFoundError as error:
        raise SessionFormatError(f"{path}: no such file{_to_recover(path, '')}") from error
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, OverflowError) as error:
        # h5py tells damage in any of these; whatever it says, the file is of no use.
        kind = "is a folder" if path.is_dir() else "is damaged, or not an HDF5 session"
        raise SessionFormatError(f"{path} {kind}{_to_recover(path, 'move it away, and ')}") from error


def _to_recover(path: Path, first: str) -> str:
    journal = journal_path(path)
    if not journal.is_file():
        return ""
    return f"; a journal lies beside it: {first}'tissueid recover {shlex.quote(str(journal))}' makes the session of it"


def journal_path(session: Path) -> Path:
    """Where the journal of a session lies: beside it."""
    return session.with_name(session.name + ".journal")


def datasets(group: h5py.Group) -> Iterator[tuple[str, h5py.Dataset]]:
    """The data of a group with their names.

    Raises:
        SessionFormatError: some are elsewhere.
    """
    for name in group:
        item = _own(group, name)
        if not isinstance(item, h5py.Dataset):
            continue  # the format may grow; a reader passes over what it does not know
        if item.external is not None or item.is_virtual:
            raise SessionFormatError(f"{name} points outside the file")
        yield name, item


def subgroup(parent: h5py.Group, name: str) -> h5py.Group:
    """A group within another.

    Raises:
        SessionFormatError: there is none, or it is elsewhere.
    """
    if name not in parent:
        raise SessionFormatError(f"the group {name} is missing")
    item = _own(parent, name)
    if not isinstance(item, h5py.Group):
        raise SessionFormatError(f"{name} is not a group")
    return item


def _own(parent: h5py.Group, name: str) -> Any:
    """A member of this very file: links that lead elsewhere are not followed."""
    if not isinstance(parent.get(name, getlink=True), h5py.HardLink):
        raise SessionFormatError(f"{name} is a link")
    return parent[name]


def plain(value: Any) -> str | float:
    """An attribute as text or number; what is neither becomes its text."""
    if isinstance(value, bytes):
        value = value.decode("utf-8", "replace")
    if isinstance(value, str):
        return value[:MAX_TEXT]
    array = np.asarray(value)
    return float(array) if array.size == 1 and array.dtype.kind in "fiub" else str(array.tolist())[:MAX_TEXT]


def text_of(attributes: h5py.AttributeManager, name: str, default: str | None = None) -> str:
    """An attribute that is text.

    Raises:
        SessionFormatError: it is not.
    """
    if name not in attributes and default is not None:
        return default
    value = plain(attributes[name])
    if not isinstance(value, str):
        raise SessionFormatError(f"the attribute {name} is not text")
    return value


def number_of(attributes: h5py.AttributeManager, name: str, default: float | None = None) -> float:
    """An attribute that is a number.

    Raises:
        SessionFormatError: it is not.
    """
    if name not in attributes and default is not None:
        return default
    value = plain(attributes[name])
    if isinstance(value, str):
        raise SessionFormatError(f"the attribute {name} is not a number")
    return value


def json_object(raw: str, name: str) -> dict[str, Any]:
    """JSON that describes something; what is not an object is kept as text under ``type``."""
    try:
        value = json.loads(raw)
    except (ValueError, RecursionError):
        return {"type": raw}
    return value if isinstance(value, dict) else {"type": raw, "of": name}
