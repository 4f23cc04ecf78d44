"""Groups, datasets and attributes of an untrusted HDF5 file, with checks of types, sizes and links."""

from __future__ import annotations

import errno
import math
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import h5py
import numpy as np

from tissueid.errors import SessionFormatError
from tissueid.language import marked
from tissueid.messages import Action, Message
from tissueid.sessions.file_policy import check_session_file, damaged, located, missing, unreadable
from tissueid.untrusted_input import MAX_CHUNK_BYTES, MAX_HEAP_BYTES, MAX_MEMBERS, MAX_TEXT, json_value, storable_text

_MARK = b"GCOL\x01\0\0\0"
"""Signature, version and reserved bytes. Other data contain these eight bytes by chance once in 10^19."""
_HEAD = len(_MARK) + 8
_OBJECT = struct.Struct("<HHIQ")
_BLOCK = 16 << 20


def check_heaps(path: Path) -> None:
    """Check that the objects of every global heap collection are consecutive and within it.

    Raises:
        SessionFormatError: an object is not, or a collection is too large.
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        start, tail = 0, b""
        while block := file.read(_BLOCK):
            data = tail + block
            offset = data.find(_MARK)
            while offset >= 0:
                _check(file, start - len(tail) + offset)
                offset = data.find(_MARK, offset + 1)
            start += len(block)
            tail = data[-len(_MARK) + 1 :]
            file.seek(start)


def _check(file: BinaryIO, offset: int) -> None:
    file.seek(offset)
    head = file.read(_HEAD)
    size = int.from_bytes(head[len(_MARK) :], "little")
    if size > MAX_HEAP_BYTES:
        raise SessionFormatError(
            "session.heap",
            "its texts take {size} bytes in one piece; at most {most} are read",
            size=size,
            most=MAX_HEAP_BYTES,
        )
    body = file.read(max(0, size - _HEAD))
    if len(head) < _HEAD or len(body) < size - _HEAD:
        raise SessionFormatError("session.heap_truncated", "is damaged: the file ends within its texts")
    at = 0
    while len(body) - at >= _OBJECT.size:
        index, _, _, length = _OBJECT.unpack_from(body, at)
        at += _OBJECT.size + length + -length % 8 if index else max(1, length) if length else len(body) + 1
        if at > len(body):
            raise SessionFormatError("session.heap_overlap", "is damaged: its texts overlap")


_READABLE = (h5py.h5t.INTEGER, h5py.h5t.FLOAT, h5py.h5t.STRING, h5py.h5t.ENUM)
"""Types of attributes that are read; others, such as references, are not used by sessions."""
_MOST_TEXTS = 16
"""Largest number of texts in one attribute; each of them can refer to the same large text."""
_MOST_CHARACTERS = 4 * MAX_TEXT
"""Largest number of characters of all attributes of one object, which can also refer to the same large text."""


@contextmanager
def opened(path: Path) -> Iterator[h5py.File]:
    """Open an HDF5 file for reading; raise any error of the file as a SessionFormatError.

    Raises:
        SessionFormatError: the file is missing, damaged, not an HDF5 file, or open in another program.
    """
    check_session_file(path)
    try:
        check_heaps(path)
        with open_hdf5(path) as file:
            yield file
    except SessionFormatError as error:
        raise SessionFormatError(located(str(path), error.message)) from error
    except FileNotFoundError as error:
        raise SessionFormatError(missing(path)) from error
    except HDF5_ERRORS as error:
        reason = unavailable(error)
        raise SessionFormatError(damaged(path) if reason is None else located(str(path), reason)) from error


HDF5_ERRORS = (OSError, KeyError, ValueError, TypeError, RuntimeError, OverflowError, MemoryError)
"""Errors that h5py raises for a damaged file."""
_LOCKED = (errno.EAGAIN, errno.EWOULDBLOCK, errno.EDEADLK, errno.ETXTBSY, errno.EBUSY)
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP)
"""Errors of file systems without locks, such as some network drives."""
_UNAVAILABLE = (errno.EACCES, errno.EPERM, errno.EIO, errno.ESTALE, errno.ETIMEDOUT, errno.EMFILE, errno.ENFILE)
"""Errors of the system or the drive that say nothing about the content of a file."""


def open_hdf5(path: Path) -> h5py.File:
    """Open an HDF5 file for reading, without a lock where the file system has none."""
    try:
        return h5py.File(path, "r")
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
    return h5py.File(path, "r", locking=False)


def unavailable(error: Exception) -> Message | None:
    """Return why a file that need not be damaged cannot be read; None for other errors."""
    if not isinstance(error, OSError):
        return None
    if error.errno in _LOCKED:
        return Message(
            "session.open_elsewhere", "is open in another program: close it there. Nothing is known to be damaged."
        )
    if "already open for write" in str(error):  # a mark in the file, which a program that was ended leaves there
        return Message(
            "session.left_open",
            "is open for writing in another program, or that program was ended: close it there, or remove the mark "
            "with {action}",
            action=Action("session.clear_mark", "h5clear --status FILE", marked("the HDF5 tools")),
        )
    return unreadable(error) if error.errno in _UNAVAILABLE else None


def datasets(group: h5py.Group) -> Iterator[tuple[str, h5py.Dataset]]:
    """Yield the datasets of a group with their names.

    Raises:
        SessionFormatError: there are too many, or one is stored outside the file.
    """
    if len(group) > MAX_MEMBERS:
        raise SessionFormatError(
            "session.too_many_signals", "{count} signals; at most {most} are read", count=len(group), most=MAX_MEMBERS
        )
    for name in group:
        item = _own(group, name)
        if not isinstance(item, h5py.Dataset):
            continue  # unknown members are ignored, so that the format can be extended
        check_dataset(name, item)
        yield name, item


def check_dataset(name: str, dataset: h5py.Dataset) -> None:
    """Check that a dataset is stored in this file, in chunks that are not too large.

    Raises:
        SessionFormatError: it is not.
    """
    if dataset.external is not None or dataset.is_virtual:
        raise SessionFormatError("session.points_outside", "{name} points outside the file", name=name[:60])
    if dataset.chunks is not None:
        chunk = math.prod(dataset.chunks) * dataset.dtype.itemsize
        if chunk > MAX_CHUNK_BYTES:
            raise SessionFormatError(
                "session.chunks",
                "{name} is stored in chunks of {size} bytes; at most {most} are read",
                name=name[:60],
                size=chunk,
                most=MAX_CHUNK_BYTES,
            )


def subgroup(parent: h5py.Group, name: str) -> h5py.Group:
    """Return a subgroup.

    Raises:
        SessionFormatError: there is none, or it is stored outside the file.
    """
    if name not in parent:
        raise SessionFormatError("session.no_group", "the group {name} is missing", name=name)
    item = _own(parent, name)
    if not isinstance(item, h5py.Group):
        raise SessionFormatError("session.not_a_group", "{name} is not a group", name=name)
    return item


def _own(parent: h5py.Group, name: str) -> Any:
    """Return a member of this file; links are not followed."""
    if not isinstance(parent.get(name, getlink=True), h5py.HardLink):
        raise SessionFormatError("session.link", "{name} is a link", name=name[:60])
    return parent[name]


def plain_attributes(attributes: h5py.AttributeManager) -> dict[str, str | float]:
    """Return the attributes of an object as texts and numbers, without types that sessions do not use.

    Raises:
        SessionFormatError: there are too many, or one is too large.
    """
    if len(attributes) > MAX_MEMBERS:
        raise SessionFormatError(
            "session.too_many_attributes",
            "{count} attributes; at most {most} are read",
            count=len(attributes),
            most=MAX_MEMBERS,
        )
    plain: dict[str, str | float] = {}
    length = 0
    for name in attributes:
        if (value := _attribute(attributes, name)) is not None:
            plain[storable_text(name)] = value
            length += len(value) if isinstance(value, str) else 0
        if length > _MOST_CHARACTERS:
            raise SessionFormatError(
                "session.attributes_too_long",
                "attributes of more than {most} characters in one place",
                most=_MOST_CHARACTERS,
            )
    return plain


def _attribute(attributes: h5py.AttributeManager, name: str) -> str | float | None:
    """Return an attribute as text or number, an array as one text; None for types that sessions do not use.

    Raises:
        SessionFormatError: it is too large.
    """
    stored = attributes.get_id(name)
    kind = stored.get_type()
    if kind.get_class() not in _READABLE:
        return None
    several = isinstance(kind, h5py.h5t.TypeStringID) and kind.is_variable_str() and stored.shape
    if stored.get_storage_size() > MAX_TEXT or (several and math.prod(several) > _MOST_TEXTS):
        raise SessionFormatError(
            "session.attribute_too_large",
            "the attribute {name} is too large: at most {most} bytes are read",
            name=name[:60],
            most=MAX_TEXT,
        )
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
    """Return a text attribute.

    Raises:
        SessionFormatError: it is not text.
    """
    if name not in attributes and default is not None:
        return default
    value = _attribute(attributes, name)
    if not isinstance(value, str):
        raise SessionFormatError("session.attribute_not_text", "the attribute {name} is not text", name=name)
    return value


def number_of(attributes: h5py.AttributeManager, name: str, default: float | None = None) -> float:
    """Return a numeric attribute.

    Raises:
        SessionFormatError: it is not a number.
    """
    if name not in attributes and default is not None:
        return default
    value = _attribute(attributes, name)
    if not isinstance(value, float):
        raise SessionFormatError("session.attribute_not_a_number", "the attribute {name} is not a number", name=name)
    return value


def json_object(raw: str, name: str) -> dict[str, Any]:
    """Return a JSON object; any other text is kept under ``type``."""
    try:
        value = json_value(raw)
    except ValueError:
        return {"type": raw}
    return value if isinstance(value, dict) else {"type": raw, "of": name}
