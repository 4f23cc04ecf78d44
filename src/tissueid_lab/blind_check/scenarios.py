"""Scenarios of the simulated laboratory: raw recordings and sealed labels, written by another process.

A scenario is a JSON file of attributes and a file of little-endian 64-bit numbers. The labels of all scenarios are one
JSON file, whose SHA-256 is published before the diagnosis.
"""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.sessions import Session, Test
from tissueid_lab.blind_check.scoring import Label

LABELS = "labels.json"
MOST_BYTES = 200_000_000


def scenario_names(folder: Path) -> list[str]:
    """Return the names of the scenarios in a folder, in order."""
    return sorted(path.stem for path in folder.glob("scenario-*.json"))


def read_scenario(folder: Path, name: str, kind: str = "") -> Session:
    """Return the session of a scenario, or a companion of this ``kind``, such as ``clean`` (the effects without noise).

    Raises:
        UnusableInputError: the files are missing or damaged.
    """
    about = _read_json(folder / f"{name}.json")
    path = folder / (f"{name}.{kind}.f64" if kind else f"{name}.f64")
    try:
        if path.stat().st_size > MOST_BYTES:
            raise UnusableInputError(f"{path} is too large for a scenario")
        numbers = np.fromfile(path, "<f8")
        names = list(about["signals"])
        tests = tuple(_test(item, names, numbers) for item in about["tests"])
        known = {item.name for item in fields(DeviceDescription)}
        instrument = DeviceDescription(**{key: value for key, value in about["instrument"].items() if key in known})
    except (OSError, AttributeError, KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
        raise UnusableInputError(f"{path} is no recording of the simulated laboratory: {error}") from error
    return Session(instrument, tests=tests)


def earlier_session(folder: Path, name: str) -> str | None:
    """Return the name of the earlier session of a scenario's person and instrument; None where there is none.

    Raises:
        UnusableInputError: the file is missing or damaged.
    """
    found = _read_json(folder / f"{name}.json").get("earlier")
    if found is None:
        return None
    if not isinstance(found, str) or re.fullmatch(r"earlier-\d{4,6}", found) is None:
        raise UnusableInputError(f"{folder / name}.json names no earlier session")
    return found


def alone_sessions(folder: Path, name: str) -> list[Session]:
    """Return a pair's sessions with one effect each, in the order of its effects; none where there are no companions.

    Raises:
        UnusableInputError: as ``read_scenario``.
    """
    kinds = sorted(path.name.split(".")[1] for path in folder.glob(f"{name}.alone-*.f64"))
    return [read_scenario(folder, name, kind) for kind in kinds]


def _test(about: dict[str, Any], names: list[str], numbers: np.ndarray) -> Test:
    samples, first = int(about["samples"]), int(about["first"])
    rows = numbers[first : first + samples * len(names)].reshape(len(names), samples)
    return Test(
        number=int(about["name"]),
        kind=str(about["kind"]),
        signals={name: row.copy() for name, row in zip(names, rows, strict=True)},
        sample_rate_hz=float(about["sample_rate_hz"]),
        configuration=str(about["configuration"]),
        preload_s=float(about["preload_s"]),
        surface_position_m=float(about["surface_position_m"]),
        stimulus=dict(about["stimulus"]),
        seed=int(about["seed"]),
        repeat_of=int(about["repeat_of"]) if about["repeat_of"] else None,
        notes=dict(about.get("notes", {})),
    )


def seal(folder: Path) -> str:
    """Return the SHA-256 of the labels, to be published before the diagnosis.

    Raises:
        UnusableInputError: there are no labels.
    """
    try:
        return hashlib.sha256((folder / LABELS).read_bytes()).hexdigest()
    except OSError as error:
        raise UnusableInputError(f"there are no labels in {folder}") from error


def unseal(folder: Path) -> dict[str, Label]:
    """Return the labels by scenario.

    Raises:
        UnusableInputError: they cannot be read.
    """
    try:
        return {name: _label(about) for name, about in _read_json(folder / LABELS).items()}
    except (KeyError, TypeError) as error:
        raise UnusableInputError(f"{folder / LABELS} holds no labels of scenarios") from error


def _label(about: dict[str, Any]) -> Label:
    effects = about["effects"]
    return Label(
        tuple(item["name"] for item in effects),
        tuple(item["stage"] for item in effects),
        tuple(bool(item["listed"]) for item in effects),
        bool(about["full"]),
        tuple(item["name"] for item in effects if item.get("hidden", False)),
        str(about.get("preset", "")),
    )


def _read_json(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > MOST_BYTES:
            raise UnusableInputError(f"{path} is too large for a scenario")
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise UnusableInputError(f"{path} cannot be read") from error
    if not isinstance(found, dict):
        raise UnusableInputError(f"{path} holds no object")
    return found
