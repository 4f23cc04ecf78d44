"""What an HDF5 file from anywhere holds, taken with suspicion: groups, data and attributes of this very file."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tissueid.errors import SessionFormatError
from tissueid.sessions.heap_check import check_heaps
from tissueid.untrusted import MAX_CHUNK_BYTES, MAX_MEMBERS, MAX_TEXT, json_value, storable_text

_READABLE = (h5py.h5t.INTEGER, h5py.h5t.FLOAT, h5py.h5t.STRING, h5py.h5t.ENUM)
"""Types of attributes that are read; the others are those of other programs, such as references."""
_MOST_TEXTS = 16
"""Texts in one attribute: each of them can point at the same large text."""
_MOST_CHARACTERS = 4 * MAX_TEXT
"""Characters of all attributes of one object, which can point at the same large text too."""


@contextmanager
def opened(path: Path) -> Iterator[h5py.File]:
    """The file, open to be read; whatever is wrong with it is said as what it is.

    Raises:
        SessionFormatError: says what.
    """
    try:
        if path.exists() and not path.is_file() and not path.is_dir():
            raise SessionFormatError("is not a plain file")
        check_heaps(path)
        with h5py.File(path, "r") as file:
            yield file
    except SessionFormatError as error:
        raise SessionFormatError(f"{path}: {error}") from error
    except FileNotFoundError as error:
        raise SessionFormatError(f"{path}: no such file{_to_recover(path, '')}") from error
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, OverflowError, MemoryError) as error:
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
    if len(group) > MAX_MEMBERS:
        raise SessionFormatError(f"{len(group)} signals; at most {MAX_MEMBERS} are read")
    for name in group:
        item = _own(group, name)
        if not isinstance(item, h5py.Dataset):
            continue  # the format may grow; a reader passes over what it does not know
        check_dataset(name, item)
        yield name, item


def check_dataset(name: str, dataset: h5py.Dataset) -> None:
    """Check that a dataset is in this very file, in chunks of a size that can be read.

    Raises:
        SessionFormatError: it is not.
    """
    if dataset.external is not None or dataset.is_virtual:
        raise SessionFormatError(f"{name} points outside the file")
    if dataset.chunks is not None:
        chunk = math.prod(dataset.chunks) * dataset.dtype.itemsize
        if chunk > MAX_CHUNK_BYTES:
            raise SessionFormatError(f"{name} is stored in chunks of {chunk} bytes; at most {MAX_CHUNK_BYTES} are read")


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


def plain_attributes(attributes: h5py.AttributeManager) -> dict[str, str | float]:
    """Return the attributes of an object as texts and numbers, without those of types that a session does not have.

    Raises:
        SessionFormatError: there are too many, or one is too large.
    """
    if len(attributes) > MAX_MEMBERS:
        raise SessionFormatError(f"{len(attributes)} attributes; at most {MAX_MEMBERS} are read")
    found: dict[str, str | float] = {}
    length = 0
    for name in attributes:
        if (value := _attribute(attributes, name)) is not None:
            found[storable_text(name)] = value
            length += len(value) if isinstance(value, str) else 0
        if length > _MOST_CHARACTERS:
            raise SessionFormatError(f"attributes of more than {_MOST_CHARACTERS} characters in one place")
    return found


def _attribute(attributes: h5py.AttributeManager, name: str) -> str | float | None:
    """An attribute as text or number; several become one text. None where its type is none that a session has.

    Raises:
        SessionFormatError: it is too large.
    """
    stored = attributes.get_id(name)
    kind = stored.get_type()
    if kind.get_class() not in _READABLE:
        return None
    several = isinstance(kind, h5py.h5t.TypeStringID) and kind.is_variable_str() and stored.shape
    if stored.get_storage_size() > MAX_TEXT or (several and math.prod(several) > _MOST_TEXTS):
        raise SessionFormatError(f"the attribute {name[:60]} is too large: at most {MAX_TEXT} bytes are read")
    value = attributes[name]
    if isinstance(value, bytes):
        value = value.decode("utf-8", "replace")
    if isinstance(value, str):
        return storable_text(value[:MAX_TEXT])
    array = np.asarray(value)
    if array.size == 1 and array.dtype.kind in "fiub":
        return float(array.item())
    return storable_text(str(array.tolist())[:MAX_TEXT])


def text_of(attributes: h5py.AttributeManager, name: str, default: str | None = None) -> str:
    """An attribute that is text.

    Raises:
        SessionFormatError: it is not.
    """
    if name not in attributes and default is not None:
        return default
    value = _attribute(attributes, name)
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
    value = _attribute(attributes, name)
    if not isinstance(value, float):
        raise SessionFormatError(f"the attribute {name} is not a number")
    return value


def json_object(raw: str, name: str) -> dict[str, Any]:
    """JSON that describes something; what is not an object is kept as text under ``type``."""
    try:
        value = json_value(raw)
    except ValueError:
        return {"type": raw}
    return value if isinstance(value, dict) else {"type": raw, "of": name}
