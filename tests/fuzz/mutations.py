"""Changes of files at random, by seed."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

_NUMBERS = (b"0", b"-1", b"1e308", b"-1e308", b"1e-320", b"nan", b"inf", b"9" * 400, b"1e400", b"0x10", b"1_0", b"true")
_TOKENS = (
    b"\0", b"\xff", b"\xe9", b"\\ud800", b"\\u0000", b'"', b"'", b"[" * 300, b"{" * 300, b'{"a":' * 200, b",", b";",
    b"\n", b"\t", b"a." * 200, b"=", b"#", b"null", b"[]", b"{}", b'""', b"\xef\xbb\xbf",
    b"\x1b[2J", b"***End_of_Header***",
)  # fmt: skip
_WORDS = tuple(value.to_bytes(4, "little") for value in (0, 1, 7, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0xFFFFFFF8))


def changed(data: bytes, seed: int, *, text: bool, places: Sequence[int] = ()) -> bytes:
    """A copy with one to four changes; near ``places``, every other time, where there are some."""
    rng = np.random.default_rng(seed)
    for _ in range(int(rng.integers(1, 5))):
        if not data:
            break
        at = int(rng.integers(len(data)))
        if len(places) and rng.integers(2):
            at = min(len(data) - 1, int(rng.choice(places)) + int(rng.integers(24)))
        data = (_text_change if text else _byte_change)(data, at, rng)
    return data


def _byte_change(data: bytes, at: int, rng: np.random.Generator) -> bytes:
    match int(rng.integers(6)):
        case 0 | 1 | 2:
            return data[:at] + bytes([data[at] ^ 1 << int(rng.integers(8))]) + data[at + 1 :]
        case 3:
            return data[:at] + _WORDS[rng.integers(len(_WORDS))] + data[at + 4 :]
        case 4:
            return data[:at]
        case _:
            length = int(rng.integers(1, 64))
            return data[:at] + data[at : at + length] + data[at:]


def _text_change(data: bytes, at: int, rng: np.random.Generator) -> bytes:
    match int(rng.integers(6)):
        case 0 | 1:
            numbers = list(re.finditer(rb"-?\d[\d.e+-]*", data))
            if not numbers:
                return data
            one = numbers[rng.integers(len(numbers))]
            return data[: one.start()] + _NUMBERS[rng.integers(len(_NUMBERS))] + data[one.end() :]
        case 2:
            return data[:at] + _TOKENS[rng.integers(len(_TOKENS))] + data[at:]
        case 3:
            return data[:at] + data[at + int(rng.integers(1, 40)) :]
        case 4:
            return data[:at] + data[max(0, at - int(rng.integers(1, 200))) :]
        case _:
            return _byte_change(data, at, rng)
