"""Answers of a sealed check as files beside its scenarios, so that a long check can be interrupted and go on.

``answers/check.json`` says which draw it is and the SHA-256 of its labels as it was before the first diagnosis;
``answers/NAME.json`` holds one answer each, written whole or not at all by whoever found it.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tissueid import __version__
from tissueid.errors import UnusableInputError
from tissueid.whole_file import private_folder, whole_file

FOLDER = "answers"
_CHECK = "check"
_MOST_BYTES = 20_000_000
_KEYS = {"verdict", "gap", "where", "ranking", "combination"}


@dataclass(frozen=True)
class Begun:
    """A check that was begun: its draw, the seal of its labels, and the version that answers."""

    n: int
    seed: int
    full_share: float
    seal: str
    software: str = __version__


def begin(folder: Path, begun: Begun) -> None:
    """Keep what a check is, before its first answer.

    Raises:
        UnusableInputError: it cannot be written.
    """
    _write(folder, _CHECK, asdict(begun))


def begun_in(folder: Path) -> Begun:
    """The check that was begun in a folder.

    Raises:
        UnusableInputError: there is none, its file is damaged, or another version began it.
    """
    found = _read(folder, _CHECK)
    if found is None:
        raise UnusableInputError(f"there is no check to go on with in {folder}: leave --resume out to begin one")
    try:
        begun = Begun(
            int(found["n"]), int(found["seed"]), float(found["full_share"]), str(found["seal"]), str(found["software"])
        )
    except (KeyError, TypeError, ValueError) as error:
        raise UnusableInputError(f"{_path(folder, _CHECK)} does not say which check it is: begin a new one") from error
    if begun.software != __version__:
        raise UnusableInputError(
            f"the check in {folder} was begun by version {begun.software}, this is {__version__}: answers of two "
            "versions are no one score; begin a new one"
        )
    return begun


def keep_answer(folder: Path, key: str, answer: dict[str, Any]) -> None:
    """Keep an answer.

    Raises:
        UnusableInputError: it cannot be written.
    """
    _write(folder, key, answer)


def kept_answer(folder: Path, key: str) -> dict[str, Any] | None:
    """An answer that was kept, None where there is none.

    Raises:
        UnusableInputError: the file holds no answer.
    """
    found = _read(folder, key)
    if found is not None and not found.keys() >= _KEYS:
        raise UnusableInputError(f"{_path(folder, key)} holds no answer: delete it, and it is asked again")
    return found


def _path(folder: Path, key: str) -> Path:
    return folder / FOLDER / f"{key}.json"


def _write(folder: Path, key: str, value: dict[str, Any]) -> None:
    path = _path(folder, key)
    try:
        private_folder(path.parent)
        with whole_file(path) as partial:
            # NaN stays what it is: a score of kept answers is that of fresh ones to the last bit.
            partial.write_text(json.dumps(value, default=lambda item: item.item()), encoding="utf-8")
    except OSError as error:
        raise UnusableInputError(f"cannot write {path}: {error.strerror}") from error


def _read(folder: Path, key: str) -> dict[str, Any] | None:
    path = _path(folder, key)
    if not path.exists():
        return None
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise UnusableInputError(f"{path} is too large for an answer: delete it, and it is asked again")
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise UnusableInputError(f"{path} cannot be read: delete it, and it is asked again") from error
    if not isinstance(found, dict):
        raise UnusableInputError(f"{path} holds no answer: delete it, and it is asked again")
    return found
