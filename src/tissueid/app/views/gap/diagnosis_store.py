"""Files of diagnoses, kept from one start of the window to the next. Their content is validated when it is read.

One JSON file holds the content of the page, the answer of the command line, the report and the twin with the named
effects. Fits are not kept. Texts are stored with their message codes; the report stays in the language in which it was
made.
"""

from __future__ import annotations

import contextlib
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from tissueid.app.user_files import default_path
from tissueid.app.views.gap.diagnosis_result import KEY, DiagnosisResult
from tissueid.atomic_write import open_regular, private_folder, write_private
from tissueid.errors import UnusableInputError
from tissueid.untrusted_input import json_value

FOLDER = "diagnoses"
MOST_KEPT = 20
MOST_BYTES = 20_000_000
"""Maximum size of a file. A diagnosis of one test takes about 600 kB, two thirds of it the report."""
_SUFFIX = ".json"
_FORMAT, _VERSION, _LOGARITHMS = "tissueid-diagnosis", "1.2", "1.1"
"""Name and version of the files, and the version whose spectra and errors are decimal logarithms."""
_ANSWER = {"verdict", "gap", "where", "ranking", "combination", "members", "next_experiment", "remarks", "seconds"}
_RESULT = TypeAdapter(DiagnosisResult)


@dataclass(frozen=True)
class KeptDiagnoses:
    """Diagnoses read from files, newest first, and the number of files that could not be read."""

    results: tuple[DiagnosisResult, ...]
    bad: int


def default_folder() -> Path:
    """Return the folder of this user's diagnoses, next to the history of analyses."""
    return default_path().with_name(FOLDER)


def keep(result: DiagnosisResult, folder: Path) -> None:
    """Write a diagnosis atomically, readable by its owner only, and remove the oldest files beyond ``MOST_KEPT``.

    Raises:
        OSError: the file cannot be written.
        UnusableInputError: the file would be rejected when it is read.
    """
    try:
        content = {"format": _FORMAT, "format_version": _VERSION} | _RESULT.dump_python(result, mode="json")
        text = json.dumps(content)
        _parsed(text.encode(), result.key)
    except ValueError as error:
        raise UnusableInputError(
            "gap.diagnosis_not_kept", "This diagnosis cannot be kept for the next start."
        ) from error
    private_folder(folder)
    write_private(folder / f"{result.key}{_SUFFIX}", text)
    for key in _keys(folder)[MOST_KEPT:]:
        remove(key, folder)


def remove(key: str, folder: Path) -> None:
    """Remove a kept diagnosis. A missing file and a failure are ignored."""
    with contextlib.suppress(OSError):
        (folder / f"{key}{_SUFFIX}").unlink()


def read_kept(folder: Path) -> KeptDiagnoses:
    """Read the kept diagnoses. A missing folder is an empty one.

    Raises:
        OSError: the folder exists and cannot be read.
    """
    results: list[DiagnosisResult] = []
    bad = 0
    for key in _keys(folder)[:MOST_KEPT]:
        try:
            results.append(_read(folder / f"{key}{_SUFFIX}", key))
        except (OSError, ValueError, TypeError, KeyError, AttributeError):
            bad += 1
    return KeptDiagnoses(tuple(results), bad)


def _read(path: Path, key: str) -> DiagnosisResult:
    with open_regular(path) as file:
        return _parsed(file.read(MOST_BYTES + 1), key)


def _parsed(data: bytes, key: str) -> DiagnosisResult:
    if len(data) > MOST_BYTES:
        raise ValueError("too long")
    content = json_value(data)
    version = content.pop("format_version")
    if content.pop("format") != _FORMAT or version not in (_VERSION, _LOGARITHMS):
        raise ValueError("the file is no diagnosis of this version")
    if version == _LOGARITHMS:
        del content["asked"]["language"]
        _undo_logarithms(content["story"])
    result = _RESULT.validate_python(content)
    if result.key != key:
        raise ValueError("the key differs from the name of the file")
    if not result.answer.keys() >= _ANSWER or result.answer["verdict"] != result.story.verdict:
        raise ValueError("the answer does not belong to this diagnosis")
    named = {name for name, _title, is_named in result.story.offered if is_named}
    if result.accepted is not None and not named <= {item.name for item in result.accepted.effects}:
        raise ValueError("the twin does not belong to this diagnosis")
    return result


def _undo_logarithms(story: dict[str, Any]) -> None:
    del story["gap"]
    if (spectrum := story["spectrum"]) is not None:
        del spectrum["unit"]
        curves = {name: _powers(values) for name, values in spectrum["lines"].items()}
        bands = [_powers(band) for band in spectrum["bands"]]
        spectrum |= {"frequency": _powers(spectrum["frequency"]), "lines": curves, "bands": bands}
    for profile in story["profiles"].values():
        profile["error"] = _powers(profile["error"])
    for overlay in story["overlays"]:
        del overlay["unit"], overlay["fine_unit"]


def _powers(logarithms: list[float]) -> list[float]:
    powers: list[float] = (10.0 ** np.asarray(logarithms, dtype=np.float64)).tolist()
    return powers


def _keys(folder: Path) -> list[str]:
    """Return the names of the kept diagnoses, newest first."""
    try:
        names = [entry.name for entry in os.scandir(folder)]
    except FileNotFoundError:
        return []
    keys = [name.removesuffix(_SUFFIX) for name in names if name.endswith(_SUFFIX)]
    return sorted((key for key in keys if KEY.fullmatch(key)), reverse=True)
