"""Calibration files: TOML that says what was measured on which device, when, how well, under which conditions."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated, Literal

import tomli_w
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from tissueid.errors import UnusableInputError
from tissueid.options import reason
from tissueid.untrusted import toml_table
from tissueid.whole_file import whole_file

FORMAT: Literal["tissueid-calibration"] = "tissueid-calibration"
MOST_BYTES = 1024 * 1024
MOST_ROWS = 10_000

Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")]
Line = Annotated[str, Field(max_length=200, pattern=r"^[^\x00-\x1f\x7f]*$")]
"""Text of one line."""
Sentence = Annotated[str, Field(max_length=500, pattern=r"^[^\x00-\x1f\x7f]*$")]
Column = Annotated[tuple[Finite, ...], Field(max_length=MOST_ROWS)]


class Quantity(BaseModel):
    """A value with its standard deviation and unit."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    value: Finite
    std: Annotated[float, Field(strict=True, ge=0, allow_inf_nan=False)] | None = None
    unit: Annotated[str, Field(max_length=32, pattern=r"^[^\x00-\x1f\x7f]*$")] = ""


class Calibration(BaseModel):
    """One calibration of one device.

    ``quantities`` are single figures by name (``coil_resistance_ohm``, ``force_constant_n_per_a``,
    ``linear_region_min_m``, ...); ``tables`` are columns of equal length by name (``force_constant``: ``position_m``,
    ``value_n_per_a``, ``std_n_per_a``). ``problems`` says why a verdict is ``failed``.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    format: Literal["tissueid-calibration"] = FORMAT
    format_version: Literal["1.0"] = "1.0"
    kind: Literal["static", "sweep"]
    model: Annotated[Line, Field(min_length=1)]
    serial_number: Annotated[Line, Field(min_length=1)]
    firmware_version: Line = ""
    date: str
    """ISO 8601, UTC."""
    valid_days: Annotated[int, Field(ge=1, le=3650)] = 90
    software: Line
    conditions: Annotated[dict[Name, Finite | Sentence], Field(max_length=100)] = Field(default_factory=dict)
    verdict: Literal["passed", "failed"]
    problems: Annotated[tuple[Sentence, ...], Field(max_length=100)] = ()
    quantities: Annotated[dict[Name, Quantity], Field(max_length=200)] = Field(default_factory=dict)
    tables: Annotated[dict[Name, dict[Name, Column]], Field(max_length=100)] = Field(default_factory=dict)

    @field_validator("date")
    @classmethod
    def _is_a_time(cls, text: str) -> str:
        try:
            time = datetime.fromisoformat(text)
        except ValueError:
            raise ValueError("it must be a time such as 2026-03-01T09:30:00Z") from None
        if time.utcoffset() != timedelta(0):
            raise ValueError("it must be a time in UTC, such as 2026-03-01T09:30:00Z")
        return text

    @field_validator("tables")
    @classmethod
    def _columns_agree(cls, tables: dict[str, dict[str, Column]]) -> dict[str, dict[str, Column]]:
        for name, columns in tables.items():
            if len({len(column) for column in columns.values()}) > 1:
                raise ValueError(f"the columns of {name} differ in length")
            if len(columns) > 50:
                raise ValueError(f"{name} has more than 50 columns")
        return tables

    @property
    def made(self) -> datetime:
        """When it was made, UTC."""
        return datetime.fromisoformat(self.date).astimezone(UTC)

    def age_days(self, now: datetime) -> float:
        """Days from when it was made until ``now``; negative where it lies in the future."""
        return (now - self.made) / timedelta(days=1)


def utc_date(now: datetime | None = None) -> str:
    """A time as calibrations carry it, to the second; that of now without one."""
    return (now or datetime.now(UTC)).astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def read_calibration(path: Path) -> Calibration:
    """Read a calibration from wherever it came.

    Raises:
        UnusableInputError: no such file, too large, not TOML, not a calibration; says which field is wrong.
    """
    if path.exists() and not path.is_file():
        raise UnusableInputError(f"{path} is not a file")
    try:
        with path.open("rb") as file:
            data = file.read(MOST_BYTES + 1)
    except OSError as error:
        raise UnusableInputError(f"cannot read {path}: {error.strerror}") from error
    content = _parsed(path, data)
    if content.get("format") != FORMAT:
        raise UnusableInputError(f"{path} is not a calibration: its format is not {FORMAT!r}")
    try:
        return Calibration.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(str(part) for part in first["loc"] if part not in ("float", "tuple", "[key]")) or "content"
        raise UnusableInputError(f"{path}: {where[:100]!r} cannot be used: {reason(error)[:200]}") from error


def _parsed(path: Path, data: bytes) -> dict[str, object]:
    """The content of a TOML file.

    Raises:
        UnusableInputError: it is none.
    """
    if len(data) > MOST_BYTES:
        raise UnusableInputError(f"{path} is too large for a calibration: at most {MOST_BYTES // 1024} KiB")
    try:
        return toml_table(data)
    except UnicodeDecodeError as error:
        raise UnusableInputError(f"{path} is not a calibration: it is not text") from error
    except ValueError as error:
        raise UnusableInputError(f"{path} is not a calibration: {str(error).splitlines()[0][:200]}") from error


def check_writable(path: Path) -> None:
    """Refuse, before any work, a file that a calibration cannot be written to.

    Raises:
        UnusableInputError: a folder, no folder for it, or a file that is not a calibration and is not written over.
    """
    if path.is_dir():
        raise UnusableInputError(f"{path} is a folder; name a file")
    if not path.parent.is_dir():
        raise UnusableInputError(f"there is no folder {path.parent}")
    if path.exists():
        try:
            with path.open("rb") as file:
                content = _parsed(path, file.read(MOST_BYTES + 1))
        except (OSError, UnusableInputError):
            content = {}
        if content.get("format") != FORMAT:
            raise UnusableInputError(f"{path} is there already and is not a calibration; it is not written over")


def write_calibration(path: Path, calibration: Calibration) -> None:
    """Write a calibration, whole or not at all and safely on the disk; only over another calibration.

    Raises:
        UnusableInputError: something else is there, the folder is missing, or it cannot be written.
    """
    check_writable(path)
    try:
        with whole_file(path, synced=True, shared=True) as partial:
            partial.write_text(as_text(calibration), encoding="utf-8")
    except OSError as error:
        raise UnusableInputError(f"cannot write {path}: {error.strerror}") from error


def keep_calibration(path: Path, calibration: Calibration) -> Path:
    """Write a calibration, a failed one beside one that passed and never over it; returns where it is.

    What is beside it is named ``<stem>.failed.toml``, with a number where another one that passed is there.

    Raises:
        UnusableInputError: as ``write_calibration``.
    """
    target, number = path, 1
    while calibration.verdict == "failed" and _passed(target):
        target = path.with_name(f"{path.stem}.failed{'' if number == 1 else f'_{number}'}.toml")
        number += 1
    write_calibration(target, calibration)
    return target


def _passed(path: Path) -> bool:
    """Whether a calibration that passed is there."""
    try:
        return read_calibration(path).verdict == "passed"
    except UnusableInputError:
        return False


def as_text(calibration: Calibration) -> str:
    """A calibration as TOML, with a head for whoever opens it."""
    head = (
        f"# {calibration.kind.capitalize()} calibration of {calibration.model}, {calibration.serial_number}.\n"
        "# SI units; std is one standard deviation. 'tissueid calibrate show FILE' tells it in words.\n\n"
    )
    return head + tomli_w.dumps(calibration.model_dump(mode="python", exclude_none=True))
