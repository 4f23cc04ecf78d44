"""Why a figure of a scenario is refused, in plain words."""

from __future__ import annotations

from collections.abc import Iterable

from pydantic_core import ErrorDetails


def why(first: ErrorDetails, known: Iterable[str] = ()) -> str:
    """Why the first thing that does not hold does not; ``known`` are the names that may stand in its place."""
    if first["type"] == "extra_forbidden":
        there_are = ", ".join(known)
        return "nothing of that name belongs there" + (f"; there are: {there_are}" if there_are else "")
    words = str(first["msg"]).removeprefix("Value error, ")
    if words == "Field required":
        return "it is missing"
    return f"it must be {words.removeprefix('Input should be ')}" if words.startswith("Input should be ") else words
