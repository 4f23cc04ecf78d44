"""Calibration files: TOML with the measured quantities of one device, their uncertainties, and the conditions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tomli_w
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from tissueid.atomic_write import atomic_file
from tissueid.errors import UnusableInputError
from tissueid.messages import Message, message_from
from tissueid.plan_options import validation_reason
from tissueid.records import Estimate
from tissueid.untrusted_input import toml_table

FORMAT: Literal["tissueid-calibration"] = "tissueid-calibration"
MAX_BYTES = 1024 * 1024
"""Maximum size of a calibration file, bytes."""
MAX_ROWS = 10_000
"""Maximum number of rows of a table."""
_MAX_MESSAGES = 200
"""Maximum number of messages in a file."""

Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")]
Line = Annotated[str, Field(max_length=200, pattern=r"^[^\x00-\x1f\x7f]*$")]
"""Text of one line."""
Sentence = Annotated[str, Field(max_length=500, pattern=r"^[^\x00-\x1f\x7f]*$")]
Column = Annotated[tuple[Finite, ...], Field(max_length=MAX_ROWS)]


class CalibratedQuantity(BaseModel):
    """A value with its standard deviation and unit."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    value: Finite
    std: Annotated[float, Field(strict=True, ge=0, allow_inf_nan=False)] | None = None
    unit: Annotated[str, Field(max_length=32, pattern=r"^[^\x00-\x1f\x7f]*$")] = ""


class Calibration(BaseModel):
    """Calibration of one device.

    ``quantities`` are single values by name (``coil_resistance_ohm``, ``force_constant_n_per_a``,
    ``linear_region_min_m``, ...); ``tables`` are columns of equal length by name (``force_constant``: ``position_m``,
    ``value_n_per_a``, ``std_n_per_a``). ``problems`` are the reasons for a ``failed`` verdict. ``messages`` holds
    problems and notes a second time, as code, template and values (``Message.as_dict``), for translation.
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
    quantities: Annotated[dict[Name, CalibratedQuantity], Field(max_length=200)] = Field(default_factory=dict)
    tables: Annotated[dict[Name, dict[Name, Column]], Field(max_length=100)] = Field(default_factory=dict)
    messages: tuple[dict[str, Any], ...] = ()

    @field_validator("messages", mode="before")
    @classmethod
    def _valid_messages(cls, given: object) -> tuple[dict[str, Any], ...]:
        """Keep the entries that are messages and can be stored as TOML."""
        messages = [message_from(item) for item in given[:_MAX_MESSAGES]] if isinstance(given, list | tuple) else []
        return stored_messages(messages)

    @field_validator("date")
    @classmethod
    def _check_date(cls, text: str) -> str:
        try:
            time = datetime.fromisoformat(text)
        except ValueError:
            raise ValueError("must be a time such as 2026-03-01T09:30:00Z") from None
        if time.utcoffset() != timedelta(0):
            raise ValueError("must be a time in UTC, such as 2026-03-01T09:30:00Z")
        return text

    @field_validator("tables")
    @classmethod
    def _check_columns(cls, tables: dict[str, dict[str, Column]]) -> dict[str, dict[str, Column]]:
        for name, columns in tables.items():
            if len({len(column) for column in columns.values()}) > 1:
                raise ValueError(f"the columns of {name} differ in length")
            if len(columns) > 50:
                raise ValueError(f"{name} has more than 50 columns")
        return tables

    @property
    def made(self) -> datetime:
        """Date of the calibration, UTC."""
        return datetime.fromisoformat(self.date).astimezone(UTC)

    def age_days(self, now: datetime) -> float:
        """Return the age in days at ``now``; negative for a date in the future."""
        return (now - self.made) / timedelta(days=1)


def stored_messages(texts: Sequence[str]) -> tuple[dict[str, Any], ...]:
    """Return the messages among texts as dictionaries for TOML; messages with None among their values are left out."""
    stored = [text.as_dict() for text in texts if isinstance(text, Message)]
    return tuple(item for item in stored if not _has_none(item))[:_MAX_MESSAGES]


def _has_none(value: object) -> bool:
    if isinstance(value, dict | list):
        return any(_has_none(item) for item in (value.values() if isinstance(value, dict) else value))
    return value is None


def utc_date(now: datetime | None = None) -> str:
    """Format a time (default: now) in UTC, to the second, as calibration files store it."""
    return (now or datetime.now(UTC)).astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def read_calibration(path: Path) -> Calibration:
    """Read a calibration file; the content is validated.

    Raises:
        UnusableInputError: the file is missing, too large, not TOML, or not a calibration; names the invalid field.
    """
    if path.exists() and not path.is_file():
        raise UnusableInputError("calibration.not_a_file", "{path} is not a file", path=str(path))
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise UnusableInputError(
            "calibration.unreadable", "cannot read {path}: {reason}", path=str(path), reason=str(error.strerror)
        ) from error
    content = _parsed(path, data)
    if content.get("format") != FORMAT:
        raise _not_a_calibration(
            path, Message("calibration.wrong_format", "its format is not '{format}'", format=FORMAT)
        )
    try:
        return Calibration.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(str(part) for part in first["loc"] if part not in ("float", "tuple", "[key]")) or "content"
        raise UnusableInputError(
            "calibration.field",
            "{path}: field '{field}' cannot be used: {reason}",
            path=str(path),
            field=where[:100],
            reason=validation_reason(error),
        ) from error


def _parsed(path: Path, data: bytes) -> dict[str, object]:
    if len(data) > MAX_BYTES:
        raise UnusableInputError(
            "calibration.too_large",
            "{path} is too large for a calibration: the limit is {limit} KiB",
            path=str(path),
            limit=MAX_BYTES // 1024,
        )
    try:
        return toml_table(data)
    except UnicodeDecodeError as error:
        raise _not_a_calibration(path, Message("calibration.not_text", "it is not a text file")) from error
    except ValueError as error:
        raise _not_a_calibration(path, str(error).splitlines()[0][:200]) from error


def _not_a_calibration(path: Path, why: str) -> UnusableInputError:
    return UnusableInputError(
        "calibration.not_one", "{path} is not a calibration: {reason}", path=str(path), reason=why
    )


def check_writable(path: Path) -> None:
    """Raise if a calibration cannot be written to ``path``; called before any measurement.

    Raises:
        UnusableInputError: ``path`` is a folder, its folder is missing, or another kind of file exists there.
    """
    if path.is_dir():
        raise UnusableInputError("file.is_folder", "{path} is a folder; name a file", path=str(path))
    if not path.parent.is_dir():
        raise UnusableInputError("file.no_folder", "there is no folder {folder}", folder=str(path.parent))
    if path.exists():
        try:
            with path.open("rb") as file:
                content = _parsed(path, file.read(MAX_BYTES + 1))
        except (OSError, UnusableInputError):
            content = {}
        if content.get("format") != FORMAT:
            raise UnusableInputError(
                "calibration.other_file",
                "{path} exists and is not a calibration: it is not overwritten. Name another file",
                path=str(path),
            )


def write_calibration(path: Path, calibration: Calibration, *, new: bool = False) -> None:
    """Write a calibration atomically and flushed to the disk. Only another calibration is overwritten.

    Raises:
        FileExistsError: ``new``, and the file exists.
        UnusableInputError: another kind of file is there, the folder is missing, or writing fails.
    """
    if not new:
        check_writable(path)
    try:
        with atomic_file(path, synced=True, new=new, shared=True) as partial:
            partial.write_text(to_toml(calibration), encoding="utf-8")
    except FileExistsError:
        raise
    except OSError as error:
        raise UnusableInputError(
            "file.not_written", "cannot write {path}: {reason}", path=str(path), reason=str(error.strerror)
        ) from error


def save_calibration(path: Path, calibration: Calibration, *, overwrite: bool = False) -> Path:
    """Write a calibration and return its path. A failed calibration never overwrites a passed one.

    It is then written to ``<stem>.failed.toml``, ``<stem>.failed_2.toml`` and so on.

    Raises:
        UnusableInputError: see ``write_calibration``.
    """
    failed = calibration.verdict == "failed" and _has_passed(path)
    if overwrite and not failed:
        write_calibration(path, calibration)
        return path
    wanted = path.with_name(f"{path.stem}.failed.toml") if failed else path
    target, number = wanted, 2
    while True:
        try:
            write_calibration(target, calibration, new=True)
        except FileExistsError:
            target, number = wanted.with_name(f"{wanted.stem}_{number}{wanted.suffix}"), number + 1
        else:
            return target


def _has_passed(path: Path) -> bool:
    try:
        return read_calibration(path).verdict == "passed"
    except UnusableInputError:
        return False


def to_toml(calibration: Calibration) -> str:
    """Return a calibration as TOML with a header comment."""
    head = (
        f"# {calibration.kind.capitalize()} calibration of {calibration.model}, {calibration.serial_number}.\n"
        "# SI units; std is one standard deviation. 'tissueid calibrate show FILE' prints it as a table.\n\n"
    )
    content = calibration.model_dump(mode="python", exclude_none=True)
    if not calibration.messages:
        del content["messages"]
    return head + tomli_w.dumps(content)


# -- results of the steps of a calibration ---------------------------------------------------------------------------


@dataclass(frozen=True)
class CalibrationFindings:
    """Results of one step. ``problems`` make the verdict a failure; ``notes`` do not.

    ``shared`` is the part of a quantity's standard deviation that is common to all repeats, in the quantity's unit,
    such as the uncertainty of the spring.
    """

    quantities: dict[str, CalibratedQuantity] = field(default_factory=dict)
    tables: dict[str, dict[str, tuple[float, ...]]] = field(default_factory=dict)
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    shared: dict[str, float] = field(default_factory=dict)

    def value(self, name: str) -> float:
        """Return the value of a quantity from an earlier step.

        Raises:
            UnusableInputError: no step has measured it.
        """
        if name not in self.quantities:
            raise UnusableInputError("calibration.no_quantity", "the calibration does not contain {name}", name=name)
        return self.quantities[name].value

    def __add__(self, other: CalibrationFindings) -> CalibrationFindings:
        return CalibrationFindings(
            self.quantities | other.quantities,
            self.tables | other.tables,
            self.problems + other.problems,
            self.notes + other.notes,
            {name: std for name, std in self.shared.items() if name not in other.quantities} | other.shared,
        )


def quantity(estimate: Estimate | float, unit: str, std: float | None = None) -> CalibratedQuantity:
    """Return a quantity of a calibration file. A standard deviation that is not finite is omitted.

    Standard deviations of an inverted channel, scaled by a negative value, are made positive.
    """
    measured = estimate if isinstance(estimate, Estimate) else Estimate(estimate, std)
    stored_std = None if measured.std is None or not np.isfinite(measured.std) else abs(float(measured.std))
    return CalibratedQuantity(value=float(measured.value), std=stored_std, unit=unit)


def column(values: ArrayLike) -> tuple[float, ...]:
    """Return a column of a table, rounded to seven digits."""
    return tuple(float(f"{value:.7g}") for value in np.asarray(values, np.float64))


def mean_of_repeats(runs: Sequence[CalibrationFindings]) -> CalibrationFindings:
    """Return the mean of several runs of the same steps.

    The random part of the standard deviation of a mean is the larger of the runs' own estimate and their scatter,
    divided by the square root of their number; the part shared by all runs is not reduced. A problem of one run is a
    problem of the result. The table ``repeats`` holds the quantities of each run; other tables are from the first run.
    """
    first = runs[0]
    if len(runs) == 1:
        return first
    names = [name for name in first.quantities if all(name in run.quantities for run in runs)]
    quantities = {}
    for name in names:
        values = np.array([run.quantities[name].value for run in runs])
        stds = [run.quantities[name].std for run in runs]
        own = float(np.mean([std for std in stds if std is not None])) if None not in stds else 0.0
        scatter = float(np.std(values, ddof=1))
        shared = float(np.mean([run.shared.get(name, 0.0) for run in runs]))
        random = max(float(np.sqrt(max(0.0, own**2 - shared**2))), scatter) / len(runs) ** 0.5
        quantities[name] = quantity(float(values.mean()), first.quantities[name].unit, float(np.hypot(shared, random)))
    repeats = {"run": column(np.arange(1, len(runs) + 1))} | {
        name: column([run.quantities[name].value for run in runs]) for name in names
    }
    return CalibrationFindings(
        quantities,
        first.tables | {"repeats": dict(list(repeats.items())[:50])},
        tuple(dict.fromkeys(problem for run in runs for problem in run.problems)),
        tuple(dict.fromkeys(note for run in runs for note in run.notes)),
        first.shared,
    )
