"""Accepted result of a sitting: a JSON file next to the sessions, written when the user finishes the sitting."""

from __future__ import annotations

import contextlib
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Literal, TypeGuard

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from tissueid.atomic_write import atomic_file
from tissueid.errors import UnusableInputError
from tissueid.plan_options import validation_reason
from tissueid.sessions.model import Test
from tissueid.version import SOFTWARE

SITTING = "sitting"
"""Name of the note of a test with the key of its sitting."""
LARGEST_BYTES = 64 * 1024
MOST_TESTS = 100
MOST_QUANTITIES = 20

_Finite = Annotated[float, Field(allow_inf_nan=False, ge=-1e12, le=1e12)]
_Deviation = Annotated[float, Field(allow_inf_nan=False, ge=0.0, le=1e12)]
_Key = Annotated[str, Field(pattern=r"^[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}$")]
_FileName = Annotated[str, Field(min_length=1, max_length=255, pattern=r"^[^/\\\x00-\x1f\x7f]+$")]
_Quantity = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")]
_Line = Annotated[str, Field(max_length=200, pattern=r"^[^\x00-\x1f\x7f]*$")]


_KEY: TypeAdapter[str] = TypeAdapter(_Key)


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore")


class AcceptedTest(_Part):
    """One test of an accepted result: its session file, its number there, and the session's id."""

    file: _FileName
    number: Annotated[int, Field(ge=0, le=1_000_000)]
    session_id: _Line

    @classmethod
    def of(cls, path: Path, session_id: str, number: int) -> AcceptedTest:
        """Return the reference to a test of a session file."""
        return cls(file=path.name, number=number, session_id=session_id)


class AcceptedValue(_Part):
    """One quantity, SI. ``std`` is that of the repeats, or of the estimate if ``count`` is 1; for 2 the larger of both.

    ``repeatability`` is the difference of two tests that is not exceeded in 95 % of cases; None below three tests.
    """

    mean: _Finite
    std: _Deviation | None = None
    repeatability: _Deviation | None = None
    count: Annotated[int, Field(ge=1, le=MOST_TESTS)] = 1


class AcceptedResult(_Part):
    """The tests that a user accepted as the result of a sitting, and their values."""

    format: Literal["tissueid-result"] = "tissueid-result"
    format_version: Literal["1.0"] = "1.0"
    sitting: _Key
    accepted: _Line = Field(default_factory=lambda: datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"))
    software: _Line = SOFTWARE
    tests: Annotated[tuple[AcceptedTest, ...], Field(min_length=1, max_length=MOST_TESTS)]
    values: Annotated[dict[_Quantity, AcceptedValue], Field(max_length=MOST_QUANTITIES)]

    @property
    def count(self) -> int:
        """Number of accepted tests."""
        return len(self.tests)

    def holds(self, session_id: str, number: int) -> bool:
        """Return whether a test of a session is one of the accepted ones."""
        return any((test.session_id, test.number) == (session_id, number) for test in self.tests)


def result_path(folder: Path, sitting: str) -> Path:
    """Return the result file of a sitting in the folder of its sessions."""
    return folder / f"sitting-{sitting}.json"


def write_result(folder: Path, result: AcceptedResult) -> Path:
    """Write the accepted result of a sitting atomically into the folder of its sessions; return its path.

    Raises:
        OSError: it cannot be written.
    """
    path = result_path(folder, result.sitting)
    with atomic_file(path, synced=True) as partial:
        partial.write_text(result.model_dump_json(indent=2, exclude_none=True) + "\n", encoding="utf-8")
    return path


def withdraw_result(folder: Path, sitting: str) -> None:
    """Remove the result file of a sitting, if there is one.

    Raises:
        OSError: it cannot be removed.
    """
    with contextlib.suppress(FileNotFoundError):
        result_path(folder, sitting).unlink()


def read_result(path: Path) -> AcceptedResult:
    """Read the accepted result of a sitting.

    Raises:
        UnusableInputError: the file is too large, or not a result.
        OSError: it cannot be read.
    """
    if not path.is_file():
        raise UnusableInputError("result.not_a_file", "{path} is not a file", path=str(path))
    with path.open("rb") as file:
        content = file.read(LARGEST_BYTES + 1)
    if len(content) > LARGEST_BYTES:
        raise UnusableInputError(
            "result.too_large",
            "{path} is larger than {most} KB: it is not the result of a sitting",
            path=str(path),
            most=LARGEST_BYTES // 1024,
        )
    try:
        return AcceptedResult.model_validate_json(content)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(str(part) for part in first["loc"])[:100] or "content"
        raise UnusableInputError(
            "result.invalid",
            "{path}: '{field}' cannot be used: {reason}",
            path=str(path),
            field=where,
            reason=validation_reason(error),
        ) from error


def result_of(folder: Path, test: Test) -> AcceptedResult | None:
    """Read the accepted result of the sitting of a test; None without a sitting or if the sitting was never finished.

    Raises:
        UnusableInputError: the result file is damaged, or belongs to another sitting.
        OSError: it cannot be read.
    """
    key = sitting_of(test)
    if key is None or not result_path(folder, key).exists():
        return None
    result = read_result(result_path(folder, key))
    if result.sitting != key:
        raise UnusableInputError(
            "result.other_sitting",
            "{path} is the result of another sitting and is not used: move it to another folder",
            path=str(result_path(folder, key)),
        )
    return result


def sitting_of(test: Test) -> str | None:
    """Return the key of the sitting of a test; None if it has no valid key."""
    key = test.notes.get(SITTING)
    return key if is_sitting_key(key) else None


def is_sitting_key(key: object) -> TypeGuard[str]:
    """Return whether a value is a valid key of a sitting, which is safe as part of a file name."""
    try:
        _KEY.validate_python(key, strict=True)
    except ValidationError:
        return False
    return True
