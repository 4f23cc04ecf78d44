"""The attributes of an exported test, in JSON beside it: all that the rows do not hold."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, fields
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, JsonValue, ValidationError

from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.options import reason
from tissueid.sessions.model import STATUSES, Session, Subject, Test
from tissueid.untrusted import RATES_HZ, json_value

FORMAT = "tissueid-export"
_MOST_BYTES = 50_000_000
_MOST = 1e300
"""No figure is larger; a whole number in JSON can be larger than any float."""


def _storable(text: str) -> str:
    """A text that an HDF5 file can hold."""
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
    """Whose session the test is from."""

    session_id: _Text = Field(min_length=1)
    created: _Text
    software: _Text
    audit_head: _Text = ""


class SubjectPart(_Part):
    """Who was measured."""

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
    """Everything about one exported test but its samples."""

    format: Literal["tissueid-export"] = "tissueid-export"
    format_version: Literal["1.0"] = "1.0"
    session: SessionPart
    instrument: dict[str, JsonValue]
    subject: SubjectPart
    test: TestPart
    columns: dict[_Name, ColumnPart]

    def device(self) -> DeviceDescription:
        """The instrument; what is not said of it is not known (NaN).

        Raises:
            UnusableInputError: a figure that is no number.
        """
        device = unknown_device()
        values: dict[str, str | float | dict[str, str | float]] = {}
        for field in fields(DeviceDescription):
            told = self.instrument.get(field.name, getattr(device, field.name))
            if field.name == "calibration":
                told = {} if told is None else told
                good = isinstance(told, dict) and all(isinstance(v, str | int | float | None) for v in told.values())
            elif field.type == "str":
                good = isinstance(told, str) and "\0" not in told
            else:
                told = math.nan if told is None else told
                good = isinstance(told, int | float) and not isinstance(told, bool) and not abs(told) > _MOST
            if not good:
                raise UnusableInputError(f"its attributes say instrument {field.name} {told!r:.60}")
            values[field.name] = told if not isinstance(told, int) else float(told)  # type: ignore[assignment]
        return DeviceDescription(**values)  # type: ignore[arg-type]

    def who(self) -> Subject:
        """The subject."""
        return Subject(self.subject.pseudonym, _numbers(self.subject.demographics))

    def filled(self, test: Test) -> Test:
        """A test with these attributes and the other's samples."""
        told = self.test
        return Test(
            number=told.number,
            kind=told.kind,
            signals=test.signals,
            sample_rate_hz=test.sample_rate_hz,
            configuration=told.configuration,
            site=told.site,
            preload_s=told.preload_s,
            surface_position_m=math.nan if told.surface_position_m is None else told.surface_position_m,
            stimulus=dict(told.stimulus),
            seed=told.seed,
            repeat_of=told.repeat_of,
            status=told.status if told.status in STATUSES else "completed",
            notes=_numbers(told.notes),
            units=test.units,
        )


def unknown_device() -> DeviceDescription:
    """An instrument of which nothing is known: no figure is made up."""
    figures = {field.name: math.nan for field in fields(DeviceDescription) if field.type == "float"}
    return DeviceDescription(model="unknown", serial_number="unknown", **figures)  # type: ignore[arg-type]


def attributes_text(session: Session, test: Test, columns: dict[str, ColumnPart]) -> str:
    """The attributes of a test as JSON; what is not finite is null."""
    told = {name: value for name, value in asdict(test).items() if name not in ("signals", "units")}
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
        "test": told | {"samples": test.samples},
        "columns": {name: part.model_dump() for name, part in columns.items()},
    }
    return json.dumps(_nulled(value), indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def attributes_beside(path: Path) -> Attributes | None:
    """What `tissueid export` put beside a file; None where there is nothing of the kind.

    Raises:
        UnusableInputError: it is there, but broken.
    """
    beside = path.with_suffix(".json")
    if beside == path or not beside.is_file():
        return None
    if beside.stat().st_size > _MOST_BYTES:
        raise UnusableInputError(f"the attributes beside it, {beside.name}, have more than {_MOST_BYTES} bytes")
    try:
        value = json_value(beside.read_bytes())
    except ValueError:
        return None  # somebody else's
    if not isinstance(value, dict) or value.get("format") != FORMAT:
        return None
    try:
        return Attributes.model_validate(value)
    except ValidationError as error:
        where = ".".join(str(step) for step in error.errors()[0]["loc"])
        raise UnusableInputError(
            f"the attributes beside it, {beside.name}, are broken at {where}: {reason(error)}"
        ) from error


def _numbers(told: dict[str, str | float | None]) -> dict[str, str | float]:
    return {name: math.nan if value is None else value for name, value in told.items()}


def _nulled(value: object) -> object:
    if isinstance(value, dict):
        return {str(key): _nulled(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_nulled(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
