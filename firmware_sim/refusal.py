"""Why a figure of a scenario is refused, in plain words."""

from __future__ import annotations

from pydantic_core import ErrorDetails


def why(first: ErrorDetails) -> str:
    """Why the first thing that does not hold does not."""
    if first["type"] == "extra_forbidden":
        return "nothing of that name belongs there"
    words = str(first["msg"]).removeprefix("Value error, ")
    if words == "Field required":
        return "it is missing"
    return f"it must be {words.removeprefix('Input should be ')}" if words.startswith("Input should be ") else words
