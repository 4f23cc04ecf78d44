"""Attributes of an exported test: a JSON file next to it with everything except the samples."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, fields
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, JsonValue, ValidationError

from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.option_errors import validation_reason
from tissueid.sessions.model import STATUSES, Session, Subject, Test
from tissueid.untrusted_input import RATES_HZ, json_value

FORMAT = "tissueid-export"
_MOST_BYTES = 50_000_000
_MOST = 1e300
"""Largest value; an integer in JSON can exceed any float."""


def _storable(text: str) -> str:
    """Return a text that HDF5 can store; raise ValueError for others."""
    if "\0" in text or any("\ud800" <= mark <= "\udfff" for mark in text):
        raise ValueError("a text with characters that are none")
    return text


_Text = Annotated[str, Field(max_length=1_000_000), AfterValidator(_storable)]
_Name = Annotated[str, Field(max_length=200, pattern=r"^[^/\x00]+$"), AfterValidator(_storable)]
_Number = Annotated[float, Field(allow_inf_nan=False)]
_Nullable = _Number | None
"""NaN is null in JSON."""


class _Part(BaseModel):
    model_config = ConfigDict(strict=True, extra="ignore", frozen=True)


class SessionPart(_Part):
    """The session of the test."""

    session_id: _Text = Field(min_length=1)
    created: _Text
    software: _Text
    audit_head: _Text = ""


class SubjectPart(_Part):
    """The subject."""

    pseudonym: _Text = "anonymous"
    demographics: dict[_Name, _Text | _Nullable] = {}


class TestPart(_Part):
    """The test, without its samples."""

    __test__ = False

    number: int = Field(ge=0, le=9999)
    samples: int = Field(gt=0)
    kind: _Text
    sample_rate_hz: _Number = Field(ge=RATES_HZ[0], le=RATES_HZ[1])
    configuration: _Text = "indentation"
    site: _Text = ""
    preload_s: _Number = Field(ge=0, default=0.0)
    surface_position_m: _Nullable = None
    stimulus: dict[str, JsonValue] = {}
    seed: int = Field(ge=-(2**63), lt=2**63, default=0)
    repeat_of: int | None = Field(ge=0, le=9999, default=None)
    status: _Text = "completed"
    notes: dict[_Name, _Text | _Nullable] = {}


class ColumnPart(_Part):
    """A signal's column and its unit, SI."""

    column: _Text
    unit: _Text


class Attributes(_Part):
    """Attributes of one exported test."""

    format: Literal["tissueid-export"] = "tissueid-export"
    format_version: Literal["1.0"] = "1.0"
    session: SessionPart
    instrument: dict[str, JsonValue]
    subject: SubjectPart
    test: TestPart
    columns: dict[_Name, ColumnPart]

    def device(self) -> DeviceDescription:
        """Return the instrument; missing parameters are NaN.

        Raises:
            UnusableInputError: a parameter is not a number.
        """
        device = unknown_device()
        values: dict[str, str | float | dict[str, str | float]] = {}
        for field in fields(DeviceDescription):
            stored = self.instrument.get(field.name, getattr(device, field.name))
            if field.name == "calibration":
                stored = {} if stored is None else stored
                good = isinstance(stored, dict) and all(
                    isinstance(v, str | int | float | None) for v in stored.values()
                )
            elif field.type == "str":
                good = isinstance(stored, str) and "\0" not in stored
            else:
                stored = math.nan if stored is None else stored
                good = isinstance(stored, int | float) and not isinstance(stored, bool) and not abs(stored) > _MOST
            if not good:
                raise UnusableInputError(
                    "import.instrument_value",
                    "its attributes say instrument {name}: {value}",
                    name=field.name,
                    value=f"{stored!r:.60}",
                )
            values[field.name] = stored if not isinstance(stored, int) else float(stored)  # type: ignore[assignment]
        return DeviceDescription(**values)  # type: ignore[arg-type]

    def who(self) -> Subject:
        """Return the subject."""
        return Subject(self.subject.pseudonym, _numbers(self.subject.demographics))

    def filled(self, test: Test) -> Test:
        """Return a test with these attributes and the samples of ``test``."""
        stored = self.test
        return Test(
            number=stored.number,
            kind=stored.kind,
            signals=test.signals,
            sample_rate_hz=test.sample_rate_hz,
            configuration=stored.configuration,
            site=stored.site,
            preload_s=stored.preload_s,
            surface_position_m=math.nan if stored.surface_position_m is None else stored.surface_position_m,
            stimulus=dict(stored.stimulus),
            seed=stored.seed,
            repeat_of=stored.repeat_of,
            status=stored.status if stored.status in STATUSES else "completed",
            notes=_numbers(stored.notes),
            units=test.units,
        )


def unknown_device() -> DeviceDescription:
    """Return an instrument whose parameters are all unknown (NaN)."""
    figures = {field.name: math.nan for field in fields(DeviceDescription) if field.type == "float"}
    return DeviceDescription(model="unknown", serial_number="unknown", **figures)  # type: ignore[arg-type]


def attributes_text(session: Session, test: Test, columns: dict[str, ColumnPart]) -> str:
    """Return the attributes of a test as JSON; values that are not finite are null."""
    stored = {name: value for name, value in asdict(test).items() if name not in ("signals", "units")}
    value = {
        "format": FORMAT,
        "format_version": "1.0",
        "session": {
            "session_id": session.session_id,
            "created": session.created,
            "software": session.software,
            "audit_head": session.audit_head,
        },
        "instrument": asdict(session.instrument),
        "subject": asdict(session.subject),
        "test": stored | {"samples": test.samples},
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
    try:
        return Attributes.model_validate(value)
    except ValidationError as error:
        where = ".".join(str(step) for step in error.errors()[0]["loc"])
        raise UnusableInputError(
            "import.attributes_invalid",
            "its attributes file {file} is invalid at {field}: {reason}",
            file=file_path.name,
            field=where,
            reason=validation_reason(error),
        ) from error


def _numbers(stored: dict[str, str | float | None]) -> dict[str, str | float]:
    return {name: math.nan if value is None else value for name, value in stored.items()}


def _nulled(value: object) -> object:
    if isinstance(value, dict):
        return {str(key): _nulled(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_nulled(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
