"""Limits for reading untrusted files, and parsers of TOML and JSON with these limits.

All readers use these limits (docs/sessions.md, "Reading files from others"). A file of any content is read or refused
within ``SECONDS`` and ``MEMORY_BYTES``; a large file may take more, in proportion to its size.
"""

from __future__ import annotations

import json
import math
import re
import tomllib
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field

SECONDS = 20.0
"""Time for reading one file, s."""
SECONDS_PER_BYTE = 1.0 / 2_000_000
"""Additional time per byte of the file, s: the speed of a slow network drive."""
MEMORY_BYTES = 500_000_000
"""Memory of the whole program while and after it reads a file."""

MAX_FILE_BYTES = 4_000_000_000
"""Largest file of a session or an imported record, bytes."""
MAX_SAMPLES = 20_000_000
"""Most samples of one signal."""
MAX_COLUMNS = 10_000
"""Most columns of an imported table, and most vectors of an imported file."""
MAX_NUMBERS = 200_000_000
"""Most numbers in all signals of a session: 1.6 GB in memory."""
FREE_NUMBERS = 5_000_000
"""Numbers that a file of any size may hold: 40 MB in memory, 400 MB during the quality check."""
NUMBERS_PER_BYTE = 4
"""Numbers per byte of the file beyond ``FREE_NUMBERS``. Recordings of noise need at least one byte per number."""
MAX_TESTS = 10_000
MAX_MEMBERS = 1_000
"""Most members of a group, other than tests, and most attributes of one object."""
MAX_TEXT = 1_000_000
"""Most characters of one text, and most bytes of one attribute."""
MAX_HEAP_BYTES = 4_500_000
"""Bytes of one collection of texts in an HDF5 file: ``MAX_TEXT`` characters in UTF-8 and some more."""
MAX_CHUNK_BYTES = 64_000_000
"""Most bytes of one decompressed chunk of data in an HDF5 file."""
RATES_HZ = (1e-6, 1e9)
"""Lowest and highest sample rate, Hz."""

UNPACKED_FREE_BYTES = 100_000_000
"""Decompressed bytes that are always permitted."""
UNPACKED_PER_BYTE = 50
"""Decompressed bytes per byte of the file beyond ``UNPACKED_FREE_BYTES``."""
MAX_LINE = 400_000
"""Most characters of one line of a text file: 10,000 columns of 40 characters."""

MAX_DEPTH = 64
"""Most levels of nesting in JSON. Python and its libraries fail at different levels of several hundred."""
MAX_KEY_PARTS = 16
"""Most parts of a dotted key in TOML. The parser's memory grows with the square of this number."""

_PART = r"""(?:[A-Za-z0-9_-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')"""
_LONG_KEY = re.compile(rf"(?:\.[ \t]*+{_PART}[ \t]*+){{{MAX_KEY_PARTS},}}")
_SURROGATES = re.compile("[\ud800-\udfff]")


def allowed_numbers(file_bytes: int) -> int:
    """Return the most numbers that a file of this size may hold."""
    return min(MAX_NUMBERS, max(FREE_NUMBERS, NUMBERS_PER_BYTE * file_bytes))


def allowed_unpacked_bytes(file_bytes: int) -> int:
    """Return the most decompressed bytes of a file of this size."""
    return max(UNPACKED_FREE_BYTES, UNPACKED_PER_BYTE * file_bytes)


def allowed_seconds(file_bytes: int) -> float:
    """Return the longest time for reading a file of this size, s."""
    return SECONDS + SECONDS_PER_BYTE * file_bytes


def toml_table(data: bytes | str) -> dict[str, Any]:
    """Parse TOML.

    Raises:
        ValueError: the data is not TOML, not UTF-8, or nested too deeply.
    """
    text = data.decode("utf-8") if isinstance(data, bytes) else data
    if _LONG_KEY.search(text):
        raise ValueError(f"a key has more than {MAX_KEY_PARTS} parts")
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error


def json_value(text: str | bytes) -> Any:
    """Parse JSON. Lone surrogates in texts, which cannot be stored, become U+FFFD.

    Raises:
        ValueError: the text is not JSON, or nested more than ``MAX_DEPTH`` levels deep.
    """
    try:
        value = json.loads(text)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error
    return _storable(value, MAX_DEPTH)


def storable_text(text: str) -> str:
    """Return the text with lone surrogates, which UTF-8 cannot encode, replaced by U+FFFD."""
    return _SURROGATES.sub("\ufffd", text)


def _without_nul(text: str) -> str:
    if "\0" in text:
        raise ValueError("a text holds a null character")
    return text


def _as_number(value: Any) -> Any:
    if isinstance(value, bool):
        return float(value)
    return math.nan if value is None else value


StoredText = Annotated[str, Field(max_length=MAX_TEXT), AfterValidator(_without_nul)]
"""A text as HDF5 can store it."""
StoredName = Annotated[str, Field(min_length=1, max_length=1000), AfterValidator(_without_nul)]
"""Name of an attribute."""
StoredNumber = Annotated[float, BeforeValidator(_as_number)]
"""A number; null in JSON is NaN, and true is 1."""
StoredValue = StoredText | StoredNumber


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
