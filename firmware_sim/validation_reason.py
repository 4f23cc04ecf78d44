"""Reasons of pydantic for refusing a value, in plain words."""

from __future__ import annotations

from collections.abc import Iterable

from pydantic_core import ErrorDetails


def validation_reason(first: ErrorDetails, known: Iterable[str] = ()) -> str:
    """Return the reason of the first error; ``known`` are the names that are allowed in its place."""
    if first["type"] == "extra_forbidden":
        there_are = ", ".join(known)
        return "the name is unknown" + (f"; there are: {there_are}" if there_are else "")
    words = str(first["msg"]).removeprefix("Value error, ")
    if words == "Field required":
        return "it is missing"
    return f"it must be {words.removeprefix('Input should be ')}" if words.startswith("Input should be ") else words
