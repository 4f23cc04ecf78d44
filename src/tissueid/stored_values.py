"""Field types of values that are stored as JSON: texts with their message codes, and numbers that may be missing."""

from __future__ import annotations

import math
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, PlainSerializer, PlainValidator

from tissueid.messages import Message, message_from

LONGEST_TEXT = 5000
"""Maximum length of a stored text, in characters."""


def finite(value: Any) -> Any:
    """Return a value for JSON: numbers that are not finite become None, keys texts, numpy's numbers Python's."""
    if isinstance(value, dict):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _text_from(stored: object) -> str:
    if isinstance(stored, dict):
        stored = message_from(stored, stored.get("text", ""))
    if not isinstance(stored, str) or len(stored) > LONGEST_TEXT:
        raise ValueError(f"a text is a string or a message of at most {LONGEST_TEXT} characters")
    return stored


def _stored_text(text: str) -> Any:
    return {"text": str(text), **text.as_dict()} if isinstance(text, Message) else text


MessageText = Annotated[str, PlainValidator(_text_from), PlainSerializer(_stored_text)]
"""A ``str``, or a ``Message`` stored with its code, template and values."""
Texts = Annotated[tuple[MessageText, ...], Field(max_length=200)]
Name = Annotated[str, Field(min_length=1, max_length=60)]
"""Name of an engine, an option or a parameter."""
Number = Annotated[
    float, BeforeValidator(lambda stored: math.nan if stored is None else stored), PlainSerializer(finite)
]
"""A number; NaN is stored as null."""
MaybeNumber = Annotated[float | None, PlainSerializer(finite)]
"""A number, or None where it is unknown; what is not finite is stored as null."""
