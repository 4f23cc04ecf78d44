"""A designed stimulus in a file: its description and a checksum, so that it comes back sample for sample or not at all.

The file holds no samples. They are built again from the description, and their checksum tells whether this version
builds what was saved. A stimulus that is generated while a test runs has a description and nothing to check.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tissueid import __version__
from tissueid.errors import UnusableInputError
from tissueid.stimuli import FeedbackKind, Stimulus, build_specified, specified
from tissueid.untrusted import json_value
from tissueid.whole_file import open_regular, whole_file

FORMAT = "tissueid-stimulus"
FORMAT_VERSION = "1.0"
_MOST_BYTES = 4 * 1024 * 1024


def save_stimulus(path: Path, stimulus: Stimulus | FeedbackKind) -> None:
    """Write a stimulus, whole or not at all; a file that is there is never written over.

    Raises:
        UnusableInputError: the file is there already, the folder is missing, or it cannot be written.
    """
    check_new(path)
    text = json.dumps(_content(stimulus), indent=2, allow_nan=False) + "\n"
    try:
        with whole_file(path, new=True, shared=True) as partial:
            partial.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UnusableInputError(f"cannot write {path}: {error.strerror}") from error


def check_new(path: Path) -> None:
    """Refuse, before any work, a file that a stimulus cannot be saved to.

    Raises:
        UnusableInputError: it is there already, or its folder is not.
    """
    if path.is_dir():
        raise UnusableInputError(f"{path} is a folder; name a file")
    if path.exists():
        raise UnusableInputError(f"{path} is there already; a saved stimulus is never written over")
    if not path.parent.is_dir():
        raise UnusableInputError(f"there is no folder {path.parent}")


def load_stimulus(path: Path) -> Stimulus | FeedbackKind:
    """Read a stimulus: built again and checked, or the specification of one that is generated while a test runs.

    Raises:
        UnusableInputError: no such file, not a stimulus, one that asks for too much, or one that this version builds
            otherwise.
    """
    content = _read(path)
    description = content.get("description")
    if not isinstance(description, dict):
        raise UnusableInputError(f"{path} holds no description of a stimulus")
    specification, preload_s = specified(description)
    if isinstance(specification, FeedbackKind):
        if preload_s is not None:
            raise UnusableInputError(f"{path}: {specification.name!r} takes its preload from the test, not from a file")
        return specification
    built = build_specified(specification, preload_s)
    _verify(path, content, built)
    return built


def checksum(stimulus: Stimulus) -> str:
    """SHA-256, hexadecimal, of the values as little-endian float64."""
    return hashlib.sha256(np.ascontiguousarray(stimulus.values, dtype="<f8").tobytes()).hexdigest()


def _content(stimulus: Stimulus | FeedbackKind) -> dict[str, Any]:
    head = {"format": FORMAT, "format_version": FORMAT_VERSION, "software": f"tissueid {__version__}"}
    if isinstance(stimulus, FeedbackKind):
        return head | {
            "description": stimulus.describe(),
            "samples": None,
            "sample_rate_hz": stimulus.sample_rate,
            "unit": "N",
            "sha256": None,
        }
    return head | {
        "description": stimulus.description,
        "samples": len(stimulus),
        "sample_rate_hz": stimulus.sample_rate_hz,
        "unit": stimulus.unit,
        "sha256": checksum(stimulus),
    }


def _read(path: Path) -> dict[str, Any]:
    """The JSON object in a stimulus file.

    Raises:
        UnusableInputError: it cannot be read, is too long, or is something else.
    """
    try:
        with open_regular(path) as file:
            data = file.read(_MOST_BYTES + 1)
    except FileNotFoundError as error:
        raise UnusableInputError(f"{path}: no such file") from error
    except OSError as error:
        raise UnusableInputError(f"cannot read {path}: {error.strerror}") from error
    if len(data) > _MOST_BYTES:
        raise UnusableInputError(f"{path} is larger than {_MOST_BYTES >> 20} MB: that is no saved stimulus")
    try:
        content = json_value(data)
    except ValueError as error:
        raise UnusableInputError(f"{path} is damaged, or not a saved stimulus") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise UnusableInputError(f"{path} is not a saved stimulus")
    version = content.get("format_version")
    if not isinstance(version, str) or version.split(".")[0] != FORMAT_VERSION.split(".")[0]:
        raise UnusableInputError(
            f"{path} has format version {str(version)[:20]!r}; this software reads {FORMAT_VERSION}: upgrade it"
        )
    return content


def _verify(path: Path, content: Mapping[str, Any], built: Stimulus) -> None:
    """Hold what was built against what was saved.

    Raises:
        UnusableInputError: length, rate, unit or samples are not those that were saved.
    """
    said = (content.get("samples"), content.get("sample_rate_hz"), content.get("unit"))
    if said != (len(built), built.sample_rate_hz, built.unit):
        raise UnusableInputError(f"{path}: length, sample rate or unit are not those of its description")
    if content.get("sha256") != checksum(built):
        by = str(content.get("software", "another version"))[:40]
        raise UnusableInputError(
            f"{path}: what is built from its description differs from what {by} saved: another version, or another "
            "processor, computes it otherwise; design the stimulus anew"
        )
