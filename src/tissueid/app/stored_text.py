"""Texts in files of the window. A stored message is shown in the language of the window that reads it."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import PlainSerializer, PlainValidator

from tissueid.messages import Message, message_from

LONGEST_TEXT = 5000
"""Maximum length of a stored text, in characters."""


def _read(stored: object) -> str:
    if isinstance(stored, dict):
        stored = message_from(stored, stored.get("text", ""))
    if not isinstance(stored, str) or len(stored) > LONGEST_TEXT:
        raise ValueError(f"a text is a string or a message of at most {LONGEST_TEXT} characters")
    return stored


def _plain(text: str) -> Any:
    return {"text": str(text), **text.as_dict()} if isinstance(text, Message) else text


StoredText = Annotated[str, PlainValidator(_read), PlainSerializer(_plain)]
"""Field type of pydantic models: a ``str``, or a ``Message`` stored with its code, template and values."""
