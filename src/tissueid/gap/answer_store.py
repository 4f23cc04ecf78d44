"""Stored answers of a blind check, so that a long check can be interrupted and resumed.

``answers/check.json`` in the folder of the scenarios holds the draw and the SHA-256 of the labels before the first
diagnosis. ``answers/NAME.json`` holds one answer each, written atomically by the process that computed it. Each file
has the SHA-256 of its content, so that a changed one is never scored or reported.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from tissueid import __version__
from tissueid.atomic_write import atomic_file, private_folder
from tissueid.errors import UnusableInputError

FOLDER = "answers"
_CHECK = "check"
_MOST_BYTES = 20_000_000
_KEYS = {"verdict", "gap", "where", "ranking", "combination"}


@dataclass(frozen=True)
class CheckInProgress:
    """A check in progress: its draw, the SHA-256 of its labels, its laboratory, whether its scenarios are on skin and
    are diagnosed against an accepted twin, and the version that answers."""

    n: int
    seed: int
    full_share: float
    seal: str
    laboratory: str = "first"
    skin: bool = False
    against_twin: bool = False
    software: str = __version__


def begin_check(folder: Path, begun: CheckInProgress) -> None:
    """Store the description of a check before its first answer; raise UnusableInputError where that fails."""
    store_answer(folder, _CHECK, asdict(begun))


def check_in_progress(folder: Path) -> CheckInProgress:
    """Return the check in progress in a folder.

    Raises:
        UnusableInputError: there is none, its file is damaged, or another version of the software began it.
    """
    found = _read(folder, _CHECK)
    if found is None:
        raise UnusableInputError(
            "blind.no_check", "there is no check to resume in {folder}: omit --resume to begin one", folder=str(folder)
        )
    try:
        begun = TypeAdapter(CheckInProgress).validate_python(found)
    except ValidationError as error:
        raise UnusableInputError(
            "blind.damaged_check", "{path} does not describe a check: begin a new one", path=str(_path(folder, _CHECK))
        ) from error
    if begun.software != __version__:
        raise UnusableInputError(
            "blind.other_version",
            "the check in {folder} was begun by version {begun}, this is {current}: answers of two versions cannot be "
            "scored together; begin a new one",
            folder=str(folder),
            begun=begun.software,
            current=__version__,
        )
    return begun


def store_answer(folder: Path, key: str, answer: dict[str, Any]) -> None:
    """Store an answer; raise UnusableInputError where it cannot be written."""
    path = _path(folder, key)
    try:
        private_folder(path.parent)
        with atomic_file(path) as partial:
            # NaN is kept, so that stored answers score exactly as fresh ones.
            body = json.dumps(answer, default=lambda item: item.item())
            partial.write_text(f'{{"sha256": "{_digest(body)}", "content": {body}}}', encoding="utf-8")
    except OSError as error:
        reason = error.strerror or ""
        raise UnusableInputError(
            "blind.unwritable", "cannot write {path}: {reason}", path=str(path), reason=reason
        ) from error


def stored_answer(folder: Path, key: str) -> dict[str, Any] | None:
    """Return a stored answer or None; raise UnusableInputError where the file holds something else."""
    found = _read(folder, key)
    if found is not None and not found.keys() >= _KEYS:
        raise _unreadable(_path(folder, key))
    return found


def _path(folder: Path, key: str) -> Path:
    return folder / FOLDER / f"{key}.json"


def _read(folder: Path, key: str) -> dict[str, Any] | None:
    path = _path(folder, key)
    if not path.exists():
        return None
    try:
        usable = path.is_file() and path.stat().st_size <= _MOST_BYTES
        found = json.loads(path.read_text(encoding="utf-8")) if usable else None
        content, digest = (found.get("content"), found.get("sha256")) if isinstance(found, dict) else (None, None)
        if isinstance(content, dict) and digest == _digest(json.dumps(content)):
            return content
    except (OSError, ValueError, RecursionError) as error:
        raise _unreadable(path) from error
    raise _unreadable(path)


def _digest(body: str) -> str:
    return hashlib.sha256(body.encode()).hexdigest()


def _unreadable(path: Path) -> UnusableInputError:
    return UnusableInputError(
        "blind.unreadable_answer", "{path} holds no answer: delete it to diagnose again", path=str(path)
    )
