"""Validation models for the JSON entries of a journal: a valid checksum does not imply valid content."""

from __future__ import annotations

from dataclasses import fields
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, JsonValue, ValidationError, model_validator

from tissueid.acquisition.journal_entries import Damage
from tissueid.device import DeviceDescription
from tissueid.instrument import SAMPLE
from tissueid.sessions import MAX_TESTS

MAX_RUN_SAMPLES = 20_000_000
"""Maximum number of samples of a run."""
MAX_JSON = 4 * 1024 * 1024
"""Maximum size of a JSON entry, bytes: four times the longest text in a session."""
_MAX_TEXT = 1_000_000
_MAX_NAME = 1_000


def _without_nul(text: str) -> str:
    if "\0" in text:
        raise ValueError("a text holds a null character")
    return text


Text = Annotated[str, Field(max_length=_MAX_TEXT), AfterValidator(_without_nul)]
Name = Annotated[str, Field(min_length=1, max_length=_MAX_NAME), AfterValidator(_without_nul)]
Whole = Annotated[int, Field(ge=-(2**63), lt=2**64)]
"""Range of an integer attribute of HDF5."""
Note = bool | Whole | float | Text
Number = Annotated[int, Field(ge=0, le=MAX_TESTS)]


class _Content(BaseModel):
    model_config = ConfigDict(strict=True, frozen=True, extra="ignore")


class SubjectContent(_Content):
    """Content of a ``sessions.Subject``."""

    pseudonym: Text = "anonymous"
    demographics: dict[Name, Note] = {}


class SittingContent(_Content):
    """Subject and instrument of a sitting. ``sample_fields`` are those of ``instrument.SAMPLE``."""

    session_id: Text
    created: Text
    device: DeviceDescription
    subject: SubjectContent
    sample_fields: list[tuple[str, str]]
    audit_head: Text = ""

    @model_validator(mode="after")
    def _usable(self) -> SittingContent:
        if self.sample_fields != [tuple(item) for item in SAMPLE.descr]:
            raise ValueError("its samples have a layout that this software does not know")
        for field in fields(self.device):
            if isinstance(value := getattr(self.device, field.name), str):
                _without_nul(value)
        return self


class RunContent(_Content):
    """Content of an ``instrument.Run``."""

    first_index: Annotated[int, Field(ge=0, lt=2**62)]
    samples: Annotated[int, Field(gt=0, le=MAX_RUN_SAMPLES)]


class AttributesContent(_Content):
    """Attributes of ``sessions.Test`` that are known when the test begins."""

    kind: Text
    sample_rate_hz: Annotated[float, Field(ge=1e-3, le=1e9)]
    configuration: Text = "indentation"
    site: Text = ""
    preload_s: Annotated[float, Field(ge=0.0, le=1e9)] = 0.0
    surface_position_m: float = float("nan")
    stimulus: dict[str, JsonValue] = {}
    seed: Whole = 0
    repeat_of: Number | None = None
    notes: dict[Name, Note] = {}


class TestContent(_Content):
    """Header of a test; ``again`` marks a repetition during the test."""

    __test__ = False

    number: Number
    run: RunContent
    attributes: AttributesContent
    again: bool = False


class TestEndContent(_Content):
    """End of a test; ``samples`` is its length if it ended early."""

    __test__ = False

    status: Text
    notes: dict[Name, Note] = {}
    test: Number | None = None
    samples: int | None = None


class ClosedContent(_Content):
    """End of a sitting."""

    audit_head: Text | None = None


class EventContent(BaseModel):
    """An event with arbitrary names and values."""

    model_config = ConfigDict(strict=True, frozen=True, extra="allow")
    __pydantic_extra__: dict[str, JsonValue]

    kind: Text
    test: Number | None = None

    def as_note(self) -> dict[str, Any]:
        """Return the event without the number of its test."""
        return self.model_dump(exclude={"test"})


_Model = TypeVar("_Model", bound=BaseModel)


def content_of(model: type[_Model], payload: bytes, damage: Damage) -> _Model | None:
    """Return the validated content of an entry; count an invalid one as damage and return None."""
    try:
        if len(payload) > MAX_JSON:
            raise ValueError("longer than any entry that this software writes")
        return model.model_validate_json(payload)
    except (ValidationError, ValueError, RecursionError):
        damage.add(len(payload))
        return None
