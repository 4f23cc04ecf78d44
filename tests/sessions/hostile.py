"""Damaged and hostile sessions, made by code: each as small as it can be."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np

from tissueid.device import DeviceDescription
from tissueid.sessions import Session, Subject, Test, write_session

SIGNALS = "tests/0001/signals"


def a_session(path: Path, samples: int = 900) -> Path:
    """A good session of one test."""
    rng = np.random.default_rng(1)
    signals = {name: rng.standard_normal(samples) for name in ("command", "current", "force", "position")}
    test = Test(1, "stochastic", signals, 2000.0, site="left forearm", stimulus={"type": "gaussian"}, preload_s=0.05)
    device = replace(DeviceDescription(), serial_number="T-1", calibration={"kind": "check"})
    write_session(path, Session(device, Subject("B5978"), (test,)))
    return path


def heap_objects(data: bytes) -> Iterator[int]:
    """Where the head of every object of every global heap collection lies."""
    collection = data.find(b"GCOL")
    while collection >= 0:
        (size,) = struct.unpack_from("<Q", data, collection + 8)
        at = collection + 16
        while at < collection + size - 16:
            index, _, _, length = struct.unpack_from("<HHIQ", data, at)
            yield at
            if not index:
                break
            at += 16 + length + -length % 8
        collection = data.find(b"GCOL", collection + 1)


def endless_heap(path: Path, *, unseen: bool = False) -> None:
    """Make the library loop for ever: an object of no size. ``unseen`` hides the collection from ``heap_check``."""
    data = bytearray(path.read_bytes())
    first = next(heap_objects(bytes(data)))
    data[first : first + 16] = bytes(16)
    if unseen:
        data[data.find(b"GCOL") + 5] = 1  # a reserved byte, which the library does not look at
    path.write_bytes(data)


def zeros_packed(count: int) -> bytes:
    """Return ``size`` bytes of zeros, compressed."""
    packer, block = zlib.compressobj(9), bytes(1 << 20)
    return b"".join([packer.compress(block) for _ in range(count >> 20)] + [packer.flush()])


def _attribute(place: str, name: str, value: object) -> Callable[[h5py.File], None]:
    return lambda file: file[place].attrs.__setitem__(name, value)


def _huge_chunk(file: h5py.File) -> None:
    del file[f"{SIGNALS}/force"]
    data = file[SIGNALS].create_dataset(
        "force", (900,), "f8", maxshape=(None,), chunks=(500_000_000,), compression="gzip"
    )
    data.id.write_direct_chunk((0,), zeros_packed(1 << 24))


def _chunk_bomb(file: h5py.File) -> None:
    del file[f"{SIGNALS}/force"]
    data = file[SIGNALS].create_dataset("force", (900,), "f8", chunks=(900,), compression="gzip")
    data.id.write_direct_chunk((0,), zeros_packed(3 << 27))


def _fill_values(file: h5py.File) -> None:
    for name in list(file[SIGNALS]):
        del file[SIGNALS][name]
        file[SIGNALS].create_dataset(name, (20_000_000,), "f8", chunks=(100_000,), fillvalue=1.0)


def _linked_often(file: h5py.File) -> None:
    for number in range(2, 301):
        file[f"tests/{number:04d}"] = file["tests/0001"]


def _many_texts(file: h5py.File) -> None:
    file["tests/0001"].attrs.create("t", ["x"] * 4000, dtype=h5py.string_dtype())


def _many_attributes(file: h5py.File) -> None:
    for number in range(1001):
        file["tests/0001"].attrs[f"a{number}"] = 1.0


REFUSED: dict[str, Callable[[h5py.File], None]] = {
    "huge chunk": _huge_chunk,
    "chunk bomb": _chunk_bomb,
    "fill values": _fill_values,
    "one test, many numbers": _linked_often,
    "many texts": _many_texts,
    "many attributes": _many_attributes,
    "long text": _attribute("tests/0001", "note", "x" * 5_000_000),
    "long array": _attribute("subject", "note", np.zeros(200_000)),
    "infinite preload": _attribute("tests/0001", "preload_s", np.inf),
    "infinite rate": _attribute("tests/0001", "sample_rate_hz", np.inf),
    "no rate": _attribute("tests/0001", "sample_rate_hz", np.nan),
    "tiny rate": _attribute("tests/0001", "sample_rate_hz", 1e-300),
}
"""Sessions that are refused, by what is wrong."""

CLEANED: dict[str, Callable[[h5py.File], None]] = {
    "deep JSON": _attribute("tests/0001", "stimulus", '{"a":' * 900 + "1" + "}" * 900),
    "half characters in JSON": _attribute("tests/0001", "stimulus", '{"a": "\\ud800", "\\udc00": ["\\udfff"]}'),
    "no UTF-8": lambda file: file["tests/0001"].attrs.create("site", b"a\xe9\xff", dtype=h5py.string_dtype("utf-8", 3)),
    "reference": lambda file: file["tests/0001"].attrs.create("ref", file.ref, dtype=h5py.ref_dtype),
}
"""Sessions that are read, but for what cannot be: they have to be exported too."""


def changed(path: Path, how: Callable[[h5py.File], None]) -> Path:
    """Change a session by the HDF5 library."""
    with h5py.File(path, "r+") as file:
        how(file)
    return path
