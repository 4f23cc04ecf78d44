"""Files of diagnoses, kept from one start of the window to the next. Their content is validated when it is read.

One JSON file holds the content of the page, the answer of the command line, the report and the twin with the named
effects. Fits are not kept. Texts are stored with their message codes; the report stays in the language in which it was
made.
"""

from __future__ import annotations

import contextlib
import os
import re
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, model_validator

from tissueid.app.user_files import default_path
from tissueid.app.views.gap.diagnosis_result import DiagnosisResult
from tissueid.app.views.gap.page_content import PageContent
from tissueid.atomic_write import open_regular, private_folder, write_private
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.instrument.twin_file import TwinFile
from tissueid.language import ENGLISH
from tissueid.procedures.gap_plans import DiagnosisPlan
from tissueid.stored_values import StoredText
from tissueid.untrusted_input import MAX_TESTS, json_value

FOLDER = "diagnoses"
MOST_KEPT = 20
MOST_BYTES = 20_000_000
"""Maximum size of a file. A diagnosis of one test takes about 600 kB, two thirds of it the report."""
_SUFFIX = ".json"
_KEY = re.compile(r"[0-9]{8}T[0-9]{12}Z-[0-9a-f]{8}")
_ANSWER = {"verdict", "gap", "where", "ranking", "combination", "members", "next_experiment", "remarks", "seconds"}
_Line = Annotated[str, Field(max_length=500)]
_Path = Annotated[str, Field(min_length=1, max_length=5000, pattern=r"^[^\x00]+$")]
_Numbers = Annotated[tuple[int, ...], Field(max_length=MAX_TESTS)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", ser_json_inf_nan="constants")


class _Asked(_Part):
    session: _Path
    twin: _Path | None
    fit: _Numbers
    check: _Numbers
    language: _Line = ENGLISH
    """Of files of earlier versions; it is not used."""

    @classmethod
    def of(cls, asked: DiagnosisPlan) -> _Asked:
        """Return the stored form of a plan."""
        twin = None if asked.twin is None else str(asked.twin)
        return cls(session=str(asked.session), twin=twin, fit=asked.fit, check=asked.check)

    @property
    def asked(self) -> DiagnosisPlan:
        """The plan."""
        twin = None if self.twin is None else Path(self.twin)
        return DiagnosisPlan(session=Path(self.session), twin=twin, fit=self.fit, check=self.check)


class _Kept(_Part):
    """The stored form of a ``DiagnosisResult``."""

    format: Literal["tissueid-diagnosis"] = "tissueid-diagnosis"
    format_version: Literal["1.0", "1.1"] = "1.1"
    key: Annotated[str, Field(pattern=rf"^{_KEY.pattern}$")]
    when: AwareDatetime
    asked: _Asked
    session_id: _Line
    instrument: DeviceDescription
    stamp: tuple[int, int] | None
    twin: TwinFile | None
    accepted: TwinFile | None
    refused: StoredText
    story: PageContent
    answer: dict[str, Any]
    report: str

    @model_validator(mode="after")
    def _agrees_with_itself(self) -> _Kept:
        if not self.answer.keys() >= _ANSWER or self.answer["verdict"] != self.story.verdict:
            raise ValueError("the answer does not belong to this diagnosis")
        named = {name for name, _title, named in self.story.offered if named}
        if self.accepted is not None and not named <= {item.name for item in self.accepted.effects}:
            raise ValueError("the twin does not belong to this diagnosis")
        return self

    @classmethod
    def of(cls, result: DiagnosisResult) -> _Kept:
        """Return the stored form of a diagnosis."""
        own = {field.name: getattr(result, field.name) for field in fields(DiagnosisResult)}
        return cls(**own | {"asked": _Asked.of(result.asked), "answer": dict(result.answer)})

    @property
    def result(self) -> DiagnosisResult:
        """The diagnosis."""
        own = {
            name: getattr(self, name) for name in type(self).model_fields if name not in ("format", "format_version")
        }
        return DiagnosisResult(**own | {"asked": self.asked.asked})


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
        text = _Kept.of(result).model_dump_json()
        _parsed(text.encode(), result.key)
    except (ValueError, RecursionError) as error:
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
        except (OSError, ValueError, RecursionError):
            bad += 1
    return KeptDiagnoses(tuple(results), bad)


def _read(path: Path, key: str) -> DiagnosisResult:
    with open_regular(path) as file:
        return _parsed(file.read(MOST_BYTES + 1), key)


def _parsed(data: bytes, key: str) -> DiagnosisResult:
    if len(data) > MOST_BYTES:
        raise ValueError("too long")
    kept = _Kept.model_validate(json_value(data))
    if kept.key != key:
        raise ValueError("the key differs from the name of the file")
    return kept.result


def _keys(folder: Path) -> list[str]:
    """Return the names of the kept diagnoses, newest first."""
    try:
        names = [entry.name for entry in os.scandir(folder)]
    except FileNotFoundError:
        return []
    keys = [name.removesuffix(_SUFFIX) for name in names if name.endswith(_SUFFIX)]
    return sorted((key for key in keys if _KEY.fullmatch(key)), reverse=True)
