"""Limits for files from anywhere, and parsers of TOML and JSON that keep to them.

Every reader takes its limits from here (docs/sessions.md, "Reading files from others"). The aim is that a file of any
content is read or refused within ``SECONDS`` and ``MEMORY_BYTES``; a large file may take more, in proportion to its
size.
"""

from __future__ import annotations

import json
import re
import tomllib
from typing import Any

SECONDS = 20.0
"""Time for reading one file, s."""
SECONDS_PER_BYTE = 1.0 / 2_000_000
"""Further time for each byte of the file: the speed of a slow network drive."""
MEMORY_BYTES = 500_000_000
"""Memory of the whole program while it reads a file, and after."""

MAX_SAMPLES = 20_000_000
"""Samples of one signal."""
MAX_NUMBERS = 200_000_000
"""Numbers in all signals of a session together: 1.6 GB once they are read."""
FREE_NUMBERS = 5_000_000
"""Numbers that a file of any size may hold: 40 MB once they are read, 400 MB while the quality gate judges them."""
NUMBERS_PER_BYTE = 4
"""Beyond ``FREE_NUMBERS``, numbers for each byte of the file. Recordings of noise need at least one byte a number."""
MAX_TESTS = 10_000
MAX_MEMBERS = 1_000
"""Members of a group, other than tests, and attributes of one object."""
MAX_TEXT = 1_000_000
"""Characters of one text, and bytes of one attribute."""
MAX_HEAP_BYTES = 4_500_000
"""Bytes of one collection of texts in an HDF5 file: ``MAX_TEXT`` characters in UTF-8 and some more."""
MAX_CHUNK_BYTES = 64_000_000
"""Bytes of one chunk of data in an HDF5 file, once it is out of its compression."""
RATES_HZ = (1e-6, 1e9)
"""Sample rates: the lowest and the highest."""

UNPACKED_FREE_BYTES = 100_000_000
"""Bytes that compressed data of any size may unpack to."""
UNPACKED_PER_BYTE = 50
"""Beyond ``UNPACKED_FREE_BYTES``, unpacked bytes for each byte of the file."""
MAX_LINE = 400_000
"""Characters of one line of a text file: 10,000 columns of 40 characters."""

MAX_DEPTH = 64
"""Levels of JSON within JSON. Python and its libraries fail at some hundreds, each at another number."""
MAX_KEY_PARTS = 16
"""Parts of a dotted key in TOML. The parser takes memory in proportion to the square of it."""

_PART = r"""(?:[A-Za-z0-9_-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')"""
_LONG_KEY = re.compile(rf"(?:\.[ \t]*+{_PART}[ \t]*+){{{MAX_KEY_PARTS},}}")
_SURROGATES = re.compile("[\ud800-\udfff]")


def most_numbers(file_bytes: int) -> int:
    """Return how many numbers a file of this size may hold."""
    return min(MAX_NUMBERS, max(FREE_NUMBERS, NUMBERS_PER_BYTE * file_bytes))


def most_unpacked(file_bytes: int) -> int:
    """Return how many bytes the compressed data of a file of this size may unpack to."""
    return max(UNPACKED_FREE_BYTES, UNPACKED_PER_BYTE * file_bytes)


def most_seconds(file_bytes: int) -> float:
    """Return how long reading a file of this size may take, s."""
    return SECONDS + SECONDS_PER_BYTE * file_bytes


def toml_table(data: bytes | str) -> dict[str, Any]:
    """Parse TOML.

    Raises:
        ValueError: it is not TOML, not UTF-8, or nested too deeply.
    """
    text = data.decode("utf-8") if isinstance(data, bytes) else data
    if _LONG_KEY.search(text):
        raise ValueError(f"a key has more than {MAX_KEY_PARTS} parts")
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error


def json_value(text: str | bytes) -> Any:
    """Parse JSON whose texts can be stored and written: half characters (lone surrogates) become U+FFFD.

    Raises:
        ValueError: it is not JSON, or nested more than ``MAX_DEPTH`` levels deep.
    """
    try:
        value = json.loads(text)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error
    return _storable(value, MAX_DEPTH)


def storable_text(text: str) -> str:
    """Return a text that UTF-8 can hold: half characters (lone surrogates) become U+FFFD."""
    return _SURROGATES.sub("\ufffd", text)


def _storable(value: Any, levels: int) -> Any:
    if isinstance(value, str):
        return storable_text(value)
    if not isinstance(value, dict | list):
        return value
    if not levels:
        raise ValueError("nested too deeply")
    if isinstance(value, dict):
        return {storable_text(key): _storable(item, levels - 1) for key, item in value.items()}
    return [_storable(item, levels - 1) for item in value]
