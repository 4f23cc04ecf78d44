"""Attributes of an exported test: a JSON file next to it with everything except the samples."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, TypeAdapter, ValidationError

from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.messages import Message, Verbatim
from tissueid.plan_options import validation_reason
from tissueid.sessions.model import ORIGIN, STATUSES, Origin, Session, Subject, Test, attributes_of
from tissueid.untrusted_input import StoredName, StoredText, json_value

FORMAT = "tissueid-export"
_MOST_BYTES = 50_000_000
_Name = Annotated[StoredName, Field(max_length=200, pattern=r"^[^/]+$")]


class _Part(BaseModel):
    model_config = ConfigDict(strict=True, extra="ignore", frozen=True)


class ColumnPart(_Part):
    """A signal's column and its unit, SI."""

    column: StoredText
    unit: StoredText


def _stated(origin: object) -> object:
    """Return the origin of a session after checking that it is stated: its defaults are those of a new session."""
    for name in ORIGIN:
        if isinstance(origin, dict) and name not in origin and name != "audit_head":
            raise ValueError(Message("import.no_origin", "it does not state '{name}'", name=Verbatim(name)))
    return origin


class Attributes(_Part):
    """Attributes of one exported test."""

    format: Literal["tissueid-export"] = "tissueid-export"
    format_version: Literal["1.0"] = "1.0"
    session: Annotated[Origin, BeforeValidator(_stated)]
    instrument: dict[str, Any]
    subject: Subject
    test: Test
    """The test, without its samples."""
    columns: dict[_Name, ColumnPart]

    def device(self) -> DeviceDescription:
        """Return the instrument; missing parameters are NaN.

        Raises:
            UnusableInputError: a parameter is not a number.
        """
        given = {name: value for name, value in self.instrument.items() if value is not None}
        values = json.dumps(asdict(unknown_device()) | given)
        try:
            device = TypeAdapter(DeviceDescription).validate_json(values, strict=True)
        except ValidationError as error:
            raise self._invalid(str(error.errors()[0]["loc"][0])) from error
        for name, value in vars(device).items():
            if value in (math.inf, -math.inf):  # an integer in JSON can exceed any float
                raise self._invalid(name)
        return device

    def _invalid(self, name: str) -> UnusableInputError:
        return UnusableInputError(
            "import.instrument_value",
            "its attributes say instrument {name}: {value}",
            name=name,
            value=f"{self.instrument[name]!r:.60}",
        )

    def filled(self, test: Test) -> Test:
        """Return a test with these attributes and the samples of ``test``."""
        status = self.test.status if self.test.status in STATUSES else "completed"
        kept = {name: getattr(test, name) for name in ("signals", "sample_rate_hz", "units")}
        return replace(self.test, status=status, **kept)


def unknown_device() -> DeviceDescription:
    """Return an instrument whose parameters are all unknown (NaN)."""
    figures = {field.name: math.nan for field in fields(DeviceDescription) if isinstance(field.default, float)}
    return DeviceDescription(model="unknown", serial_number="unknown", **figures)  # type: ignore[arg-type]


def attributes_text(session: Session, test: Test, columns: dict[str, ColumnPart]) -> str:
    """Return the attributes of a test as JSON; values that are not finite are null."""
    value = {
        "format": FORMAT,
        "format_version": "1.0",
        "session": {name: getattr(session, name) for name in ORIGIN},
        "instrument": asdict(session.instrument),
        "subject": asdict(session.subject),
        "test": {"number": test.number} | attributes_of(test) | {"samples": test.samples},
        "columns": {name: part.model_dump() for name, part in columns.items()},
    }
    return json.dumps(_nulled(value), indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def attributes_beside(path: Path) -> Attributes | None:
    """Read the attributes file that ``tissueid export`` wrote next to a file; None without one.

    Raises:
        UnusableInputError: it exists but is invalid.
    """
    file_path = path.with_suffix(".json")
    if file_path == path or not file_path.is_file():
        return None
    if file_path.stat().st_size > _MOST_BYTES:
        raise UnusableInputError(
            "import.attributes_too_large",
            "its attributes file {file} has more than {most} bytes",
            file=file_path.name,
            most=_MOST_BYTES,
        )
    try:
        value = json_value(file_path.read_bytes())
    except ValueError:
        return None  # a file of another program
    if not isinstance(value, dict) or value.get("format") != FORMAT:
        return None
    if isinstance(value.get("test"), dict):
        value["test"]["signals"] = {}
    try:
        return Attributes.model_validate_json(json.dumps(value))
    except ValidationError as error:
        where = ".".join(str(step) for step in error.errors()[0]["loc"])
        raise UnusableInputError(
            "import.attributes_invalid",
            "its attributes file {file} is invalid at {field}: {reason}",
            file=file_path.name,
            field=where,
            reason=validation_reason(error),
        ) from error


def _nulled(value: object) -> object:
    if isinstance(value, dict):
        return {str(key): _nulled(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_nulled(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
