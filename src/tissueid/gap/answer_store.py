"""Stored answers of diagnoses, so that long work on many of them can be interrupted and resumed.

``answers/NAME.json`` in a folder holds one answer each, written atomically by the process that computed it. Each file
has the SHA-256 of its content, so that a changed one is never scored or reported.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from tissueid.atomic_write import atomic_file, private_folder
from tissueid.errors import UnusableInputError

FOLDER = "answers"
_MOST_BYTES = 20_000_000
_KEYS = {"verdict", "gap", "where", "ranking", "combination"}


def store_answer(folder: Path, key: str, answer: dict[str, Any]) -> None:
    """Store an answer; raise UnusableInputError where it cannot be written."""
    path = answer_path(folder, key)
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
    found = stored_content(folder, key)
    if found is not None and not found.keys() >= _KEYS:
        raise _unreadable(answer_path(folder, key))
    return found


def answer_path(folder: Path, key: str) -> Path:
    """Return the file of an answer."""
    return folder / FOLDER / f"{key}.json"


def stored_content(folder: Path, key: str) -> dict[str, Any] | None:
    """Return what ``store_answer`` stored or None; raise UnusableInputError where the file holds something else."""
    path = answer_path(folder, key)
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
